"""What a file is and what can be seen in it without any model."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

from matcam.angles import GRID_SHAPE, Sampling, below_horizon
from matcam.camera.camera import Camera
from matcam.errors import FileFormatError
from matcam.table import sampling_of

REPORTED_ANGLES = (0, 15, 30, 45, 60, 70, 75, 80)
"""theta_d, degrees, at which lobe widths are reported."""


def identify(path: str | Path) -> Literal["merl", "camera profile"]:
    """Format of a file, by its content. FileFormatError for anything that matcam does not read."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    if head[:12] == np.array(GRID_SHAPE, dtype="<i4").tobytes() or path.suffix == ".binary":
        return "merl"
    if head.lstrip().startswith(b"{"):
        return "camera profile"
    raise FileFormatError(f"{path}: neither a MERL file (it starts with {GRID_SHAPE}) nor a camera profile (JSON)")


def inspect_table(table: xr.DataArray) -> dict[str, Any]:
    """Grid, missing share, reciprocity and lobe widths of a BRDF table, as plain numbers (JSON).

    reciprocity_rms: rms over cells of the relative difference between phi_d and pi - phi_d, which reciprocity and the
    mirror symmetry of an isotropic material make equal. lobe: half width at half maximum in theta_h, degrees, in the
    plane of light and view and across it, mean over channels; None where there is no lobe.
    """
    sampling = sampling_of(table)
    values = table.values
    missing = np.isnan(values)
    below = below_horizon(sampling)
    return {
        "grid": dict(zip(("theta_h", "theta_d", "phi_d"), GRID_SHAPE, strict=True)),
        "channels": [str(c) for c in table["channel"].values],
        "sampling": sampling,
        "missing_share": float(missing.mean()),
        "missing_above_horizon_share": float(missing[~below].mean()),
        "valid_below_horizon_share": float((~missing[below]).mean()),
        "range_per_sr": [float(np.nanmin(values)), float(np.nanmax(values))],
        "reciprocity_rms": _reciprocity(values, sampling),
        "lobe": [
            {
                "theta_d_deg": angle,
                "in_plane_hwhm_deg": _half_width(table, angle, in_plane=True),
                "across_hwhm_deg": _half_width(table, angle, in_plane=False),
            }
            for angle in REPORTED_ANGLES
        ],
    }


def _reciprocity(values: np.ndarray, sampling: Sampling) -> float:
    # at cell edges phi_d = 0 has its partner at pi, which is 0 again by reciprocity and is not stored
    first, second = (values, values[:, :, ::-1]) if sampling == "centre" else (values[:, :, 1:], values[:, :, :0:-1])
    mean = (first + second) / 2
    compared = np.isfinite(mean) & (mean > 0)
    if not compared.any():
        return float("nan")
    return float(np.sqrt(np.mean(((first[compared] - second[compared]) / mean[compared]) ** 2)))


def _half_width(table: xr.DataArray, angle: float, *, in_plane: bool) -> float | None:
    slice_ = table.isel(theta_d=int(np.clip(angle, 0, GRID_SHAPE[1] - 1))).values
    along = np.abs(np.cos(table["phi_d"].values))
    chosen = slice_[:, along > 0.95] if in_plane else slice_[:, along < 0.3]
    present = np.isfinite(chosen)
    count = present.sum(axis=(1, 2))
    profile = np.where(count > 0, np.where(present, chosen, 0).sum(axis=(1, 2)) / np.maximum(count, 1), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = profile / profile[0]
    below = np.flatnonzero(relative < 0.5)
    if not below.size or not below[0]:
        return None
    i = int(below[0])
    theta_h = table["theta_h"].values
    return float(np.degrees(np.interp(-0.5, -relative[i - 1 : i + 1], theta_h[i - 1 : i + 1])))


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
