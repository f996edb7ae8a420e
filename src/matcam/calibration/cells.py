"""The picture as an edge spread function: pixels at nearly one distance from the edge, gathered into cells.

A cell holds the pixels of one aligned column whose rows put the edge into the same eighth of a px. It keeps their exact mean
distance AND the spread of their distances, so that nothing is lost and no bin width has to be corrected for: a model's mean
over the cell is the model at the mean distance, blurred by the spread (right to 1e-6 of the step). Far from the edge, where
nothing varies quickly, half a column is one cell.
"""

from __future__ import annotations

from typing import NamedTuple

from matcam._jax import jax, jnp
from matcam.calibration import geometry
from matcam.calibration.geometry import Aligned

PHASES = 8
"""Cells to a px."""
NEAR = 7
"""px to both sides of the edge in which columns are split by phase."""


class Cells(NamedTuple):
    """Means over the pixels of n cells."""

    pixels: jax.Array
    """(n,) their number; 0 where a cell is empty (its means are then meaningless)."""
    value: jax.Array
    distance: jax.Array
    """(n,) px from the edge, along its normal."""
    spread: jax.Array
    """(n,) px^2: variance of the distances in the cell."""
    x: jax.Array
    y: jax.Array
    """(n,) px from the region's centre."""


class Phases(NamedTuple):
    """Which of the cells of its column a pixel near the edge belongs to."""

    member: jax.Array
    """(phases, rows): 1 or 0."""
    row: jax.Array
    """(rows,) index of the row's phase."""


def columns(aligned: Aligned, step: int) -> slice:
    """Columns that are split by phase."""
    middle, reach = aligned.value.shape[1] // 2, NEAR // step
    return slice(max(middle - reach, 0), middle + reach + 1)


def phases(aligned: Aligned, curve: jax.Array, step: int) -> Phases:
    """The phase of every row: where between two samples the edge crosses it."""
    middle = aligned.value.shape[1] // 2
    offset = (aligned.x[:, middle] - geometry.place(curve, aligned.y)) / step + 0.5
    row = jnp.clip(jnp.floor(offset * PHASES * step), 0, PHASES * step - 1).astype(int)
    return Phases((row == jnp.arange(PHASES * step)[:, None]).astype(float), row)


def gather(aligned: Aligned, distance: jax.Array, phase: Phases, step: int) -> Cells:
    """Cells of aligned rows. distance: (rows, columns) px."""
    near = columns(aligned, step)

    def channels(part: slice) -> tuple[jax.Array, ...]:
        valid, apart, x = aligned.valid[:, part], distance[:, part], aligned.x[:, part]
        y = aligned.y[:, None]
        return valid, aligned.value[:, part], valid * apart, valid * apart**2, valid * x, valid * y

    # one product for all channels: six small ones cost three times as much
    width = near.stop - near.start
    inside = (phase.member @ jnp.concatenate(channels(near), 1)).reshape(-1, 6, width).swapaxes(0, 1)
    # two cells to a column far from the edge, upper and lower rows, for the sake of light that varies along the edge
    half = aligned.y.size // 2
    far = zip(channels(slice(None, near.start)), channels(slice(near.stop, None)), strict=True)
    outside = [[part.sum(0) for side in both for part in (side[:half], side[half:])] for both in far]
    sums = (jnp.concatenate([i.ravel(), *o]) for i, o in zip(inside, outside, strict=True))
    count = next(sums)
    # an empty cell stands at 0, where every model is finite; it has no weight
    value, mean, square, x, y = (total / jnp.where(count > 0, count, 1.0) for total in sums)
    return Cells(count, value, mean, jnp.maximum(square - mean**2, 0.0), x, y)
