"""Pictures through a lens that passes no frequency above a limit, without a detour over sums of Gaussians.

A diffraction-limited lens, in focus or not, and a measured curve that has reached 0 end at a frequency B. Their picture is one
through a narrow Gaussian lens, filtered:

    picture = F^-1 [ lens(f) / g(f)  F picture_g ],    g(f) = exp(-2 pi^2 s^2 f^2).

picture_g is recorded at `per_px` places a pixel, by the operator for Gaussians. What it holds above per_px - B comes back as
another frequency below B; pixel and Gaussian have left nothing of it. s is so narrow that the filter amplifies little. The
filter is exact at every frequency that there is, so the lens is the stated one to `error`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.fft import next_fast_len

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import PixelResponse
from matcam.core.jax import is_concrete, jax, jnp
from matcam.numerics.lengths import plane_length

_MOST_PER_PX = 8
_AMPLIFIED = 1.6
"""Largest factor by which a filter may amplify a frequency: the record's own errors grow by it."""
_ENOUGH = 1e-6
"""Error of a transfer function that no more places a pixel are taken for."""
_SIGMAS = np.arange(0.1, 2.0, 0.025)
_FREQUENCIES = 300
_REPLICAS = 2
_APART = 160
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


def band_limit(camera: Camera) -> BandLimit | None:
    """Return how pictures of a camera are filtered; None where its lens is a sum of Gaussians, or nearer to one."""
    optics, pixel = (jax.tree.map(_stopped, part) for part in (camera.optics, camera.pixel))
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((optics, pixel))):
        return None
    by_gaussians = float(gaussian_sum(optics).total_error)
    if by_gaussians == 0:
        return None
    frequency = np.linspace(0, optics.band(), _FREQUENCIES)
    lens = np.asarray(optics.mtf(frequency))
    best = _chosen(tuple(frequency.tolist()), tuple(lens.tolist()), _pixel_transfer(pixel, frequency))
    return best if best.error < by_gaussians else None


def _stopped(leaf: object) -> object:
    return jax.lax.stop_gradient(leaf) if eqx.is_array(leaf) else leaf


def _pixel_transfer(pixel: PixelResponse, frequency: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Return the pixel's transfer at all replicas of the frequencies, for each count of places a pixel."""
    rows = []
    for per_px in range(2, _MOST_PER_PX + 1):
        at = np.concatenate([per_px * k + side * frequency for k in range(1, _REPLICAS + 1) for side in (-1, 1)])
        rows.append(tuple(np.abs(np.asarray(pixel.mtf(at))).tolist()))
    return tuple(rows)


@lru_cache(maxsize=32)
def _chosen(
    frequencies: tuple[float, ...], lens: tuple[float, ...], pixels: tuple[tuple[float, ...], ...]
) -> BandLimit:
    """Return the fewest places a pixel whose error is small enough, with the best Gaussian; else the least error."""
    f, mtf = np.array(frequencies), np.array(lens)
    best = BandLimit(_MOST_PER_PX, 0.1, np.inf)
    for per_px, pixel in zip(range(2, _MOST_PER_PX + 1), pixels, strict=True):
        at = np.concatenate([per_px * k + side * f for k in range(1, _REPLICAS + 1) for side in (-1, 1)])
        for sigma in _SIGMAS:
            raised = np.abs(mtf) * np.exp(2 * (np.pi * sigma * f) ** 2)
            if raised.max() > _AMPLIFIED:
                break
            folded = (np.array(pixel) * np.exp(-2 * (np.pi * sigma * at) ** 2)).reshape(-1, f.size).sum(axis=0)
            error = float((folded * raised).max())
            if error < best.error:
                best = BandLimit(per_px, float(sigma), error)
        if best.error < _ENOUGH:
            break
    return best


class FineLine(NamedTuple):
    """Hold the places along one axis at which a picture is recorded before it is filtered.

    Attributes:
        at: px, in steps of a share of a pixel, in the direction of the picture's own.
        first: index of the picture's first pixel.
    """

    at: np.ndarray
    first: int


def fine_line(pixels: np.ndarray, low: float, high: float, per_px: int) -> FineLine:
    """Return places that hold a picture's pixels and all that sends light, from low to high px."""
    step = 1.0 if pixels.size < 2 else float(np.sign(pixels[1] - pixels[0]))
    ends = (low, high) if step > 0 else (high, low)
    before, after = max(0.0, step * (pixels[0] - ends[0])), max(0.0, step * (ends[1] - pixels[-1]))
    first = int(np.ceil(before * per_px))
    count = first + (pixels.size - 1) * per_px + int(np.ceil(after * per_px)) + 1
    return FineLine(pixels[0] + step * (np.arange(count) - first) / per_px, first)


def filtered(values: jax.Array, optics: Optics, limit: BandLimit) -> jax.Array:
    """Return a fine record (rows, columns, channels) as the lens shows it, at the same places."""
    shape = [next_fast_len(n + _APART * limit.per_px, real=True) for n in values.shape[:2]]
    rows, columns = np.fft.fftfreq(shape[0], 1 / limit.per_px), np.fft.rfftfreq(shape[1], 1 / limit.per_px)
    f = plane_length(jnp.asarray(rows)[:, None], jnp.asarray(columns))
    band = optics_band(optics)
    seen = f <= band
    inside = jnp.where(seen, f, 0.0)
    lens = sum((weight * part.mtf(inside) for weight, part in optics.components()), jnp.zeros(()))
    transfer = jnp.where(seen, lens * jnp.exp(2 * (jnp.pi * limit.sigma * inside) ** 2), 0.0)
    spectrum = jnp.fft.rfft2(values, shape, axes=(0, 1)) * transfer[..., None]
    return jnp.fft.irfft2(spectrum, shape, axes=(0, 1))[: values.shape[0], : values.shape[1]]


def optics_band(optics: Optics) -> float:
    """Return the frequency above which a lens passes nothing, cycles/px, where its parameters may be differentiated."""
    stopped = jax.tree.map(_stopped, optics)
    return float(stopped.band())
