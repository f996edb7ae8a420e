"""Lengths of vectors that have a derivative where they are zero."""

from __future__ import annotations

from matcam.core.jax import jax, jnp


def plane_length(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return sqrt(x^2 + y^2), whose derivative at zero is zero.

    `jnp.hypot` has none there since JAX 0.12, and what is smooth in the square of a length would lose its own.
    """
    square = x * x + y * y
    nowhere = square == 0
    return jnp.where(nowhere, 0.0, jnp.sqrt(jnp.where(nowhere, 1.0, square)))
