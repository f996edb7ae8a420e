"""Whether a table shows the camera that took it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

_IN_PLANE, _ACROSS = 0.95, 0.3
_LAST = 75  # degrees of theta_d
_GAUSSIAN = np.sqrt(2 * np.log(2))  # half width at half maximum over standard deviation
_SIGNIFICANT, _WIDENING = 5.0, 1.15


class LobeWidths(NamedTuple):
    """Half widths at half maximum in theta_h, rad, one per theta_d of the table; NaN where there is no lobe."""

    in_plane: np.ndarray
    """In the plane of light and view."""
    across: np.ndarray


def lobe_widths(table: xr.DataArray) -> LobeWidths:
    """Of the BRDF, mean over channels."""
    along = np.abs(np.cos(table["phi_d"].values))
    return LobeWidths(
        *(
            _half_widths(table.values[:, :, chosen], table["theta_h"].values)
            for chosen in (along > _IN_PLANE, along < _ACROSS)
        )
    )


def camera_trace(table: xr.DataArray) -> dict[str, Any]:
    """Whether lobes widen as a camera makes them: in the plane of light and view, width^2 = lobe^2 + (kernel / cos theta_d)^2,
    and not across it (MODEL 3). Plain numbers: `visible`; `kernel_rad` and `lobe_rad`, standard deviations as of Gaussians;
    `significance` of the kernel's term; `widening` in the plane over that across, from normal view to 75 degrees.

    Visible: significance above 5 and widening above 1.15. Then a camera, a lamp's disc across, or a finish that widens by
    itself in this way was there; None where too few angles show a lobe.
    """
    widths = lobe_widths(table)
    theta_d = table["theta_d"].values
    cos = np.cos(theta_d)
    known = np.isfinite(widths.in_plane) & np.isfinite(widths.across) & (theta_d < np.radians(_LAST))
    # broad lobes reach the horizon, where they are cut
    known &= theta_d + 3 * np.nan_to_num(widths.in_plane, nan=9.0) < np.pi / 2
    if known.sum() < 20:
        return {"visible": None, "kernel_rad": None, "lobe_rad": None, "significance": None, "widening": None}
    squares = (widths.in_plane[known] / _GAUSSIAN) ** 2
    basis = np.stack([np.ones(known.sum()), cos[known] ** -2], axis=-1)
    fitted, *_ = np.linalg.lstsq(basis, squares, rcond=None)
    left = squares - basis @ fitted
    covariance = np.linalg.inv(basis.T @ basis) * np.sum(left**2) / (known.sum() - 2)
    significance = float(fitted[1] / max(np.sqrt(covariance[1, 1]), 1e-300))
    ratio = (widths.in_plane / widths.across)[known]
    widening = float(np.median(ratio[-5:]) / np.median(ratio[:5]))
    return {
        "visible": bool(significance > _SIGNIFICANT and widening > _WIDENING),
        "kernel_rad": float(np.sqrt(max(fitted[1], 0.0))),
        "lobe_rad": float(np.sqrt(max(fitted[0], 0.0))),
        "significance": significance,
        "widening": widening,
    }


def _half_widths(values: np.ndarray, theta_h: np.ndarray) -> np.ndarray:
    """values: (theta_h, theta_d, phi_d, channel). Linear between the grid's points, from the first one's value down."""
    present = np.isfinite(values)
    count = present.sum(axis=(2, 3))
    mean = np.where(count > 0, np.where(present, values, 0).sum(axis=(2, 3)) / np.maximum(count, 1), np.nan)
    found = np.full(values.shape[1], np.nan)
    for k in range(values.shape[1]):
        if not mean[0, k] > 0:
            continue
        relative = mean[:, k] / mean[0, k]
        below = np.flatnonzero(relative < 0.5)
        if below.size and below[0]:
            i = int(below[0])
            found[k] = np.interp(-0.5, -relative[i - 1 : i + 1], theta_h[i - 1 : i + 1])
    return found
