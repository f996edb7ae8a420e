"""Where a grating lies in a picture: its pixels, and the phase of each of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.calibration.smoothing import smoothed
from matcam.calibration.wave_fit import Array
from matcam.errors import FitError

MARGIN = 4.0
"""px: pixels nearer than this to a grating's border see what is outside."""
_WIDE = 50.0  # px: beyond, perspective and distortion need third order
_CLEAR = 30.0  # power of the wave over the median of the spectrum
_ENVELOPE = 0.75
_NEAR = 0.1  # of a stated frequency: how far the true one is looked for
_LONGEST = 2.0  # periods that a region must hold at least


class FoundGrating(NamedTuple):
    """A grating in a picture."""

    parameters: Array
    """(6,) or (10,) of `phase_of`."""
    inside: np.ndarray
    """(height, width) pixels that see nothing else."""
    middle: tuple[float, float]
    """px of the place that the phase is expanded about."""


def phase_of(parameters: Array, x: Array, y: Array, middle: tuple[float, float]) -> Array:
    """Phase, rad, at px: a polynomial of second or third order; in units of 100 px."""
    u, v = (x - middle[0]) / 100, (y - middle[1]) / 100
    p = parameters
    phase = p[0] + p[1] * u + p[2] * v + p[3] * u * u + p[4] * u * v + p[5] * v * v
    if len(p) == 10:
        phase = phase + p[6] * u * u * u + p[7] * u * u * v + p[8] * u * v * v + p[9] * v * v * v
    return np.asarray(phase)


def scales(found: FoundGrating) -> Array:
    """Changes of the parameters that turn the phase by about 1 rad."""
    reach = np.sqrt(found.inside.sum()) / 200
    return np.concatenate([[1.0], [1 / reach] * 2, [1 / reach**2] * 3, [1 / reach**3] * (len(found.parameters) - 6)])


def from_points(x: Array, y: Array, phase: Array, inside: np.ndarray) -> FoundGrating:
    """The grating whose (unwrapped) phase is known at some points."""
    middle = (float(x.mean()), float(y.mean()))
    u, v = (x - middle[0]) / 100, (y - middle[1]) / 100
    powers = [np.ones_like(u), u, v, u * u, u * v, v * v]
    if np.sqrt(inside.sum()) > _WIDE:
        powers += [u * u * u, u * u * v, u * v * v, v * v * v]
    parameters = np.asarray(np.linalg.lstsq(np.stack(powers, axis=-1), phase, rcond=None)[0], dtype=np.float64)
    return FoundGrating(parameters, inside, middle)


def inside_of(corners: Array, shape: tuple[int, int]) -> np.ndarray:
    """Pixels deeper than the margin inside a convex polygon (n, 2) px."""
    y, x = np.indices(shape).astype(float)
    middle, inside = corners.mean(0), np.ones(shape, bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*(b - a))
        normal *= np.sign(normal @ (middle - a))
        inside &= (x - a[0]) * normal[0] + (y - a[1]) * normal[1] > MARGIN
    return inside


def find_grating(values: Array, near: tuple[float, float] | None = None) -> FoundGrating:
    """The grating in a region (height, width), NaN where there are no data. near: its frequency (fx, fy), cycles/px, if it may
    lie beyond Nyquist; roughly: the nearest that looks the same is taken. FitError where there is none."""
    filled = values if np.isfinite(values).all() else smoothed(values, 0.9)
    frequency = _strongest(filled, near)
    if near is not None:
        shifts = np.stack(np.meshgrid([-2, -1, 0, 1, 2], [-2, -1, 0, 1, 2]), axis=-1).reshape(-1, 2)
        alike = np.concatenate([shifts + frequency, shifts - frequency])
        frequency = alike[np.argmin(np.hypot(*(alike - np.array(near)).T))]
    y, x = np.indices(values.shape).astype(float)
    wave = np.exp(-2j * np.pi * (frequency[0] * x + frequency[1] * y))
    smooth = max(3.0, 0.8 / np.hypot(*_folded(frequency)))
    turned = (filled - filled.mean()) * wave
    envelope = ndimage.gaussian_filter(turned.real, smooth) + 1j * ndimage.gaussian_filter(turned.imag, smooth)
    size = np.abs(envelope)
    label, count = ndimage.label(size > _ENVELOPE * np.quantile(size, 0.98))
    if not count:
        raise FitError("region holds no grating")
    largest = 1 + int(np.argmax(ndimage.sum_labels(np.ones_like(size), label, np.arange(1, count + 1))))
    inside = ndimage.binary_erosion(
        ndimage.binary_fill_holes(label == largest), iterations=round(MARGIN), border_value=1
    )
    if inside.sum() < 256:
        raise FitError("region holds no grating: nowhere 16 x 16 px of one regular wave")
    start = float(np.angle(envelope[inside].mean()))
    phase = start + 2 * np.pi * (frequency[0] * x + frequency[1] * y)
    return from_points(x[inside], y[inside], phase[inside], inside)


def _folded(frequency: Array) -> Array:
    return np.asarray(frequency - np.round(frequency))


def _strongest(filled: Array, near: tuple[float, float] | None) -> Array:
    """(fx, fy) cycles/px of the strongest wave below Nyquist; of those that may be `near` in truth, if that is given."""
    height, width = filled.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
    mean = (window * filled).sum() / window.sum()
    # four times as many frequencies as samples: the peak is then known to a small part of a period over the region
    power = np.abs(np.fft.rfft2(window * (filled - mean), (4 * height, 4 * width))) ** 2
    fy, fx = np.fft.fftfreq(4 * height)[:, None], np.fft.rfftfreq(4 * width)[None]
    # borders of what is in the region have power at low frequencies, more than harmonics have at high ones
    power *= np.hypot(fx, fy)
    power[(np.abs(fx) * width < _LONGEST) & (np.abs(fy) * height < _LONGEST)] = 0
    everywhere = np.median(power)
    if near is not None:
        alias = _folded(np.array(near))
        off = [np.hypot(_folded(fx - sign * alias[0]), _folded(fy - sign * alias[1])) for sign in (-1, 1)]
        power[np.minimum(*off) > max(_NEAR * float(np.hypot(*near)), 2 * _LONGEST / min(height, width))] = 0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    if not power[row, column] > _CLEAR * everywhere:
        raise FitError("region holds no grating: no frequency stands out")
    return np.array([fx[0, column], fy[row, 0]])
