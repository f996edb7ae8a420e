"""Columns and nodes of a profile across a cylinder: a window about the highlight of each strip, and other columns.

Positions on the outline are p = (column - axis) / radius = sin u. All functions are smooth in u up to the limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.mirror_ball import MirrorBall, cylinder_line, unit
from matcam.reconstruction.cylinder.strips import Strip, StripProfiles
from matcam.reconstruction.observed_pixels import LIMB, LIT, OUTSIDE, ObservedPixels
from matcam.reconstruction.picture_rule import MARGIN, WINDOW, graded_nodes

_ROW_COUNTS = 4, 8, 16, 32, 64, 128
"""Numbers of rows of a strip. There are few, because a program is compiled for each."""


class ProfileWindow(NamedTuple):
    """Nodes and columns about the highlight of each strip.

    Attributes:
        u: nodes, rad, (strips, nodes).
        weight: weights of the nodes for integration over p = sin u, (strips, nodes).
        column: columns that are read, px, (strips, WINDOW).
        row: mean row of the pixels that are read in each column, px, (channels, strips, WINDOW).
    """

    u: np.ndarray
    weight: np.ndarray
    column: np.ndarray
    row: np.ndarray


class RowRule(NamedTuple):
    """Quadrature rule for the mean over the rows of each strip.

    Attributes:
        rows: rows, px, (strips, rule).
        weight: weights of the rows, no unit, (rule,); their sum is 1.
        slope: weights for the derivative of the mean with respect to the position of the strip, 1/px, (strips, rule).
    """

    rows: np.ndarray
    weight: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, strips: Sequence[Strip], count: int) -> RowRule:
        """Compute a Gauss-Legendre rule with `count` rows."""
        nodes, weight = np.polynomial.legendre.leggauss(count)
        first, last = np.array([strip.read for strip in strips]).T
        half = (last - first + 1)[:, None] / 2
        # the mean changes by the difference of the values at both ends, divided by the length
        difference = 1.0 - (-1.0) ** np.arange(count)
        of_ends = np.linalg.solve(np.polynomial.legendre.legvander(nodes, count - 1).T, difference)
        return cls((first + last)[:, None] / 2 + half * nodes, weight / 2, of_ends / (2 * half))


def row_count(
    strips: Sequence[Strip], ball: MirrorBall, lamp: np.ndarray, lamp_distance: float, alphas: tuple[float, float]
) -> int:
    """Choose the number of rows of the strips at which the model of an image is evaluated.

    The arguments are those of `chosen_columns`.
    """
    camera, source = 1 / ball.distance, 1 / lamp_distance
    tilts = []
    for strip in strips:
        sin = _brightest(strip, ball, lamp, lamp_distance, alphas)
        depth = np.sqrt(max(1 - sin**2, 0.0))
        points = [np.array([sin, _height(ball, row, depth), depth]) for row in strip.read]
        first, last = (unit(unit(np.array([0, 0, 1]) - camera * at) + unit(lamp - source * at)) for at in points)
        tilts.append(np.arccos(np.clip(first @ last, -1, 1)) / 2)
    # along a strip, the lobe has poles where the slope is an imaginary number of the size of the roughness; the error of a
    # Gauss-Legendre rule is a power of the size of the ellipse through the poles
    ratio = min(alphas) / max(*tilts, 1e-6)
    # relative error of the mean over the rows of a strip
    needed = np.log(1 / 1e-5) / (2 * np.arcsinh(ratio))
    return next((count for count in _ROW_COUNTS if count >= needed), _ROW_COUNTS[-1])


def _height(ball: MirrorBall, row: float, depth: float) -> float:
    """Compute the height of a point above the centre, radii. depth: depth of the point, radii."""
    camera = 1 / ball.distance
    return (ball.row - row) / (ball.radius * np.sqrt(1 - camera**2)) * (1 - camera * depth)


def _brightest(
    strip: Strip, ball: MirrorBall, lamp: np.ndarray, lamp_distance: float, alphas: tuple[float, float]
) -> float:
    """Find the position p in (-1, 1) at which the lobe of a strip has its largest density."""
    cos, sin = np.cos(strip.turn), np.sin(strip.turn)
    along, across = 1 / alphas[0] ** 2, 1 / alphas[1] ** 2
    lean = -sin * cos * (along - across) / (cos**2 * along + sin**2 * across)
    middle = (strip.first + strip.last) / 2
    return cylinder_line(lamp, ball.distance, lamp_distance, lambda depth: _height(ball, middle, depth), lean)


def chosen_columns(
    profiles: StripProfiles,
    strips: Sequence[Strip],
    ball: MirrorBall,
    lamp: np.ndarray,
    lamp_distance: float,
    alphas: tuple[float, float],
    *,
    plateau: float = 0.0,
    keep: ObservedPixels | None = None,
) -> ObservedPixels:
    """Choose the columns of an image for the fit. Each column is treated as a pixel.

    Args:
        profiles: profiles of all strips and colours.
        strips: strips in the order of the profiles.
        ball: column of the axis, row to which the directions of camera and lamp refer, and half the width of the outline,
            px; distance of the camera, radii.
        lamp: direction to the lamp, (3,).
        lamp_distance: distance of the lamp, radii.
        alphas: roughness along the x axis of the material and across it, slopes, no unit.
        plateau: half the angular radius of the lamp, rad. Default: 0.
        keep: earlier choice, whose columns are kept if the highlight has moved by at most one column. Default: None.

    Returns:
        Columns of the windows, ordered by colour, strip and position, followed by the other columns. The field `row` is
        the mean row of the pixels of a column.
    """
    windows = [
        _window(
            strip,
            ball,
            _brightest(strip, ball, lamp, lamp_distance, alphas),
            alphas,
            plateau,
            None if keep is None else keep.window.column[s],
        )
        for s, strip in enumerate(strips)
    ]
    u, weight, columns = map(np.stack, zip(*windows, strict=True))
    count, rows, width = profiles.values.shape
    at = columns - profiles.column[0]
    inside = (at >= 0) & (at < width)
    near = np.where(inside, at, 0).astype(int)
    strip_index = np.arange(rows)[:, None]
    window = ProfileWindow(u, weight, columns, profiles.row[:, strip_index, near])
    outside = np.abs(window.column - ball.column) > ball.radius + OUTSIDE

    def of_window(array: np.ndarray) -> np.ndarray:
        return array[:, strip_index, near].reshape(-1)

    used = of_window(profiles.used) & np.tile((inside & ~outside).ravel(), count)
    # the other columns: in a mosaic, the pixels of one colour are in every second column
    anywhere: np.ndarray = np.any(profiles.used, axis=1, keepdims=True)
    candidates = np.flatnonzero(np.broadcast_to(anywhere, profiles.used.shape))
    # at most 2048 columns outside the windows
    step = int(np.ceil(candidates.size / 2048))
    candidates = candidates[::step]
    channel, strip_of, column = np.unravel_index(candidates, profiles.values.shape)
    p = (profiles.column[column] - ball.column) / ball.radius
    depth = np.sqrt(np.maximum(1 - p**2, 0.0))
    apart = np.abs(profiles.column[column] - window.column[strip_of, WINDOW // 2]) > WINDOW // 2
    far = apart & (np.abs(p) < 1 - LIMB / ball.radius)
    far &= p * lamp[0] + depth * lamp[2] > LIT
    far &= profiles.used.ravel()[candidates]

    def both(array: np.ndarray, empty: float) -> np.ndarray:
        values = np.concatenate([of_window(array), array.ravel()[candidates]])
        return np.where(everything, values, empty)

    everything = np.concatenate([used, far])
    row = profiles.row.ravel()[candidates]
    all_columns = np.concatenate([np.tile(window.column.ravel(), count), profiles.column[column]])
    return ObservedPixels(
        window=window,
        column=profiles.column[column],
        row=row,
        positions=np.stack([all_columns, np.concatenate([window.row.ravel(), row])]),
        values=both(profiles.values, 0.0),
        std=both(profiles.std, 1.0),
        clipped=both(profiles.clipped, False).astype(bool),
        channel=np.concatenate([np.repeat(np.arange(count), rows * WINDOW), channel]),
        used=everything,
    )


def _window(
    strip: Strip, ball: MirrorBall, peak: float, alphas: tuple[float, float], plateau: float, keep: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    column = np.round(ball.column + ball.radius * peak)
    if keep is not None and abs(keep[WINDOW // 2] - column) <= 1:
        column = keep[WINDOW // 2]
    columns = column + np.arange(WINDOW) - WINDOW // 2
    # the nodes cover the columns and their kernels
    low, high = (
        np.arcsin(np.clip((end - ball.column) / ball.radius, -1, 1))
        for end in (columns[0] - 1 - MARGIN, columns[-1] + 1 + MARGIN)
    )
    across = np.hypot(np.cos(strip.turn) / alphas[0], np.sin(strip.turn) / alphas[1])
    u, weight = graded_nodes(low, high, np.arcsin(peak), 1 / across / 3, plateau, ball.radius, 224)
    return u, weight * np.cos(u), columns
