"""Quick outline of a sphere or cylinder, and check for motion of the sample.

The outline is specified, or it is measured in a mask or in outline frames. The accuracy is a few tenths of a pixel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from matcam.acquisition.limb.backlight import field_reach, grazing_reflection
from matcam.acquisition.limb.clipped_field import field_is_clipped, hidden_by_clipping
from matcam.acquisition.limb.given_outline import given_outline
from matcam.acquisition.limb.straight_outline import straight_outline
from matcam.acquisition.mosaic_frames import MosaicReader, origin_of
from matcam.acquisition.outline import Sighting
from matcam.core.errors import FitError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture
from matcam.files.capture_frames import CaptureFrame

_MOVED = 1.0
"""Shift between two outline frames, px, above which a motion of the sample is reported. A disc is measured to about 0.3
px.
"""
_DISC_STD = 0.4
"""Standard deviation of centre and radius from the moments of the disc, px: measured on simulated frames, rounded up."""
_STATED_STD = 0.5
"""Standard deviation of an axis or radius of a cylinder that is specified without a standard deviation, px."""

_NO_SPHERE = (
    "there is no outline frame, so lit limbs or highlights determine the radius of the sphere: add a frame to outline/"
)
_NO_CYLINDER = (
    "the cylinder has no outline, which `reconstruct` requires: add a frame of the cylinder in front of a bright "
    "field to outline/, or specify sample.outline_radius_px and sample.axis_column_px"
)


class QuickOutline(NamedTuple):
    """Outline of the sample.

    Attributes:
        column: column of the centre of a sphere or the axis of a cylinder, px.
        row: row of the centre, px; NaN for a cylinder.
        radius: radius of the limb of a sphere, or half the distance between the edges of a cylinder, px.
        std: standard deviations of column, row and radius, px (3,); NaN for the row of a cylinder.
    """

    column: float
    row: float
    radius: float
    std: np.ndarray


def quick_outline(capture: Capture, black: float, sigma: float) -> tuple[QuickOutline | None, list[Remark]]:
    """Find the outline of a sphere or cylinder, and measure every outline frame.

    The sources are the same as in a reconstruction. For a sphere, a specified circle is preferred to a mask, and a mask to
    outline frames. For a cylinder, outline frames are preferred to the specified outline.

    Args:
        capture: capture of a sphere or a cylinder.
        black: code without light, DN.
        sigma: standard deviation of the lens's blur, px; used if the bright field is clipped.

    Returns:
        The outline, or None if there is none, and remarks. If outline frames are the source, the outline is that of the
        first usable frame. The remarks report a missing outline, an unusable source, a clipped field, or a sample that
        moved.
    """
    cylinder = capture.settings["sample"]["kind"] == "cylinder"
    frames = capture.of("outline")
    given, found = (_stated(capture), []) if cylinder else _given(capture, sigma)
    if not frames:
        if given is None:
            found.append(Remark("no-outline", _NO_CYLINDER if cylinder else _NO_SPHERE))
        return given, found
    reader = MosaicReader(capture)
    positions: list[tuple[CaptureFrame, QuickOutline]] = []
    for frame, codes in reader.readable(frames, capture.region, found):
        position, said = _measured(capture, reader, frame, codes, black, sigma)
        found += said
        if position is not None:
            positions.append((frame, position))
    what = "cylinder" if cylinder else "sphere"
    for frame, position in positions[1:]:
        first = positions[0][1]
        moved = float(np.hypot(position.column - first.column, 0.0 if cylinder else position.row - first.row))
        if moved > _MOVED or abs(position.radius - first.radius) > _MOVED:
            path = capture.folder / frame.file
            text = f"{path}: the {what} is {moved:.1f} px from its position in {positions[0][0].file}: fasten it, and repeat"
            found.append(Remark(f"{what}-moved", text))
    if positions and (cylinder or given is None):
        return positions[0][1], found
    return given, found


def _measured(
    capture: Capture, reader: MosaicReader, frame: CaptureFrame, codes: np.ndarray, black: float, sigma: float
) -> tuple[QuickOutline | None, list[Remark]]:
    path = capture.folder / frame.file
    origin, reach = origin_of(capture.region), field_reach(capture)
    found: list[Remark] = []
    hidden = 0.0
    if field_is_clipped(codes, reader.saturation):
        hidden, remark = hidden_by_clipping(path, sigma)
        found.append(remark)
    if capture.settings["sample"]["kind"] == "cylinder":
        try:
            stripe = straight_outline(
                codes.astype(np.float64) - black,
                reader.channel_map(codes.shape, capture.region),
                origin=origin,
                reach=reach,
            )
        except FitError as error:
            return None, [*found, Remark("no-stripe", f"{path}: {error}")]
        across, along = np.sqrt(np.diag(stripe.covariance))
        std = np.array([across, math.nan, math.hypot(along, hidden)])
        return QuickOutline(stripe.column, math.nan, stripe.radius + hidden, std), [*found, *stripe.remarks]
    column, row, radius = dark_disc(codes)
    if not math.isfinite(radius):
        text = (
            f"{path}: the frame shows no dark disc inside a bright field: photograph the sphere in front of a bright "
            "background"
        )
        return None, [*found, Remark("no-disc", text)]
    mirrored, spread = grazing_reflection(radius, reach)
    std = np.array([_DISC_STD, _DISC_STD, math.hypot(_DISC_STD, spread, hidden)])
    return QuickOutline(column + origin[1], row + origin[0], radius + mirrored + hidden, std), found


def _given(capture: Capture, sigma: float) -> tuple[QuickOutline | None, list[Remark]]:
    try:
        outline = given_outline(capture, Sighting(), sigma)
    except MatcamError as error:
        return None, [Remark("outline-left-out", str(error))]
    if outline is None:
        return None, []
    return QuickOutline(outline.column, outline.row, outline.radius, outline.std[[1, 0, 2]]), []


def _stated(capture: Capture) -> QuickOutline | None:
    radius, axis = capture.stated("outline_radius_px"), capture.stated("axis_column_px")
    if radius is None or axis is None:
        return None
    std = np.array([axis.std or _STATED_STD, math.nan, radius.std or _STATED_STD])
    return QuickOutline(axis.value, math.nan, radius.value, std)


def dark_disc(codes: np.ndarray) -> tuple[float, float, float]:
    """Estimate column, row and radius of a dark disc in front of a bright field, px.

    The disc reduces the light of the field. The area and the first moments of the missing light determine the disc to a
    few tenths of a pixel. All results are NaN if there is no disc, or if the border of the frame cuts the disc.

    Args:
        codes: frame, (height, width), DN.
    """
    # bins of 2 x 2 px contain all colours of a mosaic
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
