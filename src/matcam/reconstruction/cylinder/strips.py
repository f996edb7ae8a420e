"""Strips of material around a cylinder, one above the other, and their profiles.

The light changes slowly along the cylinder. The rows of a strip are therefore averaged, separately for each colour, to give
a profile across the cylinder. In a mosaic, the averaged rows of a colour depend on the column.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.errors import FitError
from matcam.files.capture_settings import LEAST_STRIP

MARGIN = 4
"""Number of rows that are excluded at each end of a strip, because the lens mixes adjacent strips."""


class Strip(NamedTuple):
    """Position of a strip in the frame, and orientation of its material.

    Attributes:
        first: first row, px.
        last: last row, px.
        turn: angle from the direction around the cylinder (to the right) to the x axis of the material, positive upwards,
            rad.
    """

    first: int
    last: int
    turn: float

    @property
    def read(self) -> tuple[int, int]:
        """First and last row that are averaged, px."""
        return self.first + MARGIN, self.last - MARGIN


class StripProfiles(NamedTuple):
    """Profiles of one image across the strips of a cylinder.

    All arrays but `column` have the shape (channels, strips, columns).

    Attributes:
        column: columns of the frame, px, (columns,).
        values: mean of the image values over the rows of the strip; a lower bound if a pixel is clipped; 0 where `used` is
            False.
        std: standard deviation of the noise of the values, in their unit; 1 where `used` is False.
        clipped: True where at least one of the averaged pixels is clipped.
        used: True where the column of the strip has a valid pixel of the colour.
        row: mean row of the averaged pixels in the frame, px; the middle of the strip where `used` is False.
    """

    column: np.ndarray
    values: np.ndarray
    std: np.ndarray
    clipped: np.ndarray
    used: np.ndarray
    row: np.ndarray


def strip_profiles(picture: MergedPicture, strips: Sequence[Strip]) -> StripProfiles:
    """Average the rows of every strip of an image.

    Args:
        picture: merged image with its noise.
        strips: strips of the cylinder.

    Raises:
        FitError: a strip has too few rows, or is partly outside the image.
    """
    width, count = picture.values.shape[1], len(picture.channels)
    shape = (count, len(strips), width)
    values, std, clipped, used = np.zeros(shape), np.ones(shape), np.zeros(shape, bool), np.zeros(shape, bool)
    row = np.zeros(shape)
    for s, strip in enumerate(strips):
        first, last = (row - picture.origin[0] for row in strip.read)
        if first < 0 or last >= picture.values.shape[0] or last - first + 1 < LEAST_STRIP - 2 * MARGIN:
            raise FitError(
                f"strip {s + 1} (rows {strip.first} to {strip.last}) must have at least {LEAST_STRIP} rows and be "
                "inside the region of the frames: correct sample.strip_rows_px"
            )
        rows = slice(first, last + 1)
        light, noise = picture.values[rows].astype(float), picture.std[rows].astype(float)
        good, numbers = np.isfinite(light) & (noise > 0), np.arange(strip.read[0], strip.read[1] + 1.0)
        for c in range(count):
            of = good & (picture.channel[rows] == c)
            number = of.sum(axis=0)
            some = np.maximum(number, 1)
            values[c, s] = np.where(of, light, 0.0).sum(axis=0) / some
            std[c, s] = np.where(number > 0, np.sqrt((np.where(of, noise, 0.0) ** 2).sum(axis=0)) / some, 1.0)
            clipped[c, s] = (of & picture.clipped[rows]).any(axis=0)
            used[c, s] = number > 0
            row[c, s] = np.where(number > 0, numbers @ of / some, numbers.mean())
    return StripProfiles(np.arange(width) + float(picture.origin[1]), values, std, clipped, used, row)
