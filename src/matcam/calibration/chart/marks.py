"""The fiducials of a chart in an image, dark discs in concentric dark rings: their detection, and which mark is which.

Four marks fix a pinhole's view, and a fifth must agree. All fours of marks are tried against all fours of fiducials that
follow one another in the same turn, through lenses of several barrel distortions. The mark with two rings, where it is to be
seen, says where to begin; without it every beginning is tried. Where only four marks are to be seen, any four fit: what is
printed between them decides.
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

_DARK = (0.6, 0.78, 0.45)  # of the paper around: where small discs run into their rings, another level parts them
_CONCENTRIC = 0.35  # radii of the disc
_RING, _SECOND = (2.5, 9.0), (4.5, 16.0)  # areas of the rings over the disc's: 5 and 9, in all sorts of light and blur
_SMALLEST, _LARGEST = 4, 0.01  # px; of the image: area of a disc
_BARREL = (0.0, 0.06, 0.13, -0.03)  # relative to the undistorted radius: r (1 + d r^2), r in half diagonals
# relative to the size of the chart in the image: tolerance for a mark in the view that four others define
_NEAR = 0.03
_CLOSE = 0.005  # relative to the size of the chart: mean distance below which no other lens is tried
_MOST_MARKS = (24, 9)  # number of discs of equal size that are tried with a known first mark, and without
_CANDIDATES = 40  # number of views of equal rank that are compared with the image
_SIMILAR_SIZE = 2.5  # ratio of the sizes of discs in one image
_CLEAR = 0.5  # share of the expected steps between dark and bright, if only four marks are found
_LEVEL = 0.5  # squares and patches darker than this are compared
_MOST_PLACES = 150


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
    """Find all concentric dark discs and rings in an image (height, width) with NaN for missing data.

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


class Match(NamedTuple):
    """Pairs of a fiducial of the chart and a mark in the image.

    Attributes:
        pairs: indices of fiducial and mark.
        sure: whether more than four marks agree, or the image shows what is printed between four.
    """

    pairs: list[tuple[int, int]]
    sure: bool


class _Views(NamedTuple):
    """Pinhole views of the page, and the marks that they explain.

    Attributes:
        matrix: (n, 3, 3) from mm to undistorted px from the image's middle.
        barrel: (n,) of the lens.
        nearest: (n, fiducials) nearest mark, -1 where none is near.
        explained: (n,) marks that are where the view puts a fiducial.
        off: (n,) mean distance of these, relative to the chart's size.
    """

    matrix: FloatArray
    barrel: FloatArray
    nearest: np.ndarray
    explained: np.ndarray
    off: FloatArray

    def agree(self, marks: int) -> bool:
        """Check whether a view explains so many marks closely."""
        return bool((self.off[self.explained >= marks] < _CLOSE).any())

    def subset(self, which: np.ndarray) -> _Views:
        """Return some of the views."""
        return _Views(*(column[which] for column in self))


def match_marks(chart: Chart, marks: list[Mark], smooth: FloatArray) -> Match:
    """Return the match with most marks that agrees best with the image.

    `smooth`: (height, width) image without gaps or noise.
    """
    similar_marks = _similar_marks(marks)
    places = np.array([fiducial.centre for fiducial in chart.fiducials])
    middle = (np.array(smooth.shape[::-1]) - 1) / 2
    unit = float(np.hypot(*smooth.shape)) / 2
    tops = [i for i, j in enumerate(similar_marks[: _MOST_MARKS[0]]) if marks[j].rings == 2]
    first = next(i for i, fiducial in enumerate(chart.fiducials) if fiducial.rings == 2)
    best, top, marks_used = None, 0, list[int]()
    # First with the mark that has two rings, if there is one; if that fails or explains few marks, without it.
    for pinned in (True, False) if tops else (False,):
        marks_used = similar_marks[: _MOST_MARKS[0 if pinned else 1]]
        seen = np.array([marks[j][:2] for j in marks_used])
        quads = _quads(places, [first] if pinned else list(range(len(places))))
        found: list[_Views] = []
        for barrel in _BARREL:
            off = (seen - middle) / unit
            flat = (seen - middle) * (1 + barrel * (off**2).sum(1, keepdims=True))
            starts = tops if pinned else list(range(len(seen)))
            found.append(_views(places, quads, flat, starts, barrel, pinned=pinned))
            if found[-1].agree(max(5, min(len(seen), len(places)) - 1)):
                break
        best = _best(found)
        top = int(best.explained.max(initial=0))
        if top >= max(min(5, len(places)), min(len(seen), len(places)) - 2):
            break
    if best is None or not top:
        return Match([], False)
    candidates = best if top < 5 else best.subset(np.arange(len(best.off))[:_CANDIDATES])
    scores = np.array(
        [_shown(chart, *view, smooth, middle, unit) for view in zip(candidates.matrix, candidates.barrel, strict=True)]
    )
    # The image decides between matches of four marks; with more marks it only decides between close ones.
    chosen = int(np.argmin(candidates.off - (scores if top < 5 else 0.01 * scores)))
    pairs = [(i, marks_used[int(j)]) for i, j in enumerate(candidates.nearest[chosen]) if j >= 0]
    # Marks that are not explained while fiducials are missing may be those of another chart.
    astray = top < len(places) and len(marks) > top + 1
    return Match(pairs, bool(scores[chosen] > _CLEAR) if top < 5 or astray else True)


def _similar_marks(marks: list[Mark]) -> list[int]:
    """Return the indices of marks that may be of one chart: the largest group of similar size first."""
    radii = np.array([mark.radius for mark in marks])
    near = np.array([(np.maximum(radii / r, r / radii) < _SIMILAR_SIZE).sum() for r in radii])
    middle = radii[near == near.max()]
    off = np.abs(np.log(radii / np.median(middle))) - 0.5 * np.array([mark.rings == 2 for mark in marks])
    return [int(i) for i in np.argsort(off, kind="stable")]


def _quads(places: FloatArray, begin: list[int]) -> np.ndarray:
    """Return quadruples of points in cyclic order (n, 4); the first of each is one of `begin`."""
    rows = [(start, *three) for start in begin for three in itertools.combinations(_in_turn(places, start), 3)]
    return np.array(rows, dtype=int).reshape(-1, 4)


def _views(
    places: FloatArray, quads: np.ndarray, seen: FloatArray, starts: list[int], barrel: float, *, pinned: bool
) -> _Views:
    """Return the views that quadruples of marks and of fiducials define.

    If `pinned`, the first point of a quadruple is known; else each needs to be tried from one of its starting points
    only.
    """
    fours = _quads(seen, starts)
    if not pinned:
        # the quadruples of marks are kept, those of the page are rotated
        fours = fours[fours[:, 0] == fours.min(1)]
    to_page, to_picture = _bases(places[quads]), _bases(seen[fours])
    to_page, to_picture = (maps[np.isfinite(maps).all((1, 2))] for maps in (to_page, to_picture))
    matrix = (to_picture[:, None] @ np.linalg.inv(to_page)).reshape(-1, 3, 3)
    matrix = matrix / matrix[:, 2:, 2:]
    x, y, w = np.einsum("nij,jk->ink", matrix, np.column_stack([places, np.ones(len(places))]).T)
    front = (w > 0).all(1)
    expected = np.stack([x, y], axis=-1)[front] / w[front][..., None]
    matrix = matrix[front]
    off = np.hypot(*(expected[:, :, None] - seen).transpose(3, 0, 1, 2))
    size = np.ptp(expected, axis=1).max(1)
    nearest, least = off.argmin(2), off.min(2) / np.maximum(size, 1e-9)[:, None]
    nearest = np.where(least < _NEAR, nearest, -1)
    # each mark belongs to one fiducial only
    ordered = np.sort(nearest, axis=1)
    twice = ((np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] >= 0)).any(1)
    count = np.where(twice, 0, (nearest >= 0).sum(1))
    mean = np.where(nearest >= 0, least, 0.0).sum(1) / np.maximum(count, 1)
    return _Views(matrix, np.full(len(matrix), barrel), nearest, count, mean)


def _best(found: list[_Views]) -> _Views:
    """Return the views that explain most marks, at least four, the closest first: one for each match."""
    views = _Views(*(np.concatenate(column) for column in zip(*found, strict=True)))
    views = views.subset(views.explained == max(int(views.explained.max(initial=0)), 4))
    views = views.subset(np.argsort(views.off, kind="stable"))
    return views.subset(np.sort(np.unique(views.nearest, axis=0, return_index=True)[1]))


def _shown(chart: Chart, view: FloatArray, barrel: float, smooth: FloatArray, middle: FloatArray, unit: float) -> float:
    """Return the agreement of a view with the image: 1 if all dark elements are on bright paper, about 0 by chance."""
    dark = [e for e in chart.elements if isinstance(e, Square | Patch) and e.level < _LEVEL]
    dark = dark[:: max(1, len(dark) // _MOST_PLACES)]
    if not dark:
        return 0.0
    corners = np.array([element.corners for element in dark])
    centre = corners.mean(1)
    sides = (corners + np.roll(corners, -1, axis=1)) / 2
    paper = centre[:, None] + 1.3 * (sides - centre[:, None])
    steps = []
    for points in (centre[:, None], paper):
        u, v, w = view @ np.column_stack([points.reshape(-1, 2), np.ones(points[..., 0].size)]).T
        flat = np.stack([u / w, v / w], axis=-1)
        square = ((flat / unit) ** 2).sum(1)
        at = flat / (1 + barrel * square / (1 + 2 * barrel * square))[:, None] + middle
        inside = ((at >= 0) & (at <= np.array(smooth.shape[::-1]) - 1)).all(1)
        level = ndimage.map_coordinates(smooth, at[:, ::-1].T, order=1, mode="nearest")
        steps.append(np.where(inside, level, np.nan).reshape(points.shape[:2]))
    # Squares have paper on all sides; patches are in a row, and have paper on two sides.
    ordered = np.sort(np.where(np.isfinite(steps[1]), steps[1], -np.inf), axis=1)
    bright = np.where([isinstance(element, Square) for element in dark], ordered[:, 0], ordered[:, 2])
    there = np.isfinite(steps[0][:, 0]) & (bright > 0)
    if there.sum() <= len(dark) // 2:
        return 0.0
    expected = np.array([element.level for element in dark])[there]
    return float(np.clip((1 - steps[0][there, 0] / bright[there]) / (1 - expected), -1, 1).mean())


def _in_turn(points: FloatArray, start: int) -> list[int]:
    """Return the indices of the other points in cyclic order from `start` on."""
    turn = np.arctan2(*(points - points.mean(0)).T[::-1])
    after = np.mod(turn - turn[start], 2 * np.pi)
    return [int(i) for i in np.argsort(after) if i != start]


def _bases(points: FloatArray) -> FloatArray:
    """Return the maps (n, 3, 3) from the projective basis to four points each (n, 4, 2); NaN if three are collinear."""
    whole = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2).transpose(0, 2, 1)
    first = whole[:, :, :3]
    size = np.ptp(points, axis=1).prod(1)
    good = np.abs(np.linalg.det(first)) > 1e-3 * np.maximum(size, 1e-300)
    maps = np.full(first.shape, np.nan)
    if good.any():
        weight = np.linalg.solve(first[good], whole[good, :, 3:])[..., 0]
        whole_good = first[good] * weight[:, None, :]
        clear = (np.abs(weight) > 1e-3).all(1)
        maps[np.flatnonzero(good)[clear]] = whole_good[clear]
    return maps
