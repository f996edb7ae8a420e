"""Density of the normal distribution."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.core.arrays import xp

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


def normal_density(x: ArrayLike, std: ArrayLike = 1.0) -> jax.Array:
    """Evaluate exp(-x^2 / (2 std^2)) / (sqrt(2 pi) std)."""
    return xp.exp(-xp.square(xp.divide(x, std)) / 2) / (np.sqrt(2 * np.pi) * std)
