"""Highlight of every lamp position in the shortest usable frame, and the clipped pixels of every shortest frame."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.acquisition.check.quick_outline import QuickOutline
from matcam.acquisition.highlights import find_highlight
from matcam.acquisition.light.pile_up import TopCodes, find_pile_up, top_codes
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.mosaic_frames import MosaicReader, origin_of
from matcam.acquisition.radiometry import Radiometry
from matcam.acquisition.radiometry_remarks import peak_remark
from matcam.core.errors import FitError
from matcam.core.remark import Remark, gathered
from matcam.files.capture import Capture
from matcam.files.capture_frames import CaptureFrame
from matcam.numerics.normal import robust_std

_SPOT_STD, _LEAST_STD = 0.3, 0.5
"""Standard deviation of a centroid, in radii of the bright spot, and its smallest value, px. The centroid of a rough
lobe shifts towards the limb.
"""


class Seen(NamedTuple):
    """Position of a highlight in the frame, px.

    Attributes:
        column: column of the highlight, or of a cylinder's bright line.
        row: row of the highlight; NaN for a cylinder.
        std: standard deviation of column and row each; for a cylinder that of the column.
    """

    column: float
    row: float
    std: float


def quick_highlights(
    capture: Capture,
    radiometry: Radiometry | None,
    outline: QuickOutline | None,
    camera: float = math.inf,
) -> tuple[dict[str, Seen], list[Remark]]:
    """Read the shortest frame of every lamp position, find its highlight and count its clipped pixels.

    If a frame shows no highlight, the next exposure is read. For a flat sample only clipping is checked.

    Args:
        capture: the capture.
        radiometry: radiometric calibration from a few lamp positions; None if unknown.
        outline: outline of the sample; None: unknown, and a highlight is the centroid of the bright spot.
        camera: distance of the camera from the centre of the sample, radii. Default: infinite.

    Returns:
        The highlights by lamp position, and remarks. Lamp positions without a highlight are omitted. The remarks report
        missing highlights and clipped pixels.
    """
    reader = MosaicReader(capture)
    kind = capture.settings["sample"]["kind"]
    order = list(radiometry.exposures) if radiometry is not None else capture.exposures
    found: dict[str, Seen] = {}
    remarks: list[Remark] = []
    level = _clip_threshold(reader, radiometry)
    shortest: dict[str, tuple[CaptureFrame, int]] = {}
    tops: list[TopCodes] = []
    for lamp in capture.lamps:
        frames = sorted(
            capture.of("frames", lamp=lamp), key=lambda f: order.index(f.exposure) if f.exposure in order else 99
        )
        position, readable = None, False
        for frame, whole in reader.readable(frames, capture.region):
            readable = True
            codes = _without_reference(capture, whole)
            if lamp not in shortest:
                shortest[lamp] = frame, int((codes >= level).sum())
                if radiometry is not None and not radiometry.clip.pixels:
                    tops.append(_top_codes(codes, frame, reader, radiometry))
            if kind == "flat":
                break
            position = _position(capture, reader, codes, radiometry, outline, camera)
            if position is not None:
                found[lamp] = position
                break
        if position is None and readable and kind != "flat":
            text = (
                f"{capture.folder / frames[-1].file}: no highlight of lamp {lamp} was found; check lamp and exposures"
            )
            remarks.append(Remark("no-highlight", text))
    piled = _piled(tops, radiometry)
    peaks = []
    for k, (lamp, (frame, above)) in enumerate(shortest.items()):
        count = above or piled.get(k, 0)
        if count:
            peaks.append(peak_remark(lamp, count, frame.exposure))
    return found, remarks + gathered(peaks)


def _without_reference(capture: Capture, codes: np.ndarray) -> np.ndarray:
    if capture.reference_region is not None:
        top, left = origin_of(capture.region)
        column, row, width, height = capture.reference_region
        rows = slice(max(row - top - 2, 0), max(row - top + height + 2, 0))
        codes = codes.copy()
        codes[rows, max(column - left - 2, 0) : max(column - left + width + 2, 0)] = np.median(codes)
    return codes


def _clip_threshold(reader: MosaicReader, radiometry: Radiometry | None) -> float:
    if radiometry is None or not radiometry.clip.pixels:
        return reader.saturation
    return min(reader.saturation, radiometry.clip.threshold)


def _top_codes(codes: np.ndarray, frame: CaptureFrame, reader: MosaicReader, radiometry: Radiometry) -> TopCodes:
    """Measure the brightest pixels of a frame.

    The result is used to detect clipping that the radiometric calibration from a few lamp positions did not find.
    """
    dark = radiometry.darkness.get(frame.exposure)
    hot = np.zeros(codes.shape, bool) if dark is None else dark.hot_pixels(codes.shape)
    level = black_level(radiometry) if dark is None else dark.level
    return top_codes(codes, level, hot, reader.step, radiometry.read_noise.value)


def _piled(tops: list[TopCodes], radiometry: Radiometry | None) -> dict[int, int]:
    if radiometry is None or not tops:
        return {}
    value, std = radiometry.gain
    pile = find_pile_up(tops, radiometry.read_noise.value, value - 3 * std if math.isfinite(std) else math.nan)
    return {} if pile is None else {k: int(tops[k].near) for k in pile.frames}


def _position(
    capture: Capture,
    reader: MosaicReader,
    codes: np.ndarray,
    radiometry: Radiometry | None,
    outline: QuickOutline | None,
    camera: float,
) -> Seen | None:
    origin = origin_of(capture.region)
    if capture.settings["sample"]["kind"] == "cylinder":
        return _bright_line(codes, origin[1], outline)
    seen = _bright_spot(codes, origin)
    if seen is None or outline is None:
        return seen
    gain, noise = (1.0, 2.0) if radiometry is None else (radiometry.scale, radiometry.read_noise.value)
    light = codes.astype(np.float64) - black_level(radiometry)
    picture = MergedPicture(
        "frame",
        light,
        np.sqrt(noise**2 + gain * np.maximum(light, 0)),
        codes >= _clip_threshold(reader, radiometry),
        reader.channel_map(codes.shape, capture.region),
        reader.channels,
        origin,
    )
    try:
        # the blur of lens and pixel is assumed to be 0.6 px
        one = find_highlight(picture, MirrorBall(outline.row, outline.column, outline.radius, camera), blur=0.6)
    except FitError:
        return seen
    std = math.hypot(_LEAST_STD, math.sqrt(float(np.trace(one.covariance)) / 2))
    return Seen(one.column, one.row, std)


def black_level(radiometry: Radiometry | None) -> float:
    """Compute the mean code without light, DN; 0 if it is unknown."""
    if radiometry is None or not radiometry.darkness:
        return 0.0
    return float(np.mean([one.mean for one in radiometry.darkness.values()]))


def _bright_spot(codes: np.ndarray, origin: tuple[int, int]) -> Seen | None:
    height, width = (n // 2 * 2 for n in codes.shape)
    cells = codes[:height, :width].astype(np.float64).reshape(height // 2, 2, width // 2, 2).mean((1, 3))
    level = float(np.median(cells))
    noise = robust_std(cells - level)
    peak = np.unravel_index(int(cells.argmax()), cells.shape)
    if cells[peak] - level < max(30 * noise, 20.0):
        return None
    bright = np.where(cells - level > 0.5 * (cells[peak] - level), cells - level, 0)
    rows, columns = np.indices(cells.shape)
    bright[np.hypot(rows - peak[0], columns - peak[1]) > 0.1 * max(cells.shape)] = 0
    total = bright.sum()
    spread = 2 * math.sqrt(np.count_nonzero(bright) / math.pi)
    return Seen(
        float((bright * columns).sum() / total) * 2 + 0.5 + origin[1],
        float((bright * rows).sum() / total) * 2 + 0.5 + origin[0],
        math.hypot(_LEAST_STD, _SPOT_STD * spread),
    )


def _bright_line(codes: np.ndarray, first: int, outline: QuickOutline | None) -> Seen | None:
    width = codes.shape[1] // 2 * 2
    profile = codes[: codes.shape[0] // 2 * 2, :width].astype(np.float64).mean(axis=0).reshape(-1, 2).mean(axis=1)
    columns = np.arange(profile.size) * 2 + 0.5 + first
    if outline is not None:
        profile = np.where(np.abs(columns - outline.column) < outline.radius, profile, profile.min())
    level = float(np.quantile(profile, 0.1))
    peak = int(profile.argmax())
    if profile[peak] - level < 20.0:
        return None
    bright = np.where(profile - level > 0.5 * (profile[peak] - level), profile - level, 0.0)
    bright[np.abs(np.arange(profile.size) - peak) > 0.2 * profile.size] = 0
    half = float(np.count_nonzero(bright))
    column = float((bright * columns).sum() / bright.sum())
    # in half widths of the line; small, because the profile is the mean of many rows
    return Seen(column, math.nan, math.hypot(_LEAST_STD, 0.15 * half))
