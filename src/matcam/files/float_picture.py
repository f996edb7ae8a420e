"""What a picture file may hold: 32-bit floats, (H, W) or (H, W, channels), row 0 on top. Shared by the formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from matcam.errors import ArgumentError, FileFormatError
from matcam.input_file import reading

LARGEST = 1 << 29
"""Values in one picture, at most (2 GiB): a header that promises more is taken for damaged."""
DEFLATE_LIMIT = 1032
"""What deflate makes of a byte at most (258 of every 2 bits): 1032."""


def as_float32(picture: ArrayLike) -> np.ndarray:
    """`picture` as contiguous float32. ArgumentError for a wrong shape, for complex numbers or text, and for values that
    float32 cannot hold; NaN (missing) and infinities pass."""
    given = np.asarray(picture)
    if given.dtype.kind not in "fiub":
        raise ArgumentError(f"picture must hold real numbers, got {given.dtype}")
    if given.ndim not in (2, 3) or given.size == 0 or given.size > LARGEST:
        raise ArgumentError(
            f"picture must have shape (H, W) or (H, W, channels) with at most {LARGEST} values, got {given.shape}"
        )
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(given, dtype=np.float32)
    lost = np.isinf(stored) & np.isfinite(given)
    if np.any(lost):
        raise ArgumentError(f"picture must lie within float32's range, got {given[lost].flat[0]:g}")
    return stored


def check_promised(path: Path, height: int, width: int, channels: int, size: int) -> None:
    """FileFormatError for a picture that nobody would store, or that a file of `size` bytes cannot hold however well it is
    compressed, before any memory is asked for it."""
    values = height * width * channels
    if min(height, width, channels) < 1 or values > LARGEST or 4 * values > DEFLATE_LIMIT * size:
        raise FileFormatError(
            f"{path}: header says {height} x {width} pixels of {channels} channels, in {size} bytes: damaged or too large"
        )


def file_size(path: Path) -> int:
    """Size in bytes. FileFormatError where there is no file that could be read."""
    with reading(path, "a picture"):
        return path.stat().st_size
