"""What a small change of the lens's distortion or of its blur over the field does to one picture's highlight.

About a highlight, a change of k1 moves and magnifies the picture: to first order it is another centre and another radius of
the outline, so that the model of a picture needs no parameters of its own for it. What it does to the outline itself is part of
what is stated of the outline.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.camera.lens_field import Coefficient, LensField
from matcam.reconstruction.picture_model import SCENE

FIELD = ("distortion", "blur growth")
"""Differences of k1 and of the blur's growth from the profile, no unit."""


class FieldChange(NamedTuple):
    """Say what one unit of k1 and of the blur's growth does to a picture.

    Attributes:
        base: changes that the pixels' places already contain, (2,).
        column: by which the outline's centre moves, px, by k1.
        row: likewise, px.
        magnified: by which the logarithm of its radius grows, by k1.
        widened: by which the logarithm of the lens's width grows, by its growth.
        away: by which scattered pixels are seen further to the right and further down, px, by k1, (2, pixels).
    """

    base: np.ndarray
    column: float
    row: float
    magnified: float
    widened: float
    away: np.ndarray

    def moved(self, column: np.ndarray, row: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the undistorted places of scattered pixels, px, under changes of the field, (2,)."""
        k1 = change[0] - self.base[0]
        return column - k1 * self.away[0], row - k1 * self.away[1]

    def applied(self, at: np.ndarray, change: np.ndarray, lobe: int) -> np.ndarray:
        """Return a picture's parameters, (parameters,), under changes of the field, (2,). lobe: number of the lobe's."""
        k1, growth = change - self.base
        there = at.copy()
        there[lobe + SCENE.index("lens")] += self.widened * growth
        there[lobe + SCENE.index("radius")] *= 1 + self.magnified * k1
        there[lobe + len(SCENE)] += self.column * k1
        there[lobe + len(SCENE) + 1] += self.row * k1
        return there

    def slopes(self, at: np.ndarray, lobe: int) -> np.ndarray:
        """Return the derivatives of a picture's parameters by both changes, (parameters, 2)."""
        slopes = np.zeros((at.size, len(FIELD)))
        slopes[lobe + SCENE.index("lens"), 1] = self.widened
        slopes[lobe + SCENE.index("radius"), 0] = self.magnified * at[lobe + SCENE.index("radius")]
        slopes[lobe + len(SCENE) : lobe + len(SCENE) + 2, 0] = self.column, self.row
        return slopes


def field_change(
    field: LensField,
    base: np.ndarray,
    centre: tuple[float, float],
    highlight: tuple[float, float],
    scattered: tuple[np.ndarray, np.ndarray],
) -> FieldChange:
    """Return what changes of a field do about a highlight.

    Args:
        field: of the lens.
        base: changes that it already contains, (2,).
        centre: column and row of the outline's centre, px.
        highlight: its column and row, px.
        scattered: columns and rows of pixels elsewhere, px; all without distortion.
    """
    away = np.array(highlight) - field.centre
    rho2 = float(away @ away) / field.unit**2
    magnified = 2 * rho2  # mean of 1 and 3 rho^2, across and along the radius
    column, row = away * rho2 - magnified * (np.array(highlight) - centre)
    widened = field.beyond(*highlight) / field.blur_scale(*highlight)
    there = np.array(scattered) - np.array(field.centre)[:, None]
    bent = there * (there**2).sum(0) / field.unit**2
    return FieldChange(base.copy(), float(column), float(row), magnified, widened, np.where(abs(bent) < 1e3, bent, 0.0))


def changed_field(field: LensField, change: np.ndarray) -> LensField:
    """Return a field whose k1 and growth have changed, as far as a field can."""
    k1, growth = (
        Coefficient(float(np.clip(one.value + by, -0.3, 0.3)), one.std)
        for one, by in zip((field.k1, field.growth), change, strict=True)
    )
    return replace(field, k1=k1, growth=growth)


def outline_slopes(field: LensField, centre: tuple[float, float], radius: float) -> tuple[float, float, float]:
    """Return how column, row and radius of an outline grow with k1 where it is measured in the distorted picture, px."""
    turn = 2 * np.pi * np.arange(48) / 48
    out = np.stack([np.cos(turn), np.sin(turn)])
    away = np.array(centre)[:, None] + radius * out - np.array(field.centre)[:, None]
    off = (away * (away**2).sum(0) / field.unit**2 * out).sum(0)
    return float(2 * np.mean(off * out[0])), float(2 * np.mean(off * out[1])), float(np.mean(off))
