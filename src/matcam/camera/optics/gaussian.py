"""Gaussian optics: the paper's lens, one number."""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.fourier import Rule, piecewise_rule
from matcam.camera.optics.optics import Optics
from matcam.core import checks
from matcam.core.jax import is_concrete, jax, jnp

_BAND_TIMES_SIGMA = 1.4  # exp(-2 pi^2 1.4^2) = 2e-17
_TRACED_BAND = 16.0


class GaussianOptics(Optics):
    """Optics whose PSF is a Gaussian (Holzschuch & Pacanowski 2017, section 3).

    sigma: standard deviation of the PSF, px; must be positive. The paper guesses 0.5 px for the MERL camera.
    """

    sigma: jax.Array

    def __init__(self, sigma: ArrayLike):
        self.sigma = checks.scalar("sigma", checks.positive("sigma", sigma, "px"))

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """exp(-(x^2 + y^2) / (2 sigma^2)) / (2 pi sigma^2), 1/px^2."""
        return self.lsf(x) * self.lsf(y)

    def lsf(self, x: ArrayLike) -> jax.Array:
        """exp(-x^2 / (2 sigma^2)) / (sqrt(2 pi) sigma), 1/px."""
        return jax.scipy.stats.norm.pdf(checks.number("x", x), scale=self.sigma)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """exp(-2 pi^2 sigma^2 f^2) at f cycles/px."""
        return jnp.exp(-2 * (jnp.pi * self.sigma * checks.number("f", f)) ** 2)

    def band(self) -> float:
        """Frequency, cycles/px, where the MTF falls to 2e-17."""
        return _BAND_TIMES_SIGMA / float(self.sigma) if is_concrete(self.sigma) else _TRACED_BAND

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Gauss-Legendre panels to 1.4 / sigma."""
        unit = piecewise_rule(borders)
        band = _BAND_TIMES_SIGMA / self.sigma
        return Rule(unit.frequency * band, unit.weight * band)

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Itself."""
        return ((jnp.ones(()), self),)

    def __repr__(self) -> str:
        return f"GaussianOptics(sigma={self.sigma!s})"
