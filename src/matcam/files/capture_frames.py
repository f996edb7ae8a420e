"""What a capture's list states: a picture, and where a lamp position is thought to be (capture.py reads it)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


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
    """

    angle: float
    azimuth: float

    @property
    def direction(self) -> np.ndarray:
        """Return the unit vector (x, y, z) to the lamp; NaN where an angle is not stated."""
        sin = math.sin(self.angle)
        return np.array([sin * math.cos(self.azimuth), sin * math.sin(self.azimuth), math.cos(self.angle)])
