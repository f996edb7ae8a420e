"""Labelled arrays (xarray Datasets) on disk: as NetCDF-4, and as Zarr in one zip file.

NetCDF-4 is self-describing and read by xarray, MATLAB, R and most else. Zarr (version 3, .zarr.zip) is what `xarray.open_zarr`
reads, here and from object storage. It is a zip and not a folder, because a file appears whole or not at all; its members carry
CRC-32 checksums. Zarr needs the extra `matcam[scale]`.

Both formats may claim to hold far more than they do, so that sizes are checked before anything is read.
"""

from __future__ import annotations

import math
import struct
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.io import reading, replacing

_MOST_TIMES, _MOST_VARIABLES, _SPARE = 4, 256, 1 << 16
_HDF5 = b"\x89HDF\r\n\x1a\n"
_DESCRIPTION = "zarr.json"
_LONGEST_END = 22 + (1 << 16)  # bytes: what ends a zip, with its comment


def check_stored_sizes(path: Path, size: int, variables: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
    """Refuse arrays that are larger than their file could hold.

    FileFormatError where arrays of these shapes and types take more than four times the file's bytes together: damaged, or
    compressed beyond what is trusted.
    """
    if len(variables) > _MOST_VARIABLES:
        raise FileFormatError(f"{path}: {len(variables)} variables: damaged, or not a result")
    total = 0
    for name, (shape, kind) in variables.items():
        # text and lists of any length say nothing of their size: eight bytes each
        each = np.dtype(kind).itemsize if isinstance(kind, np.dtype) else 8
        total += math.prod(shape) * max(each, 1)
        if total > _MOST_TIMES * size + _SPARE:
            raise FileFormatError(
                f"{path}: variable {name!r:.60} of {' x '.join(map(str, shape))} values does not fit into {size} bytes: "
                "damaged, or compressed beyond what is trusted"
            )


def one_line(error: Exception) -> str:
    """Return a library's complaint as one line, cut short."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def write_netcdf(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset with its attributes as NetCDF-4.

    Args:
        path: file to write (.nc).
        data: result with labels and units.
        force: replace an existing file (no unit). Default: False.

    Raises:
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
    with replacing(path, force=force) as temporary:
        try:
            data.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
        except RuntimeError as error:  # what the library makes of a full disk
            raise OutputError(f"output {path} cannot be written: {one_line(error)} (disk full?)") from error


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a Dataset, whole, from a NetCDF-4 file.

    Args:
        path: NetCDF-4 file.

    Returns:
        The Dataset, in memory.

    Raises:
        FileFormatError: the file is no NetCDF-4 file, is damaged, or claims to hold more than four times its bytes.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_netcdf(Path(folder) / "a.nc", xarray.Dataset({"raw": ("theta_d", [1.0, 2.0])}))
        ...     matcam.io.read_netcdf(Path(folder) / "a.nc")["raw"].values
        array([1., 2.])
    """
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


def write_zarr(path: str | Path, data: xr.Dataset, *, force: bool = False) -> None:
    """Write a Dataset with its attributes as Zarr in one zip file.

    Args:
        path: file to write (.zarr.zip).
        data: result with labels and units.
        force: replace an existing file (no unit). Default: False.

    Raises:
        ArgumentError: zarr is not installed.
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
    members: dict[str, Any] = {}
    store = _storage().MemoryStore(members)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # text has no final specification in Zarr 3: other readers may not know it
        # not compressed: a reader can tell from the file's size what it may have to hold
        plain = {name: {"compressors": ()} for name in data.variables}
        data.to_zarr(store, zarr_format=3, consolidated=False, encoding=plain)
    # by way of memory, because a zip cannot replace what was written to it, and the attributes are written twice
    with replacing(path, force=force) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as packed:
        for name in sorted(members, key=lambda name: (not name.endswith(_DESCRIPTION), name)):
            packed.writestr(name, members[name].to_bytes())


def read_zarr(path: str | Path) -> xr.Dataset:
    """Read a Dataset, whole, from Zarr in one zip file.

    Args:
        path: zip file whose members are stored as they are (zip -0).

    Returns:
        The Dataset, in memory.

    Raises:
        ArgumentError: zarr is not installed.
        FileFormatError: the file is no Zarr in a zip, is damaged, or claims to hold more than four times its bytes.

    Example:
        >>> import tempfile, xarray
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_zarr(Path(folder) / "a.zarr.zip", xarray.Dataset({"raw": ("theta_d", [1.0, 2.0])}))
        ...     matcam.io.read_zarr(Path(folder) / "a.zarr.zip")["raw"].values
        array([1., 2.])
    """
    import json

    storage = _storage()
    path = Path(path)
    try:
        if path.is_dir():
            raise FileFormatError(f"{path}: is a folder; a Zarr in one zip file is read (zip -0 -r a.zarr.zip .)")
        size = path.stat().st_size
        _check_directory(path, size)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if any(m.compress_type != zipfile.ZIP_STORED or max(m.file_size, m.compress_size) > size for m in members):
                raise FileFormatError(f"{path}: damaged, or compressed by zip: members are stored as they are (zip -0)")
            described = {m.filename: json.loads(archive.read(m)) for m in members if m.filename.endswith(_DESCRIPTION)}
            broken = archive.testzip()
        if broken:
            raise FileFormatError(f"{path}: damaged: {broken} is not what was written")
        arrays = {name: d for name, d in described.items() if d.get("node_type") == "array"}
        shapes = {name: tuple(d["shape"]) for name, d in arrays.items()}
        # a chunk is loaded whole, however little of it belongs to the array
        chunks = {
            f"{name} (chunk)": tuple(d["chunk_grid"]["configuration"]["chunk_shape"]) for name, d in arrays.items()
        }
        check_stored_sizes(path, size, {name: (shape, None) for name, shape in shapes.items()})
        check_stored_sizes(path, size, {name: (shape, None) for name, shape in chunks.items()})
        with storage.ZipStore(path, mode="r") as store, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return xr.open_zarr(store, consolidated=False).load()
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except FileFormatError:
        raise
    except Exception as error:  # zip, JSON and codecs each have their own errors
        raise FileFormatError(f"{path}: not a Zarr in a zip file that can be read: {one_line(error)}") from None


def _check_directory(path: Path, size: int) -> None:
    """Check the list of members at the zip's end.

    Memory for as much of it as it claims would be asked for before anything else.
    """
    with path.open("rb") as file:
        file.seek(max(0, size - _LONGEST_END))
        end = file.read()
    at = end.rfind(b"PK\5\6")
    if at < 0 or len(end) < at + 22:
        raise FileFormatError(f"{path}: not a zip file")
    length, start = struct.unpack_from("<II", end, at + 12)
    if length + start > size:
        raise FileFormatError(f"{path}: damaged: its list of members, {length} bytes at byte {start}, is not within it")


def _storage() -> Any:
    """Import zarr; ArgumentError if it is not installed."""
    try:
        from zarr import storage
    except ImportError:
        raise ArgumentError("Zarr needs an extra: pip install 'matcam[scale]'") from None
    return storage
