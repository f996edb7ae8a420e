"""Detection of the fiducials of a chart in an image, and their assignment to the description.

Fiducials are dark discs in concentric dark rings. Four marks determine a pinhole view of the page, and a fifth mark must
agree with this view. All quadruples of marks are compared with all quadruples of fiducials in the same cyclic order, for
several barrel distortions. If a mark with two rings is visible, it is the first of each quadruple. Otherwise all starting
points are tested. If only four marks are visible, every assignment is consistent. In this case the printed elements between
the marks are compared with the image.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import cKDTree

from matcam.calibration.chart.chart import Chart, Patch, Square
from matcam.calibration.photograph.linear_image import smoothed
from matcam.core.arrays import FloatArray

_MOST_MARKS = (24, 9)
"""Largest number of marks of similar size that are tested, with and without a known first mark. It limits the time."""


class Mark(NamedTuple):
    """Fiducial detected in an image.

    Attributes:
        x: column of the centre, px.
        y: row of the centre, px.
        rings: number of rings.
        radius: radius of the disc, px.
    """

    x: float
    y: float
    rings: int
    radius: float


def balanced(mosaic: ArrayLike) -> FloatArray:
    even = np.array(mosaic, dtype=np.float64)
    for row, column in itertools.product((0, 1), repeat=2):
        plane = even[row::2, column::2]
        plane /= max(float(np.nanquantile(plane, 0.9)), 1e-300)
    return even


def find_marks(picture: FloatArray, enough: int) -> list[Mark]:
    """Find dark discs with concentric dark rings in an image.

    `picture` is the image, (height, width), with NaN for missing pixels. Several levels of darkness are tested, until at
    least `enough` marks are found and one of them has two rings.
    """
    smooth = smoothed(picture)
    # The level of the paper is the local maximum of means, which noise hardly affects.
    cell = max(4, round(min(picture.shape) / 60))
    coarse = ndimage.uniform_filter(smooth, 3)[::cell, ::cell]
    paper = ndimage.uniform_filter(ndimage.maximum_filter(coarse, 9), 5)
    rows, columns = (np.minimum(np.arange(n) // cell, m - 1) for n, m in zip(picture.shape, paper.shape, strict=True))
    share = smooth / np.maximum(paper[np.ix_(rows, columns)], 1e-300)
    found: list[Mark] = []
    # Several levels relative to the paper are tested, because blur may merge disc and ring.
    for dark in (0.6, 0.78, 0.45):
        if len(found) >= enough and any(mark.rings == 2 for mark in found):
            break
        for mark in _marks_below(share, dark):
            if all(np.hypot(mark.x - one.x, mark.y - one.y) > 2 * max(mark.radius, one.radius) for one in found):
                found.append(mark)
    return found


def _marks_below(share: FloatArray, dark: float) -> list[Mark]:
    label, count = ndimage.label(share < dark, np.ones((3, 3)))
    if not count:
        return []
    rows, columns = np.nonzero(label)
    which = label[rows, columns] - 1
    area = np.bincount(which, minlength=count)
    y, x = (np.bincount(which, position, count) / area for position in (rows, columns))
    # A disc covers at least 4 px^2, and at most 1 % of the image.
    small = np.flatnonzero((area >= 4) & (area < 0.01 * share.size))
    radii = np.sqrt(area[small] / np.pi)
    # The centres of a disc and its rings differ by less than 35 % of the radius of the disc.
    around = cKDTree(np.stack([x, y], axis=-1)).query_ball_point(
        np.stack([x[small], y[small]], axis=-1), np.maximum(0.35 * radii, 0.7)
    )
    found = []
    for i, radius, beside in zip(small, radii, around, strict=True):
        near = np.array(beside)
        # The nominal areas of the first and the second ring are 5 and 9 times that of the disc.
        sizes = area[near] / area[i]
        first = (sizes > 2.5) & (sizes < 9)
        if not first.any() or (sizes < 1).any():
            continue
        ring = near[first][np.argmin(sizes[first])]
        second = (sizes > max(4.5, 1.3 * area[ring] / area[i])) & (sizes < 16)
        # The position of a mark is the centroid of the disc and its first ring.
        parts = [i, ring]
        weight = area[parts] / area[parts].sum()
        found.append(Mark(float(x[parts] @ weight), float(y[parts] @ weight), 1 + int(second.any()), float(radius)))
    return found


class _Views(NamedTuple):
    """Pinhole views of the page, and the marks that they explain.

    Attributes:
        matrix: (n, 3, 3) homographies from the page, mm, to undistorted positions, px from the middle of the image.
        barrel: (n,) coefficients d of the barrel distortion. The undistorted radius is r (1 + d r^2), where r is the radius in
            half diagonals of the image.
        nearest: (n, fiducials) index of the mark nearest to the expected position of each fiducial; -1 if none is near.
        explained: (n,) number of marks at the expected positions of fiducials.
        off: (n,) mean distance of these marks from the expected positions, relative to the size of the chart in the image.
    """

    matrix: FloatArray
    barrel: FloatArray
    nearest: np.ndarray
    explained: np.ndarray
    off: FloatArray

    def subset(self, which: np.ndarray) -> _Views:
        return _Views(*(column[which] for column in self))


def match_marks(chart: Chart, marks: list[Mark], smooth: FloatArray) -> list[tuple[int, int]]:
    """Match marks to the fiducials of a chart.

    The result contains pairs (index of the fiducial, index of the mark). Among the matches that explain the most marks, the
    match is chosen that is most accurate and agrees best with the image. If only four marks agree, or fiducials are missing
    and several marks are unexplained, the result is empty unless the image agrees with the printed elements. `smooth` is an
    image with little noise and without missing pixels, (height, width).
    """
    similar_marks = _similar_marks(marks)
    positions = np.array([fiducial.centre for fiducial in chart.fiducials])
    middle = (np.array(smooth.shape[::-1]) - 1) / 2
    unit = float(np.hypot(*smooth.shape)) / 2
    tops = [i for i, j in enumerate(similar_marks[: _MOST_MARKS[0]]) if marks[j].rings == 2]
    first = next(i for i, fiducial in enumerate(chart.fiducials) if fiducial.rings == 2)
    best, top, marks_used = None, 0, list[int]()
    # The mark with two rings is used first, if there is one. If its views explain few marks, the search is
    # repeated without this mark.
    for pinned in (True, False) if tops else (False,):
        marks_used = similar_marks[: _MOST_MARKS[0 if pinned else 1]]
        seen = np.array([marks[j][:2] for j in marks_used])
        quads = _quads(positions, [first] if pinned else list(range(len(positions))))
        starts, found = tops if pinned else list(range(len(seen))), list[_Views]()
        # Tested distortions: coefficients d of the undistorted radius r (1 + d r^2), r in half diagonals.
        for barrel in (0.0, 0.06, 0.13, -0.03):
            off = (seen - middle) / unit
            flat = (seen - middle) * (1 + barrel * (off**2).sum(1, keepdims=True))
            found.append(_views(positions, quads, flat, starts, barrel, pinned=pinned))
        best = _best(found)
        top = int(best.explained.max(initial=0))
        if top >= max(min(5, len(positions)), min(len(seen), len(positions)) - 2):
            break
    if best is None or not top:
        return []
    # At most 40 views with equally many marks are compared with the image.
    candidates = best if top < 5 else best.subset(np.arange(len(best.off))[:40])
    scores = np.array(
        [_shown(chart, *view, smooth, middle, unit) for view in zip(candidates.matrix, candidates.barrel, strict=True)]
    )
    # The image selects among matches of four marks. With more marks, it only selects among nearly equal matches.
    chosen = int(np.argmin(candidates.off - (scores if top < 5 else 0.01 * scores)))
    # Marks that are not explained while fiducials are missing may be those of another chart.
    astray = top < len(positions) and len(marks) > top + 1
    if (top < 5 or astray) and not scores[chosen] > 0.5:
        return []
    return [(i, marks_used[int(j)]) for i, j in enumerate(candidates.nearest[chosen]) if j >= 0]


def _similar_marks(marks: list[Mark]) -> list[int]:
    """Sort the indices of marks by the difference of their radius from the most common radius.

    Marks with two rings are preferred.
    """
    radii = np.array([mark.radius for mark in marks])
    # The sizes of the discs of a chart in one image differ by less than a factor of 2.5.
    near = np.array([(np.maximum(radii / r, r / radii) < 2.5).sum() for r in radii])
    middle = radii[near == near.max()]
    off = np.abs(np.log(radii / np.median(middle))) - 0.5 * np.array([mark.rings == 2 for mark in marks])
    return [int(i) for i in np.argsort(off, kind="stable")]


def _quads(positions: FloatArray, begin: list[int]) -> np.ndarray:
    """List quadruples of point indices in cyclic order, (n, 4). Each quadruple starts with an index of `begin`."""
    rows = [(start, *three) for start in begin for three in itertools.combinations(_in_turn(positions, start), 3)]
    return np.array(rows, dtype=int).reshape(-1, 4)


def _views(
    positions: FloatArray, quads: np.ndarray, seen: FloatArray, starts: list[int], barrel: float, *, pinned: bool
) -> _Views:
    """Compute the view of each pair of a quadruple of marks and a quadruple of fiducials.

    If `pinned` is True, the first points of both quadruples are known to correspond. Otherwise each quadruple of marks is used
    with one starting point only, because the quadruples of fiducials occur with all starting points.
    """
    fours = _quads(seen, starts)
    if not pinned:
        # Only the quadruples of the page occur with all starting points.
        fours = fours[fours[:, 0] == fours.min(1)]
    to_page, to_picture = _bases(positions[quads]), _bases(seen[fours])
    matrix = (to_picture[:, None] @ np.linalg.inv(to_page)).reshape(-1, 3, 3)
    matrix = matrix / matrix[:, 2:, 2:]
    x, y, w = np.einsum("nij,jk->ink", matrix, np.column_stack([positions, np.ones(len(positions))]).T)
    front = (w > 0).all(1)
    expected = np.stack([x, y], axis=-1)[front] / w[front][..., None]
    matrix = matrix[front]
    off = np.hypot(*(expected[:, :, None] - seen).transpose(3, 0, 1, 2))
    size = np.ptp(expected, axis=1).max(1)
    nearest, least = off.argmin(2), off.min(2) / np.maximum(size, 1e-9)[:, None]
    # A mark is less than 3 % of the size of the chart from its expected position.
    nearest = np.where(least < 0.03, nearest, -1)
    # Each mark may be assigned to one fiducial only.
    ordered = np.sort(nearest, axis=1)
    twice = ((np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] >= 0)).any(1)
    count = np.where(twice, 0, (nearest >= 0).sum(1))
    mean = np.where(nearest >= 0, least, 0.0).sum(1) / np.maximum(count, 1)
    return _Views(matrix, np.full(len(matrix), barrel), nearest, count, mean)


def _best(found: list[_Views]) -> _Views:
    """Select the views that explain the most marks, at least four, the most accurate first.

    If several views result from the same match of marks and fiducials, only the most accurate one is selected.
    """
    views = _Views(*(np.concatenate(column) for column in zip(*found, strict=True)))
    views = views.subset(views.explained == max(int(views.explained.max(initial=0)), 4))
    views = views.subset(np.argsort(views.off, kind="stable"))
    return views.subset(np.sort(np.unique(views.nearest, axis=0, return_index=True)[1]))


def _shown(chart: Chart, view: FloatArray, barrel: float, smooth: FloatArray, middle: FloatArray, unit: float) -> float:
    """Compute the agreement of a view with the image: 1 if all dark elements are on bright paper, about 0 by chance."""
    dark = [e for e in chart.elements if isinstance(e, Square | Patch) and e.level < 0.5]
    # About 150 squares and patches are sufficient for the comparison.
    dark = dark[:: max(1, len(dark) // 150)]
    if not dark:
        return 0.0
    corners = np.array([element.corners for element in dark])
    centre = corners.mean(1)
    sides = (corners + np.roll(corners, -1, axis=1)) / 2
    paper = centre[:, None] + 1.3 * (sides - centre[:, None])
    points = np.concatenate([centre[:, None], paper], axis=1)
    flat = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2) @ view.T
    flat = flat[..., :2] / flat[..., 2:]
    square = ((flat / unit) ** 2).sum(-1, keepdims=True)
    at = flat / (1 + barrel * square / (1 + 2 * barrel * square)) + middle
    level = ndimage.map_coordinates(smooth, np.moveaxis(at[..., ::-1], -1, 0), order=1, cval=np.nan)
    # Squares have paper on all sides; patches are in a row, and have paper on two sides.
    ordered = np.sort(np.nan_to_num(level[:, 1:], nan=-np.inf), axis=1)
    bright = np.where([isinstance(element, Square) for element in dark], ordered[:, 0], ordered[:, 2])
    there = np.isfinite(level[:, 0]) & (bright > 0)
    if there.sum() <= len(dark) // 2:
        return 0.0
    expected = np.array([element.level for element in dark])
    return float(np.clip((1 - level[:, 0] / bright) / (1 - expected), -1, 1)[there].mean())


def _in_turn(points: FloatArray, start: int) -> list[int]:
    """Sort the indices of all points except `start` in cyclic order, beginning after `start`."""
    turn = np.arctan2(*(points - points.mean(0)).T[::-1])
    after = np.mod(turn - turn[start], 2 * np.pi)
    return [int(i) for i in np.argsort(after) if i != start]


def _bases(points: FloatArray) -> FloatArray:
    """Compute homographies (m, 3, 3) from the projective basis to quadruples of points (n, 4, 2).

    Quadruples in which three points are collinear are omitted.
    """
    whole = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    # By Cramer's rule, the weight of each of the first three points is the determinant in which the fourth point replaces it,
    # divided by the determinant of the three. The divisor is omitted, because the scale of a map is arbitrary.
    weight = np.linalg.det(whole[:, [[3, 1, 2], [0, 3, 2], [0, 1, 3], [0, 1, 2]]])
    good = (np.abs(weight) > 1e-3 * np.maximum(np.ptp(points, axis=1).prod(1), 1e-300)[:, None]).all(1)
    return (whole[good, :3] * weight[good, :3, None]).swapaxes(1, 2)
