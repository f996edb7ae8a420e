"""Search for the sides of the squares of a chart in an image, based on a first registration."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.calibration.chart.chart import Chart, Square
from matcam.core.arrays import FloatArray

_ALONG = np.linspace(-0.32, 0.32, 9)
"""Positions at which a side is searched for, relative to its length, from its middle."""


class Sides(NamedTuple):
    """Measured positions of n sides of squares, m positions on each side.

    Attributes:
        page: (n, m, 2) positions on the page, mm.
        seen: (n, m, 2) measured positions of the sides in the image, px; NaN if no side was found.
        normal: (n, m, 2) outward unit vectors, towards the bright side.
        length: (n,) length of the side in the image, px.
    """

    page: FloatArray
    seen: FloatArray
    normal: FloatArray
    length: FloatArray

    @property
    def found(self) -> np.ndarray:
        """Mask (n, m) of the positions at which a side was found."""
        return np.asarray(np.isfinite(self.seen).all(2))


def seen_sides(smooth: FloatArray, chart: Chart, projection: Callable[[FloatArray], FloatArray]) -> Sides | None:
    """Find the sides of all squares; None if the chart has no squares.

    `smooth`: (height, width) image from `smoothed`. `projection`: map from the page, mm, to the image, px.
    """
    squares = [element for element in chart.elements if isinstance(element, Square)]
    if not squares:
        return None
    corners = np.array([square.corners for square in squares])
    ends = np.roll(corners, -1, axis=1)
    page = corners[:, :, None] + (ends - corners)[:, :, None] * (0.5 + _ALONG[:, None])
    page = page.reshape(-1, _ALONG.size, 2)
    middle = np.repeat(corners.mean(1), 4, axis=0)
    at = projection(page.reshape(-1, 2)).reshape(page.shape)
    along = np.gradient(at, axis=1)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal /= np.maximum(np.hypot(*normal.transpose(2, 0, 1)), 1e-12)[..., None]
    centre = projection(middle)
    inwards = ((centre[:, None] - at) * normal).sum(2)
    normal *= -np.sign(inwards)[..., None]
    length = np.hypot(*(at[:, -1] - at[:, 0]).T) / np.ptp(_ALONG)
    depth = 2 * np.abs(inwards).min(1)
    # A side is searched for up to 0.22 of the size of a square, and at most 30 px, from its expected position.
    search_range = min(float(np.median(np.minimum(depth, length))) * 0.22, 30)
    samples = np.ceil(2 * search_range)  # on each side, 0.5 px apart
    steps = np.arange(-samples, samples + 1) / 2
    positions = at[:, :, None] + normal[:, :, None] * steps[:, None]
    profile = ndimage.map_coordinates(
        smooth, positions[..., ::-1].transpose(3, 0, 1, 2), order=1, mode="constant", cval=np.nan
    )
    level = np.repeat([square.level for square in squares], 4)
    off = _steepest(profile, steps, level)
    return Sides(page, at + off[..., None] * normal, normal, length)


def _steepest(profile: FloatArray, steps: FloatArray, level: FloatArray) -> FloatArray:
    """Locate the steepest rise of profiles (n, m, k), px from the expected position of the side.

    The position is NaN if the rise is too small for a side or lies at an end of the profile, or if samples are missing.
    `steps`: (k,) positions of the samples, px. `level`: (n,) described level of the square of each side.
    """
    slope = np.diff(profile, axis=2)
    between = (steps[1:] + steps[:-1]) / 2
    best = np.nan_to_num(slope, nan=-np.inf).argmax(2)
    # The gradient within 3 px of the steepest point determines the position.
    near = np.abs(between - between[best][..., None]) <= 3.0
    weight = np.where(near, np.maximum(slope, 0.0), 0.0)
    total = weight.sum(2)
    position = (weight * between).sum(2) / np.maximum(total, 1e-300)
    paper = profile[..., -3:].mean(2)
    # Print and illumination may reduce a step to 35 % of the described step.
    good = (total > 0.35 * (1 - level)[:, None] * paper) & np.isfinite(profile).all(2)
    inside = (best > 1) & (best < slope.shape[2] - 2)
    return np.where(good & inside, position, np.nan)
