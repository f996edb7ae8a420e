"""Slopes with a Gaussian distribution, isotropic or not (Beckmann & Spizzichino 1963)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import special, xp
from matcam.material.masking import cot_of
from matcam.material.ndf.distribution import MixtureNDF, SlopeNDF, StretchedSlopes, checked_roughness

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class Beckmann(SlopeNDF, MixtureNDF):
    """Beckmann distribution: Gaussian slopes.

    The density of facet normals is D = exp(-tan^2 theta_h / alpha^2) / (pi alpha^2 cos^4 theta_h), 1/sr.

    Args:
        alpha: roughness, a slope, no unit, (0, 1]: sqrt(2) times the standard deviation of the slope in any direction.

    Raises:
        ArgumentError: alpha is out of range, or not a single number.

    Source:
        Beckmann & Spizzichino (1963); Walter et al. (2007), equation (25).

    Example:
        >>> lobe = matcam.Beckmann(0.1)
        >>> round(float(lobe.d(0.0)), 4), round(float(1 / (np.pi * 0.1**2)), 4)
        (31.831, 31.831)
    """

    alpha: jax.Array

    family = "beckmann"
    largest = 1.0

    def __init__(self, alpha: ArrayLike):
        self.alpha = checked_roughness("alpha", alpha, self.largest)

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute P22 = exp(-slope^2 / alpha^2) / (pi alpha^2)."""
        return xp.exp(-slope2 / self.alpha**2) / (xp.pi * self.alpha**2)

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda in closed form.

        Lambda is [exp(-nu^2) / (nu sqrt pi) - erfc(nu)] / 2, where nu = cot theta / alpha.

        Source:
            Smith (1967); Heitz (2014).
        """
        return beckmann_lambda(cot_of(cos) / self.alpha)

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """Compute the weight and width of the single Gaussian in the slope."""
        return xp.ones(1), self.alpha[None] / xp.sqrt(2)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, alpha."""
        return self.alpha


class AnisotropicBeckmann(StretchedSlopes):
    """Anisotropic Beckmann distribution with two roughnesses.

    Brushed and turned metals have such slopes.

    Args:
        alpha_along: roughness along the first tangent, a slope, no unit, (0, 1].
        alpha_across: roughness across the first tangent, a slope, no unit, (0, 1].

    Raises:
        ArgumentError: a roughness is out of range, or not a single number.

    Source:
        Heitz (2014).

    Example:
        >>> brushed = matcam.material.AnisotropicBeckmann(0.05, 0.3)
        >>> float(brushed.density(0.1, 0.0)) < float(brushed.density(0.0, 0.1))
        True
    """

    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """Compute P22 for roughness 1, exp(-slope^2) / pi."""
        return xp.exp(-slope2) / xp.pi

    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """Compute Smith's Lambda for roughness 1 in closed form."""
        return beckmann_lambda(nu)


def beckmann_lambda(nu: jax.Array) -> jax.Array:
    """Evaluate Smith's Lambda of Beckmann slopes at nu = cot theta / alpha.

    1 / (1 + Lambda) is accurate to 16 digits.
    """
    nu = xp.minimum(nu, 20.0)
    return xp.maximum(xp.exp(-(nu**2)) / (nu * xp.sqrt(xp.pi)) - special.erfc(nu), 0.0) / 2
