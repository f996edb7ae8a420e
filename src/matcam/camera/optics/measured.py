"""Optics with a measured MTF: a cubic spline through its samples."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.optics import Optics, Rule, split_rule
from matcam.core import checks
from matcam.core.arrays import compiled_by_jax, has_jax, is_concrete, xp
from matcam.core.arrays.module import static_field
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class MeasuredOptics(Optics):
    """Isotropic lens with a measured MTF.

    The MTF is a cubic spline through the samples. The image of a point is not shifted.

    Beyond the last sample the MTF is 0 if the last sample is 0. Otherwise the MTF is unknown there, and an evaluation
    there raises an ArgumentError. Kernels such as the PSF raise the same error, because they require all frequencies.
    In this case append a sample of 0 at the frequency at which the MTF reaches 0. No lens transfers frequencies above
    the diffraction cutoff, which is pixel pitch / (wavelength times f-number), cycles/px.

    Args:
        frequency: frequencies of the samples, cycles/px, increasing from 0, shape (n,), n >= 4.
        mtf: MTF of the optics at these frequencies, no unit, 1 at frequency 0, modulus at most 1.05, shape (n,). It must
            not include the pixel: divide a total MTF by the MTF of the pixel first.

    Raises:
        ArgumentError: the shapes differ, there are fewer than 4 samples, the frequencies do not increase from 0, or the
            MTF is not 1 at frequency 0 or its modulus exceeds 1.05.

    Source:
        ISO 12233 (measurement of the curve).

    Example:
        >>> lens = matcam.MeasuredOptics([0.0, 0.25, 0.5, 1.0], [1.0, 0.7, 0.3, 0.0])
        >>> round(float(lens.mtf(0.25)), 6), float(lens.mtf(1.5))
        (0.7, 0.0)
    """

    frequency: tuple[float, ...] = static_field()
    values: jax.Array
    ends_at_zero: bool = static_field()
    resolved: float = static_field()

    profile_fields = MappingProxyType({"frequency_cycles_per_px": "frequency", "mtf": "values"})

    def __init__(self, frequency: ArrayLike, mtf: ArrayLike):
        f = np.asarray(checks.number("frequency", frequency))
        values = checks.number("mtf", mtf)
        if f.ndim != 1 or f.size < 4 or values.shape != f.shape:
            raise ArgumentError(
                f"frequency and mtf must be lists of equal length with at least 4 numbers, got shapes {f.shape} and "
                f"{values.shape}"
            )
        if f[0] != 0 or np.any(np.diff(f) <= 0):
            raise ArgumentError("frequency must start at 0 cycles/px and increase strictly")
        ends_at_zero, resolved = True, f.size - 1
        if is_concrete(values):
            samples = np.asarray(values)
            if abs(samples[0] - 1) > 1e-6:
                raise ArgumentError(
                    f"mtf must be 1 at frequency 0, got {samples[0]:g}: divide the curve by its first sample"
                )
            largest = np.max(np.abs(samples))
            if largest > 1.05:
                raise ArgumentError(
                    f"the modulus of mtf must not exceed 1 (1.05 with noise), got {largest:g}: measure the MTF in an image "
                    "without sharpening"
                )
            # a last sample of at most 1e-9 is 0 to rounding
            ends_at_zero = bool(abs(samples[-1]) <= 1e-9)
            # frequencies with an MTF below 1e-4, which no measurement determines, do not affect the scale of the PSF
            resolved = min(int(np.flatnonzero(np.abs(samples) > 1e-4)[-1]) + 1, resolved)
        self.frequency = tuple(f.tolist())
        self.values = values
        self.ends_at_zero = ends_at_zero
        self.resolved = float(f[resolved])

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Interpolate the MTF at f cycles/px, without the pixel.

        Raises:
            ArgumentError: f lies beyond the last sample, and the curve does not end at 0.
        """
        at = xp.abs(checks.number("f", f))
        last = self.frequency[-1]
        if is_concrete(at) and not self.ends_at_zero and at.size and float(xp.max(at)) > last:
            raise ArgumentError(
                f"the measured MTF ends at {last:g} cycles/px with a value of {float(self.values[-1]):g}, but is required at "
                f"{float(xp.max(at)):g} cycles/px: append samples up to the frequency where the MTF reaches 0"
            )
        return xp.where(at > last, 0.0, _spline(xp.asarray(self.frequency), self.values, at))

    def band(self) -> float:
        """Look up the frequency of the last sample, cycles/px.

        Raises:
            ArgumentError: the curve does not end at 0.
        """
        if not self.ends_at_zero:
            raise ArgumentError(
                f"the measured MTF ends at {self.frequency[-1]:g} cycles/px with a value of {float(self.values[-1]):g}, but "
                "kernels require it at all frequencies: append samples up to the frequency where the MTF reaches 0"
            )
        return self.frequency[-1]

    def resolved_share(self) -> float:
        """Compute the share of the band that the lens resolves, no unit.

        The resolved band ends at the sample after the last sample with a modulus above 1e-4.
        """
        return self.resolved / self.frequency[-1]

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build a quadrature on panels that are split at the samples.

        The third derivative of the MTF is discontinuous at a sample.
        """
        return split_rule(self.band() * borders, np.asarray(self.frequency))

    def __repr__(self) -> str:
        return f"MeasuredOptics(frequency={list(self.frequency)}, mtf={self.values.tolist()})"


@compiled_by_jax
def _spline(x: jax.Array, y: jax.Array, at: jax.Array) -> jax.Array:
    """Evaluate the cubic spline through the points (x, y) at positions `at`.

    x and y have the shape (n,), n >= 4. The third derivative of the spline is continuous at the second and at the last
    but one point ("not-a-knot", de Boor 1978, chapter IV). The slopes solve a tridiagonal system, so that memory is
    linear in n. The spline is linear in y and therefore differentiable in y.
    """
    width, rise = xp.diff(x), xp.diff(y) / xp.diff(x)
    first, last = x[2] - x[0], x[-1] - x[-3]
    zero = xp.zeros(1)
    diagonal = xp.concatenate([width[1:2], 2 * (width[:-1] + width[1:]), width[-2:-1]])
    lower = xp.concatenate([zero, width[1:], last[None]])
    upper = xp.concatenate([first[None], width[:-1], zero])
    start = ((width[0] + 2 * first) * width[1] * rise[0] + width[0] ** 2 * rise[1]) / first
    end = (width[-1] ** 2 * rise[-2] + (2 * last + width[-1]) * width[-2] * rise[-1]) / last
    inner = 3 * (width[1:] * rise[:-1] + width[:-1] * rise[1:])
    right = xp.concatenate([start[None], inner, end[None]])
    slope = _tridiagonal_solution(lower, diagonal, upper, right)
    piece = xp.clip(xp.searchsorted(x, at, side="right") - 1, 0, x.size - 2)
    left, low, h, secant, start, end = (xp.take(values, piece) for values in (x, y, width, rise, slope[:-1], slope[1:]))
    t, curvature = at - left, (start + end - 2 * secant) / h
    return low + t * (start + t * ((secant - start) / h - curvature + t * curvature / h))


def _tridiagonal_solution(lower: jax.Array, diagonal: jax.Array, upper: jax.Array, right: jax.Array) -> jax.Array:
    """Solve a tridiagonal system. The first element of `lower` and the last element of `upper` are not used."""
    if has_jax(lower, diagonal, upper, right):
        from matcam.core.jax import jax, jnp

        below, on, above, known = (jnp.asarray(band) for band in (lower, diagonal, upper, right))
        return jax.lax.linalg.tridiagonal_solve(below, on, above, known[:, None])[:, 0]
    from scipy.linalg import solve_banded

    return solve_banded((1, 1), np.stack([np.roll(upper, 1), diagonal, np.roll(lower, -1)]), right)
