"""Where the edge runs: x0(y), a parabola in the region's own coordinates, and every pixel's exact distance to it.

Coordinates: px from the region's centre, x along the rows, y down. The bright side lies at larger x.

The picture as an edge spread function: pixels at nearly one distance from the edge, gathered into cells.

A cell holds the pixels of one aligned column whose rows put the edge into the same eighth of a px. It keeps their exact mean
distance AND the spread of their distances, so that nothing is lost and no bin width has to be corrected for: a model's mean
over the cell is the model at the mean distance, blurred by the spread (right to 1e-6 of the step). Far from the edge, where
nothing varies quickly, half a column is one cell.
"""

from __future__ import annotations

from typing import NamedTuple

from matcam.core.jax import AnyArray, jax, jnp

REACH = 8  # px to both sides of the edge in which its position in a row is read
_MARGIN = 3  # px to the border within which an edge does not count as crossing a row
_SOME = (4, 2)  # every so many rows and columns, for the first guess of the levels
_ROUNDS = 2  # of the mean of two levels, and of the fit of a line
_OUTLIER = 3.0  # px


class Rows(NamedTuple):
    """A region as rows of samples: pixels, or the sites of one colour of a mosaic.

    value: (rows, columns); NaN where there is none. y: (rows,) px. start: (rows,) px, x of the first sample in each row.
    step: px between samples of a row.
    """

    value: AnyArray
    y: AnyArray
    start: AnyArray
    step: int


class Aligned(NamedTuple):
    """Rows shifted by whole samples so that the edge stands in their middle column."""

    value: jax.Array
    """(rows, columns); 0 where there is none."""
    valid: jax.Array
    """(rows, columns): 1 or 0."""
    x: AnyArray
    """(rows, columns) px."""
    y: jax.Array
    """(rows,) px."""


def place(curve: jax.Array, y: AnyArray) -> jax.Array:
    """x0 at y, px. curve: (3,) coefficients of 1, y, y^2."""
    return curve[0] + y * (curve[1] + y * curve[2])


def distance(curve: jax.Array, x: AnyArray, y: AnyArray) -> jax.Array:
    """Signed distance to the curve, px, positive on the bright side; exact to second order in the distance.

    For a parabola of second derivative k and local slope t, with e the distance along the row: the straight edge's
    e c, c = 1 / sqrt(1 + t^2), less what the curve bends away below the foot of the normal, k e^2 t^2 c^5 / 2.
    """
    slope = curve[1] + 2 * curve[2] * y
    c = 1 / jnp.sqrt(1 + slope**2)
    along = x - place(curve, y)
    return jnp.asarray(along * c - curve[2] * (along * slope) ** 2 * c**5)


def align(rows: Rows, curve: jax.Array) -> Aligned:
    """Rows shifted so that the sample nearest to the edge stands in the middle."""
    width = rows.value.shape[1]
    half = width // 2
    first = jnp.round((place(curve, rows.y) - rows.start) / rows.step).astype(int) - half
    first = jnp.clip(first, -width - half, 2 * width)
    padded = jnp.pad(rows.value, ((0, 0), (width + half, width + 2 * half + 1)), constant_values=jnp.nan)
    cut = jax.vmap(lambda row, start: jax.lax.dynamic_slice(row, (start,), (2 * half + 1,)))
    value = cut(padded, first + width + half)
    valid = jnp.isfinite(value)
    x = rows.start[:, None] + rows.step * (first[:, None] + jnp.arange(2 * half + 1))
    return Aligned(jnp.where(valid, value, 0.0), valid.astype(float), x, jnp.asarray(rows.y))


def first_curve(rows: Rows) -> tuple[jax.Array, jax.Array]:
    """The curve, to a few hundredths of a px, without any model of the blur; and the number of rows that it crosses.

    A row's edge stands where a sharp one would have to stand to let in the same light: unlike the centroid of the
    derivative, this does not amplify noise. First over whole rows and a straight line, then near the edge and a parabola.
    """
    low, high = _two_levels(rows.value[:: _SOME[0], :: _SOME[1]])
    there = jnp.isfinite(rows.value)
    column = jnp.arange(rows.value.shape[1])
    width = jnp.max(jnp.where(there, column + 1, 0), axis=1)
    # what is missing inside a row stands where it changes least
    filled = jnp.where(there, rows.value, jnp.where(column < width[:, None], (low + high) / 2, low))
    bright = jnp.clip((filled - low).sum(1) / (high - low), 0, width) * rows.step
    found = rows.start + (width - 0.5) * rows.step - bright
    margin = _MARGIN * rows.step
    crossing = (bright > margin) & (bright < width * rows.step - margin)
    curve, weight = jnp.zeros(3), crossing.astype(float)
    for _ in range(_ROUNDS):
        curve = curve.at[:2].set(_polynomial(rows.y, found, weight, 2))
        off = jnp.abs(found - place(curve, rows.y))
        weight = crossing * (off < _OUTLIER + 2 * (weight * off).sum() / jnp.maximum(weight.sum(), 1))
    aligned = align(rows, curve)
    middle, reach = aligned.value.shape[1] // 2, REACH // rows.step
    near = slice(max(middle - reach, 0), middle + reach + 1)
    low, high = sides(aligned, rows.step)
    whole = aligned.valid[:, near].min(1)
    span = aligned.value[:, near]
    bright = (span.sum(1) - span.shape[1] * low) / (high - low) * rows.step
    found = aligned.x[:, near][:, -1] + rows.step / 2 - bright
    off = jnp.abs(found - place(curve, rows.y))
    return _polynomial(rows.y, found, whole * (off < REACH / 2), 3), whole.sum()


def sides(aligned: Aligned, step: int) -> tuple[jax.Array, jax.Array]:
    """Levels (rows,) a few px away from the edge: near enough for uneven light, far enough for the blur; lines in y."""
    middle, reach = aligned.value.shape[1] // 2, REACH // step
    outer = 2 * reach

    def line(part: slice) -> jax.Array:
        count = aligned.valid[:, part].sum(1)
        mean = aligned.value[:, part].sum(1) / jnp.maximum(count, 1.0)
        return place(jnp.append(_polynomial(aligned.y, mean, count, 2), 0.0), aligned.y)

    return line(slice(max(middle - outer, 0), middle - reach // 2)), line(
        slice(middle + reach // 2 + 1, middle + outer + 1)
    )


def _two_levels(value: AnyArray) -> tuple[jax.Array, jax.Array]:
    """Means of the samples below and above their own midpoint."""
    valid = jnp.isfinite(value)
    known = jnp.where(valid, value, 0.0)
    total, count = known.sum(), valid.sum()
    middle = total / count
    for _ in range(_ROUNDS):
        above = valid & (known > middle)
        share, light = above.sum(), (known * above).sum()
        high, low = light / jnp.maximum(share, 1), (total - light) / jnp.maximum(count - share, 1)
        middle = (low + high) / 2
    return low, high


def _polynomial(y: AnyArray, x: AnyArray, weight: jax.Array, terms: int) -> jax.Array:
    """Coefficients of a weighted polynomial fit x(y)."""
    scale = jnp.max(jnp.abs(y))
    powers = (y[:, None] / scale) ** jnp.arange(terms)
    normal = (powers.T * weight) @ powers + 1e-9 * jnp.eye(terms)
    return jnp.linalg.solve(normal, (powers.T * weight) @ x) / scale ** jnp.arange(terms)


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
    offset = (aligned.x[:, middle] - place(curve, aligned.y)) / step + 0.5
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
