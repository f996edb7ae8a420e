"""Summaries of Datasets: Fresnel term, corrected table, and bounds of a rig."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.core.grid import DIMS
from matcam.core.remark import from_attribute
from matcam.core.results.summary import Quantity, Summary, half_width

_ANGLES = (5, 15, 30, 45, 60, 75)
"""Values of theta_d in a summary, degrees. They range from near normal incidence to the minimum of F of a metal."""


def fresnel_summary(data: xr.Dataset) -> Summary:
    theta, channels = data["theta_d"].values, [str(name) for name in data["channel"].values]
    middle = len(channels) // 2
    rows = [int(np.argmin(np.abs(theta - np.radians(angle)))) for angle in _ANGLES]
    curve, std = (data[name].values[:, middle] for name in ("corrected", "corrected_std"))
    low, high = np.degrees(data.attrs["normalised_over"])
    ends = ", ".join(
        f"{name} {np.degrees(angle):.0f}°" for name, angle in zip(channels, data["supported_angle"].values, strict=True)
    )
    verdict = (
        "Rig and data contradict each other: F is not corrected for the camera."
        if data.attrs.get("withheld")
        else f"F is known to 5 % up to {ends}."
    )
    width = str(data["width"].attrs.get("long_name", "width of the lobe"))
    return Summary(
        _titled("Fresnel term", data),
        verdict,
        {
            f"F of channel {channels[middle]} divided by its mean from {low:.0f} to {high:.0f}°": [
                Quantity(f"theta_d = {np.degrees(theta[row]):.1f}°", float(curve[row]), float(std[row]))
                for row in dict.fromkeys(rows)
            ],
            "Lobe": [
                Quantity(width, float(data["width"]), float(data["width_std"])),
                half_width(float(data["hwhm"]), float(data["hwhm_std"])),
            ],
        },
        from_attribute(str(data.attrs.get("remarks", ""))),
    )


def corrected_summary(data: xr.Dataset) -> Summary:
    """Summarise a result of `correct`, or the table of a reconstruction."""
    known = np.isfinite(data["brdf_std"].values)
    share = float(data["supported"].values[known].mean()) if known.any() else 0.0
    verdict = (
        "Rig and data contradict each other, so the table is unchanged. No entry is supported."
        if data.attrs.get("withheld")
        else f"The correction leaves less than 5 % of the value uncertain in {share:.0%} of the entries with known uncertainty."
    )
    theta = data["theta_d"].values
    rows = [int(np.argmin(np.abs(theta - np.radians(angle)))) for angle in _ANGLES]
    kept = data["response"].mean("channel").transpose(*DIMS[:3]).values[0, :, len(data["phi_d"]) // 2]
    return Summary(
        _titled("Corrected table", data),
        verdict,
        {
            "Share of the peak that the camera lost": [
                Quantity(f"theta_d = {np.degrees(theta[row]):.1f}°", 1 - float(kept[row])) for row in rows
            ]
        },
        from_attribute(str(data.attrs.get("remarks", ""))),
    )


def bounds_summary(data: xr.Dataset) -> Summary:
    columns = {
        "Bound of ln roughness, lens exact": "width_std",
        "Bound of ln roughness, lens as specified by its profile": "width_std_stated",
        "Bound of ln roughness, lens free": "width_std_free",
    }
    names = [f"{data.attrs['ndf']}, roughness {value:g}" for value in data["roughness"].values]
    return Summary(
        "Bounds of a rig (Cramér-Rao)",
        sections={
            title: [Quantity(*pair) for pair in zip(names, data[name].values.tolist(), strict=True)]
            for title, name in columns.items()
            if np.isfinite(data[name].values).any()
        },
    )


def _titled(what: str, data: xr.Dataset) -> str:
    source = str(data.attrs.get("source", ""))
    return f"{what} of {source}" if source else what
