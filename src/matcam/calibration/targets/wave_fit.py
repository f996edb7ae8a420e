"""Fit of a printed wave with an approximately known phase to the pixels of an image.

A pixel at (x, y) is modelled as  L(x, y) [1 + sum_k c_k b_k(f, a) cos(h_k Phi(x, y; p))].  L is a polynomial (uneven
illumination). Phi is the phase with a few parameters p (position, perspective, distortion). f and a are the local
frequency and direction of the phase, and b_k are smooth functions of f and a. c_k are the fitted coefficients, and h_k
are the orders of the harmonics. The camera multiplies a wave of frequency f in direction a by the MTF (docs/model.md
2). Therefore the sum of c_k b_k for one harmonic, divided by the contrast of the print, is this MTF, including its
sign. The pixels are not resampled or windowed, and may be missing (mosaics). Aliased frequencies are identified
correctly, because their phase is known.

The Gauss-Newton method is used with variances from the model (docs/model.md 8). Gain and read noise are estimated from the
residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from matcam.core.arrays import FloatArray
from matcam.numerics.linalg import scaled_inverse
from matcam.numerics.polynomials import plane_powers

_MOST = 200_000
"""Largest number of pixels in a fit. More pixels require memory, and add little information."""
Basis = Callable[[FloatArray, FloatArray], FloatArray]
"""Functions b_k for one harmonic: (frequency of the harmonic (n,), direction (n,)) -> (n, k)."""


class Phase(Protocol):
    """Interface for the phase of a printed wave at pixels."""

    @property
    def scale(self) -> FloatArray:
        """Parameter changes (m,) that change the phase by about 1 rad."""

    def at(self, parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Evaluate the phase at pixel positions, rad. `parameters`: (m,)."""


class WavePixels(NamedTuple):
    """Set of n pixels of an image.

    Attributes:
        value: (n,) linear pixel values.
        x: (n,) x, px.
        y: (n,) y, px.
    """

    value: FloatArray
    x: FloatArray
    y: FloatArray

    @classmethod
    def where(cls, values: FloatArray, mask: np.ndarray, most: int | None = None) -> WavePixels:
        """Select the known pixels of a region inside a mask.

        If there are more than `most` pixels, a reproducible random subset is selected.
        """
        at, most = np.flatnonzero(mask & np.isfinite(values)), most or _MOST
        if at.size > most:
            at = np.sort(np.random.default_rng(0).choice(at, most, replace=False))
        rows, columns = np.unravel_index(at, values.shape)
        return cls(values[rows, columns], columns.astype(float), rows.astype(float))


@dataclass(frozen=True, eq=False)
class WaveFit:
    """Fitted modulation and phase of a wave, with their errors.

    Attributes:
        coefficients: (orders * k,) coefficients of the modulation.
        covariance: covariance of `coefficients`, including the uncertainty of illumination and phase.
        parameters: (m,) parameters of the phase.
        parameters_std: (m,) standard deviations of `parameters`.
        gain: variance of a pixel without read noise, divided by the value of the pixel, in the units of the values.
        read_variance: variance of a dark pixel, in squared units of the values.
        chi2: chi-square per degree of freedom for the weights of the last step; 1 if noise explains the residuals.
        values: (n,) model at every pixel.
        signal: significance of the modulation in standard deviations. It must exceed 5 for a grating, and 20 for a star.
    """

    coefficients: FloatArray
    covariance: FloatArray
    parameters: FloatArray
    parameters_std: FloatArray
    gain: float
    read_variance: float
    chi2: float
    values: FloatArray
    signal: float


def fit_wave(
    pixels: WavePixels,
    phase: Phase,
    start: FloatArray,
    basis: Basis,
    orders: tuple[int, ...] = (1,),
    *,
    steps: int = 8,
) -> WaveFit | None:
    """Fit a wave to pixels; None if the pixels do not determine the wave.

    `start`: initial parameters of the phase. `basis`: functions b_k of frequency and direction. `orders`: orders h_k of
    the harmonics. `steps`: largest number of steps with a free phase.
    """
    (value, x, y), scale = pixels, phase.scale
    u, v = ((c - c.mean()) / max(float(np.ptp(c)) / 2, 1.0) for c in (x, y))
    powers = plane_powers(u, v, 2)
    parameters = np.array(start, dtype=float)
    weight = np.ones_like(value)
    light = np.zeros(powers.shape[1])
    light[0] = value.mean()
    coefficients: FloatArray = np.zeros(0)
    gain, read = 0.0, float(value.var())
    for step in range(steps + 2):
        frequency, direction = local_wave(phase, parameters, x, y)
        at = phase.at(parameters, x, y)
        # The functions b_k cos(h_k Phi), (n, orders * k), and their derivatives with respect to the phase.
        bases = [basis(order * frequency, direction) for order in orders]
        terms = list(zip(orders, bases, strict=True))
        columns = np.concatenate([own * np.cos(order * at)[:, None] for order, own in terms], axis=1)
        slopes = np.concatenate([own * (-order * np.sin(order * at))[:, None] for order, own in terms], axis=1)
        if not step:
            coefficients = np.zeros(columns.shape[1])
        level, wave = powers @ light, columns @ coefficients
        # In the first two steps the phase is fixed, and only illumination and modulation are fitted.
        tilt = (step > 1) * level * (slopes @ coefficients)
        moved = [phase.at(parameters + one, x, y) for one in np.diag(scale * 1e-4)]
        by_phase = [tilt * wrapped(there - at) / size for there, size in zip(moved, scale * 1e-4, strict=True)]
        matrix = np.column_stack([powers * (1 + wave)[:, None], level[:, None] * columns, *by_phase])
        # A fit requires at least 3 pixels for each parameter.
        if value.size < 3.0 * matrix.shape[1]:
            return None
        residual = value - level * (1 + wave)
        if step > 2:
            gain, read = noise_from_residuals(residual, level * (1 + wave))
            weight = 1 / (gain * np.maximum(level * (1 + wave), 0) + read)
        normal = (matrix.T * weight) @ matrix
        if not np.isfinite(normal).all():
            return None
        inverse = scaled_inverse(normal)
        change = inverse @ (matrix.T @ (weight * residual))
        of_light, of_wave, shift = np.split(change, [light.size, light.size + coefficients.size])
        light, coefficients = light + of_light, coefficients + of_wave
        # The change of the phase is limited to the range in which the model is approximately linear.
        shift *= min(1.0, 1.0 / max(float(np.abs(shift / scale).max()), 1e-300))
        parameters = parameters + shift
        if not (np.isfinite(change).all() and np.isfinite(parameters).all()):
            return None
        # The fit has converged if the phase changes by less than 1e-4 rad. At least 4 steps are made, so that the weights
        # follow from the noise.
        if np.abs(shift / scale).max() < 1e-4 and step > 4:
            break
    last = inverse[light.size + coefficients.size :, light.size + coefficients.size :]
    std = np.sqrt(np.maximum(np.diag(last), 0))
    block = slice(light.size, light.size + coefficients.size)
    covariance = inverse[block, block]
    strength = float(coefficients @ np.linalg.pinv(covariance, rcond=1e-10, hermitian=True) @ coefficients)
    return WaveFit(
        coefficients,
        covariance,
        parameters,
        std,
        gain,
        read,
        float((weight * residual**2).sum() / (value.size - matrix.shape[1])),
        level * (1 + wave),
        float(np.sqrt(max(strength - coefficients.size, 0.0))),
    )


def wrapped(phase: FloatArray) -> FloatArray:
    """Reduce phases to [-pi, pi), rad."""
    return np.mod(phase + np.pi, 2 * np.pi) - np.pi


def local_wave(phase: Phase, parameters: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the frequency of a wave, cycles/px, and the direction of the frequency vector, rad, (n,) each."""
    step = 1e-3  # step of the numerical derivatives, px
    # The two ends of a step may lie on different sides of the branch cut of the angle.
    by_x = wrapped(phase.at(parameters, x + step, y) - phase.at(parameters, x - step, y))
    by_y = wrapped(phase.at(parameters, x, y + step) - phase.at(parameters, x, y - step))
    return np.hypot(by_x, by_y) / (4 * np.pi * step), np.arctan2(by_y, by_x)


def noise_from_residuals(residual: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """Fit gain and read variance to the residuals.

    The variance of a pixel is gain * value + read variance; both are non-negative. `value`: model values of the pixels. The
    read variance is at least that of rounding in single precision, so that the variance is never 0.
    """
    square, level = residual**2, np.maximum(value, 0)
    # The smallest variance represents rounding, and keeps the weights finite.
    least = 1e-13 * float((value**2).mean()) + 1e-300
    off = level - level.mean()
    gain = float((off * (square - square.mean())).sum() / max(float((off * off).sum()), 1e-300))
    gain = min(max(gain, 0.0), float(square.mean() / max(float(level.mean()), 1e-300)))
    return gain, max(float(square.mean() - gain * level.mean()), least)
