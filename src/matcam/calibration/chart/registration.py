"""The registration of a photograph: where the page of a chart lies in it.

Fiducials are found first: a dark disc in dark rings that share its centre is nothing else in a photograph. The one with two
rings tells which way is up. A pinhole camera with a distorting lens is then fitted to their places. The fit only has to lead
each target's own estimator to its place: estimators find their geometry to 0.01 px themselves.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.optimize import least_squares

from matcam.calibration.chart.chart import Chart, Element
from matcam.calibration.photograph.linear_image import LinearImage, local_mean
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import FloatArray

Projection = Callable[[FloatArray], FloatArray]
"""A map from places on the page (n, 2), mm, to places in the picture (n, 2), px: a `Registration`, or anything like it."""

_SMOOTH, _SMOOTH_GAPS = 0.7, 1.2  # px; of pictures without and with gaps
_DARK = 0.6  # of the paper around
_CONCENTRIC = 0.35  # radii of the disc
_RING, _SECOND = (2.5, 9.0), (4.5, 16.0)  # areas of the rings over the disc's: 5 and 9, in all sorts of light and blur
_SMALLEST, _LARGEST = 4, 0.01  # px; of the picture: area of a disc
_NEAR = 0.06  # of the chart's size in the picture: how far a mark may lie from where four others put it
_SETTLED = 0.1  # of that: mean distance at which no better match is looked for
_FEWEST_PLACES = 12
_WORST = 3.0  # px: root mean square of what the fit may leave


@dataclass(frozen=True, eq=False)
class Registration:
    """Map points of a chart's page to places in a photograph.

    Calling it with points (n, 2) on the page returns their places (n, 2), with pixel centres on whole numbers.

    Attributes:
        homography: (3, 3) matrix from mm to px from the picture's middle, before distortion.
        distortion: a and b of the distorted radius r (1 + a r^2 + b r^4), r in half diagonals of the picture (no unit).
        shape: height and width of the picture, px.
        residual: root mean square distance that the fit leaves at the fiducials, px.
        found: number of fiducials found.

    Example:
        >>> homography = np.diag([2.0, 2.0, 1.0])  # 2 px per mm, squarely
        >>> where = matcam.targets.Registration(homography, (0.0, 0.0), (101, 101), 0.0, 8)
        >>> where(np.array([[10.0, 5.0]])), round(where.scale((10.0, 5.0)), 3)
        (array([[70., 60.]]), 2.0)
    """

    homography: FloatArray
    distortion: tuple[float, float]
    shape: tuple[int, int]
    residual: float
    found: int

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return the places of points on the page.

        Args:
            points: (n, 2) places on the page, mm.

        Returns:
            (n, 2) places in the picture, px.
        """
        return _project(np.append(self.homography.ravel()[:8], self.distortion), np.asarray(points, float), self.shape)

    def scale(self, point: tuple[float, float]) -> float:
        """Return the scale of the picture at a point of the page.

        Args:
            point: place on the page, mm.

        Returns:
            The scale, px per mm.
        """
        step = 1e-3
        around = self(np.array(point) + step * np.array([[0, 0], [1, 0], [0, 1]]))
        (a, b), (c, d) = (around[1:] - around[0]) / step
        return float(np.sqrt(abs(a * d - b * c)))


def register_chart(image: ArrayLike | LinearImage, chart: Chart, *, mosaic: bool = False) -> Registration:
    """Find a chart in a photograph.

    Args:
        image: a `LinearImage`, or an array (height, width) of linear values, any unit; NaN where there are no data.
        chart: what the photograph shows.
        mosaic: make the four colours of every 2 x 2 px equally bright first. Default: False. Set it for raw mosaics.

    Returns:
        The map from the page to the picture.

    Raises:
        FitError: if too few fiducials are found, or they do not lie as on the chart.
        ArgumentError: if the chart has no fiducials.

    Source:
        docs/targets.md; R. Hartley and A. Zisserman, Multiple View Geometry, 2nd ed., section 4.1 (direct linear transform).

    Example:
        >>> chart = matcam.targets.design_chart(["star"], pixels_across=400)
        >>> y, x = np.mgrid[:300, :420]
        >>> page = np.ones((300, 420))
        >>> for mark in chart.fiducials:
        ...     column, row = 1.35 * np.array(mark.centre) + 8
        ...     radius = np.hypot(x - column, y - row) / (1.35 * mark.radius)
        ...     page[(radius < 1) | ((radius > 2) & (radius < 3)) | ((mark.rings == 2) & (radius > 4) & (radius < 5))] = 0.1
        >>> where = matcam.targets.register_chart(page, chart)
        >>> where.found, [round(float(v)) for v in where(np.array([[100.0, 50.0]]))[0]]
        (8, [143, 75])
    """
    if len(chart.fiducials) < 4:
        raise ArgumentError("this chart has no fiducials: it cannot be found in a photograph")
    picture = LinearImage.of(image).values
    picture = _balanced(picture) if mosaic else picture
    marks = _find_marks(picture)
    tops = [mark for mark in marks if mark.rings == 2]
    if len(marks) < 4 or not tops:
        raise FitError(
            f"no chart of this description in the picture: {len(marks)} of its {len(chart.fiducials)} fiducials found, "
            f"{len(tops) or 'none'} of them with two rings; 4, and that one, are needed"
        )
    best = max((_best_match(chart, marks, top, picture.shape) for top in tops), key=lambda match: match.rank)
    # four marks fit any four places: a fifth must agree
    if len(best.pairs) < min(5, len(chart.fiducials)):
        raise FitError(
            f"no chart of this description in the picture: {len(marks)} fiducials found, but not where it has them"
        )
    places = np.array([chart.fiducials[i].centre for i, _ in best.pairs])
    seen = np.array([marks[j][:2] for _, j in best.pairs])
    return _registration_through(places, seen, picture.shape)


def radial_distortion(places: FloatArray, seen: FloatArray, shape: tuple[int, ...]) -> tuple[float, float]:
    """Return a of the distorted radius r (1 + a r^2), and its standard deviation by the scatter of the places.

    Args:
        places: (n, 2) on a plane page, any unit.
        seen: (n, 2) in the picture, px.
        shape: height and width of the picture, px; r counts in its half diagonal.

    Raises:
        FitError: fewer than 12 places, or they do not determine a pinhole's view.
    """
    if len(places) < _FEWEST_PLACES:
        raise FitError(f"{len(places)} places do not tell the distortion; at least {_FEWEST_PLACES} are needed")
    middle, spread = places.mean(0), max(float(np.ptp(places, axis=0).max()), 1e-300)
    at, used = (places - middle) / spread, np.ones(len(places), bool)
    for _ in range(3):
        try:
            start = np.append(_homography(at[used], _from_middle(seen[used], shape)).ravel()[:8], 0.0)
        except np.linalg.LinAlgError:
            raise FitError(
                "the places do not determine how the page stands to the camera: give dots that span it"
            ) from None
        size = np.append(np.maximum(np.abs(start[:8]), 1e-6), 0.01)

        def off(p: FloatArray, at: FloatArray = at, size: FloatArray = size) -> FloatArray:
            return np.asarray(_project(np.append(p * size, 0.0), at, (shape[0], shape[1])) - seen)

        fit = least_squares(lambda p: off(p)[used].ravel(), start / size, x_scale="jac")  # noqa: B023
        left = np.hypot(*off(fit.x).T)
        good = left < 4 * max(float(np.median(left[used])), 1e-9)
        if good.sum() < _FEWEST_PLACES or np.array_equal(good, used):
            break
        used = good
    variance = 2 * fit.cost / max(fit.fun.size - fit.x.size, 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    return float(fit.x[8] * size[8]), float(np.sqrt(covariance[8, 8]) * size[8])


def check_projection_given(name: str, element: Element | None, projection: Projection | None) -> None:
    """Raise ArgumentError if only one of element and projection is given.

    name: the argument for the element.
    """
    if (element is None) != (projection is None):
        raise ArgumentError(f"{name} and projection must be given together, or neither")


def pixel_box(points: FloatArray, shape: tuple[int, int], margin: int) -> tuple[int, int, int, int]:
    """Return the region (x, y, width, height) that holds points, px.

    points: (n, 2) px. shape: (height, width) of the picture. margin: px around the points.
    """
    low = np.maximum(np.floor(points.min(0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(points.max(0)).astype(int) + margin + 1, shape[::-1])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


class _Mark(NamedTuple):
    """Hold the place of a fiducial, px, and its rings."""

    x: float
    y: float
    rings: int


class _Match(NamedTuple):
    """Pair fiducials of the chart with marks of the picture.

    Attributes:
        pairs: indices of fiducial and mark.
        distance: total distance between marks and where the pinhole through four of them puts the fiducials, px.
    """

    pairs: list[tuple[int, int]]
    distance: float

    @property
    def rank(self) -> tuple[int, float]:
        """Return what is larger for the better match."""
        return len(self.pairs), -self.distance


def _registration_through(places: FloatArray, seen: FloatArray, shape: tuple[int, ...]) -> Registration:
    """Return the camera that puts places, mm, where they were seen, px.

    FitError if none does.
    """
    free = 10 if len(places) >= 7 else 9 if len(places) >= 6 else 8
    start = np.append(_homography(places, _from_middle(seen, shape)).ravel()[:8], [0.0, 0.0])
    size = np.maximum(np.abs(start), 1e-6)
    size[8:] = 0.1

    def full(p: FloatArray) -> FloatArray:
        return np.append(p, np.zeros(10 - p.size)) * size

    def residual(p: FloatArray) -> FloatArray:
        return np.asarray((_project(full(p), places, shape) - seen).ravel())

    fit = least_squares(residual, (start / size)[:free], x_scale="jac")
    rms = float(np.sqrt((fit.fun**2).mean() * 2))
    if rms > _WORST:
        raise FitError(f"the fiducials do not lie as on the chart: {rms:.1f} px off; is this the right description?")
    parameters = full(fit.x)
    return Registration(
        np.append(parameters[:8], 1.0).reshape(3, 3), (float(parameters[8]), float(parameters[9])),
        (shape[0], shape[1]), rms, len(places),
    )  # fmt: skip


def _project(parameters: FloatArray, points: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return px of points on the page, mm.

    parameters: eight of the homography, two of the distortion.
    """
    h = np.append(parameters[:8], 1.0).reshape(3, 3)
    u, v, w = h @ np.stack([points[:, 0], points[:, 1], np.ones(len(points))])
    u, v = u / w, v / w
    square = (u * u + v * v) / ((shape[0] ** 2 + shape[1] ** 2) / 4)
    bent = 1 + parameters[8] * square + parameters[9] * square * square
    return np.stack([u * bent + (shape[1] - 1) / 2, v * bent + (shape[0] - 1) / 2], axis=-1)


def _from_middle(points: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return px counted from the picture's middle."""
    return points - (np.array(shape[1::-1]) - 1) / 2


def _balanced(mosaic: FloatArray) -> FloatArray:
    """Return a mosaic with its four planes at the same bright level."""
    even = mosaic.copy()
    for row, column in itertools.product((0, 1), repeat=2):
        even[row::2, column::2] /= max(float(np.nanquantile(mosaic[row::2, column::2], 0.9)), 1e-300)
    return even


def _find_marks(picture: FloatArray) -> list[_Mark]:
    """Find all concentric dark discs and rings of a picture."""
    smooth = local_mean(picture, _SMOOTH if np.isfinite(picture).all() else _SMOOTH_GAPS)
    # the paper's level nearby: the brightest there is, of means that noise does not reach
    cell = max(4, round(min(picture.shape) / 60))
    coarse = ndimage.uniform_filter(smooth, 3)[::cell, ::cell]
    paper = ndimage.uniform_filter(ndimage.maximum_filter(coarse, 9), 5)
    rows, columns = (np.minimum(np.arange(n) // cell, m - 1) for n, m in zip(picture.shape, paper.shape, strict=True))
    label, count = ndimage.label(smooth < _DARK * paper[np.ix_(rows, columns)], np.ones((3, 3)))
    if not count:
        return []
    every = np.arange(1, count + 1)
    area = ndimage.sum_labels(np.ones(picture.shape), label, every)
    y, x = np.array(ndimage.center_of_mass(np.ones(picture.shape), label, every)).T
    found = []
    for i in np.flatnonzero((area >= _SMALLEST) & (area < _LARGEST * picture.size)):
        radius = np.sqrt(area[i] / np.pi)
        near = np.hypot(x - x[i], y - y[i]) < max(_CONCENTRIC * radius, 0.7)
        sizes = area / area[i]
        first = near & (sizes > _RING[0]) & (sizes < _RING[1])
        if not first.any() or (near & (sizes < 1)).any():
            continue
        ring = np.flatnonzero(first)[np.argmin(sizes[first])]
        second = near & (sizes > max(_SECOND[0], 1.3 * sizes[ring])) & (sizes < _SECOND[1])
        # the disc's own place is that of all its dark, ring included
        parts = [i, ring]
        weight = area[parts]
        found.append(
            _Mark(
                float((x[parts] * weight).sum() / weight.sum()),
                float((y[parts] * weight).sum() / weight.sum()),
                1 + second.any(),
            )
        )
    return found


def _best_match(chart: Chart, marks: list[_Mark], top: _Mark, shape: tuple[int, ...]) -> _Match:
    """Return the match of most marks, and of the closest.

    top: the mark that is taken for the fiducial with two rings.
    """
    first = next(i for i, fiducial in enumerate(chart.fiducials) if fiducial.rings == 2)
    places = np.array([fiducial.centre for fiducial in chart.fiducials])
    seen = _from_middle(np.array([mark[:2] for mark in marks]), shape)
    start = marks.index(top)
    others = _in_turn(places, first)
    settled = False
    best = _Match([], np.inf)
    # three others, met in the same turn on the page and in the picture, fix a pinhole's view
    for three in itertools.combinations(_in_turn(seen, start), 3):
        for where in itertools.combinations(others, 3):
            chosen, at = [first, *where], [start, *three]
            try:
                view = _homography(places[chosen], seen[at])
            except np.linalg.LinAlgError:
                continue
            u, v, w = view @ np.column_stack([places, np.ones(len(places))]).T
            if not (w > 0).all():
                continue
            expected = np.stack([u / w, v / w], axis=-1)
            off = np.hypot(*(expected[:, None] - seen[None]).transpose(2, 0, 1))
            nearest = off.argmin(1)
            reach = _NEAR * float(np.ptp(expected, axis=0).max())
            pairs = [(i, int(j)) for i, j in enumerate(nearest) if off[i, j] < reach]
            if len({j for _, j in pairs}) != len(pairs):
                continue
            match = _Match(pairs, float(sum(off[i, j] for i, j in pairs)))
            if match.rank > best.rank:
                best = match
                settled = len(pairs) == len(places) and match.distance < _SETTLED * reach * len(places)
        if settled:
            break
    return best


def _in_turn(points: FloatArray, start: int) -> list[int]:
    """Return the other points' indices in a turn from `start` on."""
    turn = np.arctan2(*(points - points.mean(0)).T[::-1])
    after = np.mod(turn - turn[start], 2 * np.pi)
    return [int(i) for i in np.argsort(after) if i != start]


def _homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Return the homography (3, 3) from points (n >= 4, 2) to points.

    It is that of least squares, with 1 as its last entry.
    LinAlgError if they do not determine it.
    """
    scale = np.abs(source).max()
    rows = []
    for (x, y), (u, v) in zip(source / scale, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    design = np.array(rows)
    if len(source) == 4:
        solution = np.linalg.solve(design, target.ravel())
    else:
        solution = np.linalg.lstsq(design, target.ravel(), rcond=None)[0]
    return np.append(solution, 1.0).reshape(3, 3) @ np.diag([1 / scale, 1 / scale, 1])
