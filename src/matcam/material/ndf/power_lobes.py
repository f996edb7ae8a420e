"""Lobes with a roughness and a power, which determines the shapes of the peak and of the flanks."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from matcam.core import checks
from matcam.core.arrays import special, xp
from matcam.core.arrays.elementary import power
from matcam.material.lambda_table import integrated_lambda
from matcam.material.ndf.distribution import MixtureNDF, SlopeNDF, checked_roughness

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_NORM_NODES = np.polynomial.legendre.leggauss(96)
_MIXTURE_NODES = 96
_LOWEST = -13.0  # ln of the finest difference of exponents that the mixture resolves
_FADED = 40.0  # exponent at which the integrand is negligible, exp(-40)


class EPD(SlopeNDF):
    """Exponential power distribution of slopes.

    The density of facet normals is D = p / (pi beta^2 Gamma(1/p)) exp(-(tan^2 theta_h / beta^2)^p) / cos^4 theta_h,
    1/sr. theta_h is the angle between the normals of facet and surface. For p = 1, D is the Beckmann distribution.

    Args:
        beta: roughness, a slope, no unit, (0, 1].
        power: p, no unit, [0.25, 4]. Below 1, the lobe has a sharp peak on broad flanks. Below 1/2, the derivative of D
            is also infinite at the peak. Above 1, the lobe has a flat top.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        Holzschuch & Pacanowski (2017); docs/model.md 6.

    Example:
        >>> lobe = matcam.EPD(0.1, 0.5)
        >>> round(float(lobe.d(0.0) / matcam.Beckmann(0.1).d(0.0)), 6)
        0.5
    """

    beta: jax.Array
    power: jax.Array

    family = "epd"
    largest = 1.0

    def __init__(self, beta: ArrayLike, power: ArrayLike):
        self.beta = checked_roughness("beta", beta, self.largest)
        self.power = checks.scalar("power", checks.within("power", power, 0.25, 4))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute the density of slopes.

        The density is P22 = p / (pi beta^2 Gamma(1/p)) exp(-(slope^2 / beta^2)^p).
        """
        peak = self.power / (xp.pi * self.beta**2 * xp.exp(special.gammaln(1 / self.power)))
        at_peak = slope2 == 0  # the derivative of x^p is infinite or of the form 0 ln 0 there
        x = xp.where(at_peak, 1.0, slope2 / self.beta**2)
        return peak * xp.exp(-xp.where(at_peak, 0.0, power(x, self.power)))

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda by its integral over slopes."""
        return integrated_lambda(self.slope_density, self.beta, cos)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, beta, a slope, no unit."""
        return self.beta


class SGD(SlopeNDF, MixtureNDF):
    """Shifted gamma distribution of slopes.

    The density of facet normals is D = K exp(-x) / (pi x^p cos^4 theta_h), 1/sr, with x = alpha + tan^2 theta_h / alpha
    and K = 1 / (alpha Gamma(1 - p, alpha)). theta_h is the angle between the normals of facet and surface, and Gamma is
    the upper incomplete gamma function.

    The denominator of the published BRDF contains pi instead of the 4 of a microfacet BRDF. For equal Fresnel terms, the
    published BRDF is therefore larger than the BRDF of `Microfacet` by the factor `published_over_ours`. The published
    model also has fitted functions for masking and the Fresnel term.

    Args:
        alpha: roughness, a slope, no unit, (0, 1]. The core of the lobe has a width of about alpha, and its flanks have
            a width of sqrt(alpha).
        power: p, no unit, (0, 2]. Larger values make the core sharper relative to its flanks.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        Bagher, Soler & Holzschuch (2012).

    Example:
        >>> lobe = matcam.SGD(0.01, 0.8)
        >>> float(lobe.d(0.0)) > float(lobe.d(0.01))
        True
    """

    alpha: jax.Array
    power: jax.Array

    family = "sgd"
    largest = 1.0
    published_over_ours: ClassVar[float] = 4 / np.pi

    def __init__(self, alpha: ArrayLike, power: ArrayLike):
        self.alpha = checked_roughness("alpha", alpha, self.largest)
        self.power = checks.scalar("power", checks.within("power", power, 0, 2, open_low=True))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute the density of slopes.

        The density is P22 = K exp(-x) / (pi x^p), with K, x and p as in the class.
        """
        fall = slope2 / self.alpha
        above = fall / self.alpha  # x = alpha (1 + above)
        peak = 1 / (xp.pi * self.alpha**2 * self._integral)
        return peak * xp.exp(-fall) * power(1 + above, -self.power)

    @property
    def _integral(self) -> jax.Array:
        """Integrate e^(alpha - x) (x / alpha)^-p dx / alpha over x > alpha.

        The variable of integration is v = ln(x / alpha). The integral is Gamma(1 - p, alpha) without the factor
        alpha^(1 - p) e^-alpha, which may overflow.
        """
        nodes, weights = _NORM_NODES
        reach = xp.log1p(_FADED / self.alpha)
        v = reach * (nodes + 1) / 2
        return reach / 2 * (xp.exp((1 - self.power) * v - self.alpha * xp.expm1(v)) @ weights)

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """Compute weights and widths of the Gaussians whose sum is the lobe.

        The trapezoid rule in ln(u - 1) converts an integral over u > 1 to this sum. The integral of
        (u - 1)^(p - 1) exp(-u x) du / Gamma(p) is x^-p exp(-x), with x and p as in the class. One Gaussian, at the mean
        u, represents the range below the first node. The error is 1e-10 of the peak for alpha >= 1e-6.
        """
        highest = xp.log(_FADED / self.alpha)
        step = (highest - _LOWEST) / (_MIXTURE_NODES - 2)
        log_excess = _LOWEST + step * xp.arange(_MIXTURE_NODES - 1)
        excess = xp.exp(log_excess)
        # the weights of the nodes below the first form a geometric series down to u = 1
        remainder = xp.exp(self.power * (_LOWEST - step)) / -xp.expm1(-self.power * step)
        remainder_excess = xp.exp(_LOWEST - step) * xp.expm1(-self.power * step) / xp.expm1(-(1 + self.power) * step)
        u = 1 + xp.append(remainder_excess, excess)
        weights = xp.append(remainder, xp.exp(self.power * log_excess)) * xp.exp(-self.alpha * (u - 1))
        return weights / xp.sum(weights), xp.sqrt(self.alpha / (2 * u))

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda by its integral over slopes."""
        return integrated_lambda(self.slope_density, self.alpha, cos)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, alpha, a slope, no unit."""
        return self.alpha
