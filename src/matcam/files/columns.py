"""Datasets as plain columns of text (CSV), for people's spreadsheets and plotting programs."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from matcam.atomic import replacing


def write_columns(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset as CSV: one row per grid point, a column per coordinate and variable, units in the names of
    those that have any ("theta_d_rad")."""
    frame = data.to_dataframe().reset_index()
    names = {
        str(n): f"{n}_{v.attrs['units'].replace('/', '_per_')}" for n, v in data.variables.items() if "units" in v.attrs
    }
    with replacing(path, force=force) as temporary:
        frame.rename(columns=names).to_csv(temporary, index=False, float_format="%.10g")
