"""Table of the formats that matcam reads and writes, from which all lists are derived.

The format of an input is identified by its content, that of an output by its suffix. Readers and writers are imported
when they are called, so that the command line can print these lists without loading them.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.io import reading
from matcam.core.readers.names import is_folder, is_there
from matcam.core.registry import imported

CONTENTS = {
    "table": "a table on the MERL grid",
    "fields": "a BRDF in RGL's parameterisation",
    "samples": "scattered samples",
    "result": "a result of several variables",
    "picture": "an image",
    "camera": "a camera profile",
    "sidecar": "a picture sidecar",
    "chart": "a chart's description",
    "surface": "a fitted surface",
}
"""Contents of files, in words."""

MEASUREMENTS = ("table", "fields", "samples", "result", "picture")
"""Contents that `convert` converts between formats."""


@dataclass(frozen=True)
class Format:
    """File format with its reader and writers.

    Attributes:
        name: short name, as in reports.
        title: full name, for messages and lists.
        holds: keys of `CONTENTS` that the format supports.
        suffixes: endings of the names of its files, lower case, the preferred one first.
        starts: alternative first bytes of its files.
        mark: text near the beginning of a document, by which the format is identified.
        hint: description of the first bytes, for messages.
        reader: function that reads a path, as "module:function" below `matcam`; "" if the reader is in a higher layer.
        writers: functions that write (path, data, force=...), by content, as "module:function".
    """

    name: str
    title: str
    holds: tuple[str, ...]
    suffixes: tuple[str, ...]
    starts: tuple[bytes, ...] = ()
    mark: bytes = b""
    hint: str = ""
    reader: str = ""
    writers: Mapping[str, str] = field(default_factory=dict)

    @property
    def written(self) -> tuple[str, ...]:
        """Keys of `CONTENTS` that can be written in this format.

        Camera profiles and charts have their own writers.
        """
        return tuple(self.writers) or (() if self.reader else self.holds)

    def read(self, path: str | Path, **options: Any) -> Any:
        """Read a file.

        `options` are passed to the reader, such as `sampling` for MERL.
        """
        return imported(f"matcam.{self.reader}")(path, **options)

    def writer(self, content: str) -> Callable[..., None]:
        """Select the function that writes a content.

        The function has the arguments (path, data, force=...). An ArgumentError is raised if the format does not
        support the content.
        """
        if content in self.writers:
            return imported(f"matcam.{self.writers[content]}")
        choice, suffix = ", ".join(suffixes_for(content)), self.suffixes[0]
        if content == "picture":
            raise ArgumentError(f"an image cannot be stored in {suffix}: use {choice}")
        if "picture" in self.holds:
            raise ArgumentError(f"{CONTENTS[content]} is not an image and cannot be stored in {suffix}: use {choice}")
        raise ArgumentError(f"{CONTENTS[content]} cannot be stored in {suffix}: use {choice}")


_LABELLED = ("table", "fields", "samples", "result")

FORMATS = (
    Format(
        "merl",
        "MERL",
        ("table",),
        (".binary",),
        starts=(struct.pack("<3i", 90, 90, 180),),
        reader="files.merl:read_merl",
        writers={"table": "files.merl:write_merl"},
        hint="its first 12 bytes are 90, 90, 180",
    ),
    Format(
        "rgl",
        "RGL",
        ("fields",),
        (".bsdf",),
        starts=(b"tensor_file\0",),
        reader="files.rgl:read_rgl",
        writers={"fields": "files.rgl:write_rgl"},
    ),
    Format(
        "zemax",
        "Zemax BSDF",
        ("samples",),
        (".bsdf",),
        mark=b"SpectralContent",
        reader="files.zemax:read_zemax",
    ),
    Format(
        "utia",
        "UTIA",
        ("result",),
        (".bin",),
        reader="files.utia:read_utia",
    ),
    Format(
        "csv",
        "CSV",
        ("table", "samples", "result"),
        (".csv",),
        reader="files.samples:read_samples",
        writers={
            "table": "files.samples:write_samples",
            "samples": "files.samples:write_samples",
            "result": "core.io:write_columns",
        },
    ),
    Format(
        "netcdf",
        "NetCDF-4",
        _LABELLED,
        (".nc",),
        starts=(b"\x89HDF\r\n\x1a\n",),
        reader="files.datasets:read_netcdf",
        writers=dict.fromkeys(_LABELLED, "files.datasets:write_netcdf"),
    ),
    Format(
        "zarr",
        "Zarr in a zip",
        _LABELLED,
        (".zarr.zip",),
        reader="files.datasets:read_zarr",
        writers=dict.fromkeys(_LABELLED, "files.datasets:write_zarr"),
    ),
    Format(
        "bird",
        "BiRD (JSON)",
        ("samples",),
        (".brdf",),
        mark=b"brdf_json_schema",
        reader="files.bird:read_bird",
        writers={"samples": "files.bird:write_bird"},
    ),
    Format(
        "materialx",
        "MaterialX",
        ("surface",),
        (".mtlx",),
    ),
    Format(
        "exr",
        "OpenEXR",
        ("picture",),
        (".exr",),
        starts=(struct.pack("<i", 20000630),),
        reader="files.float_pictures:read_exr",
        writers={"picture": "files.float_pictures:write_exr"},
    ),
    Format(
        "tiff",
        "TIFF of floats",
        ("picture",),
        (".tif", ".tiff"),
        starts=(b"II*\0", b"MM\0*"),
        reader="files.float_pictures:read_float_tiff",
        writers={"picture": "files.float_pictures:write_float_tiff"},
    ),
    Format(
        "camera profile",
        "camera profile (JSON)",
        ("camera",),
        (".json",),
        mark=b'"matcam camera profile"',
    ),
    Format(
        "picture sidecar",
        "picture sidecar (JSON)",
        ("sidecar",),
        (".json",),
        mark=b'"matcam picture sidecar"',
        reader="files.sidecar:read_sidecar",
    ),
    Format(
        "chart",
        "chart description (JSON)",
        ("chart",),
        (".json",),
        mark=b'"matcam chart"',
    ),
)
"""All formats, in the order of the printed lists."""

_HEAD = 4096  # number of bytes at both ends of a file that are searched for marks


def format_named(name: str) -> Format:
    return next(form for form in FORMATS if form.name == name)


def suffixes_for(*contents: str) -> tuple[str, ...]:
    """List the suffixes of the output formats that support at least one of the given contents.

    `contents` are keys of `CONTENTS`. The suffixes are in the order of `FORMATS`.
    """
    return tuple(dict.fromkeys(s for form in FORMATS for s in form.suffixes if set(contents) & set(form.written)))


def titles_for(*contents: str) -> str:
    """List titles and suffixes of input formats, for messages.

    `contents` are keys of `CONTENTS`. A format is listed if it supports any of them.
    """
    read = (form for form in FORMATS if set(contents) & set(form.holds) and form.name != "materialx")
    return ", ".join(
        f"{form.title} ({', '.join(form.suffixes)})" if ".json" not in form.suffixes else form.title for form in read
    )


def identify(path: str | Path) -> str:
    """Identify the format of a file by its content.

    The suffix is used if the content has no mark of a format. A FileFormatError is raised if the file is missing or not
    supported.
    """
    path = Path(path)
    with reading(path), path.open("rb") as file:
        head = file.read(_HEAD)
        file.seek(max(0, path.stat().st_size - _HEAD))
        tail = file.read(_HEAD)
    for form in FORMATS:
        if head.startswith(form.starts):
            return form.name
    if head.startswith(b"PK\3\4") and b"zarr.json" in head + tail:
        return "zarr"
    if head.lstrip().startswith(b"{"):
        # a sidecar contains a camera profile: the first mark is that of the document itself
        marked = [form for form in FORMATS if form.mark and form.mark in head]
        named = [
            form.name
            for form in FORMATS
            if form.mark and path.suffix.lower() in form.suffixes
            if path.suffix != ".json"
        ]
        return min(marked, key=lambda form: head.find(form.mark)).name if marked else [*named, "camera profile"][0]
    marked = [form for form in FORMATS if form.mark and form.mark in head and ".json" not in form.suffixes]
    if marked:
        return marked[0].name
    first = head.split(b"\n", 1)[0]
    if b"_per_sr" in first and b"," in first:
        return "csv"
    for form in FORMATS:
        if not form.mark and path.suffix in form.suffixes:
            return form.name
    known = (f"{form.title} ({form.hint})" if form.hint else form.title for form in FORMATS)
    raise FileFormatError(f"{path}: unknown format; the supported formats are {', '.join(known)}")


def format_for(path: str | Path, *contents: str) -> Format:
    """Select the format of an output by the suffix of its name.

    The format supports at least one of `contents`, which are keys of `CONTENTS`. Default: the keys in `MEASUREMENTS`. An
    ArgumentError is raised for a name with another suffix.
    """
    name, contents = Path(path).name.lower(), contents or MEASUREMENTS
    for form in FORMATS:
        if set(contents) & set(form.written) and name.endswith(form.suffixes):
            return form
    raise ArgumentError(f"{path}: the name must end in one of {', '.join(suffixes_for(*contents))}")


_DECODERS = {
    ".nc": ("matcam.files.decoders", "h5py", "h5netcdf"),
    ".zip": ("matcam.files.decoders", "zarr.storage"),
    ".csv": ("matcam.files.table_decoders", "pandas"),
    ".bsdf": ("matcam.files.table_decoders", "matcam.files.zemax_decoder"),
    ".bin": ("matcam.files.table_decoders",),
    ".exr": ("matcam.files.picture_decoders", "OpenEXR"),
    **dict.fromkeys((".tif", ".tiff"), ("matcam.files.picture_decoders", "tifffile", "imagecodecs._zlib")),
    ".png": ("matcam.files.picture_decoders", "imagecodecs._png"),
    **dict.fromkeys((".jpg", ".jpeg"), ("matcam.files.picture_decoders", "imagecodecs._jpeg8")),
    **dict.fromkeys(
        (".arw", ".cr2", ".cr3", ".dng", ".nef", ".raf", ".rw2"), ("matcam.files.picture_decoders", "rawpy")
    ),
}
"""Modules that decode files in a separate process, by suffix."""


def decoded_by(paths: Iterable[Path]) -> list[str]:
    """List the modules that decode files, by the suffixes of the files.

    `paths` are files or folders. At most 100 files of each folder are considered. Missing paths are ignored.
    """
    suffixes = set()
    for path in paths:
        with contextlib.suppress(OSError, ValueError):  # the command reports this error
            inside = path.iterdir() if is_folder(path) else [path] if is_there(path) else []
            suffixes |= {file.suffix.lower() for file in islice(inside, 100)}
    return sorted({module for suffix in suffixes & set(_DECODERS) for module in _DECODERS[suffix]})
