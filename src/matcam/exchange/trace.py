"""The trace of a camera in a table: lobes that widen in the plane of light and view, and not across it.

A camera widens a lobe in that plane as width^2 = lobe^2 + (kernel / cos theta_d)^2 (docs/model.md 3). A lamp's disc
widens it across instead. Nothing here needs a model of the material.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

_IN_PLANE, _ACROSS = 0.95, 0.3  # |cos phi_d| above and below which cells count as in the plane, and across
_STEEPEST = np.radians(75)  # of theta_d
_FEWEST = 20  # angles with a lobe
_HWHM = np.sqrt(2 * np.log(2))  # half width at half maximum over the standard deviation of a Gaussian
_SIGNIFICANCE, _WIDENING = 5.0, 1.15


class LobeWidths(NamedTuple):
    """Half widths of a lobe at half maximum, in theta_h.

    There is one for every theta_d of the table; it is NaN where there is no lobe.

    Attributes:
        in_plane: half widths in the plane of light and view, (theta_d,), rad.
        across: half widths across that plane, (theta_d,), rad.

    Example:
        >>> widths = matcam.exchange.LobeWidths(in_plane=np.full(90, 0.07), across=np.full(90, 0.06))
        >>> widths.in_plane.shape
        (90,)
    """

    in_plane: np.ndarray
    across: np.ndarray


def lobe_widths(table: xr.DataArray) -> LobeWidths:
    """Measure the lobe's half width at half maximum at every theta_d.

    The BRDF is averaged over the channels, and over the cells within 18 degrees of the plane of light and view, or beyond 72
    degrees from it. It is linear between the grid's angles. The maximum is the value at the first theta_h.

    Args:
        table: BRDF on the MERL grid, (90, 90, 180, channels), 1/sr, such as `read_merl` returns.

    Returns:
        `LobeWidths`: arrays `in_plane` and `across`, (90,), rad, NaN where there is no lobe.

    Source:
        docs/model.md 3.

    Example:
        >>> material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> table = matcam.measure(material, matcam.Rig(matcam.rigs.merl().camera, matcam.Flat()))
        >>> print(np.round(matcam.exchange.lobe_widths(table).across[:3], 3))
        [0.065 0.065 0.065]
    """
    along = np.abs(np.cos(table["phi_d"].values))
    theta_h = table["theta_h"].values
    return LobeWidths(
        in_plane=_half_widths(table.values[:, :, along > _IN_PLANE], theta_h),
        across=_half_widths(table.values[:, :, along < _ACROSS], theta_h),
    )


def camera_trace(table: xr.DataArray) -> dict[str, Any]:
    """Tell whether lobes widen as a camera makes them.

    The squares of the widths in the plane of light and view are fitted by lobe^2 + (kernel / cos theta_d)^2. The camera is
    visible where the kernel's term stands out 5 times over its standard deviation, and the widening is above 1.15. Then a
    camera was there, or a finish that widens by itself in this way.

    Args:
        table: BRDF on the MERL grid, (90, 90, 180, channels), 1/sr, such as `read_merl` returns.

    Returns:
        Plain values, all None where too few angles show a lobe: `visible`; `kernel_rad` and `lobe_rad`, standard deviations of
        Gaussians, rad; `significance` of the kernel's term; `widening` from normal view to 75 degrees, in the plane over
        that across.

    Source:
        docs/model.md 3.

    Example:
        >>> material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> table = matcam.measure(material, matcam.Rig(matcam.rigs.merl().camera, matcam.Flat()))
        >>> matcam.exchange.camera_trace(table)["visible"]
        False
    """
    widths = lobe_widths(table)
    theta_d = table["theta_d"].values
    cos = np.cos(theta_d)
    known = np.isfinite(widths.in_plane) & np.isfinite(widths.across) & (theta_d < _STEEPEST)
    # broad lobes reach the horizon, where they are cut
    known &= theta_d + 3 * np.nan_to_num(widths.in_plane, nan=9.0) < np.pi / 2
    if known.sum() < _FEWEST:
        return {"visible": None, "kernel_rad": None, "lobe_rad": None, "significance": None, "widening": None}
    squares = (widths.in_plane[known] / _HWHM) ** 2
    basis = np.stack([np.ones(known.sum()), cos[known] ** -2], axis=-1)
    (lobe2, kernel2), *_ = np.linalg.lstsq(basis, squares, rcond=None)
    left = squares - basis @ [lobe2, kernel2]
    covariance = np.linalg.inv(basis.T @ basis) * np.sum(left**2) / (known.sum() - 2)
    significance = float(kernel2 / max(np.sqrt(covariance[1, 1]), 1e-300))
    ratio = (widths.in_plane / widths.across)[known]
    widening = float(np.median(ratio[-5:]) / np.median(ratio[:5]))
    return {
        "visible": bool(significance > _SIGNIFICANCE and widening > _WIDENING),
        "kernel_rad": float(np.sqrt(max(kernel2, 0.0))),
        "lobe_rad": float(np.sqrt(max(lobe2, 0.0))),
        "significance": significance,
        "widening": widening,
    }


def _half_widths(values: np.ndarray, theta_h: np.ndarray) -> np.ndarray:
    """Return the half width at each theta_d.

    The values (theta_h, theta_d, phi_d, channel) are linear between the angles.
    """
    present = np.isfinite(values)
    count = present.sum(axis=(2, 3))
    mean = np.where(count > 0, np.where(present, values, 0).sum(axis=(2, 3)) / np.maximum(count, 1), np.nan)
    widths = np.full(values.shape[1], np.nan)
    for k in range(values.shape[1]):
        if not mean[0, k] > 0:
            continue
        relative = mean[:, k] / mean[0, k]
        below = np.flatnonzero(relative < 0.5)
        if below.size and below[0]:
            i = int(below[0])
            widths[k] = np.interp(-0.5, -relative[i - 1 : i + 1], theta_h[i - 1 : i + 1])
    return widths
