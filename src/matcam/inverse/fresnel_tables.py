"""Comparison of a measured Fresnel term with the Fresnel terms of metals and dielectrics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNEL_WAVELENGTHS, CHANNELS
from matcam.core.results.labelled import named
from matcam.material.optical_constants import metal as metal_index
from matcam.material.optical_constants import metals
from matcam.material.reflectance import fresnel_conductor

_DIMS = ("theta_d", "channel")
_REFRACTIVE = (1.3, 1.4, 1.5, 1.6, 1.7, 1.8)
"""Refractive indices of the dielectrics with which a result is compared. They cover common polymers and glasses."""
_NAMES = {
    "tabulated": "F of tabulated optical constants, normalised",
    "tabulated_f0": "F of tabulated optical constants at normal incidence",
    "rms_corrected": "rms of corrected / tabulated - 1",
    "rms_raw": "rms of raw / tabulated - 1",
}
"""Descriptive names of the variables of the result."""


def check_fresnel_result(result: xr.Dataset) -> None:
    """Raise ArgumentError if a result is not a Dataset from `fresnel`."""
    checks.instance("result", result, xr.Dataset)
    dims = {"theta_d": ("theta_d",), "raw": _DIMS, "corrected": _DIMS, "supported_angle": _DIMS[1:]}
    lacking = [name for name, wanted in dims.items() if name not in result.variables or result[name].dims != wanted]
    lacking += [] if np.shape(result.attrs.get("normalised_over", 0)) == (2,) else ["attrs['normalised_over']"]
    if lacking:
        raise ArgumentError(
            "result must be a Dataset from fresnel, but these entries are missing or have other dimensions: "
            f"{', '.join(lacking)}"
        )


def known_wavelengths(table: xr.DataArray | xr.Dataset) -> tuple[float, ...] | None:
    """Look up the wavelength of each channel of a table, m.

    If three channels have other names than R, G and B, they are assumed to be R, G and B in this order. The result is None for
    other channels with unknown names.
    """
    labels = [str(label) for label in table["channel"].values]
    if len(labels) == len(CHANNELS) and set(labels) != set(CHANNELS):
        labels = list(CHANNELS)
    found = dict(zip(CHANNELS, CHANNEL_WAVELENGTHS, strict=True))
    return tuple(found[label] for label in labels) if set(labels) <= set(found) else None


def tabulated_fresnel(
    result: xr.Dataset, metal: str | None = None, wavelengths: Sequence[float] | None = None
) -> xr.Dataset:
    """Compare a measured Fresnel term with metals and dielectrics.

    The Fresnel terms of metals are computed from published optical constants.

    Args:
        result: Dataset from `fresnel`.
        metal: name of a metal in `metals`. Default: None, all metals, and dielectrics with refractive indices from 1.3 to
            1.8 in steps of 0.1.
        wavelengths: wavelength of each channel, m, (channels,). Default: None, 610, 550 and 465 nm for channels with the names
            R, G and B, or for any three channels in this order. Other channels require their own wavelengths.

    Returns:
        Dataset over (table, theta_d, channel), without unit:

        - `tabulated`: F from the refractive index of each table, normalised over the same range of theta_d as `result`.
        - `tabulated_f0`: F at normal incidence, not normalised, (table, channel).
        - `rms_corrected`, `rms_raw`: rms over theta_d of (corrected / tabulated - 1) and (raw / tabulated - 1), (table,
          channel). theta_d extends from the start of the range of the normalisation to the supported angle. Both are NaN if
          there is no F in this interval.

    Raises:
        ArgumentError: the metal is unknown, the wavelengths are unknown or their number is not the number of channels, or
            `result` lacks a variable.

    Source:
        `metals` lists the tables.

    Example:
        >>> import xarray as xr
        >>> theta_d = np.radians(np.arange(5.0, 80.0, 10.0))
        >>> curve = (("theta_d", "channel"), np.ones((8, 1)))
        >>> found = xr.Dataset(
        ...     {"raw": curve, "corrected": curve, "supported_angle": ("channel", [1.3])},
        ...     coords={"theta_d": theta_d, "channel": ["G"]},
        ...     attrs={"normalised_over": [0.17, 0.79]},
        ... )
        >>> matcam.inverse.tabulated_fresnel(found, "Cr", [550e-9])["tabulated_f0"].values.round(2).ravel()
        array([0.55, 0.65, 0.68])
    """
    check_fresnel_result(result)
    channels = result.sizes["channel"]
    wavelengths = known_wavelengths(result) if wavelengths is None else wavelengths
    if wavelengths is None:
        raise ArgumentError(
            f"the wavelengths of the channels {', '.join(map(str, result['channel'].values))} are unknown; "
            "specify them by the argument wavelengths"
        )
    if len(wavelengths) != channels:
        raise ArgumentError(
            f"wavelengths must have length {channels}, one value per channel of the result, got {len(wavelengths)}"
        )
    theta_d = result["theta_d"].values
    low, high = result.attrs["normalised_over"]
    inside = (theta_d >= low) & (theta_d <= high)
    judged = (theta_d[:, None] >= low) & (theta_d[:, None] <= result["supported_angle"].values)
    tables = [(name, source) for name, sources in metals(metal).items() for source in sources]
    indices = [metal_index(name, wavelengths, source) for name, source in tables]
    names = [f"{name} ({source})" for name, source in tables]
    n, k = (np.stack([getattr(index, part) for index in indices]) for part in ("n", "k"))
    if metal is None:
        names += [f"dielectric (n = {index:g})" for index in _REFRACTIVE]
        clear = np.repeat(np.array(_REFRACTIVE)[:, None], channels, axis=1)
        n, k = np.concatenate([n, clear]), np.concatenate([k, 0 * clear])
    n, k = n[:, None, :], k[:, None, :]
    *curves, f0 = np.asarray(fresnel_conductor(np.append(theta_d, 0.0)[:, None], n, k)).transpose(1, 0, 2)
    normalised = np.stack(curves, axis=1)
    normalised /= normalised[:, inside].mean(axis=1, keepdims=True)

    def rms(name: str) -> np.ndarray:
        squared = (result[name].values / normalised - 1) ** 2
        used = judged & np.isfinite(squared)
        count = used.sum(axis=1)
        return np.sqrt(np.where(count > 0, np.where(used, squared, 0).sum(axis=1) / np.maximum(count, 1), np.nan))

    found = xr.Dataset(
        {
            "tabulated": (("table", "theta_d", "channel"), normalised),
            "tabulated_f0": (("table", "channel"), f0),
            "rms_corrected": (("table", "channel"), rms("corrected")),
            "rms_raw": (("table", "channel"), rms("raw")),
        },
        coords={
            "table": names,
            "theta_d": result["theta_d"],
            "channel": result["channel"],
        },
        attrs={"wavelengths_m": list(wavelengths)},
    )
    return named(found, _NAMES)
