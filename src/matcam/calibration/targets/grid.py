"""Grids of dots: the blur at every dot, its variation over the field, and the MTF.

Each dot is modelled as the convolution of a disc, a Gaussian and a square pixel (`dot_fit`). The size of the disc
follows from the lattice of all dots. The deviation from this model that the dots of a zone have in common is described
by second and fourth derivatives of the model with respect to the position. This deviation is included in the MTF of the
zone, which is therefore not restricted to a Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.chart.chart import Dots
from matcam.calibration.chart.registration import Projection, check_projection_given, pixel_box
from matcam.calibration.photograph.linear_image import LinearImage, measurable_region, usable_region
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.dot_fit import FEWEST, SHARED, DotFit, DotLattice, find_dots, fit_dots, square_lattice
from matcam.calibration.targets.mtf_samples import MTFSamples, with_units
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.errors import ArgumentError, FitError
from matcam.core.io import plain
from matcam.files.photographs import Photograph
from matcam.numerics.normal import robust_fit
from matcam.numerics.polynomials import plane_powers

_FREQUENCY = np.array([0.2, 0.2, 0.4, 0.4, 0.4])
"""Frequencies of the reported MTF, cycles/px. There is one for each derivative in `SHARED`."""
_DIRECTION = np.radians([0.0, 90.0, 0.0, 90.0, 45.0])
"""Directions of the reported MTF, rad."""


@dataclass(frozen=True, eq=False)
class BlurField:
    """Variance of the Gaussian blur of a lens over the field.

    The variance is a polynomial of second order in the position.

    Attributes:
        coefficients: (6,) coefficients of the variance for 1, u, v, u^2, u v and v^2, px^2 each; u and v are the
            distances from `middle` along x and y, in units of `half`.
        covariance: (6, 6) covariance of `coefficients`, px^4.
        middle: (x, y) of the middle of the grid, px.
        half: half the larger of the extents of the grid along x and y, px.

    Example:
        >>> field = matcam.targets.BlurField(np.array([0.25, 0, 0, 0.11, 0, 0]), 1e-6 * np.eye(6), (100.0, 80.0), 50.0)
        >>> np.round(field.sigma_at([100, 150], [80, 80])[0], 3)
        array([0.5, 0.6])
    """

    coefficients: FloatArray
    covariance: FloatArray
    middle: tuple[float, float]
    half: float

    @classmethod
    def through(cls, x: FloatArray, y: FloatArray, variance: FloatArray, std: FloatArray) -> BlurField:
        """Fit the field to the variances of dots.

        Args:
            x: (n,) columns, px.
            y: (n,) rows, px.
            variance: (n,) variance of the lens blur at each dot, px^2.
            std: (n,) standard deviations of `variance`, px^2.

        Returns:
            The field; a constant if there are fewer than 24 dots.
        """
        middle = (float((x.min() + x.max()) / 2), float((y.min() + y.max()) / 2))
        half = float(max(np.ptp(x), np.ptp(y)) / 2)
        terms = plane_powers((x - middle[0]) / half, (y - middle[1]) / half, 2)
        terms = terms[:, : 6 if len(x) >= 24 else 1]
        # All dots get the same standard deviation. Individual ones would favour dots that are sharp by chance.
        fit = robust_fit(terms, variance, float(np.median(std)))
        more = (0, 6 - terms.shape[1])
        found, covariance = np.pad(fit.parameters, more), np.pad(fit.covariance, (more, more))
        return cls(found, covariance, middle, half)

    def sigma_at(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Evaluate the lens width sigma at positions in the image.

        Args:
            x: columns, px.
            y: rows, px.

        Returns:
            Sigma and its standard deviation, px, in the shape of `x` and `y`.
        """
        u, v = ((np.asarray(at, float) - middle) / self.half for at, middle in zip((x, y), self.middle, strict=True))
        terms = plane_powers(u, v, 2)
        square = np.maximum(terms @ self.coefficients, 1e-6)
        variance = ((terms @ self.covariance) * terms).sum(-1)
        return np.sqrt(square), np.sqrt(np.maximum(variance, 0) / square) / 2


@dataclass(frozen=True, eq=False)
class DotGrid:
    """Blur at n dots and over the field, and MTF in zones.

    Attributes:
        x: (n,) x of the dots in the image, px.
        y: (n,) y of the dots in the image, px.
        sigma: (n,) lens width (standard deviation of the Gaussian blur) at each dot, for the given half width of the
            pixel, px.
        sigma_std: (n,) standard deviation of `sigma`, px.
        printed: (n, 2) positions (x, y) on the page, mm; in pitches if no chart describes the dots.
        samples: MTF of lens and pixel in zones of the field, not restricted to a Gaussian.
        field: lens width as a smooth function over the field.
        radius: mean radius of the dots in the image without blur, px.
        gain: gain estimated from the residuals, in the units of the values; the variance of a pixel is gain * value +
            read_variance.
        read_variance: variance of a dark pixel, in squared units of the values.

    Example:
        >>> y, x = np.mgrid[:90, :90]
        >>> page = np.full((90, 90), 1000.0)
        >>> for position in np.ndindex(7, 7):
        ...     page -= 900 * np.exp(-((x - 9 - 12 * position[0]) ** 2 + (y - 9 - 12 * position[1]) ** 2) / 2)
        >>> grid = matcam.targets.dot_grid(page, radius=0.05)
        >>> sigma, std = grid.sigma_at(45, 45)
        >>> round(float(sigma), 1), grid.to_dict()["field"]["position_px"][0]
        (0.9, [45.0, 45.0])
    """

    x: FloatArray
    y: FloatArray
    sigma: FloatArray
    sigma_std: FloatArray
    printed: FloatArray
    samples: tuple[MTFSamples, ...]
    field: BlurField
    radius: float
    gain: float
    read_variance: float

    @property
    def middle(self) -> tuple[float, float]:
        """Centre (x, y) of the grid in the image, px."""
        return self.field.middle

    def sigma_at(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Evaluate the smooth lens width at positions in the image.

        Args:
            x: columns, px.
            y: rows, px.

        Returns:
            Sigma and its standard deviation, px, in the shape of `x` and `y`.
        """
        return self.field.sigma_at(x, y)

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a JSON object.

        Returns:
            All attributes, with units in the names of those that have one. The field is given as sigma at the middle of
            the grid and at the corners of the square around the grid.
        """
        middle, half = np.array(self.middle), self.field.half
        positions = middle + half * np.array([[0, 0], [-1, -1], [1, -1], [1, 1], [-1, 1]])
        sigma, std = self.sigma_at(*positions.T)
        found = with_units(self, x="px", y="px", sigma="px", sigma_std="px", radius="px")
        field = {"position_px": positions, "sigma_px": sigma, "sigma_std_px": std}
        return found | {"field": plain(field)}


def dot_grid(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    dots: Dots | None = None,
    projection: Projection | None = None,
    radius: float | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
) -> DotGrid:
    """Measure the blur over the field with a grid of dots.

    The dots are round, dark or bright, and form a square lattice.

    Args:
        image: `LinearImage`, `Photograph`, or array as in `LinearImage.of`.
        roi: region (x, y, width, height) that contains only the grid, px. Default: None, the whole image.
        dots: description of the dots from a chart, to be given with `projection`. Both replace `roi` and `radius`. Default:
            None, the dots are detected in the region.
        projection: map from the page of the chart, mm, to the image, px: a `Registration`. Default: None.
        radius: radius of the dots relative to their pitch, in (0, 0.5) (no unit). It is required without `dots`, because
            blur and size of a dot cannot be distinguished. Default: None.
        half_width: half the side of the sensitive area of a pixel, in (0, 0.5] px. The lens width depends on this
            value, but the MTF hardly does. Default: 0.5.
        cfa: colours of the first 2 x 2 px of a mosaic, as in `LinearImage.of` (no unit). Default: None.
        channel: colour, as in `LinearImage.of` (no unit). Default: None.
        tone: tone curve, as in `LinearImage.of` (no unit). Default: "linear".

    Returns:
        The lens width sigma at every dot and over the field, and the MTF in zones of the field.

    Raises:
        ArgumentError: if an argument is missing or out of range, or only one of `dots` and `projection` is given.
        FitError: if there is no grid, or the grid cannot be measured.

    Source:
        docs/model.md 7; docs/targets.md.

    Example:
        >>> y, x = np.mgrid[:90, :90]
        >>> page = np.full((90, 90), 1000.0)
        >>> for column in range(9, 90, 12):
        ...     for row in range(9, 90, 12):
        ...         page -= 900 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 2)
        >>> grid = matcam.targets.dot_grid(page, radius=0.05)
        >>> grid.sigma.size, bool(np.abs(grid.sigma / 0.9 - 1).max() < 0.1)
        (49, True)
    """
    check_projection_given("dots", dots, projection)
    half_width = float(
        checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
    )
    if dots is not None and projection is not None:
        picture, lattice = _expected_dots(LinearImage.of(image, channel, cfa, tone), dots, projection)
        size = dots.radius
    else:
        if radius is None:
            raise ArgumentError(
                "radius must be given relative to the pitch of the dots, because radius and blur cannot be distinguished"
            )
        size = float(checks.scalar("radius", checks.within("radius", radius, 0, 0.5, open_low=True, open_high=True)))
        picture = measurable_region(LinearImage.of(image, channel, cfa, tone, roi))
        lattice = square_lattice(*find_dots(picture.values))
    return _grid_result(picture, fit_dots(picture.values, lattice, size, half_width), half_width)


def _expected_dots(whole: LinearImage, dots: Dots, projection: Projection) -> tuple[LinearImage, DotLattice]:
    printed = np.array(dots.centres)
    seen = projection(printed)
    inside = (seen > 2).all(1) & (seen < np.array(whole.shape[::-1]) - 3).all(1)
    if inside.sum() < FEWEST:
        raise FitError(
            f"only {inside.sum()} dots of the grid lie inside the image, but at least {FEWEST} are needed: give an image that "
            "contains the whole grid"
        )
    box = pixel_box(seen[inside], whole.shape, 8)
    x, y = (seen[inside] - box[:2]).T
    return usable_region(whole.cut(box)), DotLattice(x, y, *printed[inside].T)


def _grid_result(picture: LinearImage, fit: DotFit, half_width: float) -> DotGrid:
    x, y, variance = fit.parameters[:, 4:7].T
    # A zone has at least 60 dots on average.
    across = int(max(1, min(3, np.sqrt(len(x) / 60))))
    borders = [np.quantile(a, np.linspace(0, 1, across + 1)[1:-1]) for a in (x, y)]
    zone = np.searchsorted(borders[0], x) + across * np.searchsorted(borders[1], y)
    zones = [fit.subset(zone == k) for k in range(across * across) if (zone == k).sum() >= FEWEST]
    sigma = np.sqrt(variance)
    left, top = picture.corner
    return DotGrid(
        x + left,
        y + top,
        sigma,
        fit.std[:, 6] / (2 * sigma),
        np.column_stack([fit.lattice.u, fit.lattice.v]),
        tuple(_zone_samples(picture, dots, half_width) for dots in zones),
        BlurField.through(x + left, y + top, variance, fit.std[:, 6]),
        fit.radius,
        fit.gain,
        fit.read_variance,
    )


def _zone_samples(picture: LinearImage, dots: DotFit, half_width: float) -> MTFSamples:
    """Compute the MTF of a zone of the field.

    The result is the MTF of the mean Gaussian and the pixel, times 1 + p. The polynomial p in the frequency is common
    to all dots of the zone.
    """
    own = dots.design[:, :, :6]
    pilot, root = dots.parameters[:, 6], np.sqrt(dots.weight)[..., None]
    mean = float(np.mean(pilot))
    # The residual refers to the mean sigma; the deviation of each dot is removed to first order.
    residual = dots.residual + dots.design[:, :, 6] * (pilot - mean)[:, None]
    basis = np.linalg.qr(root * own)[0]

    def beyond(columns: FloatArray) -> FloatArray:
        """Project weighted columns onto the complement of the individual parameters of each dot."""
        columns = root * columns
        return np.asarray(columns - basis @ (basis.transpose(0, 2, 1) @ columns)).reshape(-1, columns.shape[-1])

    shared = beyond(dots.shared)
    covariance = np.linalg.inv(shared.T @ shared)
    found = (covariance @ (shared.T @ beyond(residual[..., None])))[:, 0]
    wx, wy = (2 * np.pi * _FREQUENCY * t for t in (np.cos(_DIRECTION), np.sin(_DIRECTION)))
    turned = np.stack([(1 if (i + j) % 4 == 0 else -1) * wx**i * wy**j for i, j in SHARED], axis=-1)
    box = np.sinc(half_width * wx / np.pi) * np.sinc(half_width * wy / np.pi)
    gaussian = np.exp(-mean * (wx**2 + wy**2) / 2) * box
    rows = gaussian[:, None] * turned
    covariance = rows @ covariance @ rows.T
    x, y = dots.parameters[:, 4:6].mean(0)
    mtf, covariance = gaussian + rows @ found, (covariance + covariance.T) / 2
    return MTFSamples.of_region("dots", picture, (x, y), _FREQUENCY, _DIRECTION, mtf, covariance)
