"""Registration of a photograph: the map from the page of a chart to the image.

The fiducials are detected first; four of them are sufficient to locate the chart. A pinhole camera with distortion, and
optionally a curved page, are then fitted to the positions of the fiducials and of the sides of the squares. The
registration must only be accurate enough for each estimator to find its target. The estimators refine the geometry to
0.01 px.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from matcam.calibration.chart.chart import Chart, Element
from matcam.calibration.chart.marks import balanced, find_marks, match_marks
from matcam.calibration.chart.sides import Sides, seen_sides
from matcam.calibration.photograph.linear_image import LinearImage, smoothed
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.errors import ArgumentError, FitError
from matcam.numerics.normal import robust_std

Projection = Callable[[FloatArray], FloatArray]
"""Map from positions on the page (n, 2), mm, to positions in the image (n, 2), px: a `Registration` or any function."""

FEWEST_POSITIONS = 12
"""Smallest number of positions for an estimate over the field. The model of the distortion has nine parameters."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Map from the page of a chart to positions in a photograph.

    A call with points (n, 2) on the page, mm, returns their positions (n, 2) in the image, px. Pixel centres have integer
    coordinates.

    Attributes:
        homography: (3, 3) matrix from the page, mm, to undistorted positions, px from the middle of the image.
        distortion: a and b of the distorted radius r (1 + a r^2 + b r^4), r in half diagonals of the image (no unit).
        shape: height and width of the image, px.
        residual: root mean square residual of the fiducials, px.
        found: number of fiducials found.
        curl: shape of a curved page (no unit): the coefficients of x^2, xy and y^2 in the height of the page, then the
            point (x, y) of the page below the camera. Heights are in units of the height of the camera; x and y are in
            widths of the page, from its middle. Default: zeros, a plane page.
        page: width and height of the page, mm. Default: (1, 1), not required for a plane page.

    Example:
        >>> homography = np.diag([2.0, 2.0, 1.0])  # 2 px per mm, perpendicular view
        >>> where = matcam.targets.Registration(homography, (0.0, 0.0), (101, 101), 0.0, 8)
        >>> where(np.array([[10.0, 5.0]])), round(where.scale((10.0, 5.0)), 3)
        (array([[70., 60.]]), 2.0)
    """

    homography: FloatArray
    distortion: tuple[float, float]
    shape: tuple[int, int]
    residual: float
    found: int
    curl: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    page: tuple[float, float] = (1.0, 1.0)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Project points on the page to the image.

        Args:
            points: (n, 2) positions on the page, mm.

        Returns:
            (n, 2) positions in the image, px.
        """
        parameters = np.concatenate([self.homography.ravel()[:8], self.distortion, self.curl])
        return _project(parameters, np.asarray(points, float), self.shape, self.page)

    def scale(self, point: tuple[float, float]) -> float:
        """Compute the scale of the image at a point of the page.

        Args:
            point: position on the page, mm.

        Returns:
            The scale, px per mm: square root of the ratio of the areas in the image and on the page.
        """
        step = 1e-3
        around = self(np.array(point) + step * np.array([[0, 0], [1, 0], [0, 1]]))
        (a, b), (c, d) = (around[1:] - around[0]) / step
        return float(np.sqrt(abs(a * d - b * c)))


def register_chart(image: ArrayLike | LinearImage, chart: Chart, *, mosaic: bool = False) -> Registration:
    """Find a chart in a photograph.

    Args:
        image: a `LinearImage`, or an array (height, width) of linear values, any unit; NaN for missing pixels.
        chart: description of the chart.
        mosaic: whether the four planes of a mosaic are scaled to equal brightness before the search; required for raw
            mosaics. Default: False.

    Returns:
        The map from the page to the image.

    Raises:
        FitError: if too few fiducials are found, or their positions do not match the chart.
        ArgumentError: if the chart has no fiducials, or an argument is invalid.

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
    if len(checks.instance("chart", chart, Chart).fiducials) < 4:
        raise ArgumentError("this chart has no fiducials: add at least four, so that it can be found in a photograph")
    checks.flag("mosaic", mosaic)
    picture = LinearImage.of(image).values
    picture = balanced(picture) if mosaic else picture
    marks = find_marks(picture, len(chart.fiducials))
    if len(marks) < 4:
        raise FitError(
            f"no chart of this description was found in the image: the image shows {len(marks)} of the "
            f"{len(chart.fiducials)} fiducials, but at least 4 are needed; photograph the whole chart"
        )
    smooth = smoothed(picture)
    pairs = match_marks(chart, marks, smooth)
    if not pairs:
        raise FitError(
            f"no chart of this description was found in the image: {len(marks)} fiducials are visible, but not at the "
            "described positions; check that the description belongs to this chart"
        )
    positions = np.array([chart.fiducials[i].centre for i, _ in pairs])
    seen = np.array([marks[j][:2] for _, j in pairs])
    shape = (picture.shape[0], picture.shape[1])
    found = _registration_through(positions, seen, shape, chart.page)
    # Each search for sides starts from the improved registration.
    for _ in range(2):
        sides = seen_sides(smooth, chart, found)
        # If most squares are hidden, other structures may be found instead.
        if sides is None or sides.found.mean() < 0.3:
            break
        found = _registration_through(positions, seen, shape, chart.page, sides)
    return found


def radial_distortion(positions: FloatArray, seen: FloatArray, shape: tuple[int, ...]) -> tuple[float, float]:
    """Fit the radial distortion of a page, and estimate its standard deviation from the scatter of the positions.

    The distorted radius is r (1 + a r^2), where a is the fitted coefficient.

    Args:
        positions: (n, 2) positions on a plane page, any unit.
        seen: (n, 2) positions in the image, px.
        shape: height and width of the image, px. The unit of r is half the diagonal of the image.

    Returns:
        The coefficient a and its standard deviation, no unit.

    Raises:
        FitError: if there are fewer than 12 positions, or they do not determine the pose of the page.
    """
    if len(positions) < FEWEST_POSITIONS:
        raise FitError(
            f"{len(positions)} positions do not determine the distortion: give at least {FEWEST_POSITIONS} dots"
        )
    at = (positions - positions.mean(0)) / max(float(np.ptp(positions, axis=0).max()), 1e-300)
    try:
        start = np.append(_homography(at, _from_middle(seen, shape)).ravel()[:8], 0.0)
    except np.linalg.LinAlgError:
        raise FitError("the positions do not determine the pose of the page: give dots that span the page") from None
    size = np.append(np.maximum(np.abs(start[:8]), 1e-6), 0.01)

    def off(p: FloatArray) -> FloatArray:
        return (_project(np.append(p * size, np.zeros(6)), at, (shape[0], shape[1])) - seen).ravel()

    plain = least_squares(off, start / size, x_scale="jac")
    # Wrong positions have little weight.
    scale = max(robust_std(plain.fun), 1e-9)
    fit = least_squares(off, plain.x, x_scale="jac", loss="cauchy", f_scale=3 * scale)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * max(robust_std(fit.fun), 1e-9) ** 2
    return float(fit.x[8] * size[8]), float(np.sqrt(covariance[8, 8]) * size[8])


def check_projection_given(name: str, element: Element | None, projection: Projection | None) -> None:
    if (element is None) != (projection is None):
        raise ArgumentError(f"{name} and projection must be given together: give both, or omit both")


def pixel_box(points: FloatArray, shape: tuple[int, int], margin: int) -> tuple[int, int, int, int]:
    """Compute the region (x, y, width, height) that contains points, px.

    The region is clipped to the image. `points`: (n, 2) px. `shape`: (height, width) of the image. `margin`: px around
    the points.
    """
    low = np.maximum(np.floor(points.min(0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(points.max(0)).astype(int) + margin + 1, shape[::-1])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _registration_through(
    positions: FloatArray,
    seen: FloatArray,
    shape: tuple[int, int],
    page: tuple[float, float],
    sides: Sides | None = None,
) -> Registration:
    """Fit camera and page curvature to points with known positions on the page, mm, and in the image, px.

    `sides`: further positions, which are known only in the direction perpendicular to the side. A FitError is raised if
    the residuals of the fiducials are too large.
    """
    start = np.append(_homography(positions, _from_middle(seen, shape)).ravel()[:8], np.zeros(7))
    # Priors keep undetermined parameters near 0: distortion, curvature, and the foot point of the camera.
    # The height of pages on a table is typically 2 % of the camera distance.
    prior = np.concatenate([[0.1, 0.1], np.full(3, 0.02), [1.0, 1.0]])
    size = np.append(np.maximum(np.abs(start[:8]), 1e-6), prior)
    none = (np.zeros((0, 2)),) * 3
    at, there, normal = none if sides is None else (a[sides.found] for a in (sides.page, sides.seen, sides.normal))
    # Sides have a standard deviation of 0.3 px; their total weight is at most that of 100 positions, so that they do not
    # outweigh the fiducials.
    std = 0.3 * np.sqrt(max(len(at) / 100, 1.0))

    def residual(p: FloatArray) -> FloatArray:
        whole = p * size
        off = ((_project(whole, at, shape, page) - there) * normal).sum(1)
        # Marks have a standard deviation of 0.2 px about the model of a curved page.
        return np.concatenate([((_project(whole, positions, shape, page) - seen) / 0.2).ravel(), p[8:], off / std])

    # The robust loss reduces the weight of wrong positions on sides that are partly covered.
    fit = least_squares(residual, start / size, x_scale="jac", loss="soft_l1", f_scale=3.0)
    whole = fit.x * size
    left = np.hypot(*(_project(whole, positions, shape, page) - seen).T)
    rms = float(np.sqrt((left**2).mean()))
    # In images of up to 1000 px, residuals of 3 px are possible; they increase with the size of the image.
    if rms > 3 * max(1.0, max(shape) / 1000):
        raise FitError(
            f"the fiducials deviate by {rms:.1f} px from the chart: check that the description belongs to this chart, and "
            "that the page is not folded"
        )
    return Registration(
        np.append(whole[:8], 1.0).reshape(3, 3), (float(whole[8]), float(whole[9])), (shape[0], shape[1]), rms,
        len(positions), tuple(float(v) for v in whole[10:]), page,
    )  # fmt: skip


def _project(
    parameters: FloatArray, points: FloatArray, shape: tuple[int, int], page: tuple[float, float] = (1.0, 1.0)
) -> FloatArray:
    """Project points on the page (mm) to the image (px).

    `parameters`: (15,) eight parameters of the homography, two of the distortion, and five of `Registration.curl`.
    `shape`: (height, width) of the image, px. `page`: width and height of the page, mm.
    """
    xx, xy, yy, foot_x, foot_y = parameters[10:]
    x, y = ((points - np.array(page) / 2) / page[0]).T
    height = xx * x * x + xy * x * y + yy * y * y
    # A raised point appears at the intersection of its ray with the plane.
    points = points + page[0] * np.stack([height * (x - foot_x), height * (y - foot_y)], axis=-1)
    h = np.append(parameters[:8], 1.0).reshape(3, 3)
    u, v, w = h @ np.stack([points[:, 0], points[:, 1], np.ones(len(points))])
    u, v = u / w, v / w
    square = (u * u + v * v) / ((shape[0] ** 2 + shape[1] ** 2) / 4)
    distortion_factor = 1 + parameters[8] * square + parameters[9] * square * square
    return np.stack([u * distortion_factor + (shape[1] - 1) / 2, v * distortion_factor + (shape[0] - 1) / 2], axis=-1)


def _from_middle(points: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    return points - (np.array(shape[1::-1]) - 1) / 2


def _homography(source: FloatArray, target: FloatArray) -> FloatArray:
    """Fit the homography (3, 3) from `source` to `target`, (n >= 4, 2) points each, by least squares.

    The last entry of the matrix is 1. A LinAlgError is raised if the points do not determine the homography.
    """
    scale = np.abs(source).max()
    rows = []
    for (x, y), (u, v) in zip(source / scale, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
    solution, _, rank, _ = np.linalg.lstsq(np.array(rows), target.ravel(), rcond=None)
    if rank < 8:
        raise np.linalg.LinAlgError("the points do not determine a homography")
    return np.append(solution, 1.0).reshape(3, 3) @ np.diag([1 / scale, 1 / scale, 1])
