"""Cubic B-splines that bend a function smoothly, and what keeps them smooth."""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp


def cubic_basis(place: jax.Array, count: int) -> list[jax.Array]:
    """`count` functions at `place` in [0, count - 1]: local, smooth to the second derivative, sum 1; mirrored at 0, constant
    at the end."""
    basis = [_cubic(place - k) for k in range(count)]
    basis[1] += _cubic(place + 1)
    basis[-1] += _cubic(place - count)
    return basis


def combined(numbers: jax.Array, basis: list[jax.Array]) -> jax.Array:
    """sum_k numbers_k B_k."""
    return sum((number * own for number, own in zip(numbers, basis, strict=True)), jnp.zeros(()))


def smoothness(count: int) -> np.ndarray:
    """(rows, count): what is kept small of the numbers: their second differences, a third of the first ones, a little of
    their mean, which something else takes away."""
    numbers = np.eye(count)
    return np.concatenate([np.diff(numbers, 2, axis=0), np.diff(numbers, axis=0) / 3, np.full((1, count), 0.1 / count)])


def _cubic(x: jax.Array) -> jax.Array:
    """Cardinal cubic B-spline."""
    x = jnp.abs(x)
    return jnp.maximum(2 - x, 0.0) ** 3 / 6 - 4 * jnp.maximum(1 - x, 0.0) ** 3 / 6
