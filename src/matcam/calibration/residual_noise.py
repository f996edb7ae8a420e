"""A picture's noise, from what a fit has left of it."""

from __future__ import annotations

import numpy as np

_ROUNDING = 1e-13  # of the mean square: no picture is without any


def noise_of(residual: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """gain and read variance, both >= 0, for which gain * value + read variance explains squared residuals best.

    value: what the model expects of the pixels. Raised to what rounding leaves, so that both are never 0 together.
    """
    square, level = residual**2, np.maximum(value, 0)
    least = _ROUNDING * float((value**2).mean()) + 1e-300
    off = level - level.mean()
    gain = float((off * (square - square.mean())).sum() / max(float((off * off).sum()), 1e-300))
    gain = min(max(gain, 0.0), float(square.mean() / max(float(level.mean()), 1e-300)))
    return gain, max(float(square.mean() - gain * level.mean()), least)
