"""Search for straight edges in an image, or for the sides of the squares of a registered chart.

Without a chart, edges are found at any scale and rotation, under uneven light and mild distortion. Adjacent pixels with
gradients in similar directions form an edge. Its position and direction are the means over its pixels, weighted by the
gradient. An edge ends at a corner, where the direction of the gradient changes; the shape need not be a square. An edge is
kept if the areas on both sides are even, and wide enough to be measured. The search starts in an image of at most 2
megapixels, and continues at finer scales if it finds fewer than four edges.

Gratings, stars, dots and printed tables have hundreds of edges. Therefore, in a chart, the search is limited to the sides
of squares, at their registered positions. Sides that are partly covered are excluded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.registration import Projection
from matcam.calibration.chart.sides import seen_sides
from matcam.calibration.photograph.linear_image import smoothed
from matcam.core.arrays import FloatArray

_SHORTEST = 12.0
"""Smallest length of an edge, px of the reduced image."""
_CORNER = 2.5
"""Length that is removed from both ends of an edge, px of the reduced image. It excludes the blurred corners."""
_PROFILE = 40
"""Largest distance on both sides of an edge that is tested for evenness, px of the reduced image."""


class EdgePositions(NamedTuple):
    """Set of n edges in descending order of length times step.

    Positions are in px of the image. Pixel centres have whole-number coordinates; x points right, and y points down.

    Attributes:
        x: (n,) x of the middle, px.
        y: (n,) y of the middle, px.
        angle: (n,) angle from the x axis to the normal that points to the bright side, positive towards y, rad.
        length: (n,) length without corners, px.
        clear: (n,) distance on both sides to which the levels are even, px.
    """

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    length: np.ndarray
    clear: np.ndarray


def find_edges(picture: np.ndarray, *, mosaic: bool = False) -> EdgePositions:
    """Find straight edges in an image.

    `picture`: codes that are any monotone function of the light, (height, width) or (height, width, 3). `mosaic`: whether
    the image is a colour mosaic, which is reduced in cells of 2 x 2 px.
    """
    least = 2 if mosaic else 1
    # A reduced image of at most 2 megapixels limits the time of the search.
    factor = max(int(np.ceil(np.sqrt(picture.shape[0] * picture.shape[1] / 2_000_000) / least)) * least, least)
    while True:
        found = _at_scale(picture, factor)
        finer = factor // 2 // least * least
        # With four edges, a search at a finer scale is unnecessary.
        if found.x.size >= 4 or finer < least:
            return found
        factor = finer


def described_edges(values: FloatArray, chart: Chart, projection: Projection) -> EdgePositions | None:
    """Find the measurable sides of the squares of a chart.

    The result is None for a chart without squares. `values`: codes that are any monotone function of the light, (height,
    width); the colours of a mosaic are balanced, and missing pixels are NaN. `projection`: map from the page, mm, to the
    image, px.
    """
    smooth = smoothed(values)
    sides = seen_sides(smooth, chart, projection)
    if sides is None:
        return None
    # A side that is found at fewer than 5 positions is mostly covered.
    found = sides.found & (sides.found.sum(1) >= 5)[:, None]
    square, position = np.nonzero(found)
    some, one = np.unique(square, return_inverse=True)
    (x, y), (nx, ny) = sides.seen[square, position].T, sides.normal[square, position].T
    x, y, angle, _, width = _moments(one, some.size, x, y, nx, ny, np.ones(one.size))[0].T
    # The positions found along a side scatter about a straight line by at most 0.7 px.
    good = width < np.sqrt(12) * 0.7
    # At both ends, 3.5 px are removed, because the corners are blurred.
    return clear_edges(smooth, x[good], y[good], angle[good], sides.length[some[good]], 3.5)


def _at_scale(picture: np.ndarray, factor: int) -> EdgePositions:
    small = _reduced(picture, factor)
    ribbons = _ribbons(small) if min(small.shape) > 2 * _SHORTEST else np.zeros((0, 4))
    x, y, angle, length = ribbons.T
    edges = clear_edges(small, x, y, angle, length, _CORNER)
    x, y = (column * factor + (factor - 1) / 2 for column in (edges.x, edges.y))
    return EdgePositions(x, y, edges.angle, factor * edges.length, factor * edges.clear)


def _reduced(picture: np.ndarray, factor: int) -> np.ndarray:
    """Sum an image over squares of `factor` x `factor` px and over its colours. Only ratios of the sums are used."""
    height, width = (size // factor * factor for size in picture.shape[:2])
    total = np.zeros((height // factor, width), np.float32)
    for row in range(factor):
        part = picture[row:height:factor, :width]
        total += part if part.ndim == 2 else part.sum(-1, dtype=np.float32)
    return total.reshape(height // factor, -1, factor).sum(-1)


def _ribbons(small: np.ndarray) -> np.ndarray:
    """Find n sets of connected pixels with similar gradient directions.

    The columns of the result (n, 4) are x (px), y (px), angle of the normal (rad) and length (px).
    """
    gx, gy = (ndimage.gaussian_filter(small, 1.0, order=order, mode="nearest") for order in ((0, 1), (1, 0)))
    size = np.hypot(gx, gy)
    # The gradient of an edge is at least 6 times the median of all gradients, and 0.06 of their 99.5 % quantile.
    floor = max(6.0 * float(np.median(size)), 0.06 * float(np.quantile(size[::3, ::3], 0.995)), 1e-30)
    rows, columns = np.nonzero(size > floor)
    gx, gy, size = gx[rows, columns], gy[rows, columns], size[rows, columns]
    sectors = 16
    width = 2 * np.pi / sectors
    sector = np.floor((np.arctan2(gy, gx) + np.pi) / width).astype(int) % sectors
    found = []
    # Each sector of gradient directions is searched together with its two neighbours.
    for centre in range(sectors):
        near = (sector - centre + 1) % sectors <= 2
        mask = np.zeros(small.shape, np.uint8)
        mask[rows[near], columns[near]] = 1
        label, count = ndimage.label(mask, np.ones((3, 3)))
        one = label[rows[near], columns[near]] - 1
        ribbon, direction = _moments(one, count, *(a[near] for a in (columns, rows, gx, gy, size)))
        # An edge is found in three sectors, and assigned to the one that contains its mean direction.
        mine = np.floor((direction + np.pi) / width).astype(int) % sectors == centre
        found.append(ribbon[mine])
    ribbon = np.concatenate(found)
    length, thickness = ribbon[:, 3], ribbon[:, 4]
    # Compact sets are spots, not edges.
    return ribbon[(length >= _SHORTEST) & (length >= 3.0 * thickness)][:, :4]


def _moments(
    one: np.ndarray, count: int, x: np.ndarray, y: np.ndarray, gx: np.ndarray, gy: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the moments of components, and their mean gradient directions.

    The columns of the moments (count, 5) are x (px), y (px), angle of the normal (rad), length (px) and width (px).
    `one`: index of the component of each pixel. `gx`, `gy`: gradient of each pixel. `size`: weight of each pixel.
    """
    total = lambda values: np.bincount(one, values, count)  # noqa: E731
    weight = np.maximum(total(size), 1e-30)
    mx, my = total(size * x) / weight, total(size * y) / weight
    dx, dy = x - mx[one], y - my[one]
    xx, xy, yy = (total(size * product) / weight for product in (dx * dx, dx * dy, dy * dy))
    half, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    direction = np.arctan2(total(gy), total(gx))
    normal = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    normal = np.where(np.cos(normal - direction) < 0, normal + np.pi, normal)
    # A uniform strip of length l has a variance of l^2 / 12.
    length, thickness = np.sqrt(12 * (half + apart)), np.sqrt(12 * np.maximum(half - apart, 0))
    return np.stack([mx, my, np.angle(np.exp(1j * normal)), length, thickness], 1), direction


def clear_edges(
    small: np.ndarray, x: np.ndarray, y: np.ndarray, angle: np.ndarray, length: np.ndarray, corner: float
) -> EdgePositions:
    """Select the edges that are even on both sides, and shorten them at both ends.

    `small`: (height, width) image with little noise. `x`, `y`: (n,) middles of the edges, px. `angle`: (n,) direction of the
    normal towards the bright side, rad. `length`: (n,) px. `corner`: length that is removed at both ends, px.
    """
    if not x.size:
        return EdgePositions(x, y, angle, length, np.zeros(0))
    away = np.arange(-_PROFILE, _PROFILE + 1)
    along = np.linspace(-0.5, 0.5, 24) * np.maximum(length - 2 * _CORNER, 1)[:, None]
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    at_x = x[:, None, None] + away[:, None] * c - along[:, None, :] * s
    at_y = y[:, None, None] + away[:, None] * s + along[:, None, :] * c
    inside = (at_x >= 0) & (at_x <= small.shape[1] - 1) & (at_y >= 0) & (at_y <= small.shape[0] - 1)
    value = ndimage.map_coordinates(small, [at_y, at_x], order=1, mode="nearest")
    profile, inside = value.mean(-1), inside.all(-1)
    uneven = np.ptp(value[..., :-2] + value[..., 1:-1] + value[..., 2:], axis=-1) / 3
    steepest = np.diff(profile[:, _PROFILE - 2 : _PROFILE + 3], axis=1).max(1)
    # Arrays from the edge outwards, to the dark and to the bright side (2, n, ...).
    profile, inside, uneven = (
        np.stack([column[:, _PROFILE::-1], column[:, _PROFILE:]]) for column in (profile, inside, uneven)
    )
    # The steepest slope of an edge with step h and blur s is h / (sqrt(2 pi) s). Its levels begin at a distance of 2.5 s.
    rough = np.maximum(np.subtract(*profile[::-1, :, 4:8].mean(2)), 0)
    start = np.clip(np.ceil(rough / np.maximum(steepest, 1e-30)), 2, 12).astype(int)
    level = np.take_along_axis(profile, start[None, :, None] + np.arange(3), 2).mean(2)
    beyond = np.arange(_PROFILE + 1) - start[:, None] - 1
    # The mean of a side may deviate by 6 % of the step, and by 0.2 % more for each px of distance.
    allowed = (0.06 + 0.002 * np.maximum(beyond, 0)) * rough[:, None]
    # At one distance from the edge, a side may vary by 0.4 of the step.
    fault = (np.abs(profile - level[..., None]) > allowed) | (uneven > 0.4 * rough[:, None])
    fault = (fault & (beyond >= 0)) | ~inside
    clear = np.where(fault.any(2), fault.argmax(2) - 1, _PROFILE).min(0)
    step, length = level[1] - level[0], length - 2 * corner
    order = np.argsort(-step * length, kind="stable")
    order = order[((clear > start + 2) & (step > 0))[order]]
    return EdgePositions(*(column[order] for column in (x, y, angle, length, clear.astype(float))))
