"""First position at which a sampled curve falls to a level."""

from __future__ import annotations

import numpy as np

from matcam.core.arrays import FloatArray


def first_fall(x: FloatArray, curve: FloatArray, level: float = 0.5) -> FloatArray:
    """Find the lowest x at which a curve falls to a level, by linear interpolation.

    Args:
        x: positions of the samples, ascending, (n,).
        curve: samples of one or several curves, (..., n).
        level: level to find, in the unit of the curve. Default: 0.5.

    Returns:
        Positions, in the unit of x, (...); NaN where a curve begins below the level, or never falls below it.
    """
    curve = np.asarray(curve)
    below = curve < level
    k = np.maximum(below.argmax(-1), 1)
    flat, row = curve.reshape(-1, curve.shape[-1]), np.arange(k.size)
    before, after = (flat[row, at.ravel()].reshape(k.shape) for at in (k - 1, k))
    crosses = below.any(-1) & ~below[..., 0]
    share = (before - level) / np.where(crosses, before - after, 1.0)
    return np.asarray(np.where(crosses, x[k - 1] + share * (x[k] - x[k - 1]), np.nan))
