"""GGX: Trowbridge & Reitz (1975), Walter et al. (2007)."""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.material.masking import cot_of
from matcam.material.ndf.distribution import MixtureNDF, SlopeNDF

_MIXTURE_NODES = 56


class GGX(SlopeNDF, MixtureNDF):
    """D = alpha^2 / (pi (cos^2 theta_h (alpha^2 - 1) + 1)^2) (Walter et al. 2007, (33)): slopes of density
    alpha^2 / (pi (alpha^2 + slope^2)^2).

    alpha: roughness, a slope, (0, 1].
    """

    alpha: jax.Array

    family = "ggx"
    largest = 1.0

    def __init__(self, alpha: ArrayLike):
        self.alpha = checks.scalar("alpha", checks.within("alpha", alpha, 0, self.largest, open_low=True))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """alpha^2 / (pi (alpha^2 + slope^2)^2)."""
        return (self.alpha / (self.alpha**2 + slope2)) ** 2 / jnp.pi

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """(sqrt(1 + alpha^2 tan^2 theta) - 1) / 2 (Walter et al. 2007, (34))."""
        return ggx_lambda(cot_of(cos) / self.alpha)

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


def ggx_lambda(nu: jax.Array) -> jax.Array:
    """Lambda of GGX at nu = cot theta / alpha, as t / (2 (1 + sqrt(1 + t))), t = nu^-2, which does not cancel."""
    t = nu**-2
    return t / (2 * (1 + jnp.sqrt(1 + t)))
