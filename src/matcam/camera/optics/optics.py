"""The lens: its point spread function, before any pixel has seen it (MODEL 2)."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.fourier import Rule, line_kernel, panels_for, plane_kernel, reach_of, turns_for
from matcam.core import checks
from matcam.core.jax import jax, jnp


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
        """Modulation transfer function of the optics at f cycles/px, signed; 1 at f = 0."""

    @abstractmethod
    def band(self) -> float:
        """Frequency, cycles/px, above which the MTF is 0 to rounding."""

    @abstractmethod
    def rule_on(self, borders: np.ndarray) -> Rule:
        """Quadrature over [0, band] on which this MTF is smooth, with no panel wider than those between `borders`:
        shares of the band, increasing from 0 to 1."""

    @abstractmethod
    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """(weight, lens) of the parts that this lens is the weighted sum of; itself alone if it is of one piece."""

    def frequency_rule(self, panels: int, grade: int = 1) -> Rule:
        """`rule_on` at least `panels` panels, crowded towards 0 if grade > 1."""
        return self.rule_on(np.linspace(0, 1, panels + 1) ** grade)


def lsf_by_quadrature(optics: Optics, x: ArrayLike) -> jax.Array:
    """Line spread function of a lens of which only the MTF is known, 1/px."""
    x = checks.number("x", x)
    rule = optics.frequency_rule(panels_for(reach_of(x), optics.band()))
    return line_kernel(rule, lambda f, _: optics.mtf(f), x, jnp.zeros(()))


def psf_by_quadrature(optics: Optics, x: ArrayLike, y: ArrayLike) -> jax.Array:
    """Point spread function of a lens of which only the MTF is known, 1/px^2."""
    x, y = checks.number("x", x), checks.number("y", y)
    reach, band = reach_of(jnp.hypot(x, y)), optics.band()
    rule = optics.frequency_rule(panels_for(reach, band))
    return plane_kernel(rule, lambda f, _: optics.mtf(f), x, y, turns_for(reach, band))
