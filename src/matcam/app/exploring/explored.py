"""Data of the explore view for one table, and content of the exported files."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.app.exploring.opened import OpenedTable
from matcam.core.errors import ArgumentError

SIDE = 200
"""Height and width of a sphere, px of the screen."""


def slice_of(table: OpenedTable, theta_d: float, channel: int) -> dict[str, np.ndarray]:
    """Compute the curves of a slice over theta_h.

    The slice is across the plane of light and view (phi_d = 90 degrees).

    Args:
        table: the table.
        theta_d: difference angle of the slice, rad.
        channel: index of the channel.

    Returns:
        Columns by name. `theta_h` is in degrees; all others are in 1/sr, and missing values are NaN. `low` and `high` are
        the corrected values minus and plus their standard deviations; `low` is at least 1 % of the corrected value.
        `supported` contains the corrected values of supported entries, and `unsupported` those of all other entries.

    Raises:
        ArgumentError: the file contains only a Fresnel term.
    """
    from matcam.core.grid import merl_grid, sampling_of

    best = table.best
    if best is None:
        raise ArgumentError(f"{table.name}: the file contains only a Fresnel term, which has no slices: open a table")
    at = (*merl_grid(sampling_of(best)).index(theta_d=theta_d, phi_d=np.pi / 2), channel)
    count = best.sizes["theta_h"]

    def curve(data: xr.DataArray | None) -> np.ndarray:
        if data is None:
            return np.full(count, np.nan)
        values = np.asarray(data.values[at], dtype=float)
        return np.where(values > 0, values, np.nan)  # the axis is logarithmic

    recorded = curve(table.recorded)
    if table.pictures and table.recorded is not None:
        from matcam.figures.fitted_windows import pinhole_slice

        recorded = pinhole_slice(table.recorded, int(at[1]), channel)
    corrected, std = curve(table.corrected), curve(table.std)
    supported = np.zeros(count, bool) if table.supported is None else np.asarray(table.supported.values[at], bool)
    return {
        "theta_h": np.degrees(best["theta_h"].values),
        "recorded": recorded,
        "corrected": corrected,
        "low": np.maximum(corrected - std, 0.01 * corrected),
        "high": corrected + std,
        "supported": np.where(supported, corrected, np.nan),
        "unsupported": np.where(supported, np.nan, corrected),
    }


def range_of(curves: dict[str, np.ndarray]) -> tuple[float, float]:
    """Choose the range of displayed BRDF values of a slice, 1/sr.

    The range contains at most seven decades below the peak.
    """
    values = np.concatenate([curves["recorded"], curves["corrected"]])
    known = values[np.isfinite(values)]
    if not known.size:
        return 1e-3, 1e3
    top = float(known.max())
    return max(top * 1e-7, float(known.min()) / 2), top * 2


def sphere_of(data: xr.DataArray, lamp: float, azimuth: float, size: int = SIDE) -> np.ndarray:
    """Compute the radiance of a sphere, (size, size, channel), 1/sr.

    `data` is the table of the material. `lamp` is the angle between lamp and camera, rad. `azimuth` is the azimuth of
    the lamp, rad. `size` is the width and height of the image, px.
    """
    from matcam.figures.spheres import table_sphere

    return table_sphere(data.values, size, lamp=lamp, azimuth=azimuth)


def on_screen(light: np.ndarray, exposure: float) -> np.ndarray:
    """Convert a radiance for display, packed RGBA (size, size), bottom row first.

    Args:
        light: radiance, 1/sr, (size, size, channel).
        exposure: exposure compensation, stops; 0 shows the 99th percentile of the lit sphere as white.
    """
    from matcam.figures.spheres import body_white, encoded_for_screen

    shown = encoded_for_screen(light * 2.0**exposure, body_white(light))
    if shown.shape[-1] != 3:
        shown = np.repeat(shown[..., :1], 3, axis=-1)
    packed = np.full((*shown.shape[:2], 4), 255, np.uint8)
    packed[..., :3] = np.rint(shown * 255)
    return np.ascontiguousarray(packed[::-1]).view(np.uint32)[..., 0]


def fresnel_of(table: OpenedTable, channel: int) -> dict[str, np.ndarray]:
    """Compute the curves of the Fresnel term over theta_d.

    The mean of each curve over theta_d from 10 to 45 degrees is 1.

    Returns:
        Columns by name. `theta_d` is in degrees; all others have no unit. `corrected` is NaN for unsupported peaks.
        `low` and `high` are the values of `corrected` minus and plus their standard deviations. Both are NaN unless the
        table is a result of `matcam fresnel`.
    """
    from matcam.inverse.peak_curve import peak_curve

    if table.curve is not None:
        one = table.curve.isel(channel=min(channel, table.curve.sizes["channel"] - 1))
        corrected = one["corrected"].values
        std = one["corrected_std"].values if "corrected_std" in one else np.full_like(corrected, np.nan)
        return {
            "theta_d": np.degrees(one["theta_d"].values), "recorded": one["raw"].values, "corrected": corrected,
            "low": corrected - std, "high": corrected + std,
        }  # fmt: skip
    assert table.best is not None
    missing = np.full(table.best.sizes["theta_d"], np.nan)

    def curve(data: xr.DataArray | None) -> np.ndarray:
        return missing if data is None else peak_curve(data).values[:, channel]

    corrected = curve(table.corrected)
    if table.supported is not None:  # at least half of the cells nearest to the highlight
        corrected = np.where(table.supported.values[0, ..., channel].mean(axis=-1) >= 0.5, corrected, np.nan)
    return {
        "theta_d": np.degrees(table.best["theta_d"].values), "recorded": curve(table.recorded), "corrected": corrected,
        "low": missing, "high": missing,
    }  # fmt: skip


def as_csv(columns: dict[str, np.ndarray], first: str) -> bytes:
    """Format columns as CSV, in the format of the commands.

    `first` is the name of the column with the coordinate.
    """
    from matcam.core.io import write_columns

    data = xr.Dataset(
        {name: (first, values) for name, values in columns.items() if name != first}, {first: columns[first]}
    )
    return _written(lambda path: write_columns(path, data), ".csv")


def as_exr(light: np.ndarray) -> bytes:
    from matcam.files.float_pictures import write_exr

    return _written(lambda path: write_exr(path, light), ".exr")


def as_bsdf(data: xr.DataArray) -> bytes:
    """Encode a table in the format of RGL, which Mitsuba 3 reads with the plugin `measured`."""
    from matcam.exchange.conversion import convert
    from matcam.files.merl import write_merl

    def write(path: Path) -> None:
        write_merl(path.with_suffix(".binary"), data)
        convert(path.with_suffix(".binary"), path)

    return _written(write, ".bsdf")


def as_pbrt(table: OpenedTable) -> bytes:
    """Format the fitted material of this table as text for pbrt-v4.

    Raises:
        ArgumentError: there is no fit, or pbrt's conductor does not support the material.
    """
    from matcam.exchange.renderers import pbrt_material
    from matcam.material.microfacet import Microfacet
    from matcam.material.ndf.ggx import GGX
    from matcam.material.reflectance import Conductor

    fit: Any = table.record.get("fit") or {}
    params = fit.get("params", {})
    n, k = ([params.get(f"{name}[{channel}]") for channel in "RGB"] for name in "nk")
    if fit.get("ndf") != "ggx" or fit.get("spline_modified") or None in (*n, *k):
        raise ArgumentError(
            "pbrt supports only a GGX lobe with n and k, and this material has no such fit: save the .bsdf for Mitsuba"
        )
    return pbrt_material(Microfacet(GGX(params["alpha"]), Conductor(np.array(n), np.array(k)))).encode()


def _written(write: Any, suffix: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="matcam-app-") as folder:
        path = Path(folder) / f"a{suffix}"
        write(path)
        return path.read_bytes()
