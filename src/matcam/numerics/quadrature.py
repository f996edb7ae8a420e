"""Gauss-Legendre panels for integrals with a narrow peak at one end of the range."""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax, jnp


def nodes_between(low: jax.Array, high: jax.Array, order: int) -> tuple[jax.Array, jax.Array]:
    """Gauss-Legendre (nodes, weights) on [low, high], on a trailing axis."""
    unit, weight = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(order))
    half = (high - low)[..., None] / 2
    return (high + low)[..., None] / 2 + half * unit, half * weight


def nodes_in_panels(cuts: jax.Array, order: int) -> tuple[jax.Array, jax.Array]:
    """The same in every panel between neighbouring cuts (last axis), one panel after the other."""
    nodes, weights = nodes_between(cuts[..., :-1], cuts[..., 1:], order)
    return nodes.reshape(*nodes.shape[:-2], -1), weights.reshape(*nodes.shape[:-2], -1)


def graded_nodes(borders: jax.Array, scale: jax.Array, graded: int, order: int) -> tuple[jax.Array, jax.Array]:
    """(nodes, weights) between the first and the last of `borders` (which run one way on the last axis) for a function
    that peaks at the first on the scale `scale`: the panels between the borders, cut further by `graded` that grow by one
    factor from scale / 2; on a trailing axis. Signed: borders that fall have negative weights."""
    start, length = borders[..., :1], borders[..., -1:] - borders[..., :1]
    first = jax.lax.stop_gradient(scale)[..., None] / 2
    size = jnp.abs(length)
    growing = jnp.minimum(first * (jnp.maximum(size, first) / first) ** (np.arange(graded) / graded), size)
    steps = jnp.sort(jnp.concatenate([growing, jnp.abs(borders - start)], axis=-1), axis=-1)
    cuts = start + jnp.where(length < 0, -steps, steps)
    return nodes_in_panels(cuts, order)
