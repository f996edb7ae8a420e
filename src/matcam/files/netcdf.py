"""Results as NetCDF-4: labelled, self-describing, read by xarray, MATLAB, R and everything else."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from matcam.atomic import replacing
from matcam.errors import FileFormatError, OutputError
from matcam.files.stored_dataset import check_stored_sizes, one_line
from matcam.input_file import reading

_HDF5 = b"\x89HDF\r\n\x1a\n"


def write_netcdf(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset with its attributes. OutputError where it cannot go."""
    with replacing(path, force=force) as temporary:
        try:
            data.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
        except RuntimeError as error:  # what the library makes of a full disk
            raise OutputError(f"output {path} cannot be written: {one_line(error)} (disk full?)") from error


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a Dataset, whole. FileFormatError naming the file where it is no NetCDF-4 file, is damaged, or says it holds
    more than four times the bytes that it has."""
    import netCDF4

    path = Path(path)
    with reading(path):
        with path.open("rb") as file:
            start = file.read(len(_HDF5))
        size = path.stat().st_size
    if start != _HDF5:
        raise FileFormatError(f"{path}: not a NetCDF-4 file")
    try:
        with netCDF4.Dataset(path) as file:
            # nothing is read before this: a damaged dimension is filled with as many values as it says
            check_stored_sizes(path, size, {name: (v.shape, v.dtype) for name, v in file.variables.items()})
        with xr.open_dataset(path, engine="netcdf4") as data:
            return data.load()
    except FileFormatError:
        raise
    except Exception as error:  # the library raises whatever its C code returned
        raise FileFormatError(f"{path}: damaged NetCDF file: {one_line(error)}") from None
