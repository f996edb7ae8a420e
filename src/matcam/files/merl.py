"""Binary BRDF format of MERL (Matusik et al. 2003): reading and writing of tables. All values are little-endian.

    byte        0   int32[3]            90, 90, 180: cells along theta_h, theta_d, phi_d
    byte       12   float64[1458000]    red:   (theta_h, theta_d, phi_d), phi_d fastest
    byte 11664012   float64[1458000]    green
    byte 23328012   float64[1458000]    blue
    byte 34992012   end

A value times 1/1500, 1.15/1500, 1.66/1500 (R, G, B) is the BRDF in 1/sr; negative means missing. phi_d runs over [0,
pi): phi_d + pi is the same by reciprocity. The file does not contain the sampling position in a cell.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import CHANNELS, GRID_SHAPE, SAMPLINGS, Sampling, brdf_table, checked_table
from matcam.core.io import reading, replacing

SCALE = np.array([1.0, 1.15, 1.66]) / 1500
"""BRDF in 1/sr per stored unit, for R, G, B."""

_HEADER = np.dtype("<i4")
_VALUE = np.dtype("<f8")
_HEADER_BYTES = 3 * _HEADER.itemsize
FILE_BYTES = _HEADER_BYTES + len(CHANNELS) * int(np.prod(GRID_SHAPE)) * _VALUE.itemsize


def read_merl(path: str | Path, sampling: Sampling = "centre") -> xr.DataArray:
    """Read a BRDF table from a MERL file.

    Args:
        path: MERL file (.binary).
        sampling: position in a cell at which its value was sampled, "centre" or "edge". Default: "centre". The file
            does not specify this position. At a sharp peak the choice changes values by up to 45 %. `sampling` is
            stored in `attrs["sampling"]` and determines the angle coordinates.

    Returns:
        Table in 1/sr, dims (theta_h, theta_d, phi_d, channel), shape (90, 90, 180, 3); NaN where missing.

    Raises:
        FileFormatError: the file is missing or not a MERL file, contains NaN or infinities, or has no valid value. The
            message contains the position of a wrong value.
        ArgumentError: `sampling` is neither "centre" nor "edge".

    Source:
        Matusik et al. (2003), "A data-driven reflectance model".

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from matcam.core.grid import brdf_table
        >>> table = brdf_table(np.full((90, 90, 180, 3), 0.5), "edge")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.write_merl(Path(folder) / "grey.binary", table)
        ...     again = matcam.read_merl(Path(folder) / "grey.binary", sampling="edge")
        >>> dict(again.sizes)
        {'theta_h': 90, 'theta_d': 90, 'phi_d': 180, 'channel': 3}
    """
    path = Path(path)
    checks.choice("sampling", sampling, SAMPLINGS)
    stored = _read_stored(path)
    missing = stored < 0
    # a reduction detects a wrong value; its position is determined only in that case
    with np.errstate(over="ignore", invalid="ignore"):
        suspicious = not np.isfinite(np.sum(stored, where=~missing)) or np.isneginf(np.min(stored))
    if suspicious:
        _refuse_non_finite(path, stored)
    if missing.all():
        raise FileFormatError(f"{path}: every value is negative, which means missing: give a table with values")
    stored *= SCALE[:, None, None, None]
    stored[missing] = np.nan
    return brdf_table(np.moveaxis(stored, 0, -1), sampling, source=path.name)


def write_merl(path: str | Path, brdf: xr.DataArray, *, force: bool = False) -> None:
    """Write a BRDF table as a MERL file.

    Missing values (NaN) are written as -1, which means missing in the format.

    Args:
        path: file to write (.binary).
        brdf: table in 1/sr, such as that returned by `read_merl`, shape (90, 90, 180, 3), non-negative, not all missing.
            Labelled channels must be R, G and B.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `brdf` is not a table on the MERL grid, does not have the channels R, G and B, or has negative
            values, too large values or no values.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from matcam.core.grid import brdf_table
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grey.binary"
        ...     matcam.write_merl(path, brdf_table(np.full((90, 90, 180, 3), 0.5), "centre"))
        ...     path.stat().st_size
        34992012
    """
    brdf = checked_table(brdf)
    check_channels(brdf)
    stored = np.array(np.moveaxis(brdf.values, -1, 0), dtype=np.float64, order="C")
    lowest, highest = np.fmin.reduce(stored, axis=None), np.fmax.reduce(stored, axis=None)
    if np.isnan(lowest):
        raise ArgumentError("a MERL file must have at least one value: all values of this table are missing")
    if lowest < 0:
        raise ArgumentError(
            f"a MERL file cannot contain negative values, got {lowest:g} 1/sr: use NaN for missing values; write a table with "
            "noise about 0 to a .nc file, or set its negative values to 0, which increases the albedo"
        )
    with np.errstate(over="ignore"):
        stored /= SCALE[:, None, None, None]
    if np.isinf(stored).any():
        raise ArgumentError(
            f"a MERL file cannot contain {highest:g} 1/sr, because the stored value would overflow: give values below "
            "1e305 1/sr"
        )
    stored[np.isnan(stored)] = -1.0
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        np.array(GRID_SHAPE, dtype=_HEADER).tofile(file)
        stored.astype(_VALUE, copy=False).tofile(file)


def check_channels(brdf: xr.DataArray) -> None:
    """Raise ArgumentError if a MERL file cannot contain the channels of a table."""
    if brdf.sizes["channel"] != len(CHANNELS):
        raise ArgumentError(
            f"a MERL file requires the channels R, G, B, but this table has {brdf.sizes['channel']}: write a .nc file"
        )


def _read_stored(path: Path) -> np.ndarray:
    """Check size and header, and read the stored values, (3, 90, 90, 180)."""
    with reading(path, "a MERL file"):
        size = path.stat().st_size
        with path.open("rb") as file:
            header = file.read(_HEADER_BYTES)
            if len(header) < _HEADER_BYTES:
                raise FileFormatError(
                    f"{path}: the file has only {size} bytes, but a MERL file starts with 12 bytes of dimensions"
                )
            dims = tuple(np.frombuffer(header, dtype=_HEADER).tolist())
            if dims != GRID_SHAPE:
                raise FileFormatError(
                    f"{path}: the file is not a MERL file: its bytes 0 to 11 are {dims}, but must be {GRID_SHAPE}"
                )
            if size != FILE_BYTES:
                what = "truncated" if size < FILE_BYTES else "oversized"
                raise FileFormatError(f"{path}: the file is {what}: {size} bytes, but a MERL file has {FILE_BYTES}")
            values = np.fromfile(file, dtype=_VALUE)
    if values.nbytes != FILE_BYTES - _HEADER_BYTES:
        raise FileFormatError(f"{path}: the file changed while it was read: try again")
    return values.astype(np.float64, copy=False).reshape(len(CHANNELS), *GRID_SHAPE)


def _refuse_non_finite(path: Path, stored: np.ndarray) -> None:
    """Raise FileFormatError for non-finite values, with the byte of the first one."""
    bad = np.flatnonzero(~np.isfinite(stored))
    if bad.size:  # a sum of huge but valid values overflows, too
        byte = _HEADER_BYTES + _VALUE.itemsize * bad[0]
        raise FileFormatError(
            f"{path}: byte {byte} is {stored.flat[bad[0]]}, not a finite number ({bad.size} such values): store "
            "missing values as -1"
        )
