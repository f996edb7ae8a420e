"""What a change of the lens's distortion, or of its blur over the field, does to one picture.

About a highlight the lens is an affine map, which changes with k1: nodes stay where they are on the sphere, and are seen
elsewhere. Scattered pixels are read at other undistorted places. What a change does to the outline itself is part of what is
stated of the outline.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.camera.lens_field import Coefficient, LensField
from matcam.reconstruction.picture_rule import Window, through_lens

FIELD = ("distortion", "blur growth")
"""Differences of k1 and of the blur's growth from the profile, no unit."""
STEP = 1e-4
"""Of k1, by which derivatives are taken."""


class FieldChange(NamedTuple):
    """Apply changes of k1 and of the blur's growth, (2,), to the pixels of one picture.

    Attributes:
        field: of the lens, without changes.
        highlight: its column and row, px, without distortion.
        seen: columns and rows at which scattered pixels are seen, px, (2, pixels).
    """

    field: LensField
    highlight: tuple[float, float]
    seen: np.ndarray

    def window(self, window: Window, change: np.ndarray) -> Window:
        """Return a window's nodes as they are seen after the changes."""
        return through_lens(window, changed_field(self.field, change), self.highlight)

    def places(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the undistorted columns and rows of the scattered pixels, px."""
        return changed_field(self.field, change).true_place(*self.seen)

    def places_slopes(self, change: np.ndarray) -> np.ndarray:
        """Return the derivatives of `places` by k1, (2, pixels)."""
        ahead, here = (np.array(self.places(np.array([change[0] + by, change[1]]))) for by in (STEP, 0.0))
        return (ahead - here) / STEP

    def widening(self, change: np.ndarray) -> float:
        """Return the derivative of ln of the lens's width at the highlight by the growth."""
        return self.field.beyond(*self.highlight) / changed_field(self.field, change).blur_scale(*self.highlight)


def changed_field(field: LensField, change: np.ndarray) -> LensField:
    """Return a field whose k1 and growth have changed, as far as a field can."""
    k1, growth = (
        Coefficient(float(np.clip(one.value + by, -0.3, 0.3)), one.std)
        for one, by in zip((field.k1, field.growth), change, strict=True)
    )
    return replace(field, k1=k1, growth=growth)


def found_field(field: LensField, change: np.ndarray, std: np.ndarray) -> LensField:
    """Return a field with the changes that were found, (2,), and their standard deviations, (2,)."""
    found = changed_field(field, change)
    k1, growth = (Coefficient(one.value, float(by)) for one, by in zip((found.k1, found.growth), std, strict=True))
    return replace(found, k1=k1, growth=growth)


def outline_slopes(field: LensField, centre: tuple[float, float], radius: float) -> tuple[float, float, float]:
    """Return how column, row and radius of an outline grow with k1 where it is measured in the distorted picture, px."""
    turn = 2 * np.pi * np.arange(48) / 48
    out = np.stack([np.cos(turn), np.sin(turn)])
    away = np.array(centre)[:, None] + radius * out - np.array(field.centre)[:, None]
    off = (away * (away**2).sum(0) / field.unit**2 * out).sum(0)
    return float(2 * np.mean(off * out[0])), float(2 * np.mean(off * out[1])), float(np.mean(off))
