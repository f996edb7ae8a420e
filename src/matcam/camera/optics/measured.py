"""Optics known by a measured MTF curve."""

from __future__ import annotations

from functools import lru_cache

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.fourier import Rule, split_rule
from matcam.camera.optics.optics import Optics, lsf_by_quadrature, psf_by_quadrature
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp

_ZERO = 1e-9


class MeasuredOptics(Optics):
    """Optics given by samples of their MTF: isotropic, zero phase, a cubic spline through the samples.

    frequency: cycles/px, shape (n,), strictly increasing from 0, n >= 4.
    mtf: shape (n,), 1 at frequency 0. Optics only: divide a total MTF by the pixel's first.

    Beyond the last sample the MTF is 0 if the curve ends in 0; otherwise asking there is an error, and so is the PSF,
    which needs all frequencies: append where the curve reaches 0 (the diffraction cutoff pitch / (wavelength f_number)
    is always such a point).
    """

    frequency: tuple[float, ...] = eqx.field(static=True)
    values: jax.Array
    ends_at_zero: bool = eqx.field(static=True)

    def __init__(self, frequency: ArrayLike, mtf: ArrayLike):
        f = np.asarray(checks.number("frequency", frequency))
        values = checks.number("mtf", mtf)
        if f.ndim != 1 or f.size < 4 or values.shape != f.shape:
            raise ArgumentError(
                f"frequency and mtf must be two lists of one length of at least 4, got shapes {f.shape} and {values.shape}"
            )
        if f[0] != 0 or np.any(np.diff(f) <= 0):
            raise ArgumentError("frequency must start at 0 cycles/px and increase strictly")
        self.ends_at_zero = True
        if is_concrete(values):
            numbers = np.asarray(values)
            if abs(numbers[0] - 1) > 1e-6:
                raise ArgumentError(
                    f"mtf must be 1 at frequency 0, got {numbers[0]:g}: divide the curve by its first sample"
                )
            largest = np.max(np.abs(numbers))
            if largest > 1.05:
                raise ArgumentError(
                    f"mtf must not exceed 1 (1.05 with noise), got {largest:g}: is the picture sharpened?"
                )
            self.ends_at_zero = bool(abs(numbers[-1]) <= _ZERO)
        self.frequency = tuple(f.tolist())
        self.values = values

    def mtf(self, f: ArrayLike) -> jax.Array:
        """MTF at f cycles/px. ArgumentError beyond the last sample, unless the curve has reached 0 there."""
        f = jnp.abs(checks.number("f", f))
        last = self.frequency[-1]
        if is_concrete(f) and not self.ends_at_zero and f.size and float(jnp.max(f)) > last:
            raise ArgumentError(
                f"the measured MTF ends at {last:g} cycles/px with {float(self.values[-1]):g}, and is asked for at "
                f"{float(jnp.max(f)):g}: append samples to where it reaches 0"
            )
        knots = jnp.asarray(self.frequency)
        piece = jnp.clip(jnp.searchsorted(knots, f, side="right") - 1, 0, knots.size - 2)
        t = f - knots[piece]
        coefficients = (_spline_basis(self.frequency) @ self.values)[:, piece]
        inside = ((coefficients[0] * t + coefficients[1]) * t + coefficients[2]) * t + coefficients[3]
        return jnp.where(f > last, 0.0, inside)

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Line spread function, 1/px, by quadrature over the whole band."""
        return lsf_by_quadrature(self, x)

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Point spread function, 1/px^2, by quadrature over the whole band."""
        return psf_by_quadrature(self, x, y)

    def band(self) -> float:
        """The last sample's frequency, cycles/px; ArgumentError where the curve has not reached 0 by then."""
        if not self.ends_at_zero:
            raise ArgumentError(
                f"the measured MTF ends at {self.frequency[-1]:g} cycles/px with {float(self.values[-1]):g}: a point "
                "spread function needs all frequencies; append samples to where it reaches 0"
            )
        return self.frequency[-1]

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Panels that never straddle a sample, where the spline's third derivative jumps."""
        return split_rule(self.band() * borders, np.asarray(self.frequency))

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Itself."""
        return ((jnp.ones(()), self),)

    def __repr__(self) -> str:
        return f"MeasuredOptics(frequency={list(self.frequency)}, mtf={self.values.tolist()})"


@lru_cache(maxsize=16)
def _spline_basis(frequency: tuple[float, ...]) -> np.ndarray:
    """Coefficients (4, pieces, samples) of the splines through each unit vector.

    A spline is linear in the values that it goes through: with this map, their uncertainty passes through it.
    """
    from scipy.interpolate import CubicSpline  # a quarter of a second that only measured curves should cost

    return CubicSpline(frequency, np.eye(len(frequency))).c
