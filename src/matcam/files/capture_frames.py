"""What a capture's list states: a picture, and where a lamp position is thought to be (capture.py reads it)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError

INTENSITY = "intensity"
"""A column that only a table of the lamps' light needs: one number, or one of each colour."""


class CaptureFrame(NamedTuple):
    """Name one picture of a capture.

    Attributes:
        file: name inside the folder, such as "frames/L05_E2.tif".
        kind: "frames", "dark", "flat", "outline" or "reference": the folder in which it lies.
        lamp: the lamp position; empty where there is none.
        exposure: which exposure; pictures of one exposure share their time.
        time: nominal exposure time, s; NaN: not stated.
    """

    file: str
    kind: str
    lamp: str
    exposure: str
    time: float


class LampGuess(NamedTuple):
    """State where a lamp position is thought to be, seen from the sample's centre.

    Attributes:
        angle: between lamp and optical axis, rad; NaN: not stated.
        azimuth: about the axis from +x (right) towards +y (up), rad; NaN: not stated.
        intensity: the lamp's light, relative: one number, or one of each colour; empty: not stated.
    """

    angle: float
    azimuth: float
    intensity: tuple[float, ...] = ()

    @property
    def direction(self) -> np.ndarray:
        """Return the unit vector (x, y, z) to the lamp; NaN where an angle is not stated."""
        sin = math.sin(self.angle)
        return np.array([sin * math.cos(self.azimuth), sin * math.sin(self.azimuth), math.cos(self.angle)])


def stated_intensity(path: Path, text: str) -> tuple[float, ...]:
    """Return a lamp's stated light: numbers above 0, with spaces between those of colours."""
    try:
        light = tuple(float(part) for part in text.split())
    except ValueError:
        light = (math.nan,)
    if not all(math.isfinite(one) and one > 0 for one in light) or len(light) not in (0, 1, 3):
        raise FileFormatError(f"{path}: {INTENSITY} must be one number above 0, or three, got {text!r:.40}")
    return light
