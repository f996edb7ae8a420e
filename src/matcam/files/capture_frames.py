"""Entries of the list of a capture: images and lamp positions (read by capture.py)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError

INTENSITY = "intensity"
"""Name of the column with the relative intensity of each lamp: one value, or one per colour. The column is required only
if lamp.intensity is "table".
"""


class CaptureFrame(NamedTuple):
    """Image of a capture.

    Attributes:
        file: name inside the folder, such as "frames/L05_E2.tif".
        kind: name of the folder of the file, "frames", "dark", "flat", "outline" or "reference".
        lamp: name of the lamp position; empty if it does not apply to the image.
        exposure: name of the exposure; all images of one exposure have the same exposure time.
        time: nominal exposure time, s; NaN: unknown.
    """

    file: str
    kind: str
    lamp: str
    exposure: str
    time: float


class LampGuess(NamedTuple):
    """Specified direction of a lamp, seen from the centre of the sample, and relative intensity of the lamp.

    Attributes:
        angle: angle between lamp and optical axis, rad; NaN: unknown.
        azimuth: azimuth about the axis from +x (right) towards +y (up), rad; NaN: unknown.
        intensity: relative intensity of the lamp: one value, or one per colour; empty: unknown.
    """

    angle: float
    azimuth: float
    intensity: tuple[float, ...] = ()

    @property
    def direction(self) -> np.ndarray:
        """Unit vector (x, y, z) towards the lamp; NaN if an angle is unknown."""
        sin = math.sin(self.angle)
        return np.array([sin * math.cos(self.azimuth), sin * math.sin(self.azimuth), math.cos(self.angle)])


def stated_intensity(path: Path, text: str) -> tuple[float, ...]:
    """Parse the relative intensity of a lamp.

    `path` is the photograph, for messages. `text` contains one positive number, or three (one for each colour),
    separated by blanks. An empty text means that the intensity is unknown. A FileFormatError is raised for any other
    text.
    """
    try:
        light = tuple(float(part) for part in text.split())
    except ValueError:
        light = (math.nan,)
    if not all(math.isfinite(one) and one > 0 for one in light) or len(light) not in (0, 1, 3):
        raise FileFormatError(f"{path}: {INTENSITY} must be one or three positive numbers, got {text!r:.40}")
    return light
