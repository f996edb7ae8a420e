"""Systematic difference of alternate pixels of an image, which indicates a colour mosaic.

The columns and rows of a mosaic alternate in brightness, because the pixels of one colour are brighter than those of
another. In other images, alternate pixels do not differ systematically over the whole image.
"""

from __future__ import annotations

import numpy as np

from matcam.core.arrays import FloatArray
from matcam.numerics.normal import SIGNIFICANT, robust_std

_LARGEST = 1024
"""Largest side of the central area that is tested, px. It limits the computing time."""
_DARK = 0.2
"""Level relative to the bright parts of the image below which pixels are ignored, because noise dominates."""
_ALTERNATING = 0.03
"""Relative difference of alternating pixels above which an image is a mosaic."""
_FEWEST = 30
"""Smallest number of pixels for a median."""


def alternation(values: FloatArray) -> float:
    """Measure the relative difference of alternating pixels over an image (height, width); 0 if it is not significant.

    Second differences of neighbours are 0 where the values are constant or change linearly. Their medians at every
    second pixel of every second row or column measure the periodic part, independently of edges.
    """
    height, width = values.shape
    top, left = max(height - _LARGEST, 0) // 4 * 2, max(width - _LARGEST, 0) // 4 * 2
    middle = values[top : top + _LARGEST, left : left + _LARGEST]
    some = middle[::3, ::3]
    some = some[np.isfinite(some)]
    if not some.size:
        return 0.0
    dark = _DARK * float(np.quantile(some, 0.95))
    return max(_of_lines(middle, dark), _of_lines(middle.T, dark))


def _of_lines(values: FloatArray, dark: float) -> float:
    """Measure the relative difference of alternating pixels along the rows; 0 if it is not significant.

    `dark`: level below which pixels are ignored.
    """
    before, at, after = values[:, :-2], values[:, 1:-1], values[:, 2:]
    mean = (before + 2 * at + after) / 4
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(mean > dark, at / mean - 1, np.nan)
    found = 0.0
    for row in (0, 1):
        # Values of the two kinds of pixels, the second with the opposite sign.
        parts = [part[np.isfinite(part)] for part in (share[row::2, ::2], -share[row::2, 1::2])]
        if min(part.size for part in parts) >= _FEWEST:
            ends = [float(np.median(part)) for part in parts]
            # Standard deviation of a median.
            std = max(1.25 * robust_std(part - end) / np.sqrt(part.size) for part, end in zip(parts, ends, strict=True))
            least = min(map(abs, ends))
            if ends[0] * ends[1] > 0 and least > max(_ALTERNATING / 2, SIGNIFICANT * std):
                found = max(found, 2 * least)
    return found
