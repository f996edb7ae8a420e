"""The sphere before a bright field: the mean of the frames that show it, its outline, and the part of the frames about it."""

from __future__ import annotations

import numpy as np

from matcam.acquisition.capture_check import dark_disc
from matcam.acquisition.darkness import dark_of
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.outline import Outline, Sighting, find_outline
from matcam.core.errors import FitError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.files.capture_frames import CaptureFrame

_MARGIN = 0.12
"""Of the radius, about the outline: the part of a frame that is read."""


def about_disc(capture: Capture) -> tuple[Region | None, tuple[int, ...]]:
    """Return the part of the frames about the dark disc of the first outline frame, and the frames' shape.

    None: all of them, as there is no plain disc.
    """
    reader = MosaicReader(capture)
    for frame in capture.of("outline"):
        try:
            codes = reader.read(frame)
        except MatcamError:
            continue
        column, row, radius = dark_disc(codes)
        reach = radius * (1 + 2 * _MARGIN) + 8
        return (_box(column, row, reach, codes.shape) if np.isfinite(radius) else None), codes.shape
    return None, ()


def backlit_outline(capture: Capture, sighting: Sighting, region: Region | None, remarks: list[Remark]) -> Outline:
    """Return the outline before a bright field, from the mean of the frames that show one."""
    reader = MosaicReader(capture)
    mean = mean_outline_frame(reader, capture, region, remarks)
    # photon noise in codes, from the smoothest neighbourhoods: differences of pixels of one colour
    step = 1 if reader.cfa is None else 2
    difference = mean[step:] - mean[:-step]
    bright = mean > np.percentile(mean, 60)
    noise = 1.4826 * float(np.median(np.abs(difference[bright[step:] & bright[:-step]]))) / np.sqrt(2)
    level = float(np.median(mean[bright]))
    scatter = max(noise, 1e-6 * abs(level), 1e-9)
    std = scatter * np.sqrt(np.clip(mean / max(level, 1e-12), 0.05, None))
    origin = (0, 0) if region is None else (region[1], region[0])
    picture = MergedPicture(
        "outline",
        mean,
        std,
        np.zeros(mean.shape, bool),
        reader.channel_map(mean.shape, origin),
        reader.channels,
        origin,
    )
    beyond = np.radians(capture.settings["outline"]["field_beyond_deg"])
    reach = float(beyond), float(beyond) / 3
    return find_outline(picture, light="backlit", sighting=sighting, backlight_reach=reach)


def mean_outline_frame(
    reader: MosaicReader, capture: Capture, region: Region | None, remarks: list[Remark]
) -> np.ndarray:
    """Return the mean of the frames before a bright field, less dark; those that cannot be used are remarked."""
    total: np.ndarray | None = None
    count = 0
    for frame in capture.of("outline"):
        try:
            codes = reader.read(frame, region).astype(np.float64) - _dark(reader, capture, frame, region)
        except MatcamError as error:
            remarks.append(Remark("bad-frame", str(error)))
            continue
        if total is not None and total.shape != codes.shape:
            remarks.append(
                Remark("bad-frame", f"{capture.folder / frame.file}: is not of the other outline frames' size")
            )
            continue
        total = codes if total is None else total + codes
        count += 1
    if total is None:
        raise FitError(f"{capture.folder / 'outline'}: none of its frames can be read")
    return np.asarray(total / count)


def _dark(reader: MosaicReader, capture: Capture, frame: CaptureFrame, region: Region | None) -> np.ndarray | float:
    """Return the mean dark code of a frame's exposure, or of any; 0 where there is none."""
    frames = capture.of("dark", exposure=frame.exposure) or capture.of("dark")
    stack = []
    for one in frames[:8]:
        try:
            stack.append(reader.read(one, region))
        except MatcamError:
            continue
    if not stack:
        return float(capture.settings["camera"]["black_level_dn"] or 0.0)
    return np.asarray(dark_of(stack).level, dtype=np.float64)


def about_outline(outline: Outline, shape: tuple[int, ...]) -> Region:
    """Return the part of a frame about an outline: first column and row even, so that a mosaic stays one."""
    return _box(outline.column, outline.row, outline.radius * (1 + _MARGIN) + 4, shape)


def _box(column: float, row: float, reach: float, shape: tuple[int, ...]) -> Region:
    left, top = (2 * int(max(0, np.floor((centre - reach) / 2))) for centre in (column, row))
    right, bottom = (int(np.ceil(min(at + reach, size))) for at, size in zip((column, row), shape[::-1], strict=True))
    return left, top, right - left, bottom - top
