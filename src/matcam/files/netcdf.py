"""Results as NetCDF-4: labelled, self-describing, read by xarray, MATLAB, R and everything else."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from matcam.atomic import replacing


def write_netcdf(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset with its attributes."""
    with replacing(path, force=force) as temporary:
        data.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
