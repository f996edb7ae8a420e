"""Published Fresnel curves of metals beside a measured one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from matcam.errors import ArgumentError
from matcam.material.metals import metal as metal_index
from matcam.material.metals import metal_sources, metals
from matcam.material.reflectance import fresnel_conductor
from matcam.table import CHANNEL_WAVELENGTHS


def tabulated_fresnel(
    result: xr.Dataset, metal: str | None = None, wavelengths: Sequence[float] = CHANNEL_WAVELENGTHS
) -> xr.Dataset:
    """Conductor Fresnel curves of every table that the package carries for `metal` (None: for all metals).

    result: from `fresnel`. wavelengths: m, one per channel of it. Returns a Dataset over (table, theta_d, channel):
      tabulated            F of the table's n, k, normalised over the same range of theta_d as `result`
      tabulated_f0         F at normal incidence, (table, channel)
      rms_corrected, rms_raw    rms over theta_d of (result / tabulated - 1), from the start of the normalisation to
                           the supported angle, (table, channel); NaN where nothing is supported
    """
    channels = result.sizes["channel"]
    if len(wavelengths) != channels:
        raise ArgumentError(f"wavelengths must be {channels}, one per channel of the result, got {len(wavelengths)}")
    theta_d = result["theta_d"].values
    low, high = result.attrs["normalised_over"]
    inside = (theta_d >= low) & (theta_d <= high)
    judged = (theta_d[:, None] >= low) & (theta_d[:, None] <= result["supported_angle"].values)
    tables = [(name, source) for name in (metals() if metal is None else [metal]) for source in metal_sources(name)]
    indices = [metal_index(name, wavelengths, source) for name, source in tables]
    n, k = (np.stack([getattr(index, part) for index in indices])[:, None, :] for part in ("n", "k"))
    *curves, f0 = np.asarray(fresnel_conductor(np.append(theta_d, 0.0)[:, None], n, k)).transpose(1, 0, 2)
    normalised = np.stack(curves, axis=1)
    normalised /= normalised[:, inside].mean(axis=1, keepdims=True)

    def rms(name: str) -> np.ndarray:
        squared = (result[name].values / normalised - 1) ** 2
        used = judged & np.isfinite(squared)
        count = used.sum(axis=1)
        return np.sqrt(np.where(count > 0, np.where(used, squared, 0).sum(axis=1) / np.maximum(count, 1), np.nan))

    return xr.Dataset(
        {
            "tabulated": (("table", "theta_d", "channel"), normalised),
            "tabulated_f0": (("table", "channel"), f0),
            "rms_corrected": (("table", "channel"), rms("corrected")),
            "rms_raw": (("table", "channel"), rms("raw")),
        },
        coords={
            "table": [f"{name} ({source})" for name, source in tables],
            "theta_d": result["theta_d"],
            "channel": result["channel"],
        },
        attrs={"wavelengths_m": list(wavelengths)},
    )
