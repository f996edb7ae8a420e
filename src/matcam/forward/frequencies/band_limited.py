"""Pictures through a lens that passes no frequency above a limit, without a detour over sums of Gaussians.

A diffraction-limited lens, in focus or not, with aberrations or not, and a measured curve that has reached 0 end at a frequency
B. Their picture is one through a narrow Gaussian and no pixel, filtered:

    picture = F^-1 [ lens(f) pixel(f) / g(f)  F picture_g ],    g(f) = exp(-2 pi^2 s^2 f^2).

A sphere's light before a distant camera is known by itself (`light_grid.py`), and picture_g with it. Elsewhere picture_g
is recorded at `per_px` places a pixel, by the operator for Gaussians. What it holds above per_px - B comes back as
another frequency below B; the Gaussian has left nothing of it. s is so narrow that the filter amplifies little. The filter is
exact at every frequency that there is, so lens and pixel are the stated ones to `error`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.optics.optics import Optics
from matcam.camera.optics.zernike import ZernikeOptics
from matcam.camera.pixel import PixelResponse
from matcam.core.jax import is_concrete, jax, jnp, without_derivatives

POINT = 1e-3
"""Half width, px, of the pixel through which a fine record is made: none, to the operator."""
_MOST_PER_PX = 8
_AMPLIFIED = 3.0
"""Largest factor by which a filter may amplify a frequency: the record's own errors grow by it."""
EXACT = 1e-6
"""Error of a transfer function that no more places a pixel are taken for."""
_SIGMAS = np.arange(0.1, 2.0, 0.025)
_FREQUENCIES = 120
_ANGLES = np.linspace(0, np.pi / 4, 5)
_REPLICAS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
APART = 160
"""px between the scene and its periodic neighbour: an Airy pattern of f/8 has fallen to 1e-7 of its peak."""


class BandLimit(NamedTuple):
    """Say how a picture is recorded and filtered.

    Attributes:
        per_px: places along a pixel's side.
        sigma: standard deviation of the Gaussian lens through which they are recorded, px.
        error: largest error of the transfer function of lens and pixel.
    """

    per_px: int
    sigma: float
    error: float


def band_limit(camera: Camera, enough: float = EXACT) -> BandLimit | None:
    """Return how pictures of a camera are filtered; None where its lens is a sum of Gaussians, or nearer to one.

    enough: error of a transfer function that no more places a pixel are taken for.
    """
    if not concrete(camera):
        return None
    optics = without_derivatives(camera.optics)
    by_gaussians = float(gaussian_sum(optics).total_error)
    if by_gaussians == 0:
        return None
    best = sampling_of([optics], camera.pixel, enough)
    return best if best.error < by_gaussians else None


def concrete(camera: Camera) -> bool:
    """Tell whether the numbers of lens and pixel are known, but for their derivatives."""
    stopped = without_derivatives((camera.optics, camera.pixel))
    return all(is_concrete(leaf) for leaf in jax.tree.leaves(stopped))


def sampling_of(lenses: Sequence[Optics], pixel: PixelResponse, enough: float = EXACT) -> BandLimit:
    """Return how a picture is recorded that each of these lenses filters; their numbers must be known."""
    stopped = without_derivatives(list(lenses))
    pixel = without_derivatives(pixel)
    frequency = np.linspace(0, max(lens.band() for lens in stopped), _FREQUENCIES)
    passed = np.max([_at_most(lens, frequency) for lens in stopped], axis=0)
    along, across = (np.abs(np.asarray(pixel.mtf(frequency * part(_ANGLES[:, None])))) for part in (np.cos, np.sin))
    return _chosen(tuple(frequency.tolist()), tuple(map(tuple, (passed * along * across).tolist())), enough)


def _at_most(optics: Optics, frequency: np.ndarray) -> np.ndarray:
    """Return what a lens lets pass in any direction, at most: aberrations only take away."""
    if optics.isotropic:
        return np.abs(np.asarray(optics.mtf(frequency)))
    parts = [
        abs(float(weight))
        * np.abs(np.asarray((part.focused if isinstance(part, ZernikeOptics) else part).mtf(frequency)))
        for weight, part in optics.components()
    ]
    return np.sum(parts, axis=0)


@lru_cache(maxsize=32)
def _chosen(frequencies: tuple[float, ...], passed: tuple[tuple[float, ...], ...], enough: float) -> BandLimit:
    """Return the fewest places a pixel whose error is small enough, with the best Gaussian; else the least error.

    passed: what lens and pixel let pass at these frequencies, along `_ANGLES`.
    """
    f, total = np.array(frequencies), np.array(passed)
    fx, fy = (f * part(_ANGLES[:, None]) for part in (np.cos, np.sin))
    best = BandLimit(_MOST_PER_PX, 0.1, np.inf)
    for per_px in range(2, _MOST_PER_PX + 1):
        folded = np.array([(per_px * i - fx) ** 2 + (per_px * j - fy) ** 2 for i, j in _REPLICAS])
        for sigma in _SIGMAS:
            raised = total * np.exp(2 * (np.pi * sigma * f) ** 2)
            if raised.max() > _AMPLIFIED:
                break
            error = float((np.exp(-2 * (np.pi * sigma) ** 2 * folded).sum(axis=0) * raised).max())
            if error < best.error:
                best = BandLimit(per_px, float(sigma), error)
        if best.error < enough:
            break
    return best


class FineLine(NamedTuple):
    """Places along one axis at which a picture is recorded before it is filtered.

    Attributes:
        at: px, in steps of a share of a pixel, in the direction of the picture's own.
        first: index of the picture's first pixel.
        step: 1.0 where they run to the right or upwards, -1.0 where they run the other way.
    """

    at: np.ndarray
    first: int
    step: float


def fine_line(pixels: np.ndarray, low: float, high: float, per_px: int) -> FineLine:
    """Return places that hold a picture's pixels and all that sends light, from low to high px."""
    step = 1.0 if pixels.size < 2 else float(np.sign(pixels[1] - pixels[0]))
    ends = (low, high) if step > 0 else (high, low)
    before, after = max(0.0, step * (pixels[0] - ends[0])), max(0.0, step * (ends[1] - pixels[-1]))
    first = int(np.ceil(before * per_px))
    count = first + (pixels.size - 1) * per_px + int(np.ceil(after * per_px)) + 1
    return FineLine(pixels[0] + step * (np.arange(count) - first) / per_px, first, step)


class FineRecord(NamedTuple):
    """Transform of a fine record.

    Attributes:
        spectrum: (rows, columns, channels), complex, of real values.
        fx: frequency of its columns, to the right, cycles/px.
        fy: frequency of its rows, upwards, cycles/px.
        padded: rows and columns of the record with what parts it from its periodic neighbour.
        size: rows and columns of the record.
    """

    spectrum: jax.Array
    fx: np.ndarray
    fy: np.ndarray
    padded: tuple[int, int]
    size: tuple[int, int]

    def values(self) -> jax.Array:
        """Return the record itself, (rows, columns, channels)."""
        return jnp.fft.irfft2(self.spectrum, self.padded, axes=(0, 1))[: self.size[0], : self.size[1]]

    def through(self, sigma: float | jax.Array) -> FineRecord:
        """Return what of light is recorded through a Gaussian of a standard deviation, px, and a pixel of `POINT`."""
        return self._replace(spectrum=self.spectrum * recorded(sigma, self.fx, self.fy[:, None])[..., None])

    def derivative(self, along: int, across: int) -> jax.Array:
        """Return the values' derivative, so often by x and by y, 1/px."""
        factor = (2j * np.pi * self.fx) ** along * (2j * np.pi * self.fy[:, None]) ** across
        return self._replace(spectrum=self.spectrum * factor[..., None]).values()

    def only(self, channels: slice | list[int]) -> FineRecord:
        """Return the transform of some channels."""
        return self._replace(spectrum=self.spectrum[..., channels])

    def of(self, values: jax.Array) -> FineRecord:
        """Return the transform of other values at the same places."""
        return self._replace(spectrum=jnp.fft.rfft2(values, self.padded, axes=(0, 1)))


def transformed(values: jax.Array, across: FineLine, along: FineLine, per_px: int, periodic: bool) -> FineRecord:
    """Transform a fine record.

    Args:
        values: the record, (rows, columns, channels).
        across: its columns.
        along: its rows.
        per_px: places along a pixel's side.
        periodic: True where the record goes on along y for ever, as a cylinder's does.
    """
    height, width = values.shape[:2]
    rows, columns = (next_fast_len(n + APART * per_px, real=True) for n in (height, width))
    rows = height if periodic else rows
    fx, fy = np.fft.rfftfreq(columns, 1 / per_px) * across.step, np.fft.fftfreq(rows, 1 / per_px) * along.step
    spectrum = jnp.fft.rfft2(values, (rows, columns), axes=(0, 1))
    return FineRecord(spectrum, fx, fy, (rows, columns), (height, width))


def filtered(record: FineRecord, optics: Optics, pixel: PixelResponse, limit: BandLimit, shift: jax.Array) -> jax.Array:
    """Return a fine record as lens and pixel show it, at the same places.

    Args:
        record: the record's transform.
        optics: the lens.
        pixel: the pixel.
        limit: how the record was made.
        shift: of the picture, (right, up), px.

    Returns:
        Transform of what is seen of the record's channels.
    """
    fx, fy = np.broadcast_arrays(record.fx, record.fy[:, None])
    rows, columns = np.nonzero(np.hypot(fx, fy) <= optics_band(optics))
    fx, fy = fx[rows, columns], fy[rows, columns]
    lens = optics.otf(fx, fy) * pixel.mtf(fx) * pixel.mtf(fy) / recorded(limit.sigma, fx, fy)
    if np.any(np.asarray(jax.lax.stop_gradient(shift))):
        lens = lens * jnp.exp(-2j * jnp.pi * (fx * shift[0] + fy * shift[1]))
    passed = record.spectrum[rows, columns] * lens[:, None]
    return jnp.zeros_like(record.spectrum).at[rows, columns].set(passed)


def recorded(sigma: float | jax.Array, fx: np.ndarray, fy: np.ndarray) -> jax.Array:
    """Return the transfer function through which a fine record is made: of a Gaussian lens, px, and a pixel of `POINT`."""
    return jnp.exp(-2 * (jnp.pi * sigma) ** 2 * (fx**2 + fy**2)) * np.sinc(2 * POINT * fx) * np.sinc(2 * POINT * fy)


def optics_band(optics: Optics) -> float:
    """Return the frequency above which a lens passes nothing, cycles/px, where its parameters may be differentiated."""
    return float(without_derivatives(optics).band())
