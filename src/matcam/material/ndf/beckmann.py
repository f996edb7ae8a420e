"""Beckmann & Spizzichino (1963): slopes with a Gaussian distribution."""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.material.masking import cot_of
from matcam.material.ndf.distribution import MixtureNDF, SlopeNDF


class Beckmann(SlopeNDF, MixtureNDF):
    """D = exp(-tan^2 theta_h / alpha^2) / (pi alpha^2 cos^4 theta_h) (Walter et al. 2007, (25)).

    alpha: roughness, a slope, (0, 1]: sqrt(2) times the standard deviation of the slope in any direction.
    """

    alpha: jax.Array

    family = "beckmann"
    largest = 1.0

    def __init__(self, alpha: ArrayLike):
        self.alpha = checks.scalar("alpha", checks.within("alpha", alpha, 0, self.largest, open_low=True))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """exp(-slope^2 / alpha^2) / (pi alpha^2)."""
        return jnp.exp(-slope2 / self.alpha**2) / (jnp.pi * self.alpha**2)

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """[exp(-nu^2) / (nu sqrt pi) - erfc(nu)] / 2, nu = cot theta / alpha (Smith 1967; Heitz 2014)."""
        return beckmann_lambda(cot_of(cos) / self.alpha)

    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """One Gaussian, in the slope."""
        return jnp.ones(1), self.alpha[None] / jnp.sqrt(2)

    @property
    def roughness(self) -> jax.Array:
        """alpha."""
        return self.alpha

    def __repr__(self) -> str:
        return f"Beckmann(alpha={self.alpha!s})"


def beckmann_lambda(nu: jax.Array) -> jax.Array:
    """Lambda of Beckmann's slopes at nu = cot theta / alpha; 16 digits of 1 / (1 + Lambda), which is 1 beyond nu = 6."""
    nu = jnp.minimum(nu, 20.0)
    return jnp.maximum(jnp.exp(-(nu**2)) / (nu * jnp.sqrt(jnp.pi)) - jax.scipy.special.erfc(nu), 0.0) / 2
