"""Photographs as arrays of their own codes: TIFF, PNG, JPEG, in 8 or 16 bits. Nothing is converted, scaled or rotated.

Decoders: tifffile and imagecodecs, which keep 16 bits (Pillow turns a 16-bit colour PNG into 8 bits).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from matcam.errors import FileFormatError

_TIFF, _PNG, _JPEG = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_LARGEST = 2 << 30  # bytes


def read_photograph(path: str | Path) -> np.ndarray:
    """Codes of a picture, (height, width) or (height, width, 3), in the file's own type; an alpha channel is left out.

    FileFormatError naming the file where it is missing, of another format, or damaged.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(8)
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for a photograph")
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
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


def _decoded(path: Path, start: bytes) -> np.ndarray:
    if start[:4] in _TIFF:
        import tifffile

        with tifffile.TiffFile(path) as file:
            page = file.pages[0].aspage()
            picture = np.asarray(page.asarray())
            planar = page.planarconfig == 2 and picture.ndim == 3
        return np.moveaxis(picture, 0, -1) if planar else picture
    import imagecodecs

    if start == _PNG:
        return np.asarray(imagecodecs.png_decode(path.read_bytes()))
    if start[:3] == _JPEG:
        return np.asarray(imagecodecs.jpeg8_decode(path.read_bytes()))
    raise FileFormatError(f"{path}: neither TIFF, PNG nor JPEG")
