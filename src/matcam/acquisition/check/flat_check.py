"""Checks of a capture of a flat sample, which has neither an outline nor a highlight."""

from __future__ import annotations

import numpy as np

from matcam.acquisition.mirror_ball import unit
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.remark import Remark, some_of
from matcam.files.capture import Capture

FEWEST = 3
"""Smallest number of images for the maps of a flat sample."""
_SPREAD = 10.0
"""Range of half angles, degrees, below which the roughness is not determined."""
NOT_CHECKED = Remark(
    "not-checked",
    "a flat sample shows neither outline nor highlight, so lamp directions and tilts are not compared with the images: "
    "measure them carefully",
)


def flat_remarks(capture: Capture) -> list[Remark]:
    """Report unmet requirements of a flat sample: grey images, enough lamp positions, directions, tilts, half angles.

    Args:
        capture: capture of a flat sample.
    """
    found: list[Remark] = [NOT_CHECKED]
    reader = MosaicReader(capture)
    frames = capture.of("frames")
    try:
        reader.read(frames[0], capture.region)
    except FileFormatError as error:
        found.append(Remark("bad-frame", str(error)))
    if len(reader.channels) > 1:
        found.append(
            Remark(
                "not-grey",
                "a flat sample requires grey images, because each colour of a mosaic covers only part of the pixels: give "
                "images with one channel",
            )
        )
    names = list(capture.lamps)
    if len(names) < FEWEST:
        text = f"the number of lamp positions of the flat sample is {len(names)}, but it must be at least {FEWEST}: add images"
        found.append(Remark("too-few", text))
    lost = direction_remarks(capture)
    found += lost
    try:
        tilts = sample_tilts(capture)
    except ArgumentError as error:
        return [*found, Remark("tilts-differ", str(error))]
    return found if lost or len(names) < FEWEST else found + _half_angles(capture, tilts)


def direction_remarks(capture: Capture) -> list[Remark]:
    """Report lamp positions without a specified direction, for samples whose images do not show it."""
    lost = [name for name, guess in capture.lamps.items() if not np.isfinite(guess.direction).all()]
    if not lost:
        return []
    text = f"lamp {some_of(lost)}: the direction is not specified: add angle_deg and azimuth_deg to frames.csv"
    return [Remark("no-direction", text)]


def sample_tilts(capture: Capture) -> np.ndarray:
    """Return the specified tilt of a flat sample towards +x (right) at each lamp position, (lamps,), rad.

    The tilt is 0 if it is not specified. An ArgumentError is raised if the number of specified tilts is neither 1 nor the
    number of lamp positions.
    """
    stated, count = capture.settings["sample"]["tilt_deg"] or [0.0], len(capture.lamps)
    if len(stated) not in (1, count):
        raise ArgumentError(
            f"{capture.folder}: sample.tilt_deg has {len(stated)} angles for {count} lamp positions: give one "
            "angle, or one for each lamp position in the order of frames.csv"
        )
    return np.broadcast_to(np.radians(stated), count)


def _half_angles(capture: Capture, tilts: np.ndarray) -> list[Remark]:
    towards = np.array([guess.direction for guess in capture.lamps.values()])
    half = unit(towards + np.array([0.0, 0.0, 1.0]))
    normals = np.column_stack([np.sin(tilts), 0 * tilts, np.cos(tilts)])
    angle = np.degrees(np.arccos(np.clip((half * normals).sum(axis=1), -1, 1)))
    if np.ptp(angle) >= _SPREAD:
        return []
    return [
        Remark(
            "half-angles-similar",
            f"all images have half angles from {angle.min():.0f} to {angle.max():.0f} degrees: tilt the sample, or move the "
            f"lamp, until the half angles span {_SPREAD:.0f} degrees or more",
        )
    ]
