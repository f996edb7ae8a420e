"""Properties of files and tables, computed without a model of the material.

The properties are grids, gaps, reciprocity, albedo, and the trace of a camera in a table. A camera widens a lobe in the
plane of light and view: width^2 = lobe^2 + (kernel / cos theta_d)^2. All three are widths in theta_h, rad, and theta_d
is the difference angle (docs/model.md 3). A source disc widens a lobe across that plane instead.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import (
    CORRECTED,
    DIMS,
    GRID_SHAPE,
    Sampling,
    below_horizon,
    brdf_table,
    check_recorded,
    checked_table,
    merl_grid,
    sample_of,
    sampling_of,
)
from matcam.exchange.contents import Contents
from matcam.inverse.fit.fit_data import check_values
from matcam.inverse.operator.pixel_phase import CellRule, cell_rule
from matcam.inverse.saturated_values import without_saturated
from matcam.material.material import albedo_and_missing, albedo_remarks, cell_values
from matcam.material.measured import Adaptive, Tabulated

SPHERE_RADIUS = 256.0
"""Default radius of the sphere, px: that of the MERL rig."""


class LobeWidths(NamedTuple):
    """Half widths of a lobe at half maximum, in theta_h.

    The arrays have one half width for every theta_d of the table, or NaN where there is no lobe.

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

    The BRDF is averaged over the channels and over azimuths. The azimuths are within 18 degrees of the plane of light
    and view for `in_plane`, and beyond 72 degrees from this plane for `across`. Between the angles of the grid, the
    logarithm of the mean is interpolated linearly in theta_h^2. The maximum is the value at the first theta_h.

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
    table = checked_table(table)
    along = np.abs(np.cos(table["phi_d"].values))
    theta_h = table["theta_h"].values
    return LobeWidths(
        in_plane=_half_widths(table.values[:, :, along > 0.95], theta_h),
        across=_half_widths(table.values[:, :, along < 0.3], theta_h),
    )


def camera_trace(table: xr.DataArray) -> dict[str, Any]:
    """Check whether a camera may have widened the lobes of a table.

    The squares of the widths in the plane of light and view are fitted by lobe^2 + (kernel / cos theta_d)^2. A camera
    is visible if kernel^2 exceeds 5 of its standard deviations, and if the ratio of the width in the plane to that
    across grows by more than a factor of 1.15. The cause is then a camera, or a finish with the same widening.

    Args:
        table: BRDF on the MERL grid, (90, 90, 180, channels), 1/sr, such as `read_merl` returns.

    Returns:
        Plain values, all None if fewer than 20 angles theta_d show a lobe. `visible` is the verdict. `kernel_rad` and
        `lobe_rad` are standard deviations of Gaussians, rad. `significance` is kernel^2 divided by its standard
        deviation, no unit. `widening` is the factor by which the ratio of widths grows from normal view to 75 degrees,
        no unit.

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
    # angles up to 75 degrees are used
    known = np.isfinite(widths.in_plane) & np.isfinite(widths.across) & (theta_d < np.radians(75))
    # broad lobes are cut at the horizon
    known &= theta_d + 3 * np.nan_to_num(widths.in_plane, nan=9.0) < np.pi / 2
    # at least 20 angles with a lobe are required
    if known.sum() < 20:
        return {"visible": None, "kernel_rad": None, "lobe_rad": None, "significance": None, "widening": None}
    # a Gaussian has a half width at half maximum of sqrt(2 ln 2) standard deviations
    squares = (widths.in_plane[known] / np.sqrt(2 * np.log(2))) ** 2
    basis = np.stack([np.ones(known.sum()), cos[known] ** -2], axis=-1)
    (lobe2, kernel2), *_ = np.linalg.lstsq(basis, squares, rcond=None)
    left = squares - basis @ [lobe2, kernel2]
    covariance = np.linalg.inv(basis.T @ basis) * np.sum(left**2) / (known.sum() - 2)
    significance = float(kernel2 / max(np.sqrt(covariance[1, 1]), 1e-300))
    ratio = (widths.in_plane / widths.across)[known]
    widening = float(np.median(ratio[-5:]) / np.median(ratio[:5]))
    return {
        "visible": bool(significance > 5.0 and widening > 1.15),
        "kernel_rad": float(np.sqrt(max(kernel2, 0.0))),
        "lobe_rad": float(np.sqrt(max(lobe2, 0.0))),
        "significance": significance,
        "widening": widening,
    }


def _half_widths(values: np.ndarray, theta_h: np.ndarray) -> np.ndarray:
    """Compute the half width at half maximum at each theta_d, rad.

    The values (theta_h, theta_d, phi_d, channel) are averaged over phi_d and the channels. Between the angles, the
    logarithm of the mean is interpolated linearly in theta_h^2, which is exact for a Gaussian.
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
            depth = -np.log(np.maximum(relative[i - 1 : i + 1], 1e-12))
            widths[k] = np.sqrt(np.interp(np.log(2), depth, theta_h[i - 1 : i + 1] ** 2))
    return widths


REPORTED_ANGLES = (0, 15, 30, 45, 60, 70, 75, 80)
"""Angles of the report, degrees: theta_d of the lobe widths, and theta_o of the albedos."""


def inspect_contents(contents: Contents, radius: float = SPHERE_RADIUS) -> dict[str, Any]:
    """Report on contents (see `read_contents`), as plain values (JSON).

    The report has `holds`, a description, and sections for a table, samples, another result or an image. The report on
    RGL's fields has their own grid. It also has the sections of a table after resampling, or only albedos if the
    material is anisotropic or spectral. `radius` is the radius of the sphere from which a table was recorded, px.
    """
    report: dict[str, Callable[[Any], dict[str, Any]]] = {
        "table": partial(inspect_table, radius=radius),
        "fields": _fields_report,
        "samples": _samples_report,
        "result": partial(_result_report, radius=radius),
        "picture": _picture_report,
    }
    return {"holds": contents.kind, **report[contents.content](contents.data)}


def inspect_table(table: xr.DataArray, radius: float = SPHERE_RADIUS) -> dict[str, Any]:
    """Report on a BRDF table, as plain values (JSON).

    Args:
        table: BRDF on the MERL grid, 1/sr.
        radius: radius of the sphere from which the table was recorded, px. Default: 256, that of the MERL rig.

    Returns:
        Grid, shape of the sample, missing shares, range, and:

        - `reciprocity_rms`: rms over cells of the relative difference between the values at phi_d and pi - phi_d, no
          unit. Reciprocity and the mirror symmetry of an isotropic material make these values equal.
        - `albedo`: directional albedo of each channel, no unit, for angles theta_o to the normal. It is None if all
          values are missing. `missing_share` is the share of diffuse light whose values are missing, in the channel with
          the largest share. If it is above 0, the albedo is a lower bound.
        - `lobe`: half widths at half maximum in theta_h, degrees, in the plane of light and view and across it, None
          where there is no lobe. They refer to the mean of the channels.
        - `camera`: see `camera_trace`.
        - `correction`: `possible` is True if a correction accepts the table. Otherwise `reason` is the cause.
        - `remarks`: texts about saturated highlights, and about an albedo above 1.
        - `cells`: `rule` by which cells were read from real pixels, "nearest", "bilinear" or "mean", or None if there is
          no evidence, or if the table was not recorded on a sphere. `phase_px` is the phase of the pixel grid, or one phase
          for each slice, and `phase_std_px` its standard deviation. Both are None if no grid on a sphere of `radius_px` fits.
          Near the highlight, `repeated_share` is the share of neighbours with equal values, and `distinct_values` the number
          of distinct values, mean over slices.
    """
    sampling = sampling_of(table)
    values = table.values
    missing = np.isnan(values)
    below = below_horizon(sampling)
    widths = lobe_widths(table)
    reported = merl_grid(sampling).index(theta_d=np.radians(REPORTED_ANGLES))[1]
    albedo = _albedo(Tabulated(table), [str(c) for c in table["channel"].values])
    largest = max((row[str(c)] or 0.0 for row in albedo for c in table["channel"].values), default=0.0)
    remarks = (*without_saturated(table, None)[1], *albedo_remarks(largest))
    return {
        "grid": dict(zip(("theta_h", "theta_d", "phi_d"), GRID_SHAPE, strict=True)),
        "channels": [str(c) for c in table["channel"].values],
        "sampling": sampling,
        "corrected": bool(table.attrs.get(CORRECTED)),
        "sample": sample_of(table) or "sphere",
        "rig": str(table.attrs.get("rig", "")),
        "missing_share": float(missing.mean()),
        "missing_above_horizon_share": float(missing[~below].mean()),
        "valid_below_horizon_share": float((~missing[below]).mean()),
        "range_per_sr": [float(np.nanmin(values)), float(np.nanmax(values))],
        "reciprocity_rms": _reciprocity(values, sampling),
        "albedo": albedo,
        "lobe": [
            {
                "theta_d_deg": angle,
                "in_plane_hwhm_deg": _degrees(widths.in_plane[j]),
                "across_hwhm_deg": _degrees(widths.across[j]),
            }
            for angle, j in zip(REPORTED_ANGLES, reported, strict=True)
        ],
        "camera": camera_trace(table),
        "cells": _cells_report(table, radius),
        "correction": _correction_report(table),
        "remarks": [remark.text for remark in remarks],
    }


def _correction_report(table: xr.DataArray) -> dict[str, Any]:
    try:
        check_recorded(table, "the table")
        if sample_of(table) == "flat":
            raise FitError("the sample is flat, so the lens does not blur its table: use the table as it is")
        check_values((table,), None)
    except (ArgumentError, FitError) as error:
        return {"possible": False, "reason": str(error)}
    return {"possible": True, "reason": None}


def _cells_report(table: xr.DataArray, radius: float) -> dict[str, Any]:
    shown = CellRule(rule=None, found=None, repeated=0.0, values=0.0)
    if sample_of(table) in (None, "sphere") and not table.attrs.get(CORRECTED):
        shown = cell_rule(table, radius)
    found = shown.found
    return {
        "rule": shown.rule,
        "phase_px": None if found is None else np.asarray(found.phase).tolist(),
        "phase_std_px": None if found is None else found.std,
        "radius_px": radius,
        "repeated_share": shown.repeated,
        "distinct_values": shown.values,
    }


def _reciprocity(values: np.ndarray, sampling: Sampling) -> float:
    # at cell edges the partner of phi_d = 0 is at pi, which equals 0 by reciprocity and is not stored
    first, second = (values, values[:, :, ::-1]) if sampling == "centre" else (values[:, :, 1:], values[:, :, :0:-1])
    mean = (first + second) / 2
    compared = np.isfinite(mean) & (mean > 0)
    if not compared.any():
        return float("nan")
    return float(np.sqrt(np.mean(((first[compared] - second[compared]) / mean[compared]) ** 2)))


def _degrees(angle: float) -> float | None:
    return float(np.degrees(angle)) if np.isfinite(angle) else None


def _albedo(material: Tabulated | Adaptive, channels: list[str]) -> list[dict[str, Any]]:
    found = zip(REPORTED_ANGLES, *albedo_and_missing(material, np.radians(REPORTED_ANGLES)), strict=True)
    return [
        {
            "theta_o_deg": angle,
            **{c: None if np.isnan(value) else float(value) for c, value in zip(channels, values, strict=True)},
            "missing_share": float(np.max(missing[np.isfinite(values)], initial=0.0))
            if np.isfinite(values).any()
            else 1.0,
        }
        for angle, values, missing in found
    ]


def _fields_report(fields: xr.Dataset) -> dict[str, Any]:
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
    table = brdf_table(np.maximum(np.asarray(cell_values(material, "centre")), 0.0), "centre")
    return {"own_grid": own, "resampled": "to the MERL grid", **inspect_table(table)}


def _samples_report(samples: xr.DataArray) -> dict[str, Any]:
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


def _result_report(data: xr.Dataset, radius: float) -> dict[str, Any]:
    variables = {
        str(name): {"shape": dict(zip(map(str, v.dims), v.shape, strict=True)), "units": str(v.attrs.get("units", ""))}
        for name, v in data.variables.items()
    }
    brdf = inspect_table(data["brdf"], radius) if "brdf" in data and data["brdf"].dims == DIMS else {}
    if brdf and "supported" in data and "brdf_std" in data:
        known = np.isfinite(data["brdf_std"].values)
        brdf["supported_share"] = float(data["supported"].values[known].mean()) if known.any() else 0.0
    return {**brdf, "variables": variables, "attributes": {str(k): str(v)[:200] for k, v in data.attrs.items()}}


def _picture_report(picture: np.ndarray) -> dict[str, Any]:
    missing = np.isnan(picture)
    if missing.all():
        raise ArgumentError("every value of the image is missing: the file is empty")
    return {
        "shape": list(picture.shape),
        "missing_share": float(missing.mean()),
        "range": [float(np.nanmin(picture)), float(np.nanmax(picture))],
    }
