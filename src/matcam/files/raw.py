"""Camera raw: the mosaic as the sensor counted it, through LibRaw (rawpy, extra `raw`). Nothing is demosaiced or balanced."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.errors import FileFormatError

SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mrw", ".nef", ".nrw", ".orf", ".pef",
    ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip


class Mosaic(NamedTuple):
    """A mosaic, linear."""

    values: np.ndarray
    """(height, width) float32, counts above the black level."""
    cfa: str
    """Colours of the first 2 x 2 px, row by row."""
    saturation: float
    """Counts at which a pixel is full."""


def read_raw(path: str | Path) -> Mosaic:
    """The mosaic of a camera raw file. FileFormatError naming the file where it is none that LibRaw knows, where it is
    damaged, where its colours are no Bayer mosaic, and where rawpy is not installed."""
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
