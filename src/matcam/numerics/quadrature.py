"""Gauss-Legendre quadrature on intervals, on panels, and on panels that are graded towards a narrow peak."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from matcam.core.jax import jax, jnp

AnyValues = TypeVar("AnyValues", np.ndarray, jax.Array)


def nodes_between(low: AnyValues, high: AnyValues, order: int) -> tuple[AnyValues, AnyValues]:
    """Return Gauss-Legendre (nodes, weights) on [low, high], on a trailing axis; arrays of NumPy give arrays of NumPy."""
    unit, weight = np.polynomial.legendre.leggauss(order)
    half = (high - low)[..., None] / 2
    return (high + low)[..., None] / 2 + half * unit, half * weight


def nodes_in_panels(cuts: AnyValues, order: int) -> tuple[AnyValues, AnyValues]:
    """Return (nodes, weights) of every panel between neighbouring cuts (last axis), one panel after the other."""
    nodes, weights = nodes_between(cuts[..., :-1], cuts[..., 1:], order)
    return nodes.reshape(*nodes.shape[:-2], -1), weights.reshape(*nodes.shape[:-2], -1)


def graded_nodes(borders: jax.Array, scale: jax.Array, graded: int, order: int) -> tuple[jax.Array, jax.Array]:
    """Return (nodes, weights) for a function that peaks at the first of `borders` on the scale `scale`.

    The range runs from the first to the last border, which run one way on the last axis. The panels between borders are cut
    further by `graded` cuts, which grow by one factor from scale / 2. Borders that fall have negative weights. Nodes and
    weights stand on a trailing axis.
    """
    start, length = borders[..., :1], borders[..., -1:] - borders[..., :1]
    first = jax.lax.stop_gradient(scale)[..., None] / 2
    size = jnp.abs(length)
    growing = jnp.minimum(first * (jnp.maximum(size, first) / first) ** (np.arange(graded) / graded), size)
    steps = jnp.sort(jnp.concatenate([growing, jnp.abs(borders - start)], axis=-1), axis=-1)
    cuts = start + jnp.where(length < 0, -steps, steps)
    return nodes_in_panels(cuts, order)
