"""Outline of the sphere of a capture, and region of the frames about the outline.

The outline is specified, or is determined from a mask or from outline frames.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from matcam.acquisition.check.quick_outline import dark_disc
from matcam.acquisition.darkness import dark_level
from matcam.acquisition.limb.backlight import field_reach
from matcam.acquisition.limb.clipped_field import field_is_clipped, hidden_by_clipping
from matcam.acquisition.limb.given_outline import given_outline
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mosaic_frames import MosaicReader, origin_of
from matcam.acquisition.outline import Outline, Sighting, find_outline
from matcam.core.errors import FitError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.numerics.normal import robust_std

_MARGIN = 0.12
"""Margin about the outline in the region of a frame that is read, as a share of the radius."""


def about_disc(capture: Capture) -> Region | None:
    """Find the region about the dark disc of the first readable outline frame.

    The result is None if no outline frame is readable, or if the frame contains no disc.
    """
    for _, codes in MosaicReader(capture).readable(capture.of("outline")):
        column, row, radius = dark_disc(codes)
        reach = radius * (1 + 2 * _MARGIN) + 8
        return _box(column, row, reach, codes.shape) if np.isfinite(radius) else None
    return None


def found_outline(
    capture: Capture, sighting: Sighting, sigma: float, frame: tuple[int, int] | None, remarks: list[Remark]
) -> tuple[Outline | None, Region | None]:
    """Determine the outline of a capture, and the region of the frames about it.

    A specified circle is preferred to a mask, and a mask to outline frames. Remarks report unusable inputs. The outline is
    None if all three are missing or unusable. The region is None if whole frames are to be read.

    Args:
        capture: the capture, as read by `read_capture`.
        sighting: geometry of the camera.
        sigma: standard deviation of the blur of the lens, px.
        frame: width and height of the frames, px; None: unknown.
        remarks: list to which remarks for the user are added.
    """

    def by_frames() -> Outline | None:
        if not capture.of("outline"):
            return None
        return backlit_outline(capture, sighting, sigma, capture.region or about_disc(capture), remarks)

    for source in (partial(given_outline, capture, sighting, sigma, frame), by_frames):
        try:
            outline = source()
        except MatcamError as error:
            remarks.append(Remark("outline-left-out", f"{error}; this input was not used for the outline"))
            continue
        if outline is not None:
            return outline, capture.region or (None if frame is None else about_outline(outline, frame[::-1]))
    return None, capture.region


def backlit_outline(
    capture: Capture, sighting: Sighting, sigma: float, region: Region | None, remarks: list[Remark]
) -> Outline:
    """Measure the outline of the sphere in the mean of the outline frames.

    These frames show the sphere in front of a bright field.

    Args:
        capture: the capture, as read by `read_capture`.
        sighting: geometry of the camera.
        sigma: standard deviation of the blur of the lens, px. It is used if the field is clipped, because clipping shifts
            the edge of the field.
        region: region of the frames that is read; None: the whole frame.
        remarks: list to which remarks for the user are added.

    Raises:
        FitError: no outline frame can be read, or no outline was found.
    """
    reader = MosaicReader(capture)
    mean, clipped = mean_outline_frame(reader, capture, region, remarks)
    # photon noise in codes, from the smoothest neighbourhoods: differences of pixels of one colour
    step = reader.step
    difference = mean[step:] - mean[:-step]
    # >=, because a field of one code has no pixel above its percentile
    bright = mean >= np.percentile(mean, 60)
    pairs = bright[step:] & bright[:-step]
    noise = robust_std(difference[pairs]) / np.sqrt(2) if pairs.any() else 0.0
    level = float(np.median(mean[bright]))
    # 1e-4 is the rounding error of a field of 3000 codes
    scatter = max(noise, 1e-4 * abs(level), 1e-9)
    std = scatter * np.sqrt(np.clip(mean / max(level, 1e-12), 0.05, None))
    picture = MergedPicture(
        f"{capture.folder / 'outline'}",
        mean,
        std,
        np.zeros(mean.shape, bool),
        reader.channel_map(mean.shape, region),
        reader.channels,
        origin_of(region),
    )
    outline = find_outline(picture, light="backlit", sighting=sighting, backlight_reach=field_reach(capture))
    if not clipped:
        return outline
    hidden, remark = hidden_by_clipping(capture.folder / "outline", sigma)
    remarks.append(remark)
    wider = np.diag([0.0, 0.0, hidden**2])
    return replace(outline, radius=outline.radius + hidden, covariance=outline.covariance + wider)


def mean_outline_frame(
    reader: MosaicReader, capture: Capture, region: Region | None, remarks: list[Remark]
) -> tuple[np.ndarray, bool]:
    """Average the outline frames, less the dark level, and check whether the bright field is clipped.

    The results are the mean, DN, and True if the field is clipped in a frame. Remarks report unusable frames. A FitError is
    raised if no frame is usable.
    """
    total: np.ndarray | None = None
    count, clipped = 0, False
    for frame, codes in reader.readable(capture.of("outline"), region, remarks):
        light = codes.astype(np.float64) - dark_level(reader, capture, frame.exposure, region)
        if total is not None and total.shape != light.shape:
            remarks.append(
                Remark(
                    "bad-frame",
                    f"{capture.folder / frame.file}: the frame differs in size from the other outline frames, so it was not "
                    "used: give outline frames of one size",
                )
            )
            continue
        total = light if total is None else total + light
        count += 1
        clipped |= field_is_clipped(codes, reader.saturation)
    if total is None:
        raise FitError(f"{capture.folder / 'outline'}: none of the frames can be used: add at least one readable frame")
    return np.asarray(total / count), clipped


def about_outline(outline: Outline, shape: tuple[int, ...]) -> Region:
    """Compute the region about an outline, px. The first column and row are even, to preserve the order of a mosaic."""
    return _box(outline.column, outline.row, outline.radius * (1 + _MARGIN) + 4, shape)


def _box(column: float, row: float, reach: float, shape: tuple[int, ...]) -> Region:
    left, top = (2 * int(max(0, np.floor((centre - reach) / 2))) for centre in (column, row))
    right, bottom = (int(np.ceil(min(at + reach, size))) for at, size in zip((column, row), shape[::-1], strict=True))
    return left, top, right - left, bottom - top
