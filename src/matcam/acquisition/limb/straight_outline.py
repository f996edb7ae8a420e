"""Outline of a cylinder in front of a bright field: two edges, blurred by the lens.

Both edges are measured in blocks of rows, which shows whether the cylinder leans.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from matcam.acquisition.limb.backlight import grazing_reflection
from matcam.core.errors import FitError
from matcam.core.remark import Remark

_ABOUT = 9  # width of the fitted profile on either side of an edge, px


class StraightOutline(NamedTuple):
    """Outline of an upright cylinder.

    Attributes:
        column: column of the axis at the middle row, px.
        radius: half the distance between the edges, px.
        covariance: covariance of column and radius, px^2 (2, 2).
        lean: shift of the axis per row, px.
        remarks: warnings and limitations.
    """

    column: float
    radius: float
    covariance: np.ndarray
    lean: float = 0.0
    remarks: tuple[Remark, ...] = ()


def straight_outline(
    codes: np.ndarray,
    channel: np.ndarray,
    *,
    origin: tuple[int, int] = (0, 0),
    reach: tuple[float, float] | None = None,
) -> StraightOutline:
    """Find the two edges of an upright cylinder in front of a bright field.

    Args:
        codes: linear dark-subtracted image, (height, width), DN.
        channel: index of each pixel's colour, (height, width).
        origin: row and column of the first pixel in the frame, px. Default: (0, 0).
        reach: extent of the field beyond the outline, and its standard deviation, rad. Default: None, unknown.

    Returns:
        The outline, in px of the frame.

    Raises:
        FitError: there is no dark stripe between two bright fields, or the stripe or the field beside it is too narrow.
    """
    height, width = codes.shape
    levels = _levelled(codes, channel)
    low, high = np.quantile(levels.mean(axis=0), [0.02, 0.98])
    dark = levels.mean(axis=0) < (low + high) / 2
    inside = np.flatnonzero(dark)
    # smallest ratio of the bright field to the dark sample
    if high < 3.0 * max(low, 1e-3 * high) or not inside.size or inside.size < inside[-1] - inside[0] + 1 - 4:
        raise FitError(
            "outline: the frame shows no upright dark stripe in front of a bright field; repeat the frame, or specify "
            "sample.outline_radius_px and sample.axis_column_px"
        )
    left, right = inside[0] - 0.5, inside[-1] + 0.5
    if left < _ABOUT or right > width - 1 - _ABOUT or right - left < 4 * _ABOUT:
        raise FitError(
            f"outline: the dark stripe of columns {left + origin[1]:.0f} to {right + origin[1]:.0f} must be "
            f"{4 * _ABOUT} px wide or more, with {_ABOUT} px of the field on either side: use more pixels for the cylinder, "
            "or a wider field or region"
        )
    # largest number of blocks of rows
    borders = np.linspace(0, height, min(6, max(height // 4, 1)) + 1).round().astype(int)
    middle, edges = [], []
    for first, last in pairwise(borders.tolist()):
        middle.append((first + last - 1) / 2)
        edges.append([_edge(levels[first:last], at, side) for at, side in ((left, -1), (right, 1))])
    at, positions = np.array(middle) - (height - 1) / 2, np.array(edges)
    design = np.column_stack([np.ones_like(at), at])
    lines, *_ = np.linalg.lstsq(design, positions, rcond=None)
    freedom = max(len(at) - 2, 1)
    scatter = float(np.sqrt(((positions - design @ lines) ** 2).sum() / (2 * freedom))) if len(at) > 2 else 0.0
    # smallest standard deviation of an edge, px
    noise = max(scatter / np.sqrt(len(at)), 0.01)
    lean = float(lines[1].mean())
    upright = 1 / np.sqrt(1 + lean**2)
    seen = float(lines[0, 1] - lines[0, 0]) / 2 * upright
    mirrored, mirrored_std = grazing_reflection(seen, reach)
    remarks = []
    # largest shift of the axis over all rows without a remark, px
    if abs(lean) * height > 0.3:
        remarks.append(
            Remark(
                "cylinder-leans",
                f"the axis of the cylinder shifts by {abs(lean) * height:.1f} px over {height} rows: rotate the camera until "
                "the axis is upright",
            )
        )
    covariance = np.diag([noise**2 / 2, noise**2 / 2 + mirrored_std**2])
    column = float(lines[0].mean()) + origin[1]
    return StraightOutline(column, seen + mirrored, covariance, lean, tuple(remarks))


def _levelled(codes: np.ndarray, channel: np.ndarray) -> np.ndarray:
    levels = np.zeros(codes.shape)
    for one in range(int(channel.max()) + 1):
        of = channel == one
        bright = np.quantile(codes[of], 0.98) if of.any() else 1.0
        levels[of] = codes[of] / max(float(bright), 1e-12)
    return levels


def _edge(levels: np.ndarray, start: float, side: int) -> float:
    """Measure the column of an edge in a block of rows, px.

    `side` is -1 if the sample is to the right of the edge, otherwise 1.
    """
    first = int(np.floor(start)) - _ABOUT
    columns = np.arange(max(first, 0), min(first + 2 * _ABOUT + 2, levels.shape[1]))
    profile = levels[:, columns].mean(axis=0)

    def residual(p: np.ndarray) -> np.ndarray:
        position, log_width, low, high = p
        return low + (high - low) * ndtr(side * (columns - position) / np.exp(log_width)) - profile

    found = least_squares(residual, [start, np.log(0.7), profile.min(), profile.max()], x_scale=[1, 1, 0.1, 0.1])
    return float(found.x[0])
