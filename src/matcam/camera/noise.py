"""Noise of a pixel, as a reflectance measurement states it."""

from __future__ import annotations

from typing import NamedTuple

from matcam.errors import ArgumentError


class PixelNoise(NamedTuple):
    """Standard deviation of a pixel: relative * its value, and floor * the brightest value of its picture, in quadrature.
    gain: relative standard deviation of a picture's exposure, common to all its pixels.

    Noise belongs to pixels: table cells that were read from one pixel share it.
    """

    relative: float = 0.01
    floor: float = 1e-4
    gain: float = 0.0

    def checked(self) -> PixelNoise:
        """Itself; ArgumentError if a number is negative, not finite, or both are 0."""
        for name, value in self._asdict().items():
            if not 0 <= value < 1:
                raise ArgumentError(f"noise.{name} must lie in [0, 1), got {value!r}")
        if self.relative == self.floor == 0:
            raise ArgumentError("noise must not be zero altogether: no measurement is")
        return self
