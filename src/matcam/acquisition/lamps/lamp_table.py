"""Comparison of highlights with a table of lamps: radius, arc, common mistakes.

Axes: x right, y up, z to the camera. Directions point from the sphere's centre to the lamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from matcam.acquisition.highlights import lamp_angles_apart
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark

_LIKELY = 0.5
"""Largest ratio of the residual to the original angles at which a mistake is taken to explain a table."""
_WRONG = np.radians(1.5)
"""Rms angle between highlights and table below which no mistake is assumed, rad."""


class RadiusByHighlights(NamedTuple):
    """Radius from the highlights of known lamps, compared with that of the outline.

    Attributes:
        row: row of the centre of the sphere from the highlights, px.
        column: column of that centre, px.
        radius: radius from the highlights if lamps and camera are distant, px.
        std: standard deviations of row, column and radius, px (3,).
        rms: rms distance of the highlights from their expected positions, px.
        mismatch: ratio of the radius to that of the outline, minus 1.
        mismatch_std: standard deviation of `mismatch`, including that of the outline.
        inverse_distances: 1 / camera distance + 1 / lamp distance that would explain the mismatch, 1/radii.
        inverse_distances_std: standard deviation of `inverse_distances`, 1/radii.
        turn: rotation of the axes of the table relative to the camera that would explain the centre, rad (3,), about x,
            y, z.
        remarks: warnings and limitations.
    """

    row: float
    column: float
    radius: float
    std: np.ndarray
    rms: float
    mismatch: float
    mismatch_std: float
    inverse_distances: float
    inverse_distances_std: float
    turn: np.ndarray
    remarks: tuple[Remark, ...]


def radius_by_highlights(
    rows: np.ndarray, columns: np.ndarray, lamps: np.ndarray, ball: MirrorBall, ball_std: np.ndarray | None = None
) -> RadiusByHighlights:
    """Compare the radius from the highlights of known lamps with that of the outline.

    A near camera and near lamps move the highlights outwards, by (1 / camera distance + 1 / lamp distance) / 2 of their
    distance from the centre. Highlights alone do not distinguish this from a larger sphere, which the outline excludes,
    or from directions that are too narrow.

    Args:
        rows: rows of the mirror points of the highlights, px (n,).
        columns: columns of the mirror points, px (n,).
        lamps: known directions (n, 3).
        ball: the sphere from its outline.
        ball_std: standard deviations of row, column and radius of `ball`, px (3,). Default: 0.

    Returns:
        The radius, and possible causes of a difference.

    Raises:
        FitError: there are fewer than four highlights.
    """
    rows, columns, lamps = np.asarray(rows, float), np.asarray(columns, float), unit(np.asarray(lamps, float))
    if len(rows) < 4:
        raise FitError(f"{len(rows)} highlights do not determine a radius; at least 4 are needed")

    def off(p: np.ndarray) -> np.ndarray:
        row, column = MirrorBall(*p).mirror_position(lamps)
        return np.nan_to_num(np.concatenate([row - rows, column - columns]), nan=1e3)

    found = least_squares(off, [ball.row, ball.column, ball.radius], loss="soft_l1", x_scale="jac")
    residual = off(found.x)
    variance = float(np.sum(residual**2)) / (2 * len(rows) - 3)
    std = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * variance)
    by_outline = np.zeros(3) if ball_std is None else np.asarray(ball_std, float)
    ratio = float(found.x[2] / ball.radius)
    ratio_std = float(ratio * np.hypot(std[2] / found.x[2], by_outline[2] / ball.radius))
    inverse, inverse_std = 2 * (ratio - 1), 2 * ratio_std
    # rotation of the table's axes relative to the camera, after the correction of the radius
    near = MirrorBall(ball.row, ball.column, ball.radius * ratio)
    seen = near.lamp_seen_at(near.normals(rows, columns))
    good = np.isfinite(seen).all(1)
    turn = Rotation.align_vectors(lamps[good], seen[good])[0].as_rotvec()
    remarks = []
    if abs(ratio - 1) > 2 * ratio_std:
        cause = (
            f"check the distances D of camera and Q of lamp in radii (1/D + 1/Q = 1/{1 / inverse:.0f} explains it), or whether "
            f"the directions are {ratio - 1:.1%} too narrow"
            if inverse > 0
            else f"check whether the directions are {1 - ratio:.1%} too wide, or the outline is too large"
        )
        remarks.append(
            Remark(
                "radius-mismatch",
                f"the highlights indicate a radius of {found.x[2]:.2f} px, but the outline has {ball.radius:.2f} px: {cause}",
            )
        )
    size = float(np.linalg.norm(turn))
    if size > np.radians(0.2) and np.hypot(*(found.x[:2] - [ball.row, ball.column])) > 3 * np.hypot(*std[:2]):
        remarks.append(
            Remark(
                "table-turned",
                f"the axes of the lamp table are rotated by {np.degrees(size):.2f} degrees relative to the camera: check them",
            )
        )
    row, column, radius = map(float, found.x)
    return RadiusByHighlights(
        row,
        column,
        radius,
        std,
        float(np.sqrt(np.sum(residual**2) / len(rows))),
        ratio - 1,
        ratio_std,
        inverse,
        inverse_std,
        turn,
        tuple(remarks),
    )


class LampArc(NamedTuple):
    """Lamps on an arc: directions at equal angles from an axis.

    Attributes:
        axis: unit vector about which the arm turns (3,).
        opening: angle between axis and lamps, rad; pi/2 if the arm turns in a plane through the sphere's centre.
        angles: angle of each lamp about the axis, rad (n,), from the first lamp.
        directions: directions of the lamps on the arc, unit vectors (n, 3).
        rms: rms angle between given directions and the arc, rad.
        axis_std: standard deviations of the axis in two directions, and of the opening, rad (3,).
    """

    axis: np.ndarray
    opening: float
    angles: np.ndarray
    directions: np.ndarray
    rms: float
    axis_std: np.ndarray


def fit_arc(lamps: np.ndarray, *, std: float = np.radians(0.2), opening_std: float = np.radians(3.0)) -> LampArc:
    """Fit an arc to the directions of lamps.

    Args:
        lamps: directions (n, 3).
        std: standard deviation of a direction, rad. Default: 0.2 degrees.
        opening_std: prior standard deviation of the distance from a great circle, rad. Default: 3 degrees.

    Returns:
        The arc, with every lamp projected onto it.

    Raises:
        FitError: there are fewer than three lamps, or they are not on an arc.

    Example:
        >>> turn = np.radians([5, 20, 40, 60, 80])
        >>> arc = fit_arc(np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1))
        >>> np.degrees(arc.angles).round(3) + 0.0, round(float(np.degrees(arc.opening)), 3)
        (array([ 0., 15., 35., 55., 75.]), 90.0)
    """
    lamps = unit(np.asarray(lamps, float))
    if len(lamps) < 3:
        raise FitError(f"{len(lamps)} lamps do not determine an arc; at least 3 are needed")
    start = np.linalg.svd(lamps)[2][2]
    if np.dot(np.cross(lamps[0], lamps[-1]), start) < 0:
        start = -start
    frame = np.linalg.svd(start[None])[2][1:]

    def axis(p: np.ndarray) -> np.ndarray:
        return unit(start + p[0] * frame[0] + p[1] * frame[1])

    def off(p: np.ndarray) -> np.ndarray:
        beside = np.arccos(np.clip(lamps @ axis(p), -1, 1)) - np.pi / 2 - p[2]
        return np.append(beside / std, p[2] / opening_std)

    found = least_squares(off, np.zeros(3))
    about, opening = axis(found.x), np.pi / 2 + float(found.x[2])
    first = unit(lamps[0] - (lamps[0] @ about) * about)
    second = np.cross(about, first)
    angles = np.arctan2(lamps @ second, lamps @ first)
    on = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    on = np.cos(opening) * about + np.sin(opening) * on
    rms = float(np.sqrt(np.mean(lamp_angles_apart(on, lamps) ** 2)))
    if rms > max(5 * std, np.radians(2.0)):
        raise FitError(f"the lamps deviate from one arc by {np.degrees(rms):.1f} degrees rms: specify motion = 'free'")
    freedom = max(len(lamps) - 2, 1)
    spread = np.linalg.inv(found.jac.T @ found.jac) * max(1.0, 2 * found.cost / freedom)
    return LampArc(about, opening, angles, on, rms, np.sqrt(np.diag(spread)))


class TableVerdict(NamedTuple):
    """Agreement of a lamp table with the highlights, and the mistake that explains a disagreement.

    Attributes:
        mistake: "none", "unexplained", or the name of the mistake.
        rms: rms angle between the lamps from the highlights and the table as given, rad.
        rms_explained: `rms` after correction of the mistake, rad.
        remarks: description of a disagreement.
    """

    mistake: str
    rms: float
    rms_explained: float
    remarks: tuple[Remark, ...]


_WORDS = {
    "y-flipped": "its y axis points down; y must point up",
    "x-flipped": "its x axis points left; x must point right",
    "z-flipped": "its z axis points away from the camera; z must point to it",
    "xy-swapped": "its x and y are exchanged; x must point right, y up",
    "xy-flipped": "its x and y axes point left and down; x must point right, y up, unless the image is rotated by 180 degrees",
    "light-reversed": "its vectors point from the lamp to the sample; they must point to the lamp",
    "normals": "its vectors are the normals at the highlights; they must point to the lamps",
    "halved": "its vectors have twice the angle, because they were reflected twice; reflect them once",
    "degrees-as-radians": "its angles are degrees that were read as radians; correct the unit",
    "radians-as-degrees": "its angles are radians that were read as degrees; correct the unit",
    "order-reversed": "its rows are in the reverse order of the images; reverse them",
}


def explain_lamp_table(lamps: np.ndarray, table: np.ndarray) -> TableVerdict:
    """Find the common mistake that explains a wrong lamp table.

    Each mistake is applied to the lamps from the highlights. The result contains the mistake after which they match the
    table.

    Args:
        lamps: directions from the highlights (n, 3); NaN for a lamp without a highlight.
        table: directions as given (n, 3).

    Returns:
        The mistake, and the rms angles before and after its correction. The mistake is "none" if the table agrees within
        1.5 degrees rms, and "unexplained" if no common mistake explains the disagreement.

    Raises:
        ArgumentError: the shapes differ, or fewer than three lamps have a highlight.

    Example:
        >>> turn = np.radians([10, 25, 40, 70])
        >>> lamps = np.stack([0.6 * np.sin(turn), 0.8 * np.sin(turn), np.cos(turn)], axis=1)
        >>> explain_lamp_table(lamps, lamps * [1, -1, 1]).mistake
        'y-flipped'
    """
    lamps, table = np.asarray(lamps, float), np.asarray(table, float)
    if lamps.shape != table.shape or lamps.ndim != 2 or lamps.shape[1] != 3:
        raise ArgumentError(f"lamps and table must both have shape (n, 3), got {lamps.shape} and {table.shape}")
    good = np.isfinite(lamps).all(1) & np.isfinite(table).all(1)
    if good.sum() < 3:
        raise ArgumentError(f"only {good.sum()} lamps have a highlight and a row in the table; at least 3 are needed")
    lamps, table = unit(lamps[good]), unit(table[good])
    rms = _rms(lamps, table)
    if rms < _WRONG:
        return TableVerdict("none", rms, rms, ())
    # residual angles, divided by the factor by which the mistake stretches angles
    left: dict[str, float] = {}
    for name, made, stretch in _mistakes(lamps):
        # the median, because a mistake that stretches errors makes azimuths of lamps near the axis meaningless
        apart = float(np.median(lamp_angles_apart(made, table))) if stretch > 2 else _rms(made, table)
        left[name] = min(apart / stretch, left.get(name, np.inf))
    best = min(left, key=lambda name: left[name])
    if left[best] < _LIKELY * rms and left[best] < 2 * _WRONG:
        text = f"the lamp table deviates from the highlights by {np.degrees(rms):.1f} degrees rms: {_WORDS[best]}"
        return TableVerdict(best, rms, left[best], (Remark(f"table-{best}", text),))
    text = f"the lamp table deviates from the highlights by {np.degrees(rms):.1f} degrees rms: check its directions"
    return TableVerdict("unexplained", rms, rms, (Remark("table-contradicts", text),))


def _rms(lamps: np.ndarray, table: np.ndarray) -> float:
    return float(np.sqrt(np.mean(lamp_angles_apart(lamps, table) ** 2)))


def _mistakes(lamps: np.ndarray) -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield each mistake, the table that it would produce, and the factor by which it stretches angles."""
    z = np.array([0.0, 0.0, 1.0])
    yield "y-flipped", lamps * [1, -1, 1], 1.0
    yield "x-flipped", lamps * [-1, 1, 1], 1.0
    yield "z-flipped", lamps * [1, 1, -1], 1.0
    yield "xy-swapped", lamps[:, [1, 0, 2]], 1.0
    yield "xy-flipped", lamps * [-1, -1, 1], 1.0
    yield "light-reversed", -lamps, 1.0
    yield "normals", unit(lamps + z), 0.5
    yield "halved", 2 * lamps[:, 2:] * lamps - z, 2.0
    yield "order-reversed", lamps[::-1], 1.0
    angle, azimuth = np.arctan2(np.hypot(lamps[:, 0], lamps[:, 1]), lamps[:, 2]), np.arctan2(lamps[:, 1], lamps[:, 0])
    turn = 180 / np.pi
    for way_round in (azimuth, np.mod(azimuth, 2 * np.pi)):  # azimuths from -180 to 180, or from 0 to 360
        yield "degrees-as-radians", _polar(angle * turn, way_round * turn), turn / 4
        yield "radians-as-degrees", _polar(angle / turn, way_round / turn), 1 / turn


def _polar(angle: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
