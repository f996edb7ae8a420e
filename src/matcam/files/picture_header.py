"""Metadata of an image that are read before decoding: size and camera.

The size is read from the first bytes, before memory is allocated for the image.

Maker, model, f-number and exposure time are in the TIFF or Exif directory. Exif is a TIFF directory (CIPA DC-008-2023,
4.6). It is at the start of a TIFF and of most camera raw files, in the APP1 segment of a JPEG, or in the eXIf chunk of
a PNG. A directory has a uint16 count and entries of 12 bytes: uint16 tag, uint16 type, uint32 count, and the value or
its offset. A damaged directory is treated as absent.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.memory import available_memory
from matcam.core.readers.apart import files_are_trusted

_MOST_SEGMENTS = 200
LARGEST = 1 << 29
"""Largest number of values in an image of floats (2 GiB). A header with a larger number is treated as damaged."""
DEFLATE_LIMIT = 1032
"""Largest ratio of the sizes after and before decompression by deflate: 258 bytes for every 2 bits."""
_MAKE, _MODEL, _EXIF, _DNG = 0x010F, 0x0110, 0x8769, 0xC612
_SAMPLE_FORMAT, _FLOATS = 0x0153, 3
_WIDTH, _HEIGHT, _LONG = 0x0100, 0x0101, 4
_TIFF = {b"II*\0": "<", b"MM\0*": ">", b"IIRO": "<", b"IIU\0": "<"}
"""Byte order by the first four bytes of a file. The last two entries are those of Olympus and Panasonic."""


def picture_memory() -> int:
    """Compute the memory for one image with its working copies, bytes.

    It is half of the available memory.
    """
    return int(0.5 * available_memory())


def check_memory(path: Path, height: int, width: int, channels: int, depth: int, there: int) -> None:
    """Check that an image and its working copies fit into memory.

    `depth` is the number of bytes per sample, and `there` the memory that the image may use, bytes. A FileFormatError is
    raised if the image does not fit. Unless files are trusted, an image that needs more than 1 GiB is also rejected if
    it is more than 100 times as large as its file.
    """
    decoded = height * width * channels * depth
    # a plane of float64, its mask, and two temporary copies take 24 bytes per pixel
    needed = decoded + height * width * 24
    if needed > there:
        raise FileFormatError(
            f"{path}: an image of {width} x {height} px needs {needed / 2**30:.1f} GiB, but only "
            f"{there / 2**30:.1f} GiB of memory may be used: free memory, or give a smaller image"
        )
    size = path.stat().st_size
    # no camera writes a file that is compressed more than 100 times
    if needed > 1 << 30 and decoded > 100 * size and not files_are_trusted():
        raise FileFormatError(
            f"{path}: an image of {width} x {height} px in {size} bytes is compressed too strongly and needs "
            f"{needed / 2**30:.1f} GiB of memory: store it with less compression"
        )


def cut(picture: np.ndarray, region: Sequence[int] | None, path: Path) -> np.ndarray:
    """Crop an image to a region.

    `region` contains first column, first row, width and height, px. None means the whole image. A FileFormatError is
    raised if the region is not within the image.
    """
    if region is None:
        return picture
    column, row, width, height = region
    if column + width > picture.shape[1] or row + height > picture.shape[0] or min(column, row) < 0:
        raise FileFormatError(
            f"{path}: an image of {picture.shape[1]} x {picture.shape[0]} px does not contain the region of {width} x {height} "
            f"px at column {column}, row {row}: check that all images have the same size"
        )
    return picture[row : row + height, column : column + width]


def check_promised(path: Path, height: int, width: int, channels: int, size: int) -> None:
    """Check that a file can contain its image of 32-bit floats, before memory is allocated.

    `size` is the size of the file, bytes. A FileFormatError is raised if the image is empty or implausibly large, or if
    no compression represents it in `size` bytes.
    """
    values = height * width * channels
    if min(height, width, channels) < 1 or values > LARGEST or 4 * values > DEFLATE_LIMIT * size:
        raise FileFormatError(
            f"{path}: the header specifies {height} x {width} pixels of {channels} channels in {size} bytes: the file "
            "is damaged, or the image is too large; give a smaller image"
        )


def png_size(start: bytes) -> tuple[int, int, int, int]:
    """Read height, width, channels and bytes per sample of a PNG.

    `start` contains the first 26 bytes of the file.
    """
    width, height, bits, colours = struct.unpack_from(">IIBB", start, 16)
    # a PNG specifies its number of channels by a colour type
    return height, width, {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(colours, 4), max(bits // 8, 1)


def jpeg_size(path: Path) -> tuple[int, int, int, int]:
    """Read height, width, channels and bytes per sample of a JPEG.

    All four are 0 if they are unknown.
    """
    with path.open("rb") as file:
        at = 2
        for _ in range(_MOST_SEGMENTS):
            file.seek(at)
            head = file.read(10)
            if len(head) < 10 or head[0] != 0xFF:
                break
            if head[1] in {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}:
                bits, height, width, channels = struct.unpack(">BHHB", head[4:])
                return height, width, channels, max(bits // 8, 1)
            at += 2 + struct.unpack(">H", head[2:4])[0]
    return 0, 0, 0, 0


class Exif(NamedTuple):
    """Metadata of the camera in an image file.

    Attributes:
        camera: maker and model; empty: unknown.
        f_number: f-number of the image; None: unknown.
        dng: True if the file is a digital negative (camera raw in a TIFF container).
        size: width and height in the first directory of a TIFF, px; None: unknown.
        time: exposure time, s (CIPA DC-008-2023, 4.6.5); None: unknown.
        integers: True if the first image of a TIFF has integer values (TIFF 6.0, SampleFormat).
    """

    camera: str = ""
    f_number: float | None = None
    dng: bool = False
    size: tuple[int, int] | None = None
    time: float | None = None
    integers: bool = False


def read_exif(path: str | Path) -> Exif:
    """Read the metadata of an image.

    The result is empty if the metadata are missing or unreadable.
    """
    try:
        with Path(path).open("rb") as file:
            base = _start(file)
            return Exif() if base is None else _directory(file, base)
    except (OSError, struct.error, ValueError, KeyError, OverflowError):
        return Exif()


def _start(file: BinaryIO) -> int | None:
    """Find the offset of the TIFF header, bytes. The result is None if the file has no TIFF header."""
    head = file.read(12)
    if head[:4] in _TIFF:
        return 0
    if head[:3] == b"\xff\xd8\xff":
        at = 2
        for _ in range(_MOST_SEGMENTS):
            file.seek(at)
            marker, length = struct.unpack(">HH", file.read(4))
            if marker == 0xFFE1 and file.read(6) == b"Exif\0\0":
                return at + 10
            if marker in (0xFFDA, 0xFFD9):
                return None
            at += 2 + length
    if head[:8] == b"\x89PNG\r\n\x1a\n":
        at = 8
        for _ in range(_MOST_SEGMENTS):
            file.seek(at)
            length, kind = struct.unpack(">I4s", file.read(8))
            if kind == b"eXIf":
                return at + 8
            at += 12 + length
    return None


def _directory(file: BinaryIO, base: int) -> Exif:
    file.seek(base)
    head = file.read(8)
    order = _TIFF[head[:4]]
    first = _entries(file, base, struct.unpack(order + "I", head[4:])[0], order)
    make, model = (_text(file, base, first[tag], order) if tag in first else "" for tag in (_MAKE, _MODEL))
    found = dict(first)
    if _EXIF in first:
        found |= _entries(file, base, struct.unpack(order + "I", first[_EXIF][2])[0], order)
    f_number, time = (_ratio(file, base, found.get(tag), order) for tag in (0x829D, 0x829A))  # FNumber, ExposureTime
    # the names of many models begin with the name of their maker
    named = model if model.lower().startswith(make.lower()) else f"{make} {model}"
    integers = base == 0 and _WIDTH in first and not _is_float(file, base, first.get(_SAMPLE_FORMAT), order)
    return Exif(named.strip(), f_number, _DNG in first, _size(first, order), time, integers)


def _is_float(file: BinaryIO, base: int, entry: tuple[int, int, bytes] | None, order: str) -> bool:
    """Check whether samples are floats.

    SampleFormat has one value per channel. Without SampleFormat, samples are unsigned integers.
    """
    if entry is None:
        return False
    _, count, value = entry
    if count > 2:  # the entry contains the offset of the values
        file.seek(base + struct.unpack(order + "I", value)[0])
        value = file.read(2)
    return bool(struct.unpack(order + "H", value[:2])[0] == _FLOATS)


def _ratio(file: BinaryIO, base: int, entry: tuple[int, int, bytes] | None, order: str) -> float | None:
    """Read a positive rational number. The result is None if the number is missing or damaged."""
    if entry is None:
        return None
    file.seek(base + struct.unpack(order + "I", entry[2])[0])
    pair = file.read(8)
    over, under = struct.unpack(order + "II", pair) if len(pair) == 8 else (0, 0)
    return over / under if over and under else None


def _size(entries: dict[int, tuple[int, int, bytes]], order: str) -> tuple[int, int] | None:
    if _WIDTH not in entries or _HEIGHT not in entries:
        return None
    width, height = (
        struct.unpack(order + ("I" if kind == _LONG else "Hxx"), value)[0]
        for kind, _, value in (entries[_WIDTH], entries[_HEIGHT])
    )
    return width, height


def _entries(file: BinaryIO, base: int, offset: int, order: str) -> dict[int, tuple[int, int, bytes]]:
    """Read the entries of a directory: tag -> (type, count, value or offset)."""
    file.seek(base + offset)
    count = struct.unpack(order + "H", file.read(2))[0]
    if count > 500:
        raise ValueError
    entries = file.read(12 * count)
    return {tag: (kind, size, value) for tag, kind, size, value in struct.iter_unpack(order + "HHI4s", entries)}


def _text(file: BinaryIO, base: int, entry: tuple[int, int, bytes], order: str) -> str:
    kind, size, value = entry
    if kind != 2 or size > 200:  # ASCII
        return ""
    if size > 4:
        file.seek(base + struct.unpack(order + "I", value)[0])
        value = file.read(size)
    return " ".join(value[:size].split(b"\0")[0].decode("ascii", "replace").split())
