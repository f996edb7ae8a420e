"""Quick check of a capture in the lab.

The check detects clipping, gaps between lamp angles, wrong exposure times, a drifting lamp, a moved sample, and a rotated
lamp table. Every frame of the sample is read once. For a few lamp positions the frames are read again, to compare the
exposures pixel by pixel. A sphere is checked by its outline and highlights, and a cylinder by its outline and bright lines.
A flat sample is checked by its specified angles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from matcam.acquisition.check.cylinder_check import cylinder_remarks
from matcam.acquisition.check.flat_check import flat_remarks
from matcam.acquisition.check.quick_highlights import black_level, quick_highlights
from matcam.acquisition.check.quick_outline import quick_outline
from matcam.acquisition.check.table_check import check_table
from matcam.acquisition.check.unmeasured_lens import lens_sigma, unmeasured_lens
from matcam.acquisition.light.reference_patch import ReferencePatch, patch_geometry
from matcam.acquisition.merging import bracket_misfit, merge_position, misfit_remark
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.radiometry import Progress, Radiometry, capture_camera, measure_radiometry
from matcam.core.arrays import evenly
from matcam.core.errors import MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture
from matcam.files.capture_frames import LampGuess

_FIRST, _LAST, _GAP = 10.0, 70.0, 12.0
"""Limits of theta_d, degrees: a capture should begin below the first, end above the second, and have no gap larger than
the third.
"""
HARMLESS = frozenset({"clip-by-pile-up", "clip-not-seen", "gain-stated", "not-checked", "processed", "times-missing"})
"""Codes of remarks that do not make a capture faulty."""


@dataclass(frozen=True)
class CaptureCheck:
    """Result of the check of a capture.

    Attributes:
        findings: remarks on faults; empty if no fault was found.
        notes: remarks that are not faults.
        radiometry: radiometric calibration; None if it is not measurable. `lamp_output` is empty if the reference is
            diffuse and the lamp table is wrong.
        highlights: (column, row) of the highlight, px, by lamp position; row is NaN for the bright line of a cylinder.
            Lamp positions without a highlight are omitted.
        centre: column, row and radius of the sample, px, from the outline. Without an outline they are fitted to highlights
            and specified directions. Row is NaN for a cylinder. All are NaN without an outline if the lamp table is wrong or
            cannot be compared.
        turn: rotation vector that aligns the lamp table with the highlights, rad (3,), about x (right), y (up) and z
            (to the camera).
        turn_std: standard deviations of `turn`, rad (3,); NaN for an axis about which no rotation was fitted.
    """

    findings: tuple[Remark, ...]
    notes: tuple[Remark, ...]
    radiometry: Radiometry | None
    highlights: dict[str, tuple[float, float]]
    centre: tuple[float, float, float]
    turn: np.ndarray
    turn_std: np.ndarray


def check_capture(capture: Capture, progress: Progress | None = None) -> CaptureCheck:
    """Check a capture without a complete measurement.

    Args:
        capture: capture from `read_capture`.
        progress: function that is called after each lamp position. Default: None.

    Returns:
        Faults, notes and estimates. Bad frames are reported as faults and raise no exception.
    """
    found: list[Remark] = []
    radiometry = None
    try:
        radiometry = measure_radiometry(capture, progress=progress)
        # quick_highlights reports clipped peaks of all lamp positions below
        found += [remark for remark in radiometry.remarks if remark.code != "peak-clipped"]
    except MatcamError as error:
        found += [*capture.problems, Remark("no-radiometry", str(error))]
    profile = None
    try:
        profile = capture_camera(capture)
        if profile is None:
            found.append(Remark("no-profile", f"capture.toml has no camera.profile: {unmeasured_lens()}"))
    except MatcamError as error:
        found.append(Remark("bad-profile", str(error)))
    if radiometry is not None:
        names = list(radiometry.used)
        # the exposures of four lamp positions are compared pixel by pixel: few, because the frames are read
        # again
        for lamp in [names[i] for i in evenly(len(names), 4)]:
            misfit = bracket_misfit(capture, lamp, radiometry, merge_position(capture, lamp, radiometry))
            remark = misfit_remark(lamp, misfit)
            if remark is not None:
                found.append(remark)
    outline = None
    if capture.settings["sample"]["kind"] == "flat":
        found += flat_remarks(capture)
    else:
        if capture.settings["sample"]["kind"] == "cylinder":
            found += cylinder_remarks(capture)
        outline, said = quick_outline(capture, black_level(radiometry), lens_sigma(profile))
        found += said
    camera = capture.camera_radii
    highlights, said = quick_highlights(capture, radiometry, outline, math.inf if camera is None else camera.value)
    found += said
    table = check_table(capture, highlights, outline)
    found += table.remarks
    centre = table.centre if outline is None else (outline.column, outline.row, outline.radius)
    wrong = any(one.code.startswith("table-") for one in (*capture.problems, *table.remarks))
    if capture.settings["sample"]["kind"] != "flat" and not wrong:
        found += coverage_remarks(capture.lamps)
    if wrong and radiometry is not None and (capture.settings["reference"] or {}).get("kind") == "diffuse":
        radiometry = replace(radiometry, lamp_output={})  # it depends on the directions
    else:
        found += _lamp_remarks(capture, radiometry, centre)
    unique = list(dict.fromkeys(found))
    return CaptureCheck(
        tuple(one for one in unique if one.code not in HARMLESS),
        tuple(one for one in unique if one.code in HARMLESS),
        radiometry,
        {lamp: (one.column, one.row) for lamp, one in highlights.items()},
        centre,
        table.turn,
        table.turn_std,
    )


def coverage_remarks(lamps: dict[str, LampGuess]) -> list[Remark]:
    """Report ranges of theta_d without a lamp position.

    theta_d is half the angle between the lamp and the optical axis.

    Args:
        lamps: specified directions, by lamp position. If one of the angles is unknown, there are no remarks.
    """
    angles = np.array([guess.angle for guess in lamps.values()])
    if np.isnan(angles).any() or not angles.size:
        return []
    theta_d = np.sort(np.degrees(angles) / 2)
    texts = []
    if theta_d[0] > _FIRST:
        texts.append(
            f"the lamp positions begin at theta_d = {theta_d[0]:.0f} degrees: add a position below {_FIRST:.0f} degrees"
        )
    if theta_d[-1] < _LAST:
        texts.append(
            f"the lamp positions end at theta_d = {theta_d[-1]:.0f} degrees: add a position above {_LAST:.0f} degrees to "
            "measure F there"
        )
    gaps = [f"{low:.0f} and {high:.0f}" for low, high in pairwise(theta_d) if high - low > _GAP]
    if gaps:
        texts.append(
            f"no lamp position has theta_d between {', between '.join(gaps)} degrees: add positions, so that steps of "
            f"theta_d are at most {_GAP:.0f} degrees"
        )
    return [Remark("angles-missed", text) for text in texts]


def _lamp_remarks(capture: Capture, radiometry: Radiometry | None, sample: tuple[float, float, float]) -> list[Remark]:
    """Report light on the reference that scatters more than specified, or too few usable images of the reference.

    Args:
        capture: capture with the specified properties of the lamps.
        radiometry: radiometric calibration with the light of the reference.
        sample: column, row and radius of the sample, px; NaN: unknown. The position of a diffuse
            reference is relative to the centre of the sample.
    """
    if radiometry is None or capture.reference_position is None:
        return []
    known = all(np.isfinite(capture.lamps[lamp].direction).all() for lamp in radiometry.lamp_output)
    if capture.settings["reference"]["kind"] == "diffuse" and not known:
        return []  # the light on the reference depends on directions that `reconstruct` measures
    if capture.settings["reference"]["kind"] == "diffuse" and capture.lamp_radii and not math.isfinite(sample[0]):
        return []  # under a near lamp it depends on the position of the reference relative to the sample
    seen = {lamp: out for lamp, out in radiometry.lamp_output.items() if math.isfinite(out.value)}
    if len(seen) < 2:
        text = "fewer than two lamp positions show a usable reference, so lamp drift is not measured: expose the reference "
        return [Remark("no-reference", text + "brightly, but without clipping, at several lamp positions")]
    light = np.array([out.value for out in seen.values()]) / _near_light(capture, list(seen), sample)
    light /= light.mean()
    values = dict(zip(seen, light.tolist(), strict=True))
    stated = capture.settings["lamp"]["gain_std"]
    # errors of the lamp directions also add to the scatter of a diffuse reference
    unknown = np.array([(out.std / out.value) ** 2 for out in seen.values()])
    scatter = math.sqrt(max(float(np.var(light, ddof=1)) - float(unknown.mean()), 0.0))
    # 1e-5 keeps the weights of readings without noise finite
    weights = 1 / (unknown + max(stated, 1e-5) ** 2)
    chi2 = float(weights @ (light - np.average(light, weights=weights)) ** 2)
    # one false report of a steady lamp in a hundred captures
    if scatter <= 2 * stated + 0.002 or chdtrc(light.size - 1, chi2) > 0.01:
        return []
    worst = max(values, key=lambda lamp: abs(values[lamp] - 1))
    return [
        Remark(
            "lamp-drifts",
            f"lamp {worst}: the reference differs by {values[worst] - 1:+.1%} from the mean, and the light of all lamps "
            f"scatters by {scatter:.1%}, more than lamp.gain_std = {stated:.1%}: let the lamp warm up, or raise lamp.gain_std",
        )
    ]


def _near_light(capture: Capture, lamps: Sequence[str], sample: tuple[float, float, float]) -> np.ndarray:
    """Compute the ratio of the irradiances of a diffuse reference under near and under distant lamps, (lamps,).

    The ratio is 1 for other references, or if positions, directions or the distance of the lamps are unknown.
    """
    section, position, far = capture.settings["reference"], capture.reference_position, capture.lamp_radii
    towards = np.array([capture.lamps[lamp].direction for lamp in lamps])
    column, row, radius = sample
    if section["kind"] != "diffuse" or position is None or far is None:
        return np.ones(len(lamps))
    if not (math.isfinite(column) and math.isfinite(radius) and np.isfinite(towards).all()):
        return np.ones(len(lamps))
    camera, depth, radius_mm = capture.camera_radii, section["depth_mm"], capture.radius_mm
    if not math.isfinite(row):  # a cylinder
        row = position[1] + (position[3] - 1) / 2
    ball = MirrorBall(row, column, radius, math.inf if camera is None else camera.value)
    at = ReferencePatch(position).position(
        ball, 0.0 if depth is None or radius_mm is None else depth[0] / radius_mm.value
    )
    near, distant = (patch_geometry(towards, nearness, at)[0] for nearness in (1 / far.value, 0.0))
    return np.asarray(near / distant)
