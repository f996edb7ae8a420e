"""Search for the limb of a sphere without initial values: the normals of two edges of a circle meet at its centre."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

_EDGES = 2500  # largest number of edges, which bounds the time
_BINS = 72  # number of bins along the circumference
_NEAR = 1.6  # largest distance of an edge from its circle, px of the binned image


class FoundCircle(NamedTuple):
    """Circle through the edges of an image.

    Attributes:
        row: row of the centre, px.
        column: column of the centre, px.
        radius: radius, px.
        coverage: share of the circumference with an edge.
    """

    row: float
    column: float
    radius: float
    coverage: float

    @property
    def score(self) -> float:
        """Length of the part of the circumference with an edge, px."""
        return self.coverage * 2 * np.pi * self.radius


def find_circles(values: np.ndarray, std: np.ndarray, *, bright_inside: bool, mosaic: bool) -> list[FoundCircle]:
    """Find at most two circles in an image.

    The centre of each lies outside the other.

    Args:
        values: linear radiance in any unit, (height, width); NaN for missing values.
        std: standard deviation of `values`, same shape and unit.
        bright_inside: True for a lit sphere, False for a dark sphere in front of a bright field.
        mosaic: True if neighbouring pixels have different colours.

    Returns:
        The circles, in px of the image. Each has edges along at least 0.15 of its circumference.
    """
    # larger images are binned to 320 px to bound the time
    bin_ = int(np.ceil(max(values.shape) / 320))
    bin_ += bin_ % 2 if mosaic else 0
    position, inwards = _edges(*_binned(values, std, bin_), bright_inside)
    found: list[FoundCircle] = []
    free = np.ones(len(position), bool)
    rng = np.random.default_rng(0)
    while len(found) < 2 and free.sum() > 12:
        circle = _best(position[free], inwards[free], rng, max(values.shape) / bin_)
        if circle is None or circle.coverage < 0.15:
            break
        if any(
            np.hypot(circle.row - one.row, circle.column - one.column) <= max(circle.radius, one.radius)
            for one in found
        ):
            break
        found.append(circle)
        distance = np.hypot(position[:, 0] - circle.row, position[:, 1] - circle.column)
        free &= distance > circle.radius * 1.05 + _NEAR
    shift = (bin_ - 1) / 2
    return [FoundCircle(c.row * bin_ + shift, c.column * bin_ + shift, c.radius * bin_, c.coverage) for c in found]


def _binned(values: np.ndarray, std: np.ndarray, bin_: int) -> tuple[np.ndarray, float]:
    """Bin and compress an image so that a highlight does not dominate, and compute the noise in the compressed unit."""
    height, width = (n // bin_ * bin_ for n in values.shape)
    blocks = values[:height, :width].reshape(height // bin_, bin_, width // bin_, bin_)
    good = np.isfinite(blocks)
    number = good.sum((1, 3))
    mean = np.where(good, blocks, 0.0).sum((1, 3)) / np.maximum(number, 1)
    mean[number == 0] = np.median(mean[number > 0]) if (number > 0).any() else 0.0
    noise = float(np.nanmedian(std)) / bin_
    floor = np.percentile(mean, 5)
    unit = max(5 * noise, 1e-4 * float(np.ptp(mean)), 1e-300)
    return np.arcsinh((mean - floor) / unit), noise / unit


def _edges(picture: np.ndarray, noise: float, bright_inside: bool) -> tuple[np.ndarray, np.ndarray]:
    """Find the edges of an image: positions, px (n, 2), and unit normals towards the sphere (n, 2), in (row, column)."""
    rows = ndimage.gaussian_filter(picture, 1.0, order=(1, 0))
    columns = ndimage.gaussian_filter(picture, 1.0, order=(0, 1))
    size = np.hypot(rows, columns)
    # a Gaussian derivative with a standard deviation of 1 px reduces white noise to 0.2 of its standard deviation
    threshold = max(5 * 0.2 * noise, 0.1 * float(np.percentile(size, 99.5)))
    with np.errstate(invalid="ignore", divide="ignore"):
        u, v = rows / size, columns / size
    index = np.argwhere(size > threshold)
    if not len(index):
        return np.zeros((0, 2)), np.zeros((0, 2))
    u, v = u[tuple(index.T)], v[tuple(index.T)]
    along = np.stack([u, v])
    middle = size[tuple(index.T)]
    ahead, behind = (
        ndimage.map_coordinates(size, index.T + side * along, order=1, mode="nearest") for side in (1.0, -1.0)
    )
    ridge = (middle >= ahead) & (middle >= behind)
    index, along, middle, ahead, behind = index[ridge], along[:, ridge], middle[ridge], ahead[ridge], behind[ridge]
    curvature = 2 * middle - ahead - behind
    with np.errstate(invalid="ignore", divide="ignore"):
        fine = np.where(curvature > 0, (ahead - behind) / (2 * curvature), 0.0)
    position = index + (np.clip(fine, -0.5, 0.5) * along).T
    if len(position) > _EDGES:
        chosen = np.random.default_rng(1).choice(len(position), _EDGES, replace=False)
        position, along = position[chosen], along[:, chosen]
    return position, along.T if bright_inside else -along.T


def _best(position: np.ndarray, inwards: np.ndarray, rng: np.random.Generator, largest: float) -> FoundCircle | None:
    # number of random pairs of edges
    i, j = rng.integers(0, len(position), (2, 40000))
    apart, turned = position[j] - position[i], inwards[i] - inwards[j]
    size = (turned**2).sum(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = (apart * turned).sum(1) / size
    first, second = position[i] + radius[:, None] * inwards[i], position[j] + radius[:, None] * inwards[j]
    meets = (size > 0.1) & (radius > 6) & (radius < largest)
    meets &= np.hypot(*(first - second).T) < 1 + 0.05 * radius
    # largest number of circles that are evaluated
    chosen = np.flatnonzero(meets)[:600]
    if not len(chosen):
        return None
    centre, radius = (first[chosen] + second[chosen]) / 2, radius[chosen]
    score = np.array([_coverage(position, inwards, c[0], c[1], r)[0] * r for c, r in zip(centre, radius, strict=True)])
    best: FoundCircle | None = None
    for k in np.argsort(score)[::-1][:5]:
        (row, column), size_ = centre[k], radius[k]
        for _ in range(4):
            _, near = _coverage(position, inwards, row, column, size_)
            if near.sum() < 6:
                break
            y, x = position[near].T
            a, b, c = np.linalg.lstsq(np.stack([y, x, np.ones_like(x)], 1), y**2 + x**2, rcond=None)[0]
            if c + a**2 / 4 + b**2 / 4 <= 0:
                break
            row, column, size_ = a / 2, b / 2, np.sqrt(c + a**2 / 4 + b**2 / 4)
        circle = FoundCircle(row, column, size_, _coverage(position, inwards, row, column, size_)[0])
        if best is None or circle.score > best.score:
            best = circle
    return best


def _coverage(
    position: np.ndarray, inwards: np.ndarray, row: float, column: float, radius: float
) -> tuple[float, np.ndarray]:
    """Compute the share of a circle's circumference with an edge, and the mask of the edges on this circle."""
    y, x = row - position[:, 0], column - position[:, 1]
    distance = np.hypot(y, x)
    # smallest cosine between the normals of an edge and of its circle
    near = (np.abs(distance - radius) < _NEAR) & (y * inwards[:, 0] + x * inwards[:, 1] > 0.9 * distance)
    bins = ((np.arctan2(y[near], x[near]) / (2 * np.pi) + 0.5) * _BINS).astype(int) % _BINS
    return np.unique(bins).size / _BINS, near
