"""Effect of a change of distortion, or of blur over the field, on one image.

Near a highlight, the lens is approximated by an affine map, which depends on the distortion coefficient k1. The integration
nodes are fixed on the sphere, so their image positions change. Scattered pixels, far from the highlight, are fixed in the
image, so their undistorted positions change. The effect on the outline is part of the prior of the outline.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.camera.lens_field import Coefficient, LensField
from matcam.reconstruction.picture_rule import Window, through_lens

FIELD = ("distortion", "blur growth")
"""Names of the two changes: difference of k1 and of the growth of the blur from the profile, no unit."""
STEP = 1e-4
"""Step of k1 for numerical derivatives."""


class FieldChange(NamedTuple):
    """Effect of a change of the lens field on the pixels of one image.

    The change is that of the distortion coefficient k1 and of the growth of the blur over the field, no unit, (2,).

    Attributes:
        field: field of the lens, without the change.
        highlight: column and row of the highlight, px, without distortion.
        seen: columns and rows of the scattered pixels in the image, px, (2, pixels).
    """

    field: LensField
    highlight: tuple[float, float]
    seen: np.ndarray

    def window(self, window: Window, change: np.ndarray) -> Window:
        return through_lens(window, changed_field(self.field, change), self.highlight)

    def positions(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the undistorted columns and rows of the scattered pixels, px."""
        return changed_field(self.field, change).true_position(*self.seen)

    def positions_slopes(self, change: np.ndarray) -> np.ndarray:
        """Compute the derivatives of `positions` with respect to k1, px, (2, pixels)."""
        ahead, here = (np.array(self.positions(np.array([change[0] + by, change[1]]))) for by in (STEP, 0.0))
        return (ahead - here) / STEP

    def widening(self, change: np.ndarray) -> float:
        """Compute the derivative of ln of the lens width at the highlight with respect to the growth of the blur."""
        return self.field.beyond(*self.highlight) / changed_field(self.field, change).blur_scale(*self.highlight)


def changed_field(field: LensField, change: np.ndarray) -> LensField:
    """Add the changes, (2,), to k1 and to the growth of the blur, and limit both to [-0.3, 0.3]."""
    k1, growth = (
        Coefficient(float(np.clip(one.value + by, -0.3, 0.3)), one.std)
        for one, by in zip((field.k1, field.growth), change, strict=True)
    )
    return replace(field, k1=k1, growth=growth)


def found_field(field: LensField, change: np.ndarray, std: np.ndarray) -> LensField:
    """Build the fitted field from the changes of k1 and of the growth of the blur, (2,), and their standard deviations."""
    found = changed_field(field, change)
    k1, growth = (Coefficient(one.value, float(by)) for one, by in zip((found.k1, found.growth), std, strict=True))
    return replace(found, k1=k1, growth=growth)


def outline_slopes(field: LensField, centre: tuple[float, float], radius: float) -> np.ndarray:
    """Compute the derivatives of column, row and radius of a distorted outline with respect to k1, px, (3,)."""
    turn = 2 * np.pi * np.arange(48) / 48
    out = np.stack([np.cos(turn), np.sin(turn)])
    away = np.array(centre)[:, None] + radius * out - np.array(field.centre)[:, None]
    off = (away * (away**2).sum(0) / field.unit**2 * out).sum(0)
    return np.array([2 * np.mean(off * out[0]), 2 * np.mean(off * out[1]), np.mean(off)])
