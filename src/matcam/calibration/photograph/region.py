"""A region of a photograph before anything is measured in it: is there anything to measure, and its local means."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from matcam.calibration.photograph.linear_image import SMALLEST
from matcam.core.jax import FloatArray
from matcam.core.remark import Remark

_FLAT_TOP = 0.05  # share at the very same, brightest value, that is worth a look
_ALONE = 1e-6  # of the Gaussian's weight: a pixel with fewer data around it is left dark


def flaws(values: np.ndarray) -> list[Remark | None]:
    """Return the `flaw` of every region of a stack.

    It is quick where there is none.
    """
    low, high = values.min((1, 2)), values.max((1, 2))
    share = (values == high[:, None, None]).mean((1, 2))
    doubtful = ~((low < high) & (share <= _FLAT_TOP))  # NaN is doubtful
    return [flaw(value) if look else None for value, look in zip(values, doubtful, strict=True)]


def flaw(values: np.ndarray) -> Remark | None:
    """Return why nothing can be measured in a region.

    None if something might be. values: (height, width).
    """
    used = values[np.isfinite(values)]
    if used.size < SMALLEST**2 / 4:
        return Remark("too-few-samples", f"region holds {used.size} usable samples: too few")
    low, high = used.min(), used.max()
    if not low < high:
        return Remark("flat", f"region is all one value, {low:g}: there is no edge in it")
    if (used == high).mean() > _FLAT_TOP:
        # noise piles up at the end of a range, and nowhere else; without noise the dark side is as flat
        middle = (low + high) / 2
        flat = (used == high).sum() / (used > middle).sum()
        dark = np.unique(used[used <= middle], return_counts=True)[1]
        if dark.max() / dark.sum() < flat / 2:
            text = f"region is saturated: {flat:.0%} of its bright samples have the very same value, {high:g}"
            return Remark("saturated", text)
    return None


def local_mean(values: FloatArray, width: float) -> FloatArray:
    """Return the local means of a picture (height, width).

    They are weighted by a Gaussian of `width` px. NaN are filled from around.
    """
    known = np.isfinite(values)
    if known.all():
        return np.asarray(ndimage.gaussian_filter(values, width))
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width)
    return np.asarray(total / np.maximum(ndimage.gaussian_filter(known.astype(float), width), _ALONE))


def program_size(size: int) -> int:
    """Return the next size for which a program is compiled.

    It is 8, 10, 12 or 14 times a power of two, so that nearly equal sizes share one program.
    """
    power = 1
    while True:
        for eighths in (8, 10, 12, 14):
            if eighths * power >= size:
                return eighths * power
        power *= 2
