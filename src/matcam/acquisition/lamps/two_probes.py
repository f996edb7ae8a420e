"""Comparison of the lamp directions from two mirror balls. The directions differ if a lamp is at a finite distance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.acquisition.mirror_ball import unit
from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark

_EXPLAINED = np.radians(0.3)
"""Rms angle below which two probes agree, rad."""


class ProbeComparison(NamedTuple):
    """Comparison of two probes, with possible causes of their differences.

    Attributes:
        apart: angle between both probes' directions of each lamp, rad (n,).
        rms: rms of `apart`, rad.
        displacement: displacement of the second probe from the first, divided by the distance of the lamps, no unit
            (3,): x right, y up, z to the camera.
        left: rms of the residual angles with one distance for all lamps, rad.
        left_by_turn: rms of the residual angles with a rotation of the axes of one probe instead, rad.
        remarks: cause of a disagreement.
    """

    apart: np.ndarray
    rms: float
    displacement: np.ndarray
    left: float
    left_by_turn: float
    remarks: tuple[Remark, ...]


def compare_probes(first: np.ndarray, second: np.ndarray) -> ProbeComparison:
    """Compare the directions of the same lamps from two mirror balls.

    If a probe is displaced by d, the direction l of a lamp at distance Q changes by -(d - (d l) l) / Q. If all lamps
    have the same distance, there are three unknowns, d / Q. The other common cause, a rotation of the axes of one
    probe, also has three unknowns.

    Args:
        first: directions from one probe (n, 3).
        second: directions from the other probe (n, 3).

    Returns:
        The angles as given, and after the correction of each possible cause.

    Raises:
        ArgumentError: the shapes differ, or there are fewer than four lamps.
    """
    first, second = np.asarray(first, float), np.asarray(second, float)
    if first.shape != second.shape or first.ndim != 2 or first.shape[1] != 3 or len(first) < 4:
        raise ArgumentError(
            f"first and second must be directions of the same lamps, (n, 3), n >= 4, got {first.shape} and {second.shape}"
        )
    first, second = unit(first), unit(second)
    middle, moved = unit(first + second), second - first
    apart = 2 * np.arcsin(np.linalg.norm(moved, axis=1) / 2)
    aside = middle[:, :, None] * middle[:, None, :] - np.eye(3)
    turned = np.cross(np.eye(3)[None], middle[:, None, :]).transpose(0, 2, 1)
    displacement, left = _explained(aside, moved)
    _, left_by_turn = _explained(turned, moved)
    rms = float(np.sqrt(np.mean(apart**2)))
    size = float(np.linalg.norm(displacement))
    begin = f"the probes disagree by {np.degrees(rms):.2f} degrees rms"
    if rms < _EXPLAINED:
        remarks: tuple[Remark, ...] = ()
    elif left < _EXPLAINED and left < 0.5 * rms:
        text = (
            f"{begin}: specify the distance of the lamps; a distance of {1 / size:.0f} times that between the probes "
            "explains the disagreement"
        )
        remarks = (Remark("probes-near-lamps", text),)
    else:
        text = (
            f"{begin}: check the directions, because neither a finite distance of all lamps (residual "
            f"{np.degrees(left):.2f} degrees) nor a rotation of the axes ({np.degrees(left_by_turn):.2f} degrees) explains it"
        )
        remarks = (Remark("probes-disagree", text),)
    return ProbeComparison(apart, rms, displacement, left, left_by_turn, remarks)


def _explained(slopes: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, float]:
    """Solve for the three unknowns, and return the rms residual of the displacements (n, 3)."""
    found, *_ = np.linalg.lstsq(slopes.reshape(-1, 3), moved.ravel(), rcond=None)
    return found, float(np.sqrt(np.mean(np.sum((moved - slopes @ found) ** 2, axis=1))))
