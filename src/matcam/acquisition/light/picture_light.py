"""Light of each image of a capture relative to the mean, with its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from matcam.files.capture_settings import Stated


class PictureLight(NamedTuple):
    """Light of images, and the unit of their values, for one position of each lamp.

    Attributes:
        gain: light of each image relative to the mean, (pictures,).
        covariance: covariance of ln(`gain`), (pictures, pictures).
        gain_by_nearness: derivative of ln(`gain`) with respect to the inverse distance of the lamp, radii, (pictures,).
        unit_by_nearness: derivative of ln(`units`) with respect to the inverse distance of the lamp, radii. Default: 0,
            as for an unknown unit.
        units: units of each channel, merged value per radiance under unit irradiance at the sphere's centre, with
            relative standard deviation. Default: None, unknown.
    """

    gain: np.ndarray
    covariance: np.ndarray
    gain_by_nearness: np.ndarray
    unit_by_nearness: float = 0.0
    units: tuple[Stated, ...] | None = None

    def part(self, pictures: Sequence[int]) -> PictureLight:
        keep = list(pictures)
        return self._replace(
            gain=self.gain[keep],
            covariance=self.covariance[np.ix_(keep, keep)],
            gain_by_nearness=self.gain_by_nearness[keep],
        )

    def with_error(self, std: np.ndarray) -> PictureLight:
        """Add independent errors of ln(`gain`) with standard deviations `std`, (pictures,)."""
        return self._replace(covariance=self.covariance + np.diag(std**2))

    def wider(self, factor: float) -> PictureLight:
        """Multiply the standard deviations of ln(`gain`) by a factor."""
        return self._replace(covariance=self.covariance * factor**2)


LightAt = Callable[[np.ndarray, float], PictureLight]
"""Light of the images as a function of the directions to the lamps, unit vectors (pictures, 3), and of the inverse distance
of the lamp, 1/radii.
"""


def stated_light(gain: np.ndarray, std: np.ndarray) -> PictureLight:
    """Build the light of images from relative values with independent errors, at any distance of the lamp."""
    # smallest standard deviation of the relative light of an image, no unit
    covariance = np.diag(np.maximum(std, 1e-5) ** 2)
    return PictureLight(gain / gain.mean(), covariance, np.zeros(len(gain)))


def constant_light(count: int, std: float) -> PictureLight:
    """Build the light of images of one lamp without a measurement: equal, with a relative standard deviation."""
    return stated_light(np.ones(count), np.full(count, std))
