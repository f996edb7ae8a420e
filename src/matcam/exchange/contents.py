"""What a file is, by its content.

What a file holds, whatever its format: a table on the MERL grid, RGL's fields, samples, any other result, or a picture.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import GRID_SHAPE, Sampling, checked_table
from matcam.core.io import reading
from matcam.files.datasets import read_netcdf, read_zarr
from matcam.files.float_pictures import read_exr, read_float_tiff
from matcam.files.merl import read_merl
from matcam.files.rgl import check_fields, read_rgl
from matcam.files.samples import read_samples, table_of
from matcam.material.adaptive import Adaptive
from matcam.material.material import Material
from matcam.material.tabulated import Tabulated

Format = Literal["merl", "rgl", "csv", "netcdf", "zarr", "exr", "tiff", "camera profile", "picture sidecar"]

_STARTS: tuple[tuple[bytes, Format], ...] = (
    (np.array(GRID_SHAPE, dtype="<i4").tobytes(), "merl"),
    (b"tensor_file\0", "rgl"),
    (b"\x89HDF\r\n\x1a\n", "netcdf"),
    (struct.pack("<i", 20000630), "exr"),
    (b"II*\0", "tiff"),
    (b"MM\0*", "tiff"),
)
_TEXT_LENGTH = 4096


def identify(path: str | Path) -> Format:
    """Format of a file, by its content, or by its name where that is damaged. FileFormatError for anything that matcam does
    not read."""
    path = Path(path)
    with reading(path), path.open("rb") as file:
        head = file.read(_TEXT_LENGTH)
        file.seek(max(0, path.stat().st_size - _TEXT_LENGTH))
        tail = file.read(_TEXT_LENGTH)
    for start, kind in _STARTS:
        if head.startswith(start):
            return kind
    if head.startswith(b"PK\3\4") and b"zarr.json" in head + tail:
        return "zarr"
    if head.lstrip().startswith(b"{"):
        return "picture sidecar" if b'"matcam picture sidecar"' in head else "camera profile"
    first = head.split(b"\n", 1)[0]
    if b"_per_sr" in first and b"," in first:
        return "csv"
    by_name: dict[str, Format] = {".binary": "merl", ".bsdf": "rgl", ".csv": "csv", ".nc": "netcdf", ".exr": "exr"}
    if path.suffix in by_name:
        return by_name[path.suffix]
    raise FileFormatError(
        f"{path}: none of what matcam reads: MERL (starts with {GRID_SHAPE}), RGL, CSV of samples, NetCDF-4, Zarr in a zip, "
        "OpenEXR, TIFF, camera profile or picture sidecar (JSON)"
    )


class Contents(NamedTuple):
    """A file's format and what is in it; one of the others is not None."""

    format: Format
    table: xr.DataArray | None = None
    """On the MERL grid."""
    fields: xr.Dataset | None = None
    """RGL's."""
    samples: xr.DataArray | None = None
    """Of a BRDF, off the MERL grid."""
    result: xr.Dataset | None = None
    """Any other labelled result."""
    picture: np.ndarray | None = None

    @property
    def kind(self) -> str:
        """What it is, in words."""
        names = {
            "table": "a table on the MERL grid",
            "fields": "a BRDF in RGL's parameterisation",
            "samples": "scattered samples",
            "result": "a result that is no BRDF",
            "picture": "a picture",
        }
        return next(words for name, words in names.items() if getattr(self, name) is not None)


def read_contents(path: str | Path, sampling: Sampling = "centre") -> Contents:
    """Read a file of any format that holds measurements. sampling: of a MERL file, see `read_merl`. FileFormatError for
    anything else."""
    kind = identify(path)
    if kind == "merl":
        return Contents(kind, table=read_merl(path, sampling=sampling))
    if kind == "rgl":
        return Contents(kind, fields=read_rgl(path))
    if kind == "csv":
        samples = read_samples(path)
        try:
            return Contents(kind, table=table_of(samples))
        except ArgumentError:
            return Contents(kind, samples=samples)
    if kind in ("netcdf", "zarr"):
        return _labelled(Path(path), kind, read_netcdf(path) if kind == "netcdf" else read_zarr(path))
    if kind in ("exr", "tiff"):
        return Contents(kind, picture=read_exr(path) if kind == "exr" else read_float_tiff(path))
    raise FileFormatError(f"{path}: a {kind}, which holds no measurement")


def _labelled(path: Path, kind: Format, data: xr.Dataset) -> Contents:
    try:
        if "vndf" in data:
            return Contents(kind, fields=check_fields(data))
        if (
            "brdf" in data
            and data["brdf"].dims == ("theta_h", "theta_d", "phi_d", "channel")
            and len(data.data_vars) == 1
        ):
            return Contents(kind, table=checked_table(data["brdf"]))
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return Contents(kind, result=data)


def material_of(contents: Contents) -> Material:
    """The material that a file describes. ArgumentError where it describes none."""
    if contents.table is not None:
        return Tabulated(contents.table)
    if contents.fields is not None:
        return Adaptive(contents.fields)
    raise ArgumentError(
        f"{contents.kind} cannot be evaluated at any angle: a table (MERL, RGL, CSV on the MERL grid) can"
    )
