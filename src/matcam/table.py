"""The table: a BRDF on the MERL grid as a labelled xarray, missing values NaN, its sampling stated."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.angles import GRID_SHAPE, SAMPLINGS, Sampling, merl_grid
from matcam.errors import ArgumentError

DIMS = ("theta_h", "theta_d", "phi_d", "channel")
CHANNELS = ("R", "G", "B")
CHANNEL_WAVELENGTHS = (610e-9, 550e-9, 465e-9)
"""Representative wavelengths of R, G, B, m, at which tabulated metals are compared. MERL does not publish its camera's
spectral response; these are the middles of the bands of a common RGB sensor."""


def brdf_table(values: np.ndarray, sampling: Sampling, **attrs: object) -> xr.DataArray:
    """Label BRDF values (90, 90, 180, 3), 1/sr, NaN where missing, sampled at each cell's `sampling` point."""
    grid = merl_grid(sampling)
    table = xr.DataArray(
        values,
        dims=DIMS,
        coords={
            "theta_h": ("theta_h", grid.theta_h, {"units": "rad"}),
            "theta_d": ("theta_d", grid.theta_d, {"units": "rad"}),
            "phi_d": ("phi_d", grid.phi_d, {"units": "rad"}),
            "channel": list(CHANNELS),
        },
        name="brdf",
        attrs={"units": "1/sr", "sampling": sampling, **attrs},
    )
    return checked_table(table)


def checked_table(table: xr.DataArray) -> xr.DataArray:
    """Return `table` if it is a BRDF on the MERL grid; ArgumentError naming the offending dims, shape, coordinate or value."""
    if not isinstance(table, xr.DataArray):
        raise ArgumentError(f"a BRDF table must be an xarray.DataArray (see read_merl), got {type(table).__name__}")
    if table.dims != DIMS:
        raise ArgumentError(f"a BRDF table has dims {DIMS}, got {table.dims}")
    if table.shape[:3] != GRID_SHAPE or table.shape[3] < 1:
        raise ArgumentError(f"a BRDF table has shape {GRID_SHAPE} x channels, got {table.shape}")
    sampling = sampling_of(table)
    for name, expected in merl_grid(sampling)._asdict().items():
        if name not in table.coords or not np.allclose(table.coords[name], expected, rtol=0, atol=1e-9):
            raise ArgumentError(f"coordinate {name} is not that of the MERL grid sampled at each cell's {sampling}")
    if np.isinf(table.values).any():
        raise ArgumentError("a BRDF table must not hold infinities; a missing value is NaN")
    return table


def sampling_of(table: xr.DataArray) -> Sampling:
    """Where in its cell each value is sampled: the attribute `sampling`."""
    sampling = table.attrs.get("sampling")
    if sampling not in SAMPLINGS:
        raise ArgumentError(f"attrs['sampling'] of a BRDF table must be 'centre' or 'edge', got {sampling!r}")
    return sampling
