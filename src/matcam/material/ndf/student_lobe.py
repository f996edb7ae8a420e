"""Student's t distribution of slopes.

Its tails lie between those of GGX and Beckmann, or are longer than those of GGX.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import xp
from matcam.core.arrays.elementary import power
from matcam.material.lambda_table import integrated_lambda
from matcam.material.ndf.distribution import SlopeNDF

if TYPE_CHECKING:
    from matcam.core.jax import jax


class StudentLobe(SlopeNDF):
    """Student's t distribution of two-dimensional slopes (Ribardiere et al. 2017, STD).

    The density of slopes is P22 = (g - 1) / (pi g beta^2) (1 + slope^2 / (g beta^2))^-g. For g = 2 the distribution is
    GGX with alpha^2 = 2 beta^2, and for large g it approaches Beckmann with roughness beta. Fitted values of beta and g
    are hardly correlated.

    Attributes:
        beta: roughness, a slope, no unit, shape ().
        excess: g - 1, above 0, no unit, shape (). In the tail, P22 decreases as slope^(-2 g).
    """

    beta: jax.Array
    excess: jax.Array

    family = "student-t"
    largest = 1.0

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        g = 1 + self.excess
        square = g * self.beta**2
        return self.excess / (xp.pi * square) * power(1 + slope2 / square, -g)

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        return integrated_lambda(self.slope_density, self.beta, cos)

    @property
    def roughness(self) -> jax.Array:
        return self.beta
