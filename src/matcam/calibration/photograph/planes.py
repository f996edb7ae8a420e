"""A photograph's colours as planes of their own, linear: a mosaic's sites as they lie, a colour picture's channels, or grey."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.calibration.photograph.region import LUMINANCE
from matcam.calibration.photograph.tone import Tone, linearised
from matcam.core.errors import ArgumentError
from matcam.files.photographs import Photograph

CHANNELS = ("R", "G", "B", "Y", "grey")


class Plane(NamedTuple):
    """One channel of a photograph."""

    photograph: Photograph
    channel: str
    """One of `CHANNELS`; "Y": luminance."""
    sites: np.ndarray
    """(2, 2) bool: where the channel stands in the first 2 x 2 px; all of them where there is no mosaic."""
    tone: Tone

    def values(self, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear values at whole px, and whether they are saturated."""
        codes = self.photograph.values[y, x]
        if codes.ndim > y.ndim and self.channel != "Y":
            codes = codes[..., "RGB".index(self.channel)]
        full = codes >= self.photograph.saturation
        column = "RGB".index(self.channel) if self.channel in "RGB" else None
        if self.channel == "Y":
            return linearised(codes, self.tone) @ np.array(LUMINANCE), full.any(-1)
        return linearised(codes, self.tone, column), full

    def picture(self) -> np.ndarray:
        """(height, width) linear values; NaN where a mosaic has another colour, and where a pixel is saturated."""
        height, width = self.photograph.values.shape[:2]
        value, full = self.values(*np.mgrid[:height, :width])
        there = np.tile(self.sites, (height // 2 + 1, width // 2 + 1))[:height, :width]
        return np.where(there & ~full, value, np.nan)


def planes_of(photograph: Photograph, channels: Sequence[str] | None, tone: Tone) -> list[Plane]:
    """The channels asked for, or all. ArgumentError for a channel that this photograph has not, or a tone curve for camera
    raw, which is linear."""
    if photograph.cfa is not None:
        there: tuple[str, ...] = ("R", "G", "B")
        if not (tone is None or (isinstance(tone, str) and tone == "linear")):
            raise ArgumentError("camera raw is linear: it has no tone curve to be undone")
    else:
        there = ("grey",) if photograph.values.ndim == 2 else ("R", "G", "B")
    every = np.ones((2, 2), bool)
    planes = []
    for channel in there if channels is None else channels:
        if channel not in there and not (channel == "Y" and photograph.values.ndim == 3):
            raise ArgumentError(f"channel {channel!r} is not in this picture; it has {', '.join(there)}")
        sites = every if photograph.cfa is None else (np.array(list(photograph.cfa)) == channel).reshape(2, 2)
        planes.append(Plane(photograph, channel, sites, tone))
    return planes


def assumed_tone(photograph: Photograph) -> tuple[Tone, str]:
    """The tone curve of a photograph of which nobody has said one, and what has been assumed ("": nothing had to be)."""
    if photograph.linear:
        return None, ""
    if photograph.values.dtype.itemsize == 1:
        return "srgb", "8 bits and no tone curve stated: sRGB assumed (--tone)"
    return None, f"{8 * photograph.values.dtype.itemsize} bits and no tone curve stated: linear assumed (--tone)"
