"""Pictures smoothed, with or without gaps: a mosaic has a colour at some of its pixels only."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from matcam.calibration.wave_fit import Array

_ALONE = 1e-6  # of the Gaussian's weight: a pixel that sees less of what is there is left dark


def smoothed(values: Array, width: float) -> Array:
    """Means about every pixel (height, width), weighted by a Gaussian of `width` px, of what is there. values: NaN where there
    are no data; the result has none."""
    there = np.isfinite(values)
    if there.all():
        return np.asarray(ndimage.gaussian_filter(values, width))
    known = ndimage.gaussian_filter(np.where(there, values, 0.0), width)
    return np.asarray(known / np.maximum(ndimage.gaussian_filter(there.astype(float), width), _ALONE))
