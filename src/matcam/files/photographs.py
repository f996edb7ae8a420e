"""Photographs as arrays of their own codes: TIFF, PNG and JPEG in 8 or 16 bits, OpenEXR, camera raw.

Nothing is converted, scaled, rotated or demosaiced. Decoders are tifffile and imagecodecs, which keep 16 bits (Pillow turns a
16-bit colour PNG into 8 bits), and LibRaw (rawpy, extra `raw`), which gives the mosaic as the sensor counted it.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.files.float_pictures import DEFLATE_LIMIT, read_exr
from matcam.files.picture_header import Exif, check_memory, jpeg_size, png_size, read_exif

SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mrw", ".nef", ".nrw", ".orf", ".pef",
    ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip


_TIFF, _PNG, _JPEG = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_EXR = b"\x76\x2f\x31\x01"
_LARGEST = 2 << 30  # bytes
PICTURES = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".exr", *SUFFIXES)
"""Suffixes of files that may be photographs."""


class Mosaic(NamedTuple):
    """Hold a linear mosaic.

    Attributes:
        values: counts above the black level, float32 (height, width).
        cfa: colours of the first 2 x 2 px, row by row ("RGGB").
        saturation: counts at which a pixel is full.
    """

    values: np.ndarray
    cfa: str
    saturation: float


def read_raw(path: str | Path) -> Mosaic:
    """Read the mosaic of a camera raw file.

    FileFormatError naming the file where LibRaw does not know it, where it is damaged, or its colours are no Bayer mosaic, and
    where rawpy is not installed.
    """
    try:
        import rawpy
    except ImportError:
        raise FileFormatError(f"{path}: camera raw needs rawpy: python -m pip install 'matcam[raw]'") from None
    try:
        with rawpy.imread(str(path)) as raw:
            counts = None if raw.raw_image_visible is None else np.asarray(raw.raw_image_visible, dtype=np.float32)
            pattern, names = raw.raw_pattern, raw.color_desc.decode("ascii", "replace")
            black = np.asarray(raw.black_level_per_channel, dtype=np.float32)
            white = float(raw.white_level)
    except rawpy.LibRawFileUnsupportedError:
        raise FileFormatError(f"{path}: unknown camera raw: LibRaw does not know this format or camera") from None
    except rawpy.LibRawError as error:
        what = error.args[0] if error.args else error
        what = what.decode("ascii", "replace") if isinstance(what, bytes) else str(what)
        raise FileFormatError(f"{path}: camera raw cannot be read: {what}") from None
    if counts is None or counts.ndim != 2 or pattern is None or pattern.shape != (2, 2):
        raise FileFormatError(f"{path}: its colours are no Bayer mosaic of 2 x 2 px; others are not supported")
    cfa = "".join(names[i] for i in pattern.ravel())
    if sorted(cfa) != ["B", "G", "G", "R"] or cfa[0] == cfa[3] != "G":
        raise FileFormatError(f"{path}: its mosaic is {cfa}; red, green, green, blue is supported")
    height, width = counts.shape
    tile = black[pattern]
    counts -= np.tile(tile, (height // 2 + 1, width // 2 + 1))[:height, :width]
    return Mosaic(counts, cfa, white - float(tile.max()))


class Photograph(NamedTuple):
    """Hold a picture as it lies in its file, and what the file says of it.

    Attributes:
        values: (height, width) or (height, width, 3), in the file's own type.
        cfa: colours of a mosaic's first 2 x 2 px, row by row ("RGGB"); None: no mosaic.
        saturation: value of a full pixel; infinite if it is not known.
        linear: whether the format holds linear values by its nature: camera raw, floats.
        exif: what the file says of the camera.
    """

    values: np.ndarray
    cfa: str | None
    saturation: float
    linear: bool
    exif: Exif


def open_photograph(path: str | Path) -> Photograph:
    """Read a picture of any of these formats.

    FileFormatError naming the file where it is missing, unknown, damaged, or larger than memory allows.
    """
    path = Path(path)
    with reading(path, "a picture"):
        exif = read_exif(path)
    if exif.dng or (path.suffix.lower() in SUFFIXES and path.is_file()):
        mosaic = read_raw(path)
        return Photograph(mosaic.values, mosaic.cfa, mosaic.saturation, True, exif)
    values = _read_exr(path) if _start(path)[:4] == _EXR else read_photograph(path)
    whole = values.dtype.kind in "ui"
    return Photograph(values, None, float(np.iinfo(values.dtype).max) if whole else np.inf, not whole, exif)


def read_photograph(path: str | Path) -> np.ndarray:
    """Return the codes of a picture, (height, width) or (height, width, 3), in the file's own type.

    An alpha channel is left out. FileFormatError naming the file where it is missing, of another format, or damaged.
    """
    path = Path(path)
    start = _start(path)
    try:
        picture = _decoded(path, start)
    except FileFormatError:
        raise
    except Exception as error:  # decoders raise what they like on damaged files
        raise FileFormatError(f"{path}: damaged picture: {' '.join(str(error).split())[:120]}") from None
    if picture.ndim == 3 and picture.shape[2] in (2, 4):
        picture = picture[..., : picture.shape[2] - 1]
    if picture.ndim == 3 and picture.shape[2] == 1:
        picture = picture[..., 0]
    if picture.ndim not in (2, 3) or picture.size == 0 or (picture.ndim == 3 and picture.shape[2] != 3):
        raise FileFormatError(f"{path}: a picture of shape {picture.shape} is neither grey nor red, green, blue")
    if picture.dtype.kind not in "uif":
        raise FileFormatError(f"{path}: samples of type {picture.dtype} are not supported")
    return picture


def _read_exr(path: Path) -> np.ndarray:
    picture = read_exr(path)
    if picture.ndim == 3 and picture.shape[2] != 3:
        raise FileFormatError(f"{path}: a picture of {picture.shape[2]} channels is neither grey nor red, green, blue")
    return picture


def _tiff_size(shape: tuple[int, ...]) -> tuple[int, int, int]:
    """Return height, width and channels; a page of separate colours begins with them."""
    if len(shape) == 3 and shape[0] < shape[2]:
        return shape[1], shape[2], shape[0]
    return shape[0], shape[1], int(np.prod(shape[2:]))


def _start(path: Path) -> bytes:
    """Return the file's first bytes."""
    with reading(path, "a picture"):
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for a photograph")
        with path.open("rb") as file:
            return file.read(26)


def _decoded(path: Path, start: bytes) -> np.ndarray:
    if start[:4] in _TIFF:
        import tifffile

        with tifffile.TiffFile(path) as file:
            page = file.pages[0].aspage()
            check_memory(path, *_tiff_size(page.shape), np.dtype(page.dtype or "u1").itemsize)
            size = path.stat().st_size
            ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
            if page.nbytes > DEFLATE_LIMIT * size or max(ends, default=0) > size:
                raise FileFormatError(f"{path}: header says {page.shape}, more than its {size} bytes can hold: damaged")
            picture = np.asarray(page.asarray())
            planar = page.planarconfig == 2 and picture.ndim == 3
        return np.moveaxis(picture, 0, -1) if planar else picture
    import imagecodecs

    if start[:8] == _PNG:
        check_memory(path, *png_size(start))
        return np.asarray(imagecodecs.png_decode(path.read_bytes()))
    if start[:3] == _JPEG:
        check_memory(path, *jpeg_size(path))
        return np.asarray(imagecodecs.jpeg8_decode(path.read_bytes()))
    raise FileFormatError(f"{path}: neither TIFF, PNG, JPEG, OpenEXR nor camera raw")
