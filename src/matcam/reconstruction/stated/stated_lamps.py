"""Specified directions to the lamps, compared with the highlights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from matcam.acquisition.highlights import lamp_angles_apart
from matcam.acquisition.lamps.lamp_table import explain_lamp_table
from matcam.acquisition.mirror_ball import unit
from matcam.core.remark import Remark
from matcam.files.capture import Capture
from matcam.reconstruction.stated.stated_rig import FEWEST

_UNKNOWN = float(np.radians(20.0))
"""Default standard deviation of the direction of a lamp, rad."""


def stated_lamps(
    capture: Capture, names: Sequence[str], lamps: np.ndarray, remarks: list[Remark]
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the specified direction of each lamp, or that of the highlight if no direction is specified.

    Remarks report the difference between specified directions and highlights.

    Returns:
        Unit vectors to the lamps, (pictures, 3), and standard deviations along each tangent, rad, (pictures,).
    """
    stated, stds = lamps.copy(), np.full(len(names), _UNKNOWN)
    for k, name in enumerate(names):
        direction = capture.lamps[name].direction
        if np.all(np.isfinite(direction)):
            stated[k], stds[k] = direction, max(capture.direction_std, 1e-5)
    known = stds < _UNKNOWN
    if known.any():
        apart = np.degrees(lamp_angles_apart(lamps[known], stated[known]))
        assumed = "" if capture.settings["distances"]["lamp_mm"] else ", for the assumed distance of the lamp"
        remarks.append(
            Remark(
                "lamp-table",
                f"the highlights and the specified lamp directions differ by {np.sqrt(np.mean(apart**2)):.2g}° rms before the "
                f"fit{assumed}: if this exceeds their accuracy, check the specified directions",
            )
        )
    if known.sum() >= FEWEST:
        remark = _table_mistake(lamps, stated, stds, known)
        remarks.extend([] if remark is None else [remark])
    return stated, stds


def first_lamps(lamps: np.ndarray, covariances: np.ndarray, stated: np.ndarray, stds: np.ndarray) -> np.ndarray:
    """Choose the directions from which a fit starts.

    The direction of each lamp is that of the highlight. The specified direction is used if the two directions are
    inconsistent and that of the highlight is less certain. Near the limb, a highlight narrower than a pixel hardly
    determines the direction, and a fit does not converge if its window does not contain the highlight.

    Args:
        lamps: directions from the highlights, (pictures, 3).
        covariances: covariances of `lamps`, rad^2, (pictures, 3, 3).
        stated: specified directions, (pictures, 3).
        stds: standard deviations of `stated` along each tangent, rad, (pictures,).
    """
    own = np.sqrt(np.trace(covariances, axis1=1, axis2=2) / 2)
    apart = lamp_angles_apart(lamps, stated)
    usual = np.maximum(stds, np.median(apart))
    # ratio of the angle between a highlight and the table to its typical value above which a poorly known
    # highlight is rejected
    doubtful = (apart > 3.0 * usual) & (own > usual)
    return np.where(doubtful[:, None], unit(stated), lamps)


def _table_mistake(lamps: np.ndarray, stated: np.ndarray, stds: np.ndarray, known: np.ndarray) -> Remark | None:
    """Identify the mistake in a lamp table, and build a remark about it; None: the table is used as it is.

    If a remark is built, the entries of `stated` and `stds` where `known` is True are changed in place, so that the fit
    depends less on the mistake.
    """
    verdict = explain_lamp_table(lamps[known], stated[known])
    if verdict.mistake == "none":
        return None
    (said,) = verdict.remarks
    if verdict.mistake != "unexplained":
        stated[known], stds[known] = lamps[known], _UNKNOWN
        return Remark(said.code, f"{said.text}; the directions from the highlights are used instead")
    usual = float(np.median(lamp_angles_apart(lamps[known], stated[known])))
    # angle between highlights and a lamp table above which the table is not used as a starting point, rad
    if usual < np.radians(10.0):
        return None  # the joint fit determines whether the table, the outline or a distance is wrong
    stds[known] = np.maximum(stds[known], 1.5 * usual)
    return Remark(
        said.code,
        f"{said.text}; the standard deviation of the directions in the table is enlarged to {np.degrees(1.5 * usual):.2g}°",
    )
