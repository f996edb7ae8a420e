"""Detection of the fiducials of a chart in a picture: dark discs in concentric dark rings."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import cKDTree

from matcam.calibration.photograph.linear_image import smoothed
from matcam.core.arrays import FloatArray

_DARK = (0.6, 0.78, 0.45)  # of the paper around: where small discs run into their rings, another level parts them
_CONCENTRIC = 0.35  # radii of the disc
_RING, _SECOND = (2.5, 9.0), (4.5, 16.0)  # areas of the rings over the disc's: 5 and 9, in all sorts of light and blur
_SMALLEST, _LARGEST = 4, 0.01  # px; of the picture: area of a disc


class Mark(NamedTuple):
    """Position of a fiducial, px, the number of its rings, and the radius of its disc, px."""

    x: float
    y: float
    rings: int
    radius: float


def balanced(mosaic: ArrayLike) -> FloatArray:
    """Scale the four planes of a mosaic, of any real type, to the same bright level."""
    even = np.array(mosaic, dtype=np.float64)
    for row, column in itertools.product((0, 1), repeat=2):
        plane = even[row::2, column::2]
        plane /= max(float(np.nanquantile(plane, 0.9)), 1e-300)
    return even


def find_marks(picture: FloatArray, enough: int) -> list[Mark]:
    """Find all concentric dark discs and rings in a picture (height, width) with NaN for missing data.

    The search stops at `enough` marks if one of them has two rings.
    """
    smooth = smoothed(picture)
    # the paper's level nearby: the brightest there is, of means that noise does not reach
    cell = max(4, round(min(picture.shape) / 60))
    coarse = ndimage.uniform_filter(smooth, 3)[::cell, ::cell]
    paper = ndimage.uniform_filter(ndimage.maximum_filter(coarse, 9), 5)
    rows, columns = (np.minimum(np.arange(n) // cell, m - 1) for n, m in zip(picture.shape, paper.shape, strict=True))
    share = smooth / np.maximum(paper[np.ix_(rows, columns)], 1e-300)
    found: list[Mark] = []
    for dark in _DARK:
        if len(found) >= enough and any(mark.rings == 2 for mark in found):
            break
        for mark in _marks_below(share, dark):
            if all(np.hypot(mark.x - one.x, mark.y - one.y) > 2 * max(mark.radius, one.radius) for one in found):
                found.append(mark)
    return found


def _marks_below(share: FloatArray, dark: float) -> list[Mark]:
    """Find the discs and rings that are darker than a share of the paper."""
    label, count = ndimage.label(share < dark, np.ones((3, 3)))
    if not count:
        return []
    rows, columns = np.nonzero(label)
    which = label[rows, columns] - 1
    area = np.bincount(which, minlength=count)
    y, x = (np.bincount(which, place, count) / area for place in (rows, columns))
    small = np.flatnonzero((area >= _SMALLEST) & (area < _LARGEST * share.size))
    radii = np.sqrt(area[small] / np.pi)
    around = cKDTree(np.stack([x, y], axis=-1)).query_ball_point(
        np.stack([x[small], y[small]], axis=-1), np.maximum(_CONCENTRIC * radii, 0.7)
    )
    found = []
    for i, radius, beside in zip(small, radii, around, strict=True):
        near = np.array(beside)
        sizes = area[near] / area[i]
        first = (sizes > _RING[0]) & (sizes < _RING[1])
        if not first.any() or (sizes < 1).any():
            continue
        ring = near[first][np.argmin(sizes[first])]
        second = (sizes > max(_SECOND[0], 1.3 * area[ring] / area[i])) & (sizes < _SECOND[1])
        # the position of the disc is that of all dark pixels, rings included
        parts = [i, ring]
        weight = area[parts] / area[parts].sum()
        found.append(Mark(float(x[parts] @ weight), float(y[parts] @ weight), 1 + int(second.any()), float(radius)))
    return found
