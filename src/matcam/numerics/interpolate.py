"""Values between the points of a regular grid, for functions that hold nothing finer than the grid.

Cubic B-splines that bend a function smoothly, and what keeps them smooth.
"""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax, jnp

POINTS = 8
"""Points per axis that a value is made of; half of them must lie on either side."""

_SCALE = np.array([np.prod([float(k - m) for m in range(POINTS) if m != k]) for k in range(POINTS)])


def lagrange(position: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(index of the first point, weights (..., POINTS)) of Lagrange's polynomial at `position`, in grid steps."""
    first = jnp.floor(position).astype(int) - (POINTS // 2 - 1)
    t = (position - first)[..., None] - np.arange(POINTS)
    # products of all but one factor, from the left and from the right
    left = jnp.cumprod(t, axis=-1)
    right = jnp.cumprod(t[..., ::-1], axis=-1)[..., ::-1]
    one = jnp.ones_like(t[..., :1])
    others = jnp.concatenate([one, left[..., :-1]], axis=-1) * jnp.concatenate([right[..., 1:], one], axis=-1)
    return first, others / _SCALE


def interpolated(grids: jax.Array, which: jax.Array, row: jax.Array, column: jax.Array) -> jax.Array:
    """Values at fractional (row, column) of the grids numbered `which`; grids: (n, rows, columns, channels), the rest
    (targets,). Shape (targets, channels)."""
    first_row, row_weight = lagrange(row)
    first_column, column_weight = lagrange(column)
    steps = np.arange(POINTS)
    patch = grids[
        which[:, None, None], (first_row[:, None] + steps)[:, :, None], (first_column[:, None] + steps)[:, None, :]
    ]
    return jnp.einsum("trkc,tr,tk->tc", patch, row_weight, column_weight)


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
