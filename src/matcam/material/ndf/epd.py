"""The exponential power distribution of slopes (Holzschuch & Pacanowski 2017)."""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.material.masking import tabulated_lambda
from matcam.material.ndf.distribution import SlopeNDF


class EPD(SlopeNDF):
    """D = p / (pi beta^2 Gamma(1/p)) exp(-(tan^2 theta_h / beta^2)^p) / cos^4 theta_h (MODEL 6). p = 1 is Beckmann.

    beta: roughness, a slope, (0, 1]. power: p, [0.25, 4]: below 1 a sharp peak on broad flanks, whose slope at the peak
    is infinite for p < 1/2; above 1 a flat top.
    """

    beta: jax.Array
    power: jax.Array

    family = "epd"
    largest = 1.0

    def __init__(self, beta: ArrayLike, power: ArrayLike):
        self.beta = checks.scalar("beta", checks.within("beta", beta, 0, self.largest, open_low=True))
        self.power = checks.scalar("power", checks.within("power", power, 0.25, 4))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """p / (pi beta^2 Gamma(1/p)) exp(-(slope^2 / beta^2)^p)."""
        peak = self.power / (jnp.pi * self.beta**2 * jnp.exp(jax.scipy.special.gammaln(1 / self.power)))
        at_peak = slope2 == 0  # where the derivative of x^p is infinite or of the form 0 ln 0
        x = jnp.where(at_peak, 1.0, slope2 / self.beta**2)
        return peak * jnp.exp(-jnp.where(at_peak, 0.0, x**self.power))

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """By the integral over slopes."""
        return tabulated_lambda(self.slope_density, self.beta, cos)

    @property
    def roughness(self) -> jax.Array:
        """beta."""
        return self.beta

    def __repr__(self) -> str:
        return f"EPD(beta={self.beta!s}, power={self.power!s})"
