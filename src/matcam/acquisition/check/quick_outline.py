"""Outline of a sphere or cylinder in the frames before a bright field, to a few tenths of a pixel, and whether it moved."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.acquisition.limb.backlight import grazing_reflection
from matcam.acquisition.limb.straight_outline import straight_outline
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.core.errors import FileFormatError, FitError
from matcam.core.remark import Remark
from matcam.files.capture import Capture
from matcam.files.capture_frames import CaptureFrame

_MOVED = 1.0
"""Shift between two outline frames, px, from which the sample is reported to have moved. A disc is measured to about 0.3 px."""
_DISC_STD = 0.4
"""Standard deviation of the disc's centre and radius by moments, px: measured on drawn frames, rounded up."""
_STATED_STD = 0.5
"""Standard deviation of a stated axis or radius of a cylinder that has none, px."""


class QuickOutline(NamedTuple):
    """Outline of the sample.

    Attributes:
        column: of the centre of a sphere or the axis of a cylinder, px.
        row: of the centre, px; NaN for a cylinder.
        radius: of the limb, or half the distance of the edges, px.
        std: standard deviations of column, row and radius, px (3,).
    """

    column: float
    row: float
    radius: float
    std: np.ndarray


def quick_outline(capture: Capture, black: float) -> tuple[QuickOutline | None, list[Remark]]:
    """Measure the outline of a sphere or cylinder in every outline frame.

    Args:
        capture: of a sphere or a cylinder.
        black: code without light, DN.

    Returns:
        The outline in the first frame that shows one, or None, and the remarks: no outline, or a sample that moved.
    """
    cylinder = capture.settings["sample"]["kind"] == "cylinder"
    what = "cylinder" if cylinder else "sphere"
    frames = capture.of("outline")
    if not frames:
        return _stated(capture) if cylinder else (None, [_missing("sphere")])
    reader = MosaicReader(capture)
    beyond = math.radians(capture.settings["outline"]["field_beyond_deg"])
    reach = (beyond, beyond / 3)
    places: list[tuple[CaptureFrame, QuickOutline]] = []
    found: list[Remark] = []
    for frame in frames:
        path = capture.folder / frame.file
        try:
            codes = reader.read(frame, capture.region)
        except FileFormatError as error:
            found.append(Remark("bad-frame", str(error)))
            continue
        origin = (0, 0) if capture.region is None else (capture.region[1], capture.region[0])
        if cylinder:
            try:
                stripe = straight_outline(
                    codes.astype(np.float64) - black,
                    reader.channel_map((codes.shape[0], codes.shape[1]), origin),
                    origin=origin,
                    reach=reach,
                )
            except FitError as error:
                found.append(Remark("no-stripe", f"{path}: {error}"))
                continue
            found += stripe.remarks
            std = np.sqrt(np.diag(stripe.covariance))
            places.append(
                (frame, QuickOutline(stripe.column, math.nan, stripe.radius, np.array([std[0], math.nan, std[1]])))
            )
            continue
        column, row, radius = dark_disc(codes)
        if not math.isfinite(radius):
            found.append(Remark("no-disc", f"{path}: shows no dark disc inside of a bright field"))
            continue
        mirrored, spread = grazing_reflection(radius, reach)
        std = np.array([_DISC_STD, _DISC_STD, math.hypot(_DISC_STD, spread)])
        places.append((frame, QuickOutline(column + origin[1], row + origin[0], radius + mirrored, std)))
    for frame, place in places[1:]:
        first = places[0][1]
        moved = float(np.hypot(place.column - first.column, 0.0 if cylinder else place.row - first.row))
        if moved > _MOVED or abs(place.radius - first.radius) > _MOVED:
            path = capture.folder / frame.file
            text = f"{path}: the {what} is {moved:.1f} px from where {places[0][0].file} shows it"
            found.append(Remark(f"{what}-moved", text))
    return (places[0][1] if places else None), found


def _missing(what: str) -> Remark:
    text = f"there is no outline frame: the {what}'s radius comes from lit limbs or highlights alone"
    return Remark("no-outline", text)


def _stated(capture: Capture) -> tuple[QuickOutline | None, list[Remark]]:
    """Return the outline of a cylinder as capture.toml states it."""
    radius, axis = capture.stated("outline_radius_px"), capture.stated("axis_column_px")
    if radius is None or axis is None:
        text = "give a frame of the cylinder before a bright field, in outline/, or state sample.outline_radius_px and "
        return None, [Remark("no-outline", f"{text}sample.axis_column_px: `reconstruct` needs one of them")]
    std = np.array([axis.std or _STATED_STD, math.nan, radius.std or _STATED_STD])
    return QuickOutline(axis.value, math.nan, radius.value, std), []


def dark_disc(codes: np.ndarray) -> tuple[float, float, float]:
    """Compute column, row and radius, px, of a dark disc before a bright field, to a few tenths of a pixel.

    The area and the first moments of the missing light give them. NaN: there is no disc, or the frame cuts it.

    Args:
        codes: frame, (height, width).
    """
    # 2 x 2 px together: a mosaic's colours
    height, width = (n // 2 * 2 for n in codes.shape)
    cells = codes[:height, :width].reshape(height // 2, 2, width // 2, 2).mean((1, 3), dtype=np.float64)
    dark, bright = np.quantile(cells, [0.01, 0.99])
    lacking = np.clip((bright - cells) / max(bright - dark, 1e-9), 0, 1)
    lacking[lacking < 0.2] = 0
    area = lacking.sum()
    border = np.concatenate([lacking[0], lacking[-1], lacking[:, 0], lacking[:, -1]])
    if bright < 1.5 * max(dark, 1.0) or area < 50 or np.mean(border > 0.5) > 0.02:
        return math.nan, math.nan, math.nan
    rows, columns = np.indices(cells.shape)
    row, column = (float((lacking * index).sum() / area) * 2 + 0.5 for index in (rows, columns))
    return column, row, 2 * math.sqrt(area / math.pi)
