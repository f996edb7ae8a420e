"""Input of the joint fit from a capture of a sphere: merged images, outline, first lamp directions, prior knowledge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.acquisition.check.unmeasured_lens import lens_sigma
from matcam.acquisition.frame_shifts import find_shifts
from matcam.acquisition.highlights import find_highlights, lamp_from_highlight
from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.merging import merge
from matcam.acquisition.mosaic_frames import frame_size
from matcam.acquisition.outline import Outline, Sighting, find_outline, stacked
from matcam.acquisition.radiometry import Progress, Radiometry
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Stated
from matcam.reconstruction.rig.earlier_rig import known_rig
from matcam.reconstruction.rig.rig_document import EarlierRig
from matcam.reconstruction.sphere_scene import SphereScene, unstated_distortion
from matcam.reconstruction.stated.lamp_light import gains_of
from matcam.reconstruction.stated.outline_frames import found_outline
from matcam.reconstruction.stated.stated_lamps import first_lamps, stated_lamps
from matcam.reconstruction.stated.stated_rig import (
    FEWEST,
    captured_lens,
    known_nearness,
    known_radius,
    lamp_radius_of,
)
from matcam.reconstruction.stated.undistorted import undistorted_sphere

_SHIFT = 0.3
"""Assumed standard deviation of the position of the sphere between images, px, if the limb does not determine it."""
INCOMPLETE = (
    "bad-flat",
    "bad-frame",
    "bad-line",
    "dark-too-bright",
    "extra-frame",
    "missing-frame",
    "other-size",
    "frame-clipped",
    "frame-mislabelled",
    "no-direction",
    "no-highlight",
    "outline-left-out",
    "profile-left-out",
    "reference-left-out",
    "picture-left-out",
    "table-exchanged",
)
"""Codes of the remarks on unusable inputs."""


class CapturedScene(NamedTuple):
    """Data of a capture before the joint fit.

    Attributes:
        pictures: merged images that can be fitted.
        scene: prior knowledge of the scene.
        lamps: unit vectors to the lamps with which the fit starts, mostly from the highlights, (pictures, 3).
        radiometry: radiometric calibration of the frames.
        outline: outline of the sphere; None: the sample is not a sphere.
        left_out: names of the lamp positions that cannot be used.
        remarks: remarks on the capture.
        frame: width and height of the frames, px. Default: None, unknown.
        sample_radius: radius of the sphere with its standard deviation, mm. Default: None, unknown.
    """

    pictures: list[MergedPicture]
    scene: SphereScene
    lamps: np.ndarray
    radiometry: Radiometry
    outline: Outline | None
    left_out: tuple[str, ...]
    remarks: tuple[Remark, ...]
    frame: tuple[int, int] | None = None
    sample_radius: Stated | None = None


def captured_scene(
    capture: Capture,
    progress: Progress | None = None,
    earlier: EarlierRig | None = None,
    *,
    workers: int = 1,
    kept: KeptWork | None = None,
) -> CapturedScene:
    """Merge the frames of a capture, and find outline, highlights and lamps.

    Args:
        capture: capture, as returned by `read_capture`.
        progress: function that is called with the name of a step, the number of finished parts and the number of all parts.
            Default: None.
        earlier: rig of an earlier reconstruction, which replaces the specified values. Default: None, there is none.
        workers: number of lamp positions that are read at the same time. Default: 1.
        kept: stored results from which an interrupted computation resumes. Default: None, nothing is stored.

    Raises:
        ArgumentError: the capture is not of a sphere, or `earlier` is of another rig.
        FitError: the frames cannot be merged, no sphere was found, or fewer than three images contain a highlight.
    """
    kind = capture.settings["sample"]["kind"]
    if kind != "sphere":
        raise ArgumentError(f"{capture.folder}: sample.kind must be 'sphere' to find an outline, got {kind!r}")
    remarks: list[Remark] = list(capture.problems)
    camera, spread = captured_lens(capture, remarks)
    frame, rig = frame_size(capture), None
    if earlier is not None:
        sigma, radius = camera.parameters().get("optics.sigma_px"), capture.radius_mm
        rig, said = known_rig(
            earlier,
            list(capture.lamps),
            frame,
            None if radius is None else radius.value,
            None if sigma is None else float(sigma),
        )
        remarks.extend(said)
        camera = camera.with_field(earlier.field)
    camera_nearness = known_nearness(capture, "camera", remarks if rig is None else [])
    lamp_nearness = known_nearness(capture, "lamp", remarks if rig is None else [])
    sample_radius = known_radius(capture)
    if rig is not None:
        std = np.sqrt(np.diag(rig.covariance))
        camera_nearness, lamp_nearness = (
            Stated(float(rig.values[at]), float(std[at])) if rig.knows[at] else stated
            for at, stated in ((1, camera_nearness), (2, lamp_nearness))
        )
    sighting = Sighting(1 / camera_nearness.value if camera_nearness.value > 0 else np.inf)
    outline, region = found_outline(capture, sighting, lens_sigma(camera), frame, remarks)
    pictures, radiometry = merge(capture, region, progress, workers=workers, kept=kept)
    remarks.extend(radiometry.remarks)
    centres: np.ndarray | None = None
    if outline is None:
        try:
            outline = find_outline(stacked(pictures), sighting=sighting)
        except FitError as error:
            tried = [one.text for one in remarks if one.code == "outline-left-out"]
            advice = "add frames of the sphere in front of a bright field to outline/, or set outline.mask or outline.centre_px"
            raise FitError(f"{'; '.join([*tried, str(error)])}; {advice}") from error
        outline, shifts = find_shifts(pictures, outline, _SHIFT)
        centres = np.array([[outline.column + s.column, outline.row + s.row] for s in shifts])
    remarks.extend(outline.remarks)
    highlights, said = find_highlights(pictures, outline.ball, blur=float(np.hypot(outline.sigma, 0.29)))
    remarks.extend(said)
    ball, centres, highlights = undistorted_sphere(camera.field, outline.ball, centres, highlights)
    far = 1 / lamp_nearness.value if lamp_nearness.value > 0 else np.inf
    seen = [k for k, one in enumerate(highlights) if one is not None]
    left_out = tuple(one.name for k, one in enumerate(pictures) if k not in seen)
    if len(seen) < FEWEST:
        raise FitError(
            f"{capture.folder}: a highlight on the sphere was found in only {len(seen)} of {len(pictures)} images, "
            f"but {FEWEST} are required: check the outline and the exposures"
        )
    mirrored = [lamp_from_highlight(one, ball, far) for one in highlights if one is not None]
    lamps, covariances = map(np.array, zip(*mirrored, strict=True))
    pictures = [pictures[k] for k in seen]
    centres = np.tile([ball.column, ball.row], (len(seen), 1)) if centres is None else centres[seen]
    names = [one.name for one in pictures]
    if rig is None:
        stated, stds = stated_lamps(capture, names, lamps, remarks)
    else:
        every = list(capture.lamps)
        rig = rig._replace(lamps=rig.lamps[[every.index(name) for name in names]])
        stated, stds = stated_lamps(capture, names, lamps, [])
        known = rig.lamps >= 0
        stated[known], stds[known] = rig.directions[rig.lamps[known]], rig.lamp_std[rig.lamps[known]]
    order = [1, 0, 2]  # (row, column, radius) to (column, row, radius)
    lamps = first_lamps(lamps, covariances, stated, stds)
    light = gains_of(capture, radiometry, names, lamps, ball, lamp_nearness.value, remarks)
    scene = SphereScene(
        camera=camera,
        lens_std=spread,
        centres=centres,
        radius=ball.radius,
        outline_covariance=outline.covariance[np.ix_(order, order)],
        shift_std=_SHIFT,
        camera_nearness=camera_nearness,
        lamp_nearness=lamp_nearness,
        lamps=stated,
        lamp_std=stds,
        lamp_radius=lamp_radius_of(capture),
        rig=rig,
        unstated_field=None if camera.field is not None else unstated_distortion(ball),
        sample_radius=sample_radius,
        light=light,
    )
    said_once = tuple(dict.fromkeys(remarks))
    radius = capture.radius_mm
    return CapturedScene(pictures, scene, lamps, radiometry, outline, left_out, said_once, frame, radius)
