"""What a file is, by its content."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Literal

import numpy as np

from matcam.angles import GRID_SHAPE
from matcam.errors import FileFormatError
from matcam.input_file import reading

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
