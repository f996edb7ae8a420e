"""Radiance around a highlight on a grid, from nodes in longitude and latitude that are denser towards the half vector."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.frequencies.regions import STEEPEST, Regions, RegionWidths, horizon
from matcam.forward.frequencies.taps import Taps
from matcam.numerics.approximation import nodes_in_panels

_GRADED = 3.0 ** -np.arange(5, 0, -1.0)
"""Borders within the panel next to the half vector, as shares of the panel."""
_PANELS = 5
"""Number of panels in the plane of incidence, on either side of the half vector."""
_TALL = (8, 20, 48)
"""Available numbers of panels across the plane of incidence. There are few values, because each requires a program."""
_WIDEST_PANEL = 2.9
"""Width of the widest panel, in standard deviations of the transition of a weight."""
_NODES = 8
"""Number of Gauss-Legendre nodes in a panel, along each axis."""


class PatchSize(NamedTuple):
    """Size of the patch about a highlight on a grid.

    Attributes:
        panels: number of panels across the plane of incidence, to either side.
        columns: number of grid points along a row of the patch.
        rows: number of grid points along a column of the patch.
    """

    panels: int
    columns: int
    rows: int


def patch_size(
    widths: RegionWidths, squeezed: float, step: float, taps: Taps, symmetric: bool, turned: bool
) -> PatchSize:
    """Choose the size of the patch about a highlight.

    Args:
        widths: widths of the regions.
        squeezed: cosine of the viewing angle at the highlight.
        step: step of the grid, px.
        taps: weights that distribute a node over neighbouring points of the grid.
        symmetric: True if the radiance is symmetric, and only the upper half is computed.
        turned: True if the axes of the sensor are rotated relative to the axes of the scene.
    """
    squeezed = max(squeezed, STEEPEST)
    widest = _WIDEST_PANEL * widths.sigma
    panels = next(n for n in _TALL if n * widest * squeezed >= widths.around or n == _TALL[-1])
    most = min(panels * widest, widths.around / STEEPEST)
    wide = 2 * widths.around
    # if the axes are rotated, each latitude is added separately
    high = wide if turned else most if symmetric else 2 * most
    return PatchSize(panels, *(int(np.ceil(side / step)) + 2 * taps.reach + 2 for side in (wide, high)))


def lay_highlight(
    grid: jax.Array, regions: Regions, size: PatchSize, x: jax.Array, y: jax.Array, taps: Taps, symmetric: bool
) -> jax.Array:
    """Add the radiance around a highlight to a grid.

    Args:
        grid: radiance on the grid, 1/sr, (rows, columns, channels).
        regions: regions of the radiance.
        size: size of the patch.
        x: positions of the columns of the grid, px.
        y: positions of the rows of the grid, px.
        taps: weights that distribute a node over neighbouring points of the grid.
        symmetric: True if the radiance is symmetric, and only the upper half is computed.
    """
    scene, around = regions.scene, regions.widths.around
    counts = min(size.columns, x.size), min(size.rows, y.size)

    def shares(line: jax.Array, at: jax.Array, start: jax.Array, count: int) -> jax.Array:
        step = line[1] - line[0]
        return taps.weights((at - line[0]) / step, start, count) / jnp.abs(step)

    radius = scene.sample.radius
    tall = np.concatenate([[0.0], _GRADED, np.arange(1, size.panels + 1)]) / size.panels
    latitude = jnp.arcsin(jnp.clip(around / regions.squeezed * tall / radius, 0, 1 - 1e-12))
    # the radiance of all nodes is computed first, because it would be computed repeatedly inside the loop
    nodes = jax.lax.map(lambda node: _light(regions, *node), nodes_in_panels(latitude, _NODES))
    if scene.turn is None:  # all nodes of one latitude have the same y
        at_x, at_y, sent = nodes
        left = _start(x, regions.peak, counts[0])
        low = jnp.zeros((), int) if symmetric else _start(y, jnp.zeros(()), counts[1])
        values = jax.lax.map(lambda row: shares(x, row[0], left, counts[0]) @ row[1], (at_x, sent))
        rows = sum(shares(y, side * at_y[:, 0], low, counts[1]) for side in (1, -1))
        return _added(grid, jnp.einsum("rv,vck->rck", rows, values), low, left)

    def lay(grid: jax.Array, row: tuple[jax.Array, ...]) -> tuple[jax.Array, None]:
        for side in (1, -1):
            column, line = scene.on_sensor(row[0], side * row[1])
            left, low = (
                _start(axis, (jnp.min(at) + jnp.max(at)) / 2, count)
                for axis, at, count in zip((x, y), (column, line), counts, strict=True)
            )
            laid = shares(y, line, low, counts[1]), shares(x, column, left, counts[0]), row[2]
            grid = _added(grid, jnp.einsum("rn,cn,nk->rck", *laid), low, left)
        return grid, None

    return jax.lax.scan(lay, grid, nodes)[0]


def _added(grid: jax.Array, part: jax.Array, row: jax.Array, column: jax.Array) -> jax.Array:
    at = row, column, jnp.zeros((), row.dtype)
    return jax.lax.dynamic_update_slice(grid, jax.lax.dynamic_slice(grid, at, part.shape) + part, at)


def _start(line: jax.Array, middle: jax.Array, count: int) -> jax.Array:
    position = (jax.lax.stop_gradient(middle) - line[0]) / (line[1] - line[0])
    return jnp.clip(jnp.round(position).astype(int) - count // 2, 0, line.size - count)


def _light(regions: Regions, v: jax.Array, width: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute x and y, px, and radiance times weight, px^2/sr, of the nodes of one latitude in the scene.

    `v` is the latitude, rad. `width` is the weight of the latitude, rad.
    """
    scene, around, peak = regions.scene, regions.widths.around, regions.peak
    radius = scene.sample.radius
    cuts = np.concatenate([[0.0], _GRADED, np.arange(1, _PANELS + 1)]) / _PANELS
    cuts = np.concatenate([-cuts[:0:-1], cuts])
    longitude = jnp.arcsin(jnp.clip((peak + around * cuts) / radius, -1 + 1e-12, 1 - 1e-12))
    dark = scene.lamp_angle - jnp.arccos(jnp.clip(horizon(scene) / jnp.cos(v), 0, 1 - 1e-12))
    u, share = nodes_in_panels(jnp.clip(longitude, dark, np.pi / 2), _NODES)
    element = scene.sample.surface(u, v)
    share *= regions.highlight(element.x, element.y) * width
    return element.x, jnp.broadcast_to(element.y, u.shape), scene.sent(element) * share[:, None]
