"""Input of the joint fit from a capture of a cylinder: merged images, outline, strips, lamp directions."""

from __future__ import annotations

import numpy as np

from matcam.acquisition.check.unmeasured_lens import lens_sigma
from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.limb.backlight import field_reach
from matcam.acquisition.limb.clipped_field import hidden_by_clipping
from matcam.acquisition.limb.straight_outline import StraightOutline, straight_outline
from matcam.acquisition.merging import merge
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.mosaic_frames import MosaicReader, frame_size, origin_of
from matcam.acquisition.radiometry import Progress
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Stated
from matcam.reconstruction.cylinder.strips import Strip
from matcam.reconstruction.sphere_scene import SphereScene
from matcam.reconstruction.stated.captured_scene import CapturedScene
from matcam.reconstruction.stated.lamp_light import gains_of
from matcam.reconstruction.stated.outline_frames import mean_outline_frame
from matcam.reconstruction.stated.stated_rig import (
    FEWEST,
    captured_lens,
    known_nearness,
    known_radius,
    lamp_radius_of,
    without_field,
)

_SHIFT = 0.3
"""Standard deviation of the motion of the axis between images, px."""
_STATED_STD = 0.05
"""Default standard deviation of a specified radius or axis, px."""


def captured_cylinder(
    capture: Capture, progress: Progress | None = None, *, workers: int = 1, kept: KeptWork | None = None
) -> tuple[CapturedScene, tuple[Strip, ...]]:
    """Merge the frames of a capture, and find the outline of the cylinder.

    Args:
        capture: capture of a cylinder, as returned by `read_capture`.
        progress: function that is called with the name of a step, the number of finished parts and the number of all parts.
            Default: None.
        workers: number of lamp positions that are read at the same time. Default: 1.
        kept: stored results from which an interrupted computation resumes. Default: None, nothing is stored.

    Returns:
        Merged images with prior knowledge of the rig, and the strips of material.

    Raises:
        ArgumentError: the capture has neither frames of the outline nor a specified outline.
        FitError: the outline cannot be measured, or fewer than three lamp positions can be used.
    """
    remarks: list[Remark] = list(capture.problems)
    camera, lens = captured_lens(capture, remarks)
    camera = without_field(camera, "cylinder", remarks)
    camera_nearness = known_nearness(capture, "camera", remarks)
    lamp_nearness = known_nearness(capture, "lamp", remarks)
    sample_radius = known_radius(capture)
    outline = _outline(capture, lens_sigma(camera), remarks)
    remarks.extend(outline.remarks)
    directions = {name: guess.direction for name, guess in capture.lamps.items()}
    lost = tuple(name for name, one in directions.items() if not np.all(np.isfinite(one)))
    if lost:
        remarks.append(
            Remark(
                "no-direction",
                f"the fit excludes {', '.join(lost)}, because the lamp direction is unknown: angle_deg and azimuth_deg of "
                "frames.csv must specify the direction of the lamp",
            ),
        )
    merged, radiometry = merge(capture, capture.region, progress, workers=workers, kept=kept)
    remarks.extend(radiometry.remarks)
    pictures = [one for one in merged if one.name not in lost]
    if len(pictures) < FEWEST:
        raise FitError(
            f"{capture.folder}: only {len(pictures)} of the lamp positions have both usable frames and a direction, but "
            f"{FEWEST} are required: add frames, or angle_deg and azimuth_deg to frames.csv"
        )
    size = frame_size(capture)
    assert size is not None  # frames were merged
    height = size[1]
    strips = _strips(capture, pictures[0].values.shape[0], pictures[0].origin[0])
    # the row that the camera faces is assumed to be the middle row, within 5 % of the height
    row = capture.stated("centre_row_px") or Stated((height - 1) / 2, 0.05 * height)
    lamps = np.array([directions[one.name] for one in pictures])
    ball = MirrorBall(row.value, outline.column, outline.radius)
    names = [one.name for one in pictures]
    light = gains_of(capture, radiometry, names, lamps, ball, lamp_nearness.value, remarks)
    covariance = np.zeros((3, 3))
    covariance[np.ix_([0, 2], [0, 2])] = outline.covariance
    covariance[1, 1] = max(row.std, 1e-3) ** 2
    scene = SphereScene(
        camera=camera,
        lens_std=lens,
        centres=np.tile([outline.column, row.value], (len(pictures), 1)),
        radius=outline.radius,
        outline_covariance=covariance,
        shift_std=_SHIFT,
        camera_nearness=camera_nearness,
        lamp_nearness=lamp_nearness,
        lamps=lamps,
        lamp_std=max(capture.direction_std, 1e-5),
        lamp_radius=lamp_radius_of(capture),
        sample_radius=sample_radius,
        light=light,
    )
    found = CapturedScene(pictures, scene, lamps, radiometry, None, lost, tuple(dict.fromkeys(remarks)))
    return found, strips


def _strips(capture: Capture, height: int, first: int) -> tuple[Strip, ...]:
    sample = capture.settings["sample"]
    rows, turns = sample["strip_rows_px"], sample["strip_turn_deg"]
    if rows is None:
        return (Strip(first, first + height - 1, 0.0),)
    turns = turns or [0.0] * len(rows)
    return tuple(Strip(low, high, float(np.radians(turn))) for (low, high), turn in zip(rows, turns, strict=True))


def _outline(capture: Capture, sigma: float, remarks: list[Remark]) -> StraightOutline:
    radius, axis = capture.stated("outline_radius_px"), capture.stated("axis_column_px")
    if capture.of("outline"):
        try:
            return _seen_outline(capture, sigma, remarks)
        except FitError as error:
            if radius is None or axis is None:
                raise
            remarks.append(Remark("outline-left-out", f"{error}; the specified outline was used"))
    if radius is None or axis is None:
        raise ArgumentError(
            f"{capture.folder}: the outline of the cylinder is unknown: add a frame of the cylinder in front of a bright "
            "field to outline/, or set sample.outline_radius_px and sample.axis_column_px"
        )
    std = (max(axis.std, 1e-3), max(radius.std, 1e-3)) if axis.std or radius.std else (_STATED_STD,) * 2
    return StraightOutline(axis.value, radius.value, np.diag(np.square(std)))


def _seen_outline(capture: Capture, sigma: float, remarks: list[Remark]) -> StraightOutline:
    region, reader = capture.region, MosaicReader(capture)
    codes, clipped = mean_outline_frame(reader, capture, region, remarks)
    outline = straight_outline(
        codes, reader.channel_map(codes.shape, region), origin=origin_of(region), reach=field_reach(capture)
    )
    if not clipped:
        return outline
    hidden, remark = hidden_by_clipping(capture.folder / "outline", sigma)
    remarks.append(remark)
    wider = outline.covariance + np.diag([0.0, hidden**2])
    return outline._replace(radius=outline.radius + hidden, covariance=wider)
