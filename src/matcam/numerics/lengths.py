"""Lengths of vectors that have a derivative where they are zero."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import xp

if TYPE_CHECKING:
    from matcam.core.jax import jax


def plane_length(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return sqrt(x^2 + y^2), whose derivative at zero is zero.

    `xp.hypot` has none there since JAX 0.12, and what is smooth in the square of a length would lose its own.
    """
    square = x * x + y * y
    nowhere = square == 0
    return xp.where(nowhere, 0.0, xp.sqrt(xp.where(nowhere, 1.0, square)))
