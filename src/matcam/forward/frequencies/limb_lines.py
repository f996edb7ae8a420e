"""Radiance at the limb on a grid, from nodes along rows and columns of the grid.

Within a few px of the limb, the radiance varies as the square root of the distance from the limb, and ends there. Along
a row or column, the radiance is a smooth function of the angle (`lines.py`). The radiance ends at the limb, or at the
terminator if the terminator is closer. A row or column that meets the limb at less than 45 degrees would cause
aliasing. Rows are therefore used at the left and right limb, and columns at the top and bottom. The transition between
them is smooth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.frequencies.lines import Lines
from matcam.forward.frequencies.regions import Regions, falling
from matcam.forward.frequencies.taps import Taps
from matcam.numerics.approximation import nodes_between
from matcam.sample.curved import Sphere

_NODES = 32
"""Number of nodes along a row or column."""
_BETWEEN = 0.045
"""Standard deviation of the transition between rows and columns, rad."""
_STEEPEST_LINE = np.pi / 4 + 4.9 * _BETWEEN
"""Largest angle, at the centre of the sphere, between the direction of a row or column and its end at the limb, rad."""
_AT_ONCE = 16
"""Number of rows or columns that are computed at a time. Their arrays fit into the cache of a processor."""


class LimbLines(NamedTuple):
    """Rows or columns (lines) of a grid for one side of the limb, or for two opposite sides.

    Attributes:
        upright: True for columns, False for rows.
        sides: 1 if the lines end at the right or top, -1 at the left or bottom.
        first: index of the first line.
        last: index after the last line.
        length: number of grid points over which the nodes of one line are distributed.
    """

    upright: bool
    sides: tuple[int, ...]
    first: int
    last: int
    length: int


def limb_lines(
    fixed: np.ndarray, radius: float, widest: float, taps: Taps, upright: bool, sides: tuple[int, ...]
) -> LimbLines:
    """Select the rows or columns (lines) for one side of the limb, or for two.

    Args:
        fixed: positions of all lines across their direction, at a constant step, px.
        radius: radius of the limb, px.
        widest: largest depth of the region of the limb, px.
        taps: weights that distribute a node over neighbouring points of the grid.
        upright: see `LimbLines`.
        sides: see `LimbLines`.
    """
    served = np.flatnonzero(np.abs(fixed) < radius * np.sin(_STEEPEST_LINE))
    step = abs(fixed[1] - fixed[0])
    length = int(np.ceil(widest / step / np.cos(_STEEPEST_LINE))) + 2 * taps.reach + 2
    return LimbLines(upright, sides, int(served[0]), int(served[-1]) + 1, length)


def lay_limb(
    grid: jax.Array, regions: Regions, served: LimbLines, across: jax.Array, along: jax.Array, taps: Taps
) -> jax.Array:
    """Add the radiance of one side of the limb, or of two, to a grid.

    Args:
        grid: radiance on the grid, 1/sr, (rows, columns, channels).
        regions: regions of the radiance.
        served: lines of these sides.
        across: positions of all lines of the same direction, px.
        along: positions of the grid points on one line, px.
        taps: weights that distribute a node over neighbouring points of the grid.
    """
    first, step = along[0], along[1] - along[0]
    count = served.last - served.first
    padded = -(-count // _AT_ONCE) * _AT_ONCE
    number = served.first + jnp.minimum(jnp.arange(padded), count - 1)

    def light(block: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        fixed, side = block
        lines = Lines(regions.scene, served.upright, fixed)
        low, high = _ends(lines, regions, side)
        nothing = jnp.zeros((fixed.size, _NODES)), jnp.zeros((fixed.size, _NODES, grid.shape[-1]))
        return jax.lax.cond(jnp.any(high > low), lambda: _light(lines, regions, side, low, high), lambda: nothing)

    def lay(node: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        at, sent = node
        at = (at - first) / step
        lowest = jnp.floor(jnp.min(jax.lax.stop_gradient(at), axis=-1)).astype(int) - taps.reach
        start = jnp.clip(lowest, 0, along.size - served.length)

        def laid() -> jax.Array:
            weights = taps.weights(at, start, served.length)
            return jnp.einsum("lpn,lnc->lpc", weights, sent / jnp.abs(step))

        nothing = jnp.zeros((*start.shape, served.length, sent.shape[-1]))
        return start, jax.lax.cond(jnp.any(sent != 0), laid, lambda: nothing)

    # the radiance of all nodes is computed first, because it would be computed repeatedly inside the loop
    blocks, each = across[number].reshape(-1, _AT_ONCE), len(served.sides)
    sides = np.repeat(np.array(served.sides, dtype=float), blocks.shape[0])
    nodes = jax.lax.map(light, (jnp.tile(blocks, (each, 1)), jnp.asarray(sides)))
    starts, values = jax.lax.map(lay, nodes)
    values = values.reshape(each, padded, served.length, -1)[:, :count]
    where = starts.reshape(each, padded)[:, :count, None] + np.arange(served.length)
    line = number[:count, None]
    return grid.at[(where, line) if served.upright else (line, where)].add(values)


def _ends(lines: Lines, regions: Regions, side: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute the ends of the region of the limb on each line.

    They are angles on the circle of the line (see `Lines`), which increase towards `side`, rad.
    """
    middle, half = lines.lit()
    middle = side * middle
    middle = jnp.where(middle < -np.pi / 2, middle + 2 * np.pi, middle)  # the equivalent angle closest to the limb
    radius = regions.scene.sample.radius
    within = jnp.sqrt(jnp.maximum((radius - regions.depth) ** 2 - lines.fixed**2, 1e-12)) / lines.radius
    low = jnp.maximum(jnp.arcsin(jnp.clip(within, 0, 1 - 1e-12)), middle - half)
    high = jnp.minimum(np.pi / 2, middle + half)
    return low, jnp.maximum(high, low)


def _light(
    lines: Lines, regions: Regions, side: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the nodes on each line, px, and the radiance times weight at the nodes, px/sr, channels last."""
    scene, sphere = regions.scene, regions.scene.sample
    assert isinstance(sphere, Sphere)
    radius = sphere.radius
    angle, width = nodes_between(low, high, _NODES)
    along = side * lines.radius[:, None] * jnp.sin(angle)
    normal = lines.normal(side * angle)
    x, y = radius * normal[0], radius * normal[1]
    share = regions.limb(x, y) * (1 - regions.highlight(x, y))
    share *= falling(jnp.arctan2(jnp.abs(lines.fixed[:, None]), jnp.abs(along)) - np.pi / 4, _BETWEEN)
    # along a line dx = cos_o radius d(angle), and `sent` is rho cos_i cos_o radius^2: radiance dx = sent / radius d(angle)
    sent = scene.sent(sphere.facing(normal))
    return along, sent * (share * width / radius)[..., None]
