"""Detection of common mistakes in a table of lamp directions, by comparison with the highlights.

Axes: x right, y up, z to the camera. Directions point from the sphere's centre to the lamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from matcam.acquisition.highlights import lamp_angles_apart
from matcam.acquisition.mirror_ball import unit
from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark

_WRONG = np.radians(1.5)
"""Rms angle between highlights and table below which no mistake is assumed, rad."""


class TableVerdict(NamedTuple):
    """Agreement of a lamp table with the highlights, and the mistake that explains a disagreement.

    Attributes:
        mistake: "none", "unexplained", or the name of the mistake.
        remarks: remark on a disagreement; empty if the table agrees.
    """

    mistake: str
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

    Each mistake is applied to the directions from the highlights. The result is the mistake that reproduces the table best.

    Args:
        lamps: directions from the highlights (n, 3); NaN for a lamp without a highlight.
        table: directions as given (n, 3); NaN: unknown.

    Returns:
        The mistake, and a remark on it. The mistake is "none" if the table agrees within 1.5 degrees rms, and "unexplained" if
        no common mistake explains the disagreement.

    Raises:
        ArgumentError: the shapes differ or are not (n, 3), or fewer than three lamps have both directions.

    Example:
        >>> turn = np.radians([10, 25, 40, 70])
        >>> lamps = np.stack([0.6 * np.sin(turn), 0.8 * np.sin(turn), np.cos(turn)], axis=1)
        >>> explain_lamp_table(lamps, lamps * [1, -1, 1]).mistake
        'y-flipped'
    """
    lamps, table = np.asarray(lamps, float), np.asarray(table, float)
    if lamps.shape != table.shape or lamps.ndim != 2 or lamps.shape[1] != 3:
        raise ArgumentError(f"lamps and table must have the same shape (n, 3), got {lamps.shape} and {table.shape}")
    good = np.isfinite(lamps).all(1) & np.isfinite(table).all(1)
    if good.sum() < 3:
        raise ArgumentError(
            f"the number of lamps with a highlight and a direction in the table is {good.sum()}; it must be at least 3"
        )
    lamps, table = unit(lamps[good]), unit(table[good])
    rms = _rms(lamps, table)
    if rms < _WRONG:
        return TableVerdict("none", ())
    # residual angles, divided by the factor by which the mistake stretches angles
    left: dict[str, float] = {}
    for name, made, stretch in _mistakes(lamps):
        # the median, because a mistake that stretches errors makes azimuths of lamps near the axis meaningless
        apart = float(np.median(lamp_angles_apart(made, table))) if stretch > 2 else _rms(made, table)
        left[name] = min(apart / stretch, left.get(name, np.inf))
    best = min(left, key=lambda name: left[name])
    # the mistake explains the table if it at least halves the angles
    if left[best] < 0.5 * rms and left[best] < 2 * _WRONG:
        text = f"the lamp table deviates from the highlights by {np.degrees(rms):.1f} degrees rms: {_WORDS[best]}"
        return TableVerdict(best, (Remark(f"table-{best}", text),))
    text = f"the lamp table deviates from the highlights by {np.degrees(rms):.1f} degrees rms: check its directions"
    return TableVerdict("unexplained", (Remark("table-contradicts", text),))


def in_radians(table: np.ndarray) -> tuple[np.ndarray, Remark]:
    """Correct a table whose angles are radians that were read as degrees, and describe this mistake.

    Args:
        table: directions as read, unit vectors (n, 3).

    Returns:
        The corrected directions (n, 3), and the remark if they agree with the highlights.
    """
    angle, azimuth = np.arctan2(np.hypot(table[:, 0], table[:, 1]), table[:, 2]), np.arctan2(table[:, 1], table[:, 0])
    name = "radians-as-degrees"
    remark = Remark(f"table-{name}", f"the lamp table deviates from the highlights: {_WORDS[name]}")
    return _polar(np.degrees(angle), np.degrees(azimuth)), remark


def _rms(lamps: np.ndarray, table: np.ndarray) -> float:
    return float(np.sqrt(np.mean(lamp_angles_apart(lamps, table) ** 2)))


def _mistakes(lamps: np.ndarray) -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield the name of each mistake, the resulting table, and the factor by which the mistake stretches angles."""
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
