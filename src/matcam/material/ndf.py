"""Normal distribution functions: how a rough surface's microfacets are tilted (MODEL 6).

Near its peak an NDF is, as a function of a tangent-plane coordinate r, a mixture of Gaussians

    D(theta_h) = D(0) flattening(theta_h) sum_j weight_j exp(-r^2 / (2 width_j^2)),     r = coordinate(theta_h),

because a camera's effect on a Gaussian has a closed form (forward/lobe.py).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.material import masking

_MIXTURE_NODES = 56


class NDF(eqx.Module):
    """An isotropic distribution of microfacet normals; the integral of D cos over the hemisphere is 1."""

    family: ClassVar[str]
    """Its name where a family of NDFs is asked for: on the command line, in `fresnel`."""
    largest: ClassVar[float]
    """Largest value of its roughness, the constructor's argument."""

    @abstractmethod
    def d(self, theta_h: ArrayLike) -> jax.Array:
        """D, 1/sr, at angle theta_h (rad) from the surface normal."""

    @abstractmethod
    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """Tangent-plane coordinate r of theta_h (an angle or a slope)."""

    @abstractmethod
    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """D divided by D(0) and by the mixture: what the tangent plane leaves out; 1 at the peak."""

    @abstractmethod
    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """(weights, widths) of the Gaussians in r, each shape (n,); weights sum to 1."""

    @property
    @abstractmethod
    def roughness(self) -> jax.Array:
        """The one number that its width goes with; also the scale of the facets' slopes."""

    def slope_density(self, slope: jax.Array) -> jax.Array:
        """P22: distribution of the facets' slopes, D cos^4; integrates to 1 over the plane."""
        return self.d(jnp.arctan(slope)) / (1 + slope**2) ** 2

    def g1(self, theta: ArrayLike) -> jax.Array:
        """Smith masking: share of the facets seen from `theta` (rad) that others do not hide."""
        theta = checks.within("theta", theta, 0, np.pi / 2, "rad")
        return 1 / (1 + masking.smith_lambda(self.slope_density, self.roughness, theta))


class GaussianNDF(NDF):
    """D proportional to exp(-theta_h^2 / (2 width^2)): the paper's lobe. width: rad, (0, 0.5]."""

    width: jax.Array

    family = "gaussian"
    largest = 0.5  # rad; beyond, a Gaussian in theta_h does not die out before the horizon

    def __init__(self, width: ArrayLike):
        self.width = checks.scalar("width", checks.within("width", width, 0, self.largest, "rad", open_low=True))

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """exp(-theta_h^2 / (2 width^2)), normalised by quadrature of D cos over the hemisphere."""
        return jnp.exp(-((checks.number("theta_h", theta_h) / self.width) ** 2) / 2) / self._integral

    @property
    def _integral(self) -> jax.Array:
        nodes, weights = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(64))
        reach = jnp.minimum(jnp.pi / 2, 9 * self.width)
        theta = reach * (nodes + 1) / 2
        inside = jnp.exp(-((theta / self.width) ** 2) / 2) * jnp.sin(2 * theta)
        return jnp.pi * reach / 2 * (inside @ weights)

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """theta_h itself."""
        return theta_h

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """1: the lobe is Gaussian in theta_h."""
        return jnp.ones_like(theta_h)

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """One Gaussian."""
        return jnp.ones(1), self.width[None]

    @property
    def roughness(self) -> jax.Array:
        """The width, rad."""
        return self.width

    def __repr__(self) -> str:
        return f"GaussianNDF(width={self.width!s})"


class GGX(NDF):
    """Trowbridge-Reitz: D = alpha^2 / (pi (cos^2 theta_h (alpha^2 - 1) + 1)^2) (Walter et al. 2007, (33)).

    alpha: roughness, a slope, (0, 1].
    """

    alpha: jax.Array

    family = "ggx"
    largest = 1.0

    def __init__(self, alpha: ArrayLike):
        self.alpha = checks.scalar("alpha", checks.within("alpha", alpha, 0, self.largest, open_low=True))

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """D, 1/sr; the denominator as sin^2 + alpha^2 cos^2, which keeps its digits for a sharp lobe."""
        theta_h = checks.number("theta_h", theta_h)
        spread = jnp.sin(theta_h) ** 2 + (self.alpha * jnp.cos(theta_h)) ** 2
        return (self.alpha / spread) ** 2 / jnp.pi

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """The slope tan theta_h."""
        return jnp.tan(theta_h)

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """cos^-4 theta_h, from slopes to solid angle."""
        return jnp.cos(theta_h) ** -4

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """(1 + r^2)^-2 = integral of t exp(-t) exp(-t r^2) dt, by the trapezoid rule in ln t (MODEL 4): 2e-11 of the
        peak, to r = 1e3 alpha."""
        log_t = np.linspace(-14.0, 3.9, _MIXTURE_NODES)
        t = np.exp(log_t)
        weights = t**2 * np.exp(-t)
        return jnp.asarray(weights / weights.sum()), self.alpha / np.sqrt(2 * t)

    @property
    def roughness(self) -> jax.Array:
        """alpha."""
        return self.alpha

    def __repr__(self) -> str:
        return f"GGX(alpha={self.alpha!s})"


FAMILIES: dict[str, type[NDF]] = {cls.family: cls for cls in (GaussianNDF, GGX)}
"""NDFs of one roughness, by name."""
