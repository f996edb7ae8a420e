"""Values between the points of a regular grid, for functions that hold nothing finer than the grid."""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp

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
