"""The lens: its point spread function, before any pixel has seen it (MODEL 2)."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
from jax.typing import ArrayLike

from matcam._jax import jax
from matcam.camera.fourier import Rule


class Optics(eqx.Module):
    """A lens that blurs isotropically and without shift. Optics only: the pixel is not in it.

    Three things are called PSF: the *optical* one (this type), the *pixel response* (`PixelResponse`) and their
    combination, the *effective* one (`Camera`). They are different types so that none can be applied twice.
    """

    @abstractmethod
    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Optical point spread function at (x, y) px from its centre, 1/px^2; integrates to 1."""

    @abstractmethod
    def lsf(self, x: ArrayLike) -> jax.Array:
        """Optical line spread function, 1/px: the PSF's projection on a line; integrates to 1. x in px."""

    @abstractmethod
    def mtf(self, f: ArrayLike) -> jax.Array:
        """Modulation transfer function of the optics at f cycles/px; 1 at f = 0."""

    @abstractmethod
    def band(self) -> float:
        """Frequency, cycles/px, above which the MTF is 0 to rounding."""

    @abstractmethod
    def frequency_rule(self, panels: int, grade: int = 1) -> Rule:
        """Quadrature over [0, band] on which this MTF is smooth, with at least `panels` panels, crowded towards 0 if
        grade > 1."""
