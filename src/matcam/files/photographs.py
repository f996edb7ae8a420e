"""Photographs as arrays of their stored codes: TIFF, PNG and JPEG in 8 or 16 bits, OpenEXR, camera raw.

Images are not converted, scaled, rotated or demosaiced. Only the black level of camera raw is subtracted. Files are
decoded in a separate process (picture_decoders.py).
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.readers.apart import read_apart
from matcam.core.readers.names import is_file
from matcam.files.float_pictures import read_exr
from matcam.files.picture_header import Exif, cut, picture_memory, read_exif

SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mrw", ".nef", ".nrw", ".orf", ".pef",
    ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip
"""Suffixes of camera raw files."""

_DECODERS = "matcam.files.picture_decoders"
_EXR = b"\x76\x2f\x31\x01"
PICTURES = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".exr", *SUFFIXES)
"""Suffixes of files that are listed as photographs."""


class Photograph(NamedTuple):
    """Image as stored in its file, with metadata.

    Attributes:
        values: (height, width) or (height, width, 3), in the type of the file.
        cfa: colours of a mosaic's first 2 x 2 px, row by row ("RGGB"); None: not a mosaic.
        saturation: value of a saturated pixel; infinite if unknown.
        linear: True if the format stores linear values (camera raw, floats).
        exif: metadata of the camera.
    """

    values: np.ndarray
    cfa: str | None
    saturation: float
    linear: bool
    exif: Exif


def open_photograph(path: str | Path, region: tuple[int, int, int, int] | None = None) -> Photograph:
    """Read an image of any supported format, or a region of it.

    `region` contains first column, first row, width and height, px. Default: None, the whole image. First column and
    first row must be even, to preserve the mosaic. Images are cropped during decoding. A FileFormatError is raised if
    the file is missing, of an unknown format, damaged, smaller than the region, or too large for the memory, or if
    rawpy is not installed.
    """
    path = Path(path)
    with reading(path, "an image"), path.open("rb") as file:
        start = file.read(len(_EXR))
        exif = read_exif(path)
    if exif.dng or (path.suffix.lower() in SUFFIXES and is_file(path)):
        there = _memory_for(path)
        if importlib.util.find_spec("rawpy") is None:
            raise FileFormatError(f"{path}: camera raw needs rawpy: run python -m pip install 'matcam[raw]'")
        raw = read_apart(f"{_DECODERS}:decode_raw", path, "an image", libraries=("rawpy",), there=there, region=region)
        return Photograph(raw["values"], raw["cfa"], raw["saturation"], True, exif)
    values = cut(_read_exr(path), region, path) if start == _EXR else read_photograph(path, region)
    whole = values.dtype.kind in "ui"
    return Photograph(values, None, float(np.iinfo(values.dtype).max) if whole else np.inf, not whole, exif)


def read_photograph(path: str | Path, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
    """Read the codes of an image or of a region of it.

    The result has shape (height, width) or (height, width, 3), and the type of the file. An alpha channel is omitted.
    A FileFormatError is raised if the file is missing, unsupported, damaged, too large, or smaller than `region` (see
    `open_photograph`).
    """
    path = Path(path)
    there = _memory_for(path)
    libraries = ("tifffile", "imagecodecs._zlib", "imagecodecs._png", "imagecodecs._jpeg8")
    return read_apart(
        f"{_DECODERS}:decode_photograph", path, "an image", libraries=libraries, there=there, region=region
    )


def _read_exr(path: Path) -> np.ndarray:
    picture = read_exr(path)
    if picture.ndim == 3 and picture.shape[2] != 3:
        raise FileFormatError(
            f"{path}: the image has {picture.shape[2]} channels: give a grey image, or one with red, green and blue"
        )
    return picture


def _memory_for(path: Path) -> int:
    """Compute the available memory for an image, bytes. A FileFormatError is raised for a file that is too large."""
    with reading(path, "an image"):
        size, largest = path.stat().st_size, 2 << 30
        if size > largest:
            raise FileFormatError(
                f"{path}: the file has {size} bytes, but at most {largest} are allowed for a photograph: give "
                "a smaller file"
            )
    return picture_memory()
