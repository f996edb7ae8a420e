"""Pictures smoothed, with or without gaps: a mosaic has a colour at some of its pixels only.

Light over the field, from the bright sides of a picture's edges: most of them are the same paper.

An edge's own fit has light that changes linearly; what a lens's vignetting bends beyond that within a strip is divided out.
Only the bend matters: a wrong level or slope of the light changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from matcam.calibration.photograph.region import Region
from matcam.core.jax import FloatArray

_ALONE = 1e-6  # of the Gaussian's weight: a pixel that sees less of what is there is left dark


def smoothed(values: FloatArray, width: float) -> FloatArray:
    """Means about every pixel (height, width), weighted by a Gaussian of `width` px, of what is there. values: NaN where there
    are no data; the result has none."""
    there = np.isfinite(values)
    if there.all():
        return np.asarray(ndimage.gaussian_filter(values, width))
    known = ndimage.gaussian_filter(np.where(there, values, 0.0), width)
    return np.asarray(known / np.maximum(ndimage.gaussian_filter(there.astype(float), width), _ALONE))


_FEWEST = 12  # edges, for the six numbers of the light
_OUTLIER, _ROUNDS = 3.0, 6
_LEAST_SCATTER = 0.003  # relative
_SHARE = 4  # the last quarter of a row is its bright side
_RANGE = 20.0  # no chart is lit so unevenly


def evened(regions: Sequence[Region]) -> list[Region]:
    """Strips with their light made even: log light is a quadratic over the field; as they are where it cannot be known."""
    x, y = (np.concatenate([getattr(r.frame, axis) for r in regions]) for axis in "xy")
    bright = np.concatenate([_bright(r.value) for r in regions])
    good = np.isfinite(bright) & (bright > 0)
    if good.sum() < _FEWEST:
        return list(regions)
    middle, scale = (x.mean(), y.mean()), max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    powers = _powers((x - middle[0]) / scale, (y - middle[1]) / scale)
    level = np.log(np.where(good, bright, 1.0))
    for _ in range(_ROUNDS):
        found = np.linalg.lstsq(powers[good], level[good], rcond=1e-6)[0]
        off = np.abs(level - powers @ found)
        scatter = max(1.5 * float(np.median(off[good])), _LEAST_SCATTER)
        good = (bright > 0) & (off < _OUTLIER * scatter)
        if good.sum() < _FEWEST:
            return list(regions)
    if np.ptp(powers[good] @ found) > np.log(_RANGE):
        return list(regions)
    return [_divided(r, found, middle, scale) for r in regions]


def _divided(region: Region, found: np.ndarray, middle: tuple[float, float], scale: float) -> Region:
    """A region by its light relative to that at its centre."""
    frame = region.frame
    across = region.start[..., None] + region.step * np.arange(region.value.shape[2])
    columns = frame._replace(
        transposed=np.asarray(frame.transposed)[:, None, None], mirrored=np.asarray(frame.mirrored)[:, None, None]
    )
    dx, dy = columns.turned(across, np.broadcast_to(region.y[..., None], across.shape))
    x, y = (np.asarray(a)[:, None, None] for a in (frame.x, frame.y))
    dx, dy, x, y = dx / scale, dy / scale, (x - middle[0]) / scale, (y - middle[1]) / scale
    # the difference of the quadratic between a place and the centre
    _, fx, fy, fxx, fxy, fyy = found
    bend = (fx + fxx * (2 * x + dx) + fxy * (y + dy)) * dx + (fy + fxy * x + fyy * (2 * y + dy)) * dy
    return region._replace(value=region.value * np.exp(-bend))


def _bright(value: np.ndarray) -> np.ndarray:
    """(n,) mean of every strip's bright side."""
    there = np.isfinite(value)
    width = there.any(1).sum(1)
    side = there & (np.arange(value.shape[2]) >= (width - width // _SHARE)[:, None, None])
    count = side.sum((1, 2))
    return np.where(side, value, 0.0).sum((1, 2)) / np.where(count > 0, count, np.nan)


def _powers(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
