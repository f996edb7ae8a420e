"""Lengths of vectors, with a derivative at zero."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import xp

if TYPE_CHECKING:
    from matcam.core.jax import jax


def plane_length(x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute sqrt(x^2 + y^2), with derivative zero at zero.

    `xp.hypot` has none there since JAX 0.12, so smooth functions of the squared length would lose their derivatives.
    """
    square = x * x + y * y
    nowhere = square == 0
    return xp.where(nowhere, 0.0, xp.sqrt(xp.where(nowhere, 1.0, square)))
