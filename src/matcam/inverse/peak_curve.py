"""Fresnel term from the peaks of a table, without a fit or a camera, and Fresnel term of a conductor."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNEL_WAVELENGTHS, merl_grid, sampling_of
from matcam.material.optical_constants import metal
from matcam.material.reflectance import fresnel_conductor

NORMALISED_OVER = (np.radians(10.0), np.radians(45.0))
"""Range of theta_d, rad, over which a curve has mean 1. It is the default range of `fresnel`. Below 10 degrees lamp and camera
occlude each other on real rigs; F of metals is flat up to 45 degrees.
"""


def recorded_peak(brdf: xr.DataArray, theta_d: np.ndarray) -> np.ndarray:
    """Average the cells nearest to the highlight in each slice, 1/sr.

    The result has shape (channels, slices). It is NaN where these cells are missing or their mean is not positive.

    theta_d: theta_d of the slices, rad, (slices,).
    """
    ring = brdf.values[merl_grid(sampling_of(brdf)).index(theta_h=0.0, theta_d=theta_d)]
    count = np.isfinite(ring).sum(axis=1)
    peak = np.where(count > 0, np.nansum(ring, axis=1) / np.maximum(count, 1), np.nan).T
    return np.where(np.nan_to_num(peak) > 0, peak, np.nan)


def peak_curve(table: xr.DataArray) -> xr.DataArray:
    """Compute the peak times cos^2 theta_d, normalised over theta_d.

    The mean from 10 to 45 degrees is 1. For a lobe of constant shape and without masking the curve is the normalised
    Fresnel term (docs/model.md 6).

    Args:
        table: BRDF on the MERL grid, 1/sr.

    Returns:
        Curve over (theta_d, channel), no unit; NaN where the peak is missing or not positive.
    """
    theta_d = table["theta_d"].values
    values = (recorded_peak(table, theta_d) * np.cos(theta_d) ** 2).T
    return xr.DataArray(
        _normalised(values, theta_d),
        dims=("theta_d", "channel"),
        coords={"theta_d": table["theta_d"], "channel": table["channel"]},
        attrs={"units": "1", "long_name": "recorded peak times cos^2 theta_d, normalised"},
    )


def metal_curve(name: str, theta_d: np.ndarray) -> np.ndarray:
    """Compute the Fresnel term of a metal from its tabulated refractive index.

    The term has shape (angles, 3) and no unit. It is normalised as in `peak_curve`.

    Args:
        name: name of the metal, such as "Cr".
        theta_d: difference angle, rad, (angles,).
    """
    n, k, _ = metal(name, CHANNEL_WAVELENGTHS)
    return conductor_curve(n, k, theta_d)


def conductor_curve(n: np.ndarray, k: np.ndarray, theta_d: np.ndarray) -> np.ndarray:
    """Compute the Fresnel term of a conductor.

    The term has shape (angles, channels) and no unit. It is normalised as in `peak_curve`.

    Args:
        n: refractive index of each channel, no unit, (channels,).
        k: extinction coefficient of each channel, no unit, (channels,).
        theta_d: difference angle, rad, (angles,).
    """
    values = np.asarray(fresnel_conductor(np.asarray(theta_d)[:, None], n, k))
    return _normalised(values, np.asarray(theta_d))


def _normalised(values: np.ndarray, theta_d: np.ndarray) -> np.ndarray:
    low, high = NORMALISED_OVER
    used = values[(theta_d >= low) & (theta_d <= high)]
    known = np.isfinite(used)
    mean = np.where(known, used, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(mean > 0, values / mean, np.nan)
