"""The exponential power distribution of slopes (Holzschuch & Pacanowski 2017)."""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.material.masking import tabulated_lambda
from matcam.material.ndf.distribution import SlopeNDF


class EPD(SlopeNDF):
    """Distribute slopes by an exponential of their power.

    D = p / (pi beta^2 Gamma(1/p)) exp(-(tan^2 theta_h / beta^2)^p) / cos^4 theta_h, 1/sr. p = 1 is Beckmann.

    Args:
        beta: roughness, a slope, no unit, (0, 1].
        power: p, no unit, [0.25, 4]. Below 1 the lobe has a sharp peak on broad flanks, and an infinite slope at the peak
            below 1/2; above 1 it has a flat top.

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
        self.beta = checks.scalar("beta", checks.within("beta", beta, 0, self.largest, open_low=True))
        self.power = checks.scalar("power", checks.within("power", power, 0.25, 4))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Return p / (pi beta^2 Gamma(1/p)) exp(-(slope^2 / beta^2)^p)."""
        peak = self.power / (jnp.pi * self.beta**2 * jnp.exp(jax.scipy.special.gammaln(1 / self.power)))
        at_peak = slope2 == 0  # where the derivative of x^p is infinite or of the form 0 ln 0
        x = jnp.where(at_peak, 1.0, slope2 / self.beta**2)
        return peak * jnp.exp(-jnp.where(at_peak, 0.0, x**self.power))

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Return Smith's Lambda by its integral over slopes."""
        return tabulated_lambda(self.slope_density, self.beta, cos)

    @property
    def roughness(self) -> jax.Array:
        """First parameter, beta."""
        return self.beta

    def __repr__(self) -> str:
        return f"EPD(beta={self.beta!s}, power={self.power!s})"
