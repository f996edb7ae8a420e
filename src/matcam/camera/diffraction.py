"""A perfect lens: diffraction at a circular aperture, the limit of what any lens can do."""

from __future__ import annotations

from functools import partial

import numpy as np
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import is_concrete, jax, jnp
from matcam.camera.fourier import Rule, piecewise_rule, reach_of
from matcam.camera.optics import Optics, lsf_by_quadrature

_TRACED_BAND = 8.0


class DiffractionOptics(Optics):
    """Incoherent, diffraction-limited circular pupil (Goodman, Introduction to Fourier Optics, 6.3.2).

    f_number: working f-number, positive. wavelength, pixel_pitch: m, positive. The MTF ends at
    pixel_pitch / (wavelength f_number) cycles/px.
    """

    f_number: jax.Array
    wavelength: jax.Array
    pixel_pitch: jax.Array

    def __init__(self, f_number: ArrayLike, wavelength: ArrayLike, pixel_pitch: ArrayLike):
        self.f_number = checks.scalar("f_number", checks.positive("f_number", f_number))
        self.wavelength = checks.scalar(
            "wavelength", checks.within("wavelength", wavelength, 1e-9, 1e-3, "m (550 nm is 550e-9)")
        )
        self.pixel_pitch = checks.scalar(
            "pixel_pitch", checks.within("pixel_pitch", pixel_pitch, 1e-8, 1e-2, "m (5 um is 5e-6)")
        )

    @property
    def cutoff(self) -> jax.Array:
        """Frequency at which the MTF reaches 0, cycles/px."""
        return self.pixel_pitch / (self.wavelength * self.f_number)

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Airy pattern (pi cutoff^2 / 4) [2 J1(v) / v]^2, v = pi cutoff r, 1/px^2."""
        r = jnp.hypot(checks.number("x", x), checks.number("y", y))
        return jnp.pi / 4 * self.cutoff**2 * _jinc(jnp.pi * self.cutoff * r, reach_of(r) * self.band()) ** 2

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Line spread function, 1/px, by quadrature over the MTF (it falls as 1/x^2)."""
        return lsf_by_quadrature(self, x)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """(2 / pi) [acos nu - nu sqrt(1 - nu^2)], nu = f / cutoff (Goodman 6-31); 0 beyond the cutoff."""
        nu = jnp.abs(checks.number("f", f)) / self.cutoff
        inside = nu < 1
        nu = jnp.where(inside, nu, 0.5)  # keeps the gradient finite at and beyond the cutoff
        return jnp.where(inside, 2 / jnp.pi * (jnp.arccos(nu) - nu * jnp.sqrt(1 - nu**2)), 0.0)

    def band(self) -> float:
        """The cutoff as a plain number, cycles/px."""
        return float(self.cutoff) if is_concrete(self.cutoff) else _TRACED_BAND

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Panels in t with f = cutoff t (2 - t), which makes the end (1 - nu)^(3/2) a polynomial."""
        unit = piecewise_rule(1 - np.sqrt(1 - borders))
        t = unit.frequency
        return Rule(self.cutoff * t * (2 - t), self.cutoff * unit.weight * 2 * (1 - t))

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Itself."""
        return ((jnp.ones(()), self),)

    def __repr__(self) -> str:
        return (
            f"DiffractionOptics(f_number={self.f_number!s}, wavelength={self.wavelength!s}, "
            f"pixel_pitch={self.pixel_pitch!s})"
        )


def _jinc(v: jax.Array, turns: float) -> jax.Array:
    """2 J1(v) / v as the mean over the pupil's chords, 2 cos^2 t cos(v sin t): exact once the nodes outnumber v."""
    return _over_chords(
        24 + int(np.ceil(np.pi * turns)), v
    )  # v = pi turns; the trapezoid rule sees the quarter turn only


@partial(jax.jit, static_argnums=0)
def _over_chords(nodes: int, v: jax.Array) -> jax.Array:
    t = (jnp.arange(nodes) + 0.5) * (jnp.pi / 2 / nodes)
    chord = 2 * jnp.cos(t) ** 2 / nodes

    def at(value: jax.Array) -> jax.Array:
        return jnp.cos(value * jnp.sin(t)) @ chord

    return jax.lax.map(at, v.ravel(), batch_size=256).reshape(v.shape)
