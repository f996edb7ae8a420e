"""Pictures as TIFF of 32-bit floats (TIFF 6.0, SampleFormat 3): one page, channels beside each other, deflated losslessly.

Three channels are marked as RGB, any other number as grey with extra samples; the values are linear all the same.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from matcam.atomic import replacing
from matcam.errors import FileFormatError
from matcam.files.float_picture import as_float32, check_promised, file_size


def write_float_tiff(path: str | Path, picture: ArrayLike, *, force: bool = False) -> None:
    """Write a picture, shape (H, W) or (H, W, channels), as float32. OutputError where it cannot go."""
    import tifffile

    stored = as_float32(picture)
    channels = stored.shape[2] if stored.ndim == 3 else 1
    with replacing(path, force=force) as temporary:
        tifffile.imwrite(
            temporary,
            stored,
            photometric="rgb" if channels == 3 else "minisblack",
            planarconfig="contig" if channels > 1 else None,
            compression="zlib",
        )


def read_float_tiff(path: str | Path) -> np.ndarray:
    """Read a picture: float32, shape (H, W) or (H, W, channels). FileFormatError for more than one page, other numbers
    than 32-bit floats, and damaged files."""
    import tifffile

    path = Path(path)
    size = file_size(path)
    try:
        with _quiet(), tifffile.TiffFile(path) as file:
            if len(file.pages) != 1:
                raise FileFormatError(f"{path}: {len(file.pages)} pages; one is read")
            page = file.pages[0].aspage()
            if page.dtype != np.float32:
                raise FileFormatError(f"{path}: holds {page.dtype or 'unknown numbers'}; 32-bit floats are read")
            shape = file.series[0].shape if file.is_shaped else page.shape
            if len(shape) not in (2, 3) or page.planarconfig != 1:
                raise FileFormatError(f"{path}: a picture of shape {shape}; (H, W) or (H, W, channels) is read")
            height, width, channels = (*page.shape, 1)[:3]
            check_promised(path, height, width, channels, size)
            ends = [a + n for a, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
            if max(ends, default=0) > size or 0 in page.databytecounts:
                raise FileFormatError(f"{path}: truncated: data up to byte {max(ends, default=0)}, the file has {size}")
            return np.ascontiguousarray(page.asarray().reshape(shape), dtype=np.float32)
    except FileFormatError:
        raise
    except Exception as error:  # a damaged file makes its reader throw nearly anything
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(f"{path}: not a TIFF file that can be read: {reason:.100}") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """The library logs what it then raises; one line is enough."""
    logger = logging.getLogger("tifffile")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)
