"""Decoders of images (TIFF, PNG, JPEG, OpenEXR, camera raw), which run in a separate process (apart.py).

Decoders are tifffile, imagecodecs, OpenEXR and LibRaw. tifffile and imagecodecs preserve 16 bits, but Pillow converts a
16-bit colour PNG to 8 bits. LibRaw (rawpy, extra `raw`) returns the mosaic of the sensor. `there` is the memory, in
bytes, that the calling process has for the image and its working copies: a larger image is rejected before decoding.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.files.picture_header import DEFLATE_LIMIT, check_memory, check_promised, cut, jpeg_size, png_size


def decode_photograph(path: Path, *, there: int, region: Sequence[int] | None = None) -> np.ndarray:
    """Decode a TIFF, PNG or JPEG, or a region of it.

    The result has shape (height, width) or (height, width, 3). An alpha channel is omitted.
    """
    with path.open("rb") as file:
        # the size of a PNG ends at byte 26
        start = file.read(26)
    picture = _decoded(path, start, there, in_part=region is not None)
    if picture.ndim == 3 and picture.shape[2] in (2, 4):
        picture = picture[..., : picture.shape[2] - 1]
    if picture.ndim == 3 and picture.shape[2] == 1:
        picture = picture[..., 0]
    if picture.ndim not in (2, 3) or picture.size == 0 or (picture.ndim == 3 and picture.shape[2] != 3):
        raise FileFormatError(
            f"{path}: the image has the shape {picture.shape}: give a grey image (height, width) or a colour "
            "image (height, width, 3)"
        )
    if picture.dtype.kind not in "uif":
        raise FileFormatError(
            f"{path}: samples of type {picture.dtype} are not supported: give an image of integers or floats"
        )
    return cut(picture, region, path)


def _decoded(path: Path, start: bytes, there: int, *, in_part: bool = False) -> np.ndarray:
    if start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        import tifffile

        with tifffile.TiffFile(path) as file:
            page = file.pages[0].aspage()
            if page.subfiletype & 1 or start[8:10] == b"CR":  # NewSubfileType (TIFF 6.0), or header of a CR2
                raise FileFormatError(
                    f"{path}: the file starts with a preview of {page.imagewidth} x {page.imagelength} px, as camera raw does: "
                    "rename the file with the suffix of its raw format (.dng, .nef, .cr2, ...)"
                )
            check_memory(path, *_tiff_size(page.shape), np.dtype(page.dtype or "u1").itemsize, there)
            size = path.stat().st_size
            ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
            if page.nbytes > DEFLATE_LIMIT * size or max(ends, default=0) > size:
                raise FileFormatError(
                    f"{path}: the file is damaged: its header specifies an image of shape {page.shape}, but the file has only "
                    f"{size} bytes; copy it again"
                )
            # if the file stores the image uncompressed, only the memory pages of the region are read
            mapped = in_part and page.is_memmappable
            picture = page.asarray(out="memmap") if mapped else np.asarray(page.asarray())
            planar = page.planarconfig == 2 and picture.ndim == 3
        return np.moveaxis(picture, 0, -1) if planar else picture
    import imagecodecs

    if start[:8] == b"\x89PNG\r\n\x1a\n":
        check_memory(path, *png_size(start), there)
        return np.asarray(imagecodecs.png_decode(path.read_bytes()))
    if start[:3] == b"\xff\xd8\xff":
        check_memory(path, *jpeg_size(path), there)
        return np.asarray(imagecodecs.jpeg8_decode(path.read_bytes()))
    raise FileFormatError(
        f"{path}: the file is neither TIFF, PNG, JPEG, OpenEXR nor camera raw: convert it to TIFF or PNG"
    )


def _tiff_size(shape: tuple[int, ...]) -> tuple[int, int, int]:
    """Derive height, width and channels from the shape of a page.

    If the colours are stored as separate planes, the first axis is that of the colours.
    """
    if len(shape) == 3 and shape[0] < shape[2]:
        return shape[1], shape[2], shape[0]
    return shape[0], shape[1], int(np.prod(shape[2:]))


def decode_raw(path: Path, *, there: int, region: Sequence[int] | None = None) -> dict[str, Any]:
    """Decode the mosaic of a camera raw file, or a region of it.

    The result has three entries. `values` are float32 counts above the black level. `cfa` contains the colours of the
    first 2 x 2 px row by row ("RGGB"). `saturation` is the value of a saturated pixel in the same counts.
    """
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            check_memory(path, raw.sizes.raw_height, raw.sizes.raw_width, 1, 4, there)
            counts = None if raw.raw_image_visible is None else np.asarray(raw.raw_image_visible, dtype=np.float32)
            pattern, names = raw.raw_pattern, raw.color_desc.decode("ascii", "replace")
            black = np.asarray(raw.black_level_per_channel, dtype=np.float32)
            white = float(raw.white_level)
    except rawpy.LibRawFileUnsupportedError:
        raise FileFormatError(
            f"{path}: unknown camera raw, because LibRaw does not support this format or camera: convert the file to DNG"
        ) from None
    except rawpy.LibRawError as error:
        what = error.args[0] if error.args else error
        what = what.decode("ascii", "replace") if isinstance(what, bytes) else str(what)
        raise FileFormatError(f"{path}: the camera raw file cannot be read: {what}; copy it again") from None
    if counts is None or counts.ndim != 2 or pattern is None or pattern.shape != (2, 2):
        raise FileFormatError(
            f"{path}: the camera raw file has no Bayer mosaic of 2 x 2 px, and other data are not supported: convert it to TIFF"
        )
    cfa = "".join(names[i] for i in pattern.ravel())
    if sorted(cfa) != ["B", "G", "G", "R"] or "GG" not in (cfa[::3], cfa[1:3]):
        raise FileFormatError(
            f"{path}: the mosaic is {cfa}, but must be that of Bayer (RGGB, BGGR, GRBG or GBRG): convert the file to TIFF"
        )
    height, width = counts.shape
    tile = black[pattern]
    counts -= np.tile(tile, (height // 2 + 1, width // 2 + 1))[:height, :width]
    return {"values": cut(counts, region, path), "cfa": cfa, "saturation": white - float(tile.max())}


def decode_float_tiff(path: Path, *, there: int) -> np.ndarray:
    import tifffile

    size = path.stat().st_size
    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # tifffile also logs the errors that it raises
    with tifffile.TiffFile(path) as file:
        if len(file.pages) != 1:
            raise FileFormatError(f"{path}: the file has {len(file.pages)} pages, but only one page is supported")
        page = file.pages[0].aspage()
        if page.dtype != np.float32:
            raise FileFormatError(
                f"{path}: the file contains {page.dtype or 'an unknown type'}, but only 32-bit floats are supported"
            )
        shape = file.series[0].shape if file.is_shaped else page.shape
        if page.planarconfig != 1:
            raise FileFormatError(
                f"{path}: the image of shape {shape} has separate planes of channels: store them interleaved"
            )
        if len(shape) not in (2, 3):
            raise FileFormatError(
                f"{path}: the image has shape {shape}, but only (H, W) and (H, W, channels) are supported"
            )
        height, width, channels = (*page.shape, 1)[:3]
        check_promised(path, height, width, channels, size)
        check_memory(path, height, width, channels, 4, there)
        ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if max(ends, default=0) > size:
            raise FileFormatError(
                f"{path}: the file is truncated: the data extend to byte {max(ends)}, but the file has {size}; copy it again"
            )
        if 0 in page.databytecounts:
            raise FileFormatError(f"{path}: the file is damaged: a part of the image has no data; create it again")
        return np.ascontiguousarray(page.asarray().reshape(shape), dtype=np.float32)


def decode_exr(path: Path, *, channels: list[str]) -> dict[str, np.ndarray]:
    """Decode channels of an OpenEXR file by name.

    The caller must have checked the structure of the file.
    """
    import OpenEXR

    stored = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(stored[name].pixels) for name in channels}
