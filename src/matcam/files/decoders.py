"""Decoders of labelled arrays (NetCDF-4 and Zarr), which run in a separate process (apart.py).

Files are not trusted. Links to other files, storage in other files, and groups are rejected before any value is read.
Filters and codecs must be on a short list, because HDF5 would load plugins for others. Arrays must not be larger than
16 times the file.
"""

from __future__ import annotations

import json
import math
import struct
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core import checks
from matcam.core.errors import FileFormatError

_HDF5 = b"\x89HDF\r\n\x1a\n"
_MOST_VARIABLES = 256
_FILTERS = {1: "deflate", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset"}
"""Built-in filters of HDF5 by number. All others are plugins, which are not loaded."""
_CODECS = {"bytes", "crc32c", "gzip", "zstd", "blosc", "transpose", "vlen-utf8"}
_NUMBERS = {
    "bool",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
    "float16",
    "float32",
    "float64",
}
DESCRIPTION = "zarr.json"
_DESCRIPTION_BYTES = 1 << 20


def check_stored_sizes(path: Path, size: int, variables: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
    """Check that a file can contain its arrays.

    A FileFormatError is raised if the file has more than 256 arrays, if a length is not an integer >= 0, or if the
    arrays take more than 16 times the bytes of the file. Such a file is damaged or compressed too strongly.
    """
    if len(variables) > _MOST_VARIABLES:
        raise FileFormatError(
            f"{path}: the file contains {len(variables)} variables, but a result has at most {_MOST_VARIABLES}: give a "
            "file of one result"
        )
    total = 0
    for name, (shape, kind) in variables.items():
        check_lengths(path, name, shape)
        # text of variable length has no given size
        # a Python string and the pointers to it take 64 bytes
        each = kind.itemsize if isinstance(kind, np.dtype) and kind.kind != "O" else 64
        total += math.prod(shape) * max(each, 1)
        if total > 16 * size + (1 << 16):
            raise FileFormatError(
                f"{path}: variable {name!r:.60} of {' x '.join(map(str, shape))} values does not fit into {size} bytes: "
                "the file is damaged, or compressed too strongly; create it again without compression"
            )


def check_lengths(path: Path, name: str, shape: Sequence[Any]) -> None:
    """Raise FileFormatError unless all lengths are integers >= 0."""
    if not all(type(length) is int and length >= 0 for length in shape):
        raise FileFormatError(
            f"{path}: variable {name!r:.60} has invalid lengths {list(shape)!r:.60}: the file is damaged; "
            "create it again"
        )


def decode_netcdf(path: Path) -> dict[str, Any]:
    import h5netcdf
    import h5py

    with path.open("rb") as file:
        if file.read(len(_HDF5)) != _HDF5:
            raise FileFormatError(f"{path}: the file is not a NetCDF-4 file: convert it to NetCDF-4")
    with h5py.File(path, "r", locking=False) as stored:
        _check_hdf5(path, stored)
        with h5netcdf.File(stored, phony_dims="sort") as opened:
            variables = {
                name: {"dims": v.dimensions, "values": v[...], "attrs": _texts(v.attrs)}
                for name, v in opened.variables.items()
            }
            return {"variables": variables, "attrs": _texts(opened.attrs)}


def _texts(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Decode attributes that are bytes, because HDF5 stores a text of one character as a byte."""
    return {
        name: value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        for name, value in attributes.items()
    }


def _check_hdf5(path: Path, file: Any) -> None:
    import h5py

    shapes: dict[str, tuple[tuple[int, ...], Any]] = {}
    chunks: dict[str, tuple[tuple[int, ...], Any]] = {}
    for index, name in enumerate(file):
        if index > _MOST_VARIABLES:
            raise FileFormatError(
                f"{path}: the file contains more than {_MOST_VARIABLES} variables: give a file of one result"
            )
        link = file.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise FileFormatError(
                f"{path}: {name!r:.60} is a link to another file, {link.filename!r:.80}, which is not followed: "
                "give a file that contains all of its variables"
            )
        if not isinstance(link, h5py.HardLink):
            raise FileFormatError(
                f"{path}: {name!r:.60} is a symbolic link, which is not followed: give a file that contains all "
                "of its variables"
            )
        variable = file[name]
        if isinstance(variable, h5py.Group):
            raise FileFormatError(
                f"{path}: {name!r:.60} is a group, which is not supported: store the variables outside of groups"
            )
        if not isinstance(variable, h5py.Dataset):
            continue  # a named type, which no variable requires
        if variable.external:
            raise FileFormatError(
                f"{path}: variable {name!r:.60} is stored in another file, {variable.external[0][0]!r:.80}, which is not read: "
                "give a file that contains all of its variables"
            )
        if variable.is_virtual:
            raise FileFormatError(
                f"{path}: variable {name!r:.60} is assembled from other files, which are not read: give a file "
                "that contains all of its variables"
            )
        if variable.dtype.kind == "O" and h5py.check_string_dtype(variable.dtype) is None:
            raise FileFormatError(
                f"{path}: variable {name!r:.60} contains lists or references, but only numbers and text are supported"
            )
        creation = variable.id.get_create_plist()
        seen: set[int] = set()
        for number in range(creation.get_nfilters()):
            code = creation.get_filter(number)[0]
            if code not in _FILTERS:
                raise FileFormatError(
                    f"{path}: variable {name!r:.60} is compressed by filter {code}; supported: {', '.join(_FILTERS.values())}"
                )
            if code in seen:  # each pass of deflate multiplies the size by up to 1032
                raise FileFormatError(
                    f"{path}: variable {name!r:.60} is filtered twice by {_FILTERS[code]}: the file is damaged; create it again"
                )
            seen.add(code)
        shapes[name] = (variable.shape or (), variable.dtype)
        if variable.chunks:  # a chunk is decoded completely, even if the array uses little of it
            chunks[f"{name} (chunk)"] = (variable.chunks, variable.dtype)
    # checked before reading, because a damaged dimension is filled up to its declared length
    size = path.stat().st_size
    check_stored_sizes(path, size, shapes)
    check_stored_sizes(path, size, chunks)


def decode_zarr(path: Path) -> dict[str, Any]:
    checks.extra("Zarr", "scale", "zarr")
    import zarr
    from zarr import storage

    _check_zarr(path)
    with storage.ZipStore(path, mode="r") as store, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        group = zarr.open_group(store, mode="r", zarr_format=3, use_consolidated=False)
        variables = {
            name: {
                "dims": list(getattr(array.metadata, "dimension_names", None) or ()),
                "values": array[...],
                "attrs": dict(array.attrs),
            }
            for name, array in group.arrays()
        }
        return {"variables": variables, "attrs": dict(group.attrs)}


def decode_rows(folder: Path, *, arrays: list[str], row: int | None = None) -> dict[str, Any]:
    """Read the attributes of a Zarr store, and complete arrays or one row of each.

    `arrays` contains the names of the arrays. `row` is the index of the row. Default: None, complete arrays.
    """
    import zarr

    group: Any = zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)
    return {
        "attrs": dict(group.attrs),
        "values": {name: group[name][...] if row is None else group[name][row] for name in arrays},
    }


def _check_zarr(path: Path) -> None:
    size = path.stat().st_size
    _check_directory(path, size)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if any(m.compress_type != zipfile.ZIP_STORED or max(m.file_size, m.compress_size) > size for m in members):
            raise FileFormatError(
                f"{path}: the file is damaged, or compressed by zip: its members must be uncompressed (zip -0)"
            )
        _check_members(path, size, members)
        described = {}
        for member in members:
            if member.filename.endswith((".zarray", ".zgroup", ".zattrs", ".zmetadata")):
                raise FileFormatError(
                    f"{path}: {member.filename!r:.60} is of Zarr version 2: write the store in version 3"
                )
            if member.filename.rsplit("/", 1)[-1] == DESCRIPTION:
                if member.filename.count("/") > 1:
                    raise FileFormatError(
                        f"{path}: {member.filename!r:.60} is inside an array or a second group: store the arrays in the "
                        "root group"
                    )
                if member.file_size > _DESCRIPTION_BYTES:
                    raise FileFormatError(
                        f"{path}: {member.filename!r:.60} has {member.file_size} bytes, but must have at most "
                        f"{_DESCRIPTION_BYTES}: the file is damaged; create it again"
                    )
                described[member.filename] = json.loads(archive.read(member))
        broken = archive.testzip()
    if broken:
        raise FileFormatError(f"{path}: the checksum of {broken} differs: the file is damaged; copy or create it again")
    if described.get(DESCRIPTION, {}).get("node_type") != "group":
        raise FileFormatError(
            f"{path}: the file is not a Zarr store of version 3, because its root has no zarr.json of a group: write "
            "the store in version 3"
        )
    shapes, chunks = {}, {}
    for name, document in described.items():
        if document.get("zarr_format") != 3:
            raise FileFormatError(f"{path}: {name!r:.60} is not of Zarr version 3: write the store in version 3")
        if document.get("node_type") == "array":
            check_codecs(path, name, document)
            width = _width(document["data_type"])
            shapes[name] = (tuple(document["shape"]), width)
            chunks[f"{name} (chunk)"] = (chunk_shape(document), width)
        elif name != DESCRIPTION:
            raise FileFormatError(f"{path}: {name!r:.60} is a group inside a group: store the arrays in the root group")
    check_stored_sizes(path, size, shapes)
    check_stored_sizes(path, size, chunks)


def check_codecs(path: Path, name: str, document: dict[str, Any]) -> None:
    """Check that the values and codecs of a Zarr array are supported.

    `document` is the description of the array. A FileFormatError is raised if the array is not supported.
    """
    kind = document["data_type"]
    kind = kind["name"] if isinstance(kind, dict) else kind
    if kind not in _NUMBERS | {"string", "fixed_length_utf32"}:
        raise FileFormatError(
            f"{path}: {name!r:.60} has values of type {kind!r:.40}, but only numbers and text are supported"
        )
    if document["chunk_grid"]["name"] != "regular":
        raise FileFormatError(f"{path}: {name!r:.60} must have regular chunks")
    if document.get("storage_transformers"):
        raise FileFormatError(
            f"{path}: {name!r:.60} has storage transformers, which are not supported: write the array without them"
        )
    for codec in document["codecs"]:
        used = codec["name"] if isinstance(codec, dict) else codec
        if used not in _CODECS:
            raise FileFormatError(
                f"{path}: {name!r:.60} is coded by {used!r:.40}; supported: {', '.join(sorted(_CODECS))}"
            )


def chunk_shape(document: dict[str, Any]) -> tuple[int, ...]:
    return tuple(document["chunk_grid"]["configuration"]["chunk_shape"])


def _width(kind: Any) -> np.dtype | None:
    """Find a NumPy type with the width of one value of a Zarr array. The result is None for text of variable length."""
    if isinstance(kind, dict):
        length = kind.get("configuration", {}).get("length_bytes")
        return np.dtype(f"V{int(length)}") if length else None
    return np.dtype(kind) if kind in _NUMBERS else None


def _check_members(path: Path, size: int, members: list[zipfile.ZipInfo]) -> None:
    """Reject members that overlap, occur twice or extend beyond the file.

    Many members with the same bytes would be a zip bomb.
    """
    end = 0
    for member in sorted(members, key=lambda m: m.header_offset):
        if member.header_offset < end:
            raise FileFormatError(
                f"{path}: member {member.filename!r:.60} overlaps the previous member: the file is damaged; create it again"
            )
        # a local header takes 30 bytes, without its name and extra field
        end = member.header_offset + 30 + len(member.filename.encode()) + member.compress_size
    if end > size:
        raise FileFormatError(
            f"{path}: the members of the zip end at byte {end} of {size}: the file is damaged; copy or create it again"
        )
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        raise FileFormatError(f"{path}: a member occurs twice in the zip: the file is damaged; create it again")


def _check_directory(path: Path, size: int) -> None:
    """Check that the directory of a zip lies within the file.

    `zipfile` would allocate the size that the file specifies.
    """
    with path.open("rb") as file:
        # the end of a zip takes 22 bytes, and its comment at most 64 KiB
        file.seek(max(0, size - (22 + (1 << 16))))
        end = file.read()
    at = end.rfind(b"PK\5\6")
    if at < 0 or len(end) < at + 22:
        raise FileFormatError(
            f"{path}: the file is not a zip file, or its end is missing: give a Zarr store in one zip file"
        )
    length, start = struct.unpack_from("<II", end, at + 12)
    if length + start > size:
        raise FileFormatError(
            f"{path}: the list of members of the zip, {length} bytes at byte {start}, exceeds the file: the file is "
            "damaged; copy or create it again"
        )
