"""Whether a table shows the camera that took it.

What can be seen in a file without any model.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, Sampling, below_horizon, sampling_of
from matcam.exchange.contents import Contents
from matcam.forward.measurement import true_table
from matcam.material.adaptive import Adaptive
from matcam.material.material import albedo
from matcam.material.tabulated import Tabulated

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


REPORTED_ANGLES = (0, 15, 30, 45, 60, 70, 75, 80)
"""Degrees: theta_d at which lobe widths are reported, theta_o at which albedos are."""


def inspect_contents(held: Contents) -> dict[str, Any]:
    """What is in a file of any format that holds measurements (see `read_contents`), as plain numbers (JSON): `holds`, and
    what there is to say of a table, RGL's fields (their own grid, and all that is said of a table after resampling), samples,
    another result or a picture."""
    if held.table is not None:
        return {"holds": held.kind, **inspect_table(held.table)}
    if held.fields is not None:
        return {"holds": held.kind, **_of_fields(held.fields)}
    if held.samples is not None:
        return {"holds": held.kind, **_of_samples(held.samples)}
    if held.result is not None:
        return {"holds": held.kind, **_of_result(held.result)}
    assert held.picture is not None
    return {"holds": held.kind, **_of_picture(held.picture)}


def inspect_table(table: xr.DataArray) -> dict[str, Any]:
    """Grid, missing share, reciprocity, albedo, lobe widths and the trace of a camera in a BRDF table, as plain numbers (JSON).

    reciprocity_rms: rms over cells of the relative difference between phi_d and pi - phi_d, which reciprocity and the
    mirror symmetry of an isotropic material make equal. albedo: of light from theta_o, per channel, what is missing counted as
    0 (see `albedo`). lobe: half width at half maximum in theta_h, degrees, in the plane of light and view and across it, mean
    over channels; None where there is no lobe. camera: see `camera_trace`.
    """
    sampling = sampling_of(table)
    values = table.values
    missing = np.isnan(values)
    below = below_horizon(sampling)
    widths = lobe_widths(table)
    return {
        "grid": dict(zip(("theta_h", "theta_d", "phi_d"), GRID_SHAPE, strict=True)),
        "channels": [str(c) for c in table["channel"].values],
        "sampling": sampling,
        "missing_share": float(missing.mean()),
        "missing_above_horizon_share": float(missing[~below].mean()),
        "valid_below_horizon_share": float((~missing[below]).mean()),
        "range_per_sr": [float(np.nanmin(values)), float(np.nanmax(values))],
        "reciprocity_rms": _reciprocity(values, sampling),
        "albedo": _albedo(Tabulated(table), [str(c) for c in table["channel"].values]),
        "lobe": [
            {
                "theta_d_deg": angle,
                "in_plane_hwhm_deg": _degrees(widths.in_plane[min(angle, GRID_SHAPE[1] - 1)]),
                "across_hwhm_deg": _degrees(widths.across[min(angle, GRID_SHAPE[1] - 1)]),
            }
            for angle in REPORTED_ANGLES
        ],
        "camera": camera_trace(table),
    }


def _reciprocity(values: np.ndarray, sampling: Sampling) -> float:
    # at cell edges phi_d = 0 has its partner at pi, which is 0 again by reciprocity and is not stored
    first, second = (values, values[:, :, ::-1]) if sampling == "centre" else (values[:, :, 1:], values[:, :, :0:-1])
    mean = (first + second) / 2
    compared = np.isfinite(mean) & (mean > 0)
    if not compared.any():
        return float("nan")
    return float(np.sqrt(np.mean(((first[compared] - second[compared]) / mean[compared]) ** 2)))


def _degrees(angle: float) -> float | None:
    return float(np.degrees(angle)) if np.isfinite(angle) else None


def _albedo(material: Tabulated | Adaptive, channels: list[str]) -> list[dict[str, Any]]:
    found = albedo(material, np.radians(REPORTED_ANGLES))
    return [
        {"theta_o_deg": angle, **{c: float(value) for c, value in zip(channels, values, strict=True)}}
        for angle, values in zip(REPORTED_ANGLES, found, strict=True)
    ]


def _of_fields(fields: xr.Dataset) -> dict[str, Any]:
    material = Adaptive(fields)
    colour = "spectra" if "spectra" in fields else "rgb"
    own = {
        "description": bytes(fields["description"].values).decode(errors="replace") if "description" in fields else "",
        "light_directions": {"phi_i": int(fields.sizes["phi_i"]), "theta_i": int(fields.sizes["theta_i"])},
        "square": [int(fields.sizes["row"]), int(fields.sizes["column"])],
        "isotropic": material.mirrored == 0,
        "negative_share": float((fields[colour].values < 0).mean()),
    }
    if material.mirrored or colour == "spectra":
        channels = [f"{w:g} nm" for w in fields["wavelengths"].values] if colour == "spectra" else ["R", "G", "B"]
        return {"own_grid": own, "albedo": _albedo(material, channels)}
    return {"own_grid": own, "resampled": "to the MERL grid", **inspect_table(true_table(material))}


def _of_samples(samples: xr.DataArray) -> dict[str, Any]:
    spans = {
        name: np.degrees([samples[name].min(), samples[name].max()]).tolist()
        for name in ("theta_h", "theta_d", "phi_d")
    }
    return {
        "samples": int(samples.sizes["sample"]),
        "channels": [str(c) for c in samples["channel"].values],
        "missing_share": float(np.isnan(samples.values).mean()),
        "range_per_sr": [float(samples.min()), float(samples.max())],
        "angles_deg": spans,
    }


def _of_result(data: xr.Dataset) -> dict[str, Any]:
    variables = {
        str(name): {"shape": dict(zip(map(str, v.dims), v.shape, strict=True)), "units": str(v.attrs.get("units", ""))}
        for name, v in data.variables.items()
    }
    return {"variables": variables, "attributes": {str(k): str(v)[:200] for k, v in data.attrs.items()}}


def _of_picture(picture: np.ndarray) -> dict[str, Any]:
    missing = np.isnan(picture)
    if missing.all():
        raise ArgumentError("every value of the picture is missing")
    return {
        "shape": list(picture.shape),
        "missing_share": float(missing.mean()),
        "range": [float(np.nanmin(picture)), float(np.nanmax(picture))],
    }


def inspect_camera(path: str | Path) -> dict[str, Any]:
    """Parameters, their standard deviations, MTF50 (cycles/px, along a row) and provenance of a camera profile."""
    camera = Camera.load(path)
    frequency = np.linspace(0, 2, 4001)
    below = np.flatnonzero(np.asarray(camera.mtf(frequency)) < 0.5)
    return {
        "parameters": {name: float(value) for name, value in camera.parameters().items()},
        "std": camera.uncertainty.std() if camera.uncertainty else {},
        "mtf50_cycles_per_px": float(frequency[below[0]]) if below.size else float("nan"),
        "provenance": dataclasses.asdict(camera.provenance),
    }
