"""GGX distributions of slopes, isotropic and anisotropic (Trowbridge & Reitz 1975; Walter et al. 2007)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.core.arrays import xp
from matcam.material.masking import NEAREST
from matcam.material.ndf.distribution import MixtureNDF, SlopeNDF, StretchedSlopes, checked_roughness

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_MIXTURE_NODES = 56  # number of Gaussians, whose sum has an error of 2e-11 of the peak


class GGX(SlopeNDF, MixtureNDF):
    """GGX (Trowbridge-Reitz) distribution, with long tails.

    The density of facet normals is D = alpha^2 / (pi (cos^2 theta_h (alpha^2 - 1) + 1)^2), 1/sr. theta_h is the angle
    between the normals of facet and surface. The density of slopes is alpha^2 / (pi (alpha^2 + slope^2)^2).

    Args:
        alpha: roughness, a slope, no unit, (0, 1].

    Raises:
        ArgumentError: alpha is out of range, or not a single number.

    Source:
        Trowbridge & Reitz (1975); Walter et al. (2007), (33).

    Example:
        >>> lobe = matcam.GGX(0.1)
        >>> round(float(lobe.d(0.0)), 4), round(float(lobe.g1(0.0)), 4)
        (31.831, 1.0)
    """

    alpha: jax.Array

    family = "ggx"
    largest = 1.0

    def __init__(self, alpha: ArrayLike):
        self.alpha = checked_roughness("alpha", alpha, self.largest)

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute the density of slopes.

        The density is P22 = alpha^2 / (pi (alpha^2 + slope^2)^2).
        """
        return (self.alpha / (self.alpha**2 + slope2)) ** 2 / xp.pi

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda in closed form.

        Lambda is (sqrt(1 + alpha^2 tan^2 theta) - 1) / 2, where theta is the angle of the direction to the normal
        (from Walter et al. 2007, (34)).
        """
        cos = xp.maximum(cos, NEAREST)
        return ggx_lambda(cos, self.alpha**2 * (1 - cos) * (1 + cos))

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """Compute weights and widths of the Gaussians whose sum is the lobe.

        The trapezoid rule in ln t converts an integral over t > 0 to this sum (docs/model.md 4). The integral of
        t exp(-t) exp(-t x^2) dt is (1 + x^2)^-2, the lobe at the slope r = alpha x. The error is 2e-11 of the peak up to
        r = 1e3 alpha.
        """
        log_t = np.linspace(-14.0, 3.9, _MIXTURE_NODES)
        t = np.exp(log_t)
        weights = t**2 * np.exp(-t)
        return xp.asarray(weights / weights.sum()), self.alpha / np.sqrt(2 * t)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, alpha, a slope, no unit."""
        return self.alpha


class AnisotropicGGX(StretchedSlopes):
    """Anisotropic GGX distribution with two roughnesses.

    It describes brushed and turned metals, whose slopes along and across the grooves differ.

    Args:
        alpha_along: roughness along the first tangent, a slope, no unit, (0, 1].
        alpha_across: roughness across the first tangent, a slope, no unit, (0, 1].

    Raises:
        ArgumentError: a roughness is out of range, or not a single number.

    Source:
        Heitz (2014).

    Example:
        >>> brushed = matcam.material.AnisotropicGGX(0.05, 0.3)
        >>> float(brushed.density(0.1, 0.0)) < float(brushed.density(0.0, 0.1))
        True
    """

    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """Compute the density of slopes for roughness 1.

        The density is P22 = 1 / (pi (1 + slope^2)^2).
        """
        return 1 / (xp.pi * (1 + slope2) ** 2)

    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """Compute Smith's Lambda for roughness 1 in closed form."""
        return ggx_lambda(nu, 1.0)


def ggx_lambda(along: jax.Array, across2: ArrayLike) -> jax.Array:
    """Compute Smith's Lambda of GGX, (sqrt(1 + nu^-2) - 1) / 2, in a form without cancellation.

    nu is cot theta / alpha, where theta is the angle of the direction to the normal. The arguments have the ratio nu^2 =
    along^2 / across2, such as cos theta and (alpha sin theta)^2.
    """
    return across2 / (2 * along * (along + xp.sqrt(along**2 + across2)))
