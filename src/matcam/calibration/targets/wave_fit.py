"""A picture's noise, from what a fit has left of it.

A printed wave in a picture: light x (1 + modulation), whose phase is nearly known, fitted to the pixels as they are.

A pixel at (x, y) is modelled as  L(x, y) [1 + sum_k c_k b_k(f, a) cos(h_k Phi(x, y; p))]:  L a polynomial (uneven light), Phi
the phase with a few parameters p (place, perspective, distortion), (f, a) the phase's own local frequency and direction,
b_k smooth functions of them. The camera multiplies a wave of frequency f along a by its MTF (MODEL 2), so c b / contrast is
that MTF, signed. Nothing is resampled or windowed, and pixels may be missing (mosaics): what aliases is not mistaken for
anything else, because its phase is known.

Gauss-Newton with variances from the model (MODEL 8); the gain and read noise of the picture come from its residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from matcam.core.jax import FloatArray
from matcam.numerics.linalg import scaled_inverse

_ROUNDING = 1e-13  # of the mean square: no picture is without any


def noise_of(residual: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """gain and read variance, both >= 0, for which gain * value + read variance explains squared residuals best.

    value: what the model expects of the pixels. Raised to what rounding leaves, so that both are never 0 together.
    """
    square, level = residual**2, np.maximum(value, 0)
    least = _ROUNDING * float((value**2).mean()) + 1e-300
    off = level - level.mean()
    gain = float((off * (square - square.mean())).sum() / max(float((off * off).sum()), 1e-300))
    gain = min(max(gain, 0.0), float(square.mean() / max(float(level.mean()), 1e-300)))
    return gain, max(float(square.mean() - gain * level.mean()), least)


Phase = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""(parameters (m,), x, y) -> phase, rad."""

_STEP = 1e-3  # px
_WEIGHTED = 4  # steps after which weights are those of the noise
_SETTLED, _ROUGH = 1e-4, 1e-2  # rad
_MOST = 200_000  # pixels: more cost memory, and tell what these have told
_FEWEST = 3.0  # pixels for each number that is fitted


@dataclass(frozen=True)
class Modulation:
    """The functions b_k cos(h_k Phi), and what they are worth where."""

    basis: Callable[[FloatArray, FloatArray], FloatArray]
    """(f, direction) (n,) -> (n, k) for one harmonic: f is the harmonic's own."""
    orders: tuple[int, ...] = (1,)


@dataclass(frozen=True, eq=False)
class WaveFit:
    """What was found: coefficients of light and modulation, phase parameters, and their errors."""

    light: FloatArray
    coefficients: FloatArray
    """(orders * k,)"""
    covariance: FloatArray
    """Of `coefficients`, with light and phase free."""
    parameters: FloatArray
    parameters_std: FloatArray
    gain: float
    read_variance: float
    """Variance of a pixel: gain * value + read_variance."""
    chi2: float
    """Per degree of freedom, of the last step's weights: 1 where noise explains all."""
    step: float
    """Largest last change of a phase parameter, in its standard deviations: converged if well below 1."""
    values: FloatArray
    """The model at every pixel."""
    signal: float
    """Modulation over its standard deviation: below 5 there is no wave."""


def enough(used: np.ndarray, most: int | None = None) -> np.ndarray:
    """Indices of as many of the True entries as a fit needs, spread evenly, always the same ones; of all if they are few."""
    places, most = np.flatnonzero(used), _MOST if most is None else most
    if len(places) <= most:
        return places
    return np.sort(np.random.default_rng(0).choice(places, most, replace=False))


def local_wave(
    phase: Phase, parameters: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phase, frequency (cycles/px) and direction (rad) of a wave at pixels."""
    by_x = phase(parameters, x + _STEP, y) - phase(parameters, x - _STEP, y)
    by_y = phase(parameters, x, y + _STEP) - phase(parameters, x, y - _STEP)
    # two ends of a step may lie on both sides of the cut of an angle
    by_x, by_y = (np.mod(d + np.pi, 2 * np.pi) - np.pi for d in (by_x, by_y))
    return (
        phase(parameters, x, y),
        np.hypot(by_x, by_y) / (4 * np.pi * _STEP),
        np.arctan2(by_y, by_x),
    )


def fit_wave(
    value: FloatArray, x: FloatArray, y: FloatArray, phase: Phase, start: FloatArray, scale: FloatArray, modulation: Modulation,
    degree: int = 2, steps: int = 8, rough: bool = False,
) -> WaveFit | None:  # fmt: skip
    """Fit a wave to pixels (n,); None where they do not determine it.

    start: phase parameters; scale: changes of them that move the phase by about 1 rad somewhere. degree: of the light. rough:
    only the phase is wanted, to 0.01 rad.
    """
    powers = _powers(x, y, degree)
    parameters = np.array(start, dtype=float)
    weight = np.ones_like(value)
    light = np.zeros(powers.shape[1])
    light[0] = value.mean()
    coefficients: FloatArray = np.zeros(0)
    gain, read = 0.0, float(value.var())
    for step in range(steps + 2):
        columns, slopes = _columns(phase, parameters, x, y, modulation)
        if not step:
            coefficients = np.zeros(columns.shape[1])
        level, wave = powers @ light, columns @ coefficients
        # the first two steps find how strong the wave is where it is thought to be
        moving = step > 1
        design = [powers * (1 + wave)[:, None], level[:, None] * columns]
        if moving:
            tilt = level * (slopes @ coefficients)
            at = phase(parameters, x, y)
            for i, size in enumerate(scale * 1e-4):
                moved = parameters.copy()
                moved[i] += size
                turned = np.mod(phase(moved, x, y) - at + np.pi, 2 * np.pi) - np.pi
                design.append((tilt * turned / size)[:, None])
        matrix = np.concatenate(design, axis=1)
        if value.size < _FEWEST * matrix.shape[1]:
            return None
        residual = value - level * (1 + wave)
        if moving and step > 2:
            gain, read = noise_of(residual, level * (1 + wave))
            weight = 1 / (gain * np.maximum(level * (1 + wave), 0) + read)
        normal = (matrix.T * weight) @ matrix
        if not np.isfinite(normal).all():
            return None
        inverse = scaled_inverse(normal)
        change = inverse @ (matrix.T @ (weight * residual))
        light = light + change[: light.size]
        coefficients = coefficients + change[light.size : light.size + coefficients.size]
        if moving:
            shift = change[light.size + coefficients.size :]
            # no step may turn the phase by more than it can be trusted to be linear
            shift *= min(1.0, 1.0 / max(float(np.abs(shift / scale).max()), 1e-300))
            parameters = parameters + shift
        else:
            shift = np.zeros_like(scale)
        if not (np.isfinite(change).all() and np.isfinite(parameters).all()):
            return None
        if np.abs(shift / scale).max() < (_ROUGH if rough else _SETTLED) and (rough or step > _WEIGHTED) and moving:
            break
    last = inverse[light.size + coefficients.size :, light.size + coefficients.size :]
    std = np.sqrt(np.maximum(np.diag(last), 0))
    block = slice(light.size, light.size + coefficients.size)
    covariance = inverse[block, block]
    strength = float(coefficients @ np.linalg.pinv(covariance, rcond=1e-10, hermitian=True) @ coefficients)
    return WaveFit(
        light,
        coefficients,
        covariance,
        parameters,
        std,
        gain,
        read,
        float((weight * residual**2).sum() / (value.size - matrix.shape[1])),
        float(np.max(np.abs(shift) / np.maximum(std, 1e-300))) if shift.size else 0.0,
        level * (1 + wave),
        float(np.sqrt(max(strength - coefficients.size, 0.0))),
    )


def _columns(
    phase: Phase, parameters: FloatArray, x: FloatArray, y: FloatArray, modulation: Modulation
) -> tuple[FloatArray, FloatArray]:
    """The functions at the pixels (n, orders * k), and their derivatives by the phase."""
    at, frequency, direction = local_wave(phase, parameters, x, y)
    columns, slopes = [], []
    for order in modulation.orders:
        basis = modulation.basis(order * frequency, direction)
        columns.append(basis * np.cos(order * at)[:, None])
        slopes.append(-order * basis * np.sin(order * at)[:, None])
    return np.concatenate(columns, axis=1), np.concatenate(slopes, axis=1)


def _powers(x: FloatArray, y: FloatArray, degree: int) -> FloatArray:
    """Polynomials of the place, (n, terms), the constant first."""
    u, v = ((c - c.mean()) / max(float(np.ptp(c)) / 2, 1.0) for c in (x, y))
    return np.stack([u**i * v**j for n in range(degree + 1) for i in range(n, -1, -1) for j in (n - i,)], axis=-1)
