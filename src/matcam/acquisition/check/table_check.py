"""Comparison of the lamp table with the highlights, which detects a rotated table, a wrong radius and single wrong lamps.

The unknowns are a rotation of the axes of the table relative to the camera, and the outline of the sample in the frame.
If an outline was measured, its centre and radius are known and the rotation is free. Without an outline, a rotation
about an axis in the image plane is indistinguishable from a shift of the sphere. In this case only the rotation about
the optical axis is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from matcam.acquisition.check.quick_highlights import Seen
from matcam.acquisition.check.quick_outline import QuickOutline
from matcam.acquisition.check.unmeasured_lens import GUESSED_NEARNESS
from matcam.acquisition.lamps.lamp_table import explain_lamp_table, in_radians
from matcam.acquisition.mirror_ball import MirrorBall, cylinder_line
from matcam.acquisition.mosaic_frames import frame_size
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Stated
from matcam.numerics.normal import robust_std

_FEWEST = 4
"""Smallest number of highlights with a specified direction for a comparison: three angles are unknown, and one lamp may
be wrong.
"""
_OFF = 4.0
"""Distance of a single highlight from its expected position, px, below which it is not reported.

Centroids have errors of 1 to 2 px.
"""
_SIGNIFICANT = 4.0
"""Number of standard deviations above which a rotation or a radius is reported: one false alarm in 16,000 captures."""


class TableCheck(NamedTuple):
    """Result of the comparison of a lamp table with the highlights.

    Attributes:
        centre: column, row and radius of the sample from highlights, table and outline, px; NaN if they were not fitted,
            or if the table is wrong.
        turn: rotation vector from the table to the highlights, about x (right), y (up) and z (to the camera), rad (3,);
            0 for an axis about which no rotation was fitted.
        turn_std: standard deviations of `turn`, rad (3,); NaN for an axis about which no rotation was fitted.
        remarks: contradictions between table, highlights and outline.
    """

    centre: tuple[float, float, float]
    turn: np.ndarray
    turn_std: np.ndarray
    remarks: tuple[Remark, ...]


_NOTHING = TableCheck((math.nan,) * 3, np.zeros(3), np.full(3, math.nan), ())


class _Fit(NamedTuple):
    p: np.ndarray
    covariance: np.ndarray
    off: np.ndarray
    """Distance of each highlight from its expected position, px (n,)."""


def _distances(capture: Capture) -> tuple[float, float, float]:
    """Compute the distances of camera and lamp from the centre of the sample, radii, and the error that they cause.

    The error is the relative standard deviation of a radius from highlights.
    """

    def known(value: Stated | None) -> Stated:
        return GUESSED_NEARNESS if value is None else Stated(1 / value.value, value.std / value.value**2)

    (camera, camera_std), (lamp, lamp_std) = known(capture.camera_radii), known(capture.lamp_radii)
    return 1 / camera, 1 / lamp, math.hypot(camera_std, lamp_std) / 2


def check_table(capture: Capture, seen: dict[str, Seen], outline: QuickOutline | None) -> TableCheck:
    """Compare the lamp table of a sphere or a cylinder with the highlights.

    At least four highlights with a specified direction are required, and for a cylinder an outline. Otherwise, the
    result contains no centre (NaN), no rotation and no remarks.

    Args:
        capture: the capture with the directions.
        seen: highlights by lamp position.
        outline: outline of the sample in the frame; None: not measured.
    """
    names = [name for name in seen if np.isfinite(capture.lamps[name].direction).all()]
    if len(names) < _FEWEST:
        return _NOTHING
    directions = np.array([capture.lamps[name].direction for name in names])
    highlights = [seen[name] for name in names]
    if capture.settings["sample"]["kind"] == "cylinder":
        return _NOTHING if outline is None else _of_cylinder(capture, names, directions, highlights, outline)
    found = _of_sphere(capture, names, directions, highlights, outline)
    size = frame_size(capture) if outline is None else None
    if size is not None and found.centre[2] > math.hypot(*size):
        # the circle surrounds the frame, so the camera would see no limb
        text = f"the highlights and the lamp table indicate a radius of {found.centre[2]:.0f} px, larger than the frame: check "
        return _NOTHING._replace(
            remarks=(Remark("table-contradicts", f"{text}angle_deg and azimuth_deg in frames.csv"),)
        )
    return found


def _of_sphere(
    capture: Capture, names: list[str], directions: np.ndarray, seen: list[Seen], outline: QuickOutline | None
) -> TableCheck:
    camera, lamp, growth_std = _distances(capture)
    positions = np.array([[one.column, one.row] for one in seen])

    def expected(p: np.ndarray, flip: float = 1.0) -> np.ndarray:
        ball = MirrorBall(p[4], p[3], abs(p[5]), camera)
        turned = Rotation.from_rotvec(p[:3]).apply(directions * [1.0, flip, 1.0])
        row, column = ball.mirror_position(turned, lamp)
        return np.column_stack([column, row])

    middle = np.median(positions, axis=0)
    if outline is None:
        spread = max(float(np.ptp(positions, axis=0).max()), 10.0)
        start, std = np.array([0, 0, 0, *middle, spread]), np.array([0, 0, np.inf, np.inf, np.inf, np.inf])
    else:
        start = np.array([0, 0, 0, outline.column, outline.row, outline.radius])
        known = np.hypot(outline.std, [0, 0, outline.radius * growth_std])
        std = np.array([np.inf, np.inf, np.inf, *known])
    loose = np.array([0, 0, 0, np.inf, np.inf, np.inf])
    errors = _errors(capture, seen, start[5])
    right, flipped = (_fitted(partial(expected, flip=way), start, loose, positions, errors) for way in (1.0, -1.0))
    spread = float(np.ptp(directions[:, 1]))
    apart, other = float(np.median(right.off)), float(np.median(flipped.off))
    if spread > 0.2 and other < 0.2 * apart and apart > 2:
        text = (
            "the highlights move opposite to the specified lamp directions: measure azimuths from +x (right) to +y (up)"
        )
        return _NOTHING._replace(centre=_circle(flipped), remarks=(Remark("table-flipped", text),))
    if outline is not None:
        ball = MirrorBall(outline.row, outline.column, outline.radius, camera)
        lamps = ball.lamp_seen_at(ball.normals(positions[:, 1], positions[:, 0]), lamp)
        good = np.isfinite(lamps).all(axis=1)
        if good.sum() >= _FEWEST:
            verdict = explain_lamp_table(lamps[good], directions[good])
            if verdict.mistake not in ("none", "unexplained"):
                return _NOTHING._replace(remarks=verdict.remarks)
            start[:3] = Rotation.align_vectors(lamps[good], directions[good])[0].as_rotvec()
    fit = _fitted(expected, start, std, positions, errors)
    if wrong := _whole_remarks(fit, errors):
        return _NOTHING._replace(remarks=wrong)
    return _checked(capture, names, fit, std, outline)


def _of_cylinder(
    capture: Capture, names: list[str], directions: np.ndarray, seen: list[Seen], outline: QuickOutline
) -> TableCheck:
    """Compare the columns of the bright lines with those predicted from the lamp table.

    The columns determine only the rotation about the axis of the cylinder.
    """
    camera, lamp, growth_std = _distances(capture)
    columns = np.array([[one.column] for one in seen])

    def expected(p: np.ndarray, lamps: np.ndarray = directions) -> np.ndarray:
        turned = Rotation.from_rotvec(p[:3]).apply(lamps)
        positions = [cylinder_line(one, camera, lamp) for one in turned]
        return (p[3] + p[5] * np.array(positions))[:, None]

    start = np.array([0, 0, 0, outline.column, 0.0, outline.radius])
    radius_std = math.hypot(outline.std[2], outline.radius * growth_std)
    std = np.array([0, np.inf, 0, outline.std[0], 0, radius_std])
    errors = _errors(capture, seen, outline.radius)
    fit = _fitted(expected, start, std, columns, errors)
    if wrong := _whole_remarks(fit, errors):
        lamps, radians = in_radians(directions)
        if not _whole_remarks(_fitted(partial(expected, lamps=lamps), start, std, columns, errors), errors):
            wrong = (radians,)
        return _NOTHING._replace(remarks=wrong)
    return _checked(capture, names, fit, std, outline)


def _checked(
    capture: Capture, names: list[str], fit: _Fit, std: np.ndarray, outline: QuickOutline | None
) -> TableCheck:
    """Build the result of a fit whose rotation and radius are meaningful. `std` is the prior of its parameters."""
    sample = capture.settings["sample"]["kind"]
    remarks = _turn_remarks(fit, std, f"{sample}'s")
    if outline is not None:
        remarks += _radius_remarks(fit, outline, std[5])
    remarks += _single_remarks(capture, names, fit)
    turn_std = np.where(std[:3] > 0, np.sqrt(np.diag(fit.covariance)[:3]), math.nan)
    column, row, radius = _circle(fit)
    return TableCheck((column, math.nan if sample == "cylinder" else row, radius), fit.p[:3], turn_std, tuple(remarks))


def _errors(capture: Capture, seen: list[Seen], radius: float) -> np.ndarray:
    """Compute the standard deviation of each highlight about its expected position, px.

    An error of the direction of the lamp rotates the normal at the highlight by half of this error.
    """
    return np.hypot([one.std for one in seen], abs(radius) * capture.direction_std / 2)


def _fitted(
    expected: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    std: np.ndarray,
    positions: np.ndarray,
    errors: np.ndarray,
) -> _Fit:
    """Fit the parameters whose prior standard deviation is above 0, robustly against single wrong lamps."""
    free = np.flatnonzero(std > 0)
    known = free[np.isfinite(std[free])]

    def whole(q: np.ndarray) -> np.ndarray:
        p = start.copy()
        p[free] = q
        return p

    def away(q: np.ndarray) -> np.ndarray:
        return np.nan_to_num(expected(whole(q)) - positions, nan=1e3)

    def residual(q: np.ndarray) -> np.ndarray:
        p = whole(q)
        return np.append((away(q) / errors[:, None]).ravel(), (p[known] - start[known]) / std[known])

    found = least_squares(residual, start[free], loss="soft_l1", x_scale="jac")
    off = np.linalg.norm(away(found.x), axis=1)
    scatter = robust_std(away(found.x) / errors[:, None])
    covariance = np.zeros((start.size, start.size))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac.T @ found.jac) * max(1.0, scatter) ** 2
    return _Fit(whole(found.x), covariance, off)


def _circle(fit: _Fit) -> tuple[float, float, float]:
    return float(fit.p[3]), float(fit.p[4]), float(abs(fit.p[5]))


def _whole_remarks(fit: _Fit, errors: np.ndarray) -> tuple[Remark, ...]:
    """Report a table that no rotation aligns with the highlights. Its fitted radius and rotation are meaningless.

    Single wrong lamps do not change the median. If the table is right, half of four highlights are further off than
    `_SIGNIFICANT` standard deviations once in 10^6 captures.
    """
    off = float(np.median(fit.off))
    if off < max(_OFF, _SIGNIFICANT * float(np.median(errors))):
        return ()
    text = f"the highlights are {off:.0f} px (median) from the positions that the lamp table predicts: check angle_deg and "
    return (Remark("table-contradicts", f"{text}azimuth_deg in frames.csv, and the distances"),)


def _turn_remarks(fit: _Fit, std: np.ndarray, whose: str) -> list[Remark]:
    free = std[:3] > 0
    turn, covariance = fit.p[:3], fit.covariance[:3, :3]
    size = float(np.linalg.norm(turn))
    # even in careful set-ups tables are rotated by some tenths of a degree, and `reconstruct` fits this rotation
    if size < math.radians(0.5):
        return []
    along = turn / size
    spread = math.sqrt(float(along @ covariance @ along))
    if size < _SIGNIFICANT * spread:
        return []
    degrees, axes = np.degrees(turn), ("x (right)", "y (up)", "z (to the camera)")
    parts = ", ".join(f"{value:+.1f} about {axis}" for value, axis, one in zip(degrees, axes, free, strict=True) if one)
    where = f" relative to the {whose} outline" if free[1] else ""
    return [
        Remark(
            "table-turned",
            f"the highlights indicate a rotation of the lamp table by {np.degrees(size):.1f} ± {np.degrees(spread):.1f} "
            f"degrees{where} ({parts}): check the axes of angles and azimuths",
        )
    ]


def _radius_remarks(fit: _Fit, outline: QuickOutline, std: float) -> list[Remark]:
    change = float(fit.p[5] - outline.radius)
    known = math.sqrt(max(std**2 - float(fit.covariance[5, 5]), 1e-12))
    # differences of less than 1 % are not reported, because `reconstruct` fits the radius
    if abs(change) < max(_SIGNIFICANT * known, 0.01 * outline.radius):
        return []
    text = f"the highlights indicate a radius of {fit.p[5]:.1f} ± {math.sqrt(fit.covariance[5, 5]):.1f} px, but the "
    text += f"outline has {outline.radius:.1f} px: check sample.radius_mm, the distances and the angles of frames.csv"
    return [Remark("radius-mismatch", text)]


def _single_remarks(capture: Capture, names: list[str], fit: _Fit) -> list[Remark]:
    scatter = float(np.median(fit.off))
    allowed = max(_OFF, 5 * scatter, abs(fit.p[5]) * 2 * capture.direction_std)
    return [
        Remark(
            "table-contradicts",
            f"lamp {name}: the highlight is {off:.0f} px from the position that the specified direction predicts: check "
            "this direction in frames.csv",
        )
        for name, off in zip(names, fit.off, strict=True)
        if off > allowed
    ]
