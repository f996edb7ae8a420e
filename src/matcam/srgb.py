"""sRGB's transfer function (IEC 61966-2-1) and its inverse: light as a share of white <-> code as a share of full scale."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def encoded(light: ArrayLike) -> np.ndarray:
    """Codes of linear light; of light below 0 as well, on the straight part."""
    light = np.asarray(light, dtype=np.float64)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def decoded(code: ArrayLike) -> np.ndarray:
    """Linear light of codes, the inverse of `encoded`."""
    code = np.asarray(code, dtype=np.float64)
    return np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0) + 0.055) / 1.055) ** 2.4)
