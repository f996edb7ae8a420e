"""Labelled arrays (xarray Datasets) on disk: as NetCDF-4, and as Zarr in one zip file.

NetCDF-4 is self-describing and supported by xarray, MATLAB, R and many other programs. `xarray.open_zarr` reads Zarr (version
3, .zarr.zip) from disk and from object storage. The store is a zip file and not a folder, because a file can be written
atomically. The members of the zip file have CRC-32 checksums. Zarr requires the extra `matcam[scale]`.

Headers of both formats may specify far more data than the file contains, so sizes are checked before reading.
"""

from __future__ import annotations

import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError, one_line
from matcam.core.io import replacing, uninterrupted
from matcam.core.readers.apart import read_apart
from matcam.core.readers.names import is_folder
from matcam.files.decoders import DESCRIPTION, check_stored_sizes


def write_netcdf(path: str | Path, data: xr.Dataset, *, force: bool = False, compress: bool = True) -> None:
    """Write a Dataset with its attributes as NetCDF-4.

    Tables of standard deviations are stored as float32, because 7 digits of an uncertainty suffice. These tables are
    float64 variables of more than two dimensions with names that end in _std. All other variables are stored exactly.

    Args:
        path: file to write (.nc).
        data: result with labels and units.
        force: True to replace an existing file. Default: False.
        compress: compress the arrays losslessly by deflate at level 1, which every reader of NetCDF-4 supports.
            Default: True.

    Raises:
        ArgumentError: `data` is not a Dataset, or `compress` is not a bool.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> data = xarray.Dataset({"raw": ("theta_d", [1.0, 2.0], {"units": "1/sr"})})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_netcdf(Path(folder) / "a.nc", data)
        ...     matcam.io.read_netcdf(Path(folder) / "a.nc")["raw"].attrs
        {'units': '1/sr'}
    """
    _check_dataset(data)
    checks.flag("compress", compress)
    # uninterrupted: an interruption would leave xarray locked, and closing the file would wait for the lock
    with replacing(path, force=force) as temporary, uninterrupted():
        stored = with_short_deviations(data)
        _write(temporary, stored, _compressed(stored) if compress else {})
        if compress and not _readable(temporary, stored):
            _write(temporary, stored, {})


_Encoding = dict[str, dict[str, Any]]


def _write(path: Path, data: xr.Dataset, encoding: _Encoding) -> None:
    # in memory first, because HDF5 crashes on a full disk
    path.write_bytes(data.to_netcdf(engine="h5netcdf", format="NETCDF4", encoding=encoding))


def with_short_deviations(data: xr.Dataset) -> xr.Dataset:
    """Convert tables of standard deviations to float32. Values beyond the range of float32 are clipped."""
    tables = {
        name: one
        for name, one in data.data_vars.items()
        if str(name).endswith("_std") and one.dtype == np.float64 and one.ndim > 2
    }
    largest = np.finfo(np.float32).max
    return data.assign(
        {n: one.copy(data=np.minimum(one.values, largest).astype(np.float32)) for n, one in tables.items()}
    )


def _compressed(data: xr.Dataset) -> _Encoding:
    """Build the encoding that compresses numeric arrays.

    Arrays of more than two dimensions have one chunk for each index of the first dimension.
    """
    encoding: _Encoding = {}
    for name, one in data.data_vars.items():
        if one.ndim and one.dtype.kind in "biuf":
            chunks = {"chunksizes": (1, *one.shape[1:])} if one.ndim > 2 else {}
            encoding[str(name)] = {"zlib": True, "complevel": 1, "shuffle": True, **chunks}
    return encoding


def _readable(path: Path, data: xr.Dataset) -> bool:
    """Check that `read_netcdf` accepts a compressed file.

    `read_netcdf` rejects a file whose arrays are much larger than the file.
    """
    try:
        shapes = {str(name): (one.shape, one.dtype) for name, one in data.variables.items()}
        check_stored_sizes(path, path.stat().st_size, shapes)
    except FileFormatError:
        return False
    return True


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a complete Dataset from a NetCDF-4 file.

    Args:
        path: NetCDF-4 file.

    Returns:
        The Dataset, in memory.

    Raises:
        FileFormatError: the file is missing, damaged or not NetCDF-4, or its arrays take more than 16 times the bytes
            of the file.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_netcdf(Path(folder) / "a.nc", xarray.Dataset({"raw": ("theta_d", [1.0, 2.0])}))
        ...     matcam.io.read_netcdf(Path(folder) / "a.nc")["raw"].values
        array([1., 2.])
    """
    path = Path(path)
    stored = read_apart("matcam.files.decoders:decode_netcdf", path, "a NetCDF-4 file", libraries=("h5py", "h5netcdf"))
    try:
        return xr.decode_cf(xr.Dataset(_variables(stored), attrs=stored["attrs"]))
    except Exception as error:  # inconsistent labels
        raise FileFormatError(f"{path}: the NetCDF file is damaged: {one_line(error)}; create it again") from None


def write_zarr(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset with its attributes as Zarr in one zip file.

    Args:
        path: file to write (.zarr.zip).
        data: result with labels and units.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `data` is not a Dataset, or zarr is not installed.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> data = xarray.Dataset({"raw": ("theta_d", [1.0, 2.0], {"units": "1/sr"})})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_zarr(Path(folder) / "a.zarr.zip", data)
        ...     matcam.io.read_zarr(Path(folder) / "a.zarr.zip")["raw"].attrs
        {'units': '1/sr'}
    """
    _check_dataset(data)
    members: dict[str, Any] = {}
    checks.extra("Zarr", "scale", "zarr")
    from zarr import storage

    store = storage.MemoryStore(members)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # text has no final specification in Zarr 3: other readers may not support it
        # not compressed, so that the size of the file bounds the required memory
        plain = {name: {"compressors": ()} for name in data.variables}
        data.to_zarr(store, zarr_format=3, consolidated=False, encoding=plain)
    # written through memory, because a zip cannot replace a member, and the attributes are written twice
    with replacing(path, force=force) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as packed:
        for name in sorted(members, key=lambda name: (not name.endswith(DESCRIPTION), name)):
            packed.writestr(name, members[name].to_bytes())


def read_zarr(path: str | Path) -> xr.Dataset:
    """Read a complete Dataset from Zarr in one zip file.

    Args:
        path: zip file with uncompressed members (zip -0).

    Returns:
        The Dataset, in memory.

    Raises:
        ArgumentError: zarr is not installed.
        FileFormatError: the file is missing, damaged or not Zarr in a zip, or its arrays take more than 16 times the
            bytes of the file.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_zarr(Path(folder) / "a.zarr.zip", xarray.Dataset({"raw": ("theta_d", [1.0, 2.0])}))
        ...     matcam.io.read_zarr(Path(folder) / "a.zarr.zip")["raw"].values
        array([1., 2.])
    """
    from xarray.backends.zarr import FillValueCoder

    path = Path(path)
    if is_folder(path):
        raise FileFormatError(
            f"{path}: the input is a folder: give a Zarr store in one zip file (zip -0 -r a.zarr.zip .)"
        )
    stored = read_apart("matcam.files.decoders:decode_zarr", path, "a Zarr in a zip file", libraries=("zarr.storage",))
    try:
        for variable in stored["variables"].values():
            if isinstance(fill := variable["attrs"].get("_FillValue"), str):  # base64 of its bytes, as xarray writes it
                variable["attrs"]["_FillValue"] = FillValueCoder.decode(fill, variable["values"].dtype)
        return xr.decode_cf(xr.Dataset(_variables(stored), attrs=stored["attrs"]))
    except Exception as error:  # inconsistent labels
        raise FileFormatError(f"{path}: the Zarr store is damaged: {one_line(error)}; create it again") from None


def _variables(stored: dict[str, Any]) -> dict[str, xr.Variable]:
    return {name: xr.Variable(tuple(v["dims"]), v["values"], v["attrs"]) for name, v in stored["variables"].items()}


def _check_dataset(data: object) -> None:
    if not isinstance(data, xr.Dataset):
        raise ArgumentError(
            f"data must be an xarray.Dataset, got {type(data).__name__}; convert a DataArray by to_dataset()"
        )
