"""Correction of a sum over grid points at the terminator, where the slope of the radiance is discontinuous.

Let f be a function that is 0 up to a position p and increases with slope s beyond p. The sum of f over points with the
spacing h, multiplied by h, equals the integral of f minus h^2 s B_2(d) / 2 (Euler and Maclaurin). Here d is the distance
from p to the next point, in steps, and B_2 is the second Bernoulli polynomial. The correction h s B_2(d) / 2 is
distributed over the values at the two points about p. It is computed along rows and along columns. The two corrections
are averaged. Their weights are proportional to the squared slopes of the cosine of the angle of incidence along rows and
along columns.
"""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.frequencies.lines import Lines
from matcam.forward.frequencies.regions import Regions


def remove_kink(grid: jax.Array, regions: Regions, upright: bool, across: jax.Array, along: jax.Array) -> jax.Array:
    """Add the corrections at the terminator along all rows, or along all columns, to a grid.

    Args:
        grid: radiance on the grid, 1/sr, (rows, columns, channels).
        regions: regions of the radiance.
        upright: True for columns, False for rows.
        across: positions of the columns or rows, px.
        along: positions of the grid points on one column or row, px.
    """
    radius = regions.scene.sample.radius
    first, step = along[0], along[1] - along[0]
    hit = jnp.abs(across) < radius
    lines = Lines(regions.scene, upright, jnp.where(hit, across, 0.0))
    middle, half = lines.lit()
    ends = hit & (half > 0) & (half < np.pi) & ~regions.all_limb
    towards, beside, axis = lines.lamp()
    side = np.array([[1.0], [-1.0]])
    angle = middle + side * half
    angle = angle - 2 * np.pi * jnp.round(angle / (2 * np.pi))
    there = ends & (jnp.abs(angle) < np.pi / 2)
    at = lines.radius * jnp.sin(angle)
    depth = lines.radius * jnp.where(there, jnp.cos(angle), 1.0)
    fixed = jnp.broadcast_to(lines.fixed, at.shape)
    # slopes of the cosine of the angle of incidence along and across the line
    grows, beyond = towards - axis * at / depth, beside - axis * across / depth
    share = grows**2 / jnp.where(there, grows**2 + beyond**2, 1.0)
    share = jnp.where(there, share * regions.inside(*lines.ordered(at, fixed)), 0.0)
    near = jnp.abs(step) / 4  # distance over which the slope is determined
    slope = regions.sent(*lines.ordered(at - side * near, fixed)) / near
    position = (at - first) / step
    below = jnp.floor(jax.lax.stop_gradient(position))
    rest = position - below
    off = jnp.where(side * step < 0, 1 - rest, rest)  # the lit part is on the other side
    added = jnp.abs(step) / 2 * (off**2 - off + 1 / 6) * share
    point, part = jnp.stack([below, below + 1]), jnp.stack([1 - rest, rest])
    where = jnp.where((point >= 0) & (point < along.size), point, along.size).astype(int)
    number = jnp.arange(across.size)
    index = (where, number) if upright else (number, where)
    return grid.at[index].add(slope * (added * part)[..., None], mode="drop")
