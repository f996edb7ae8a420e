"""Where the edge runs, every pixel's distance to it, and the cells that gather pixels at nearly one distance.

The edge is a parabola x0(y) in the region's own coordinates: px from the region's centre, x along the rows, y down. The bright
side lies at larger x.

A cell holds the pixels of one aligned column whose rows put the edge into the same eighth of a px. It keeps their exact mean
distance AND the spread of their distances, so that nothing is lost and no bin width has to be corrected for. A model's mean
over the cell is the model at the mean distance, blurred by the spread (right to 1e-6 of the step). Far from the edge, where
nothing varies quickly, half a column is one cell.
"""

from __future__ import annotations

from typing import NamedTuple

from matcam.core.jax import AnyArray, jax, jnp

_REACH = 8  # px to both sides of the edge in which its position in a row is read
_MARGIN = 3  # px to the border within which an edge does not count as crossing a row
_SOME = (4, 2)  # every so many rows and columns, for the first guess of the levels
_ROUNDS = 2  # of the mean of two levels, and of the fit of a line
_OUTLIER = 3.0  # px
_PHASES = 8  # cells to a px
_NEAR = 7  # px to both sides of the edge in which columns are split by phase


class Rows(NamedTuple):
    """Hold a region as rows of samples.

    Attributes:
        value: (rows, columns); NaN where there is none.
        y: (rows,) px.
        start: (rows,) px, x of the first sample in each row.
        step: px between samples of a row.
    """

    value: AnyArray
    y: AnyArray
    start: AnyArray
    step: int


class AlignedRows(NamedTuple):
    """Hold rows whose middle sample is the nearest to the edge.

    Attributes:
        value: (rows, columns); 0 where there is none.
        valid: (rows, columns) 1 or 0.
        x: (rows, columns) px.
        y: (rows,) px.
        step: px between samples of a row.
    """

    value: jax.Array
    valid: jax.Array
    x: AnyArray
    y: jax.Array
    step: int

    @property
    def near(self) -> slice:
        """Return the columns that are split by phase."""
        middle, reach = self.value.shape[1] // 2, _NEAR // self.step
        return slice(max(middle - reach, 0), middle + reach + 1)


class PhasedRows(NamedTuple):
    """Hold aligned rows with distances to a curve, and phases.

    A row's phase says where between two samples the edge crosses it.

    Attributes:
        rows: the aligned rows.
        curve: (3,) the edge.
        distance: (rows, columns) px.
        member: (phases, rows) 1 or 0.
        phase: (rows,) index of the row's phase.
    """

    rows: AlignedRows
    curve: jax.Array
    distance: jax.Array
    member: jax.Array
    phase: jax.Array


class EdgeCells(NamedTuple):
    """Hold means over the pixels of n cells.

    Attributes:
        pixels: (n,) how many there are; 0 where a cell is empty (its means are then meaningless).
        value: (n,).
        distance: (n,) px from the edge, along its normal.
        spread: (n,) px^2, variance of the distances in the cell.
        x: (n,) px from the region's centre.
        y: (n,) px from the region's centre.
    """

    pixels: jax.Array
    value: jax.Array
    distance: jax.Array
    spread: jax.Array
    x: jax.Array
    y: jax.Array


def edge_place(curve: jax.Array, y: AnyArray) -> jax.Array:
    """Return x0 at y, px. curve: (3,) coefficients of 1, y, y^2."""
    return curve[0] + y * (curve[1] + y * curve[2])


def edge_distance(curve: jax.Array, x: AnyArray, y: AnyArray) -> jax.Array:
    """Return the distance to the curve, px, to second order.

    It is positive on the bright side. For a parabola of second derivative k and local slope t, with e the distance along
    the row, it is the straight edge's e c, c = 1 / sqrt(1 + t^2), less what the curve bends away below the foot of the
    normal, k e^2 t^2 c^5 / 2.
    """
    slope = curve[1] + 2 * curve[2] * y
    c = 1 / jnp.sqrt(1 + slope**2)
    along = x - edge_place(curve, y)
    return jnp.asarray(along * c - curve[2] * (along * slope) ** 2 * c**5)


def aligned_rows(rows: Rows, curve: jax.Array) -> AlignedRows:
    """Shift rows so that the edge stands in the middle column."""
    width = rows.value.shape[1]
    half = width // 2
    first = jnp.round((edge_place(curve, rows.y) - rows.start) / rows.step).astype(int) - half
    first = jnp.clip(first, -width - half, 2 * width)
    padded = jnp.pad(rows.value, ((0, 0), (width + half, width + 2 * half + 1)), constant_values=jnp.nan)
    cut = jax.vmap(lambda row, start: jax.lax.dynamic_slice(row, (start,), (2 * half + 1,)))
    value = cut(padded, first + width + half)
    valid = jnp.isfinite(value)
    x = rows.start[:, None] + rows.step * (first[:, None] + jnp.arange(2 * half + 1))
    return AlignedRows(jnp.where(valid, value, 0.0), valid.astype(float), x, jnp.asarray(rows.y), rows.step)


def first_curve(rows: Rows) -> tuple[jax.Array, jax.Array]:
    """Return a first curve, and how many rows it crosses.

    The curve is right to a few hundredths of a px, without a model of the blur. A row's edge stands where a sharp one would
    have to stand to let in the same light: unlike the centroid of the derivative, this does not amplify noise. It is found
    first over whole rows as a straight line, then near the edge as a parabola.
    """
    low, high = _two_levels(rows.value[:: _SOME[0], :: _SOME[1]])
    there = jnp.isfinite(rows.value)
    column = jnp.arange(rows.value.shape[1])
    width = jnp.max(jnp.where(there, column + 1, 0), axis=1)
    # what is missing inside a row stands where it changes least
    complete = jnp.where(there, rows.value, jnp.where(column < width[:, None], (low + high) / 2, low))
    bright = jnp.clip((complete - low).sum(1) / (high - low), 0, width) * rows.step
    found = rows.start + (width - 0.5) * rows.step - bright
    margin = _MARGIN * rows.step
    crossing = (bright > margin) & (bright < width * rows.step - margin)
    curve, weight = jnp.zeros(3), crossing.astype(float)
    for _ in range(_ROUNDS):
        curve = curve.at[:2].set(_polynomial(rows.y, found, weight, 2))
        off = jnp.abs(found - edge_place(curve, rows.y))
        weight = crossing * (off < _OUTLIER + 2 * (weight * off).sum() / jnp.maximum(weight.sum(), 1))
    aligned = aligned_rows(rows, curve)
    middle, reach = aligned.value.shape[1] // 2, _REACH // rows.step
    near = slice(max(middle - reach, 0), middle + reach + 1)
    low, high = side_levels(aligned)
    whole = aligned.valid[:, near].min(1)
    span = aligned.value[:, near]
    bright = (span.sum(1) - span.shape[1] * low) / (high - low) * rows.step
    found = aligned.x[:, near][:, -1] + rows.step / 2 - bright
    off = jnp.abs(found - edge_place(curve, rows.y))
    return _polynomial(rows.y, found, whole * (off < _REACH / 2), 3), whole.sum()


def side_levels(aligned: AlignedRows) -> tuple[jax.Array, jax.Array]:
    """Return both levels (rows,) a few px from the edge.

    They are lines in y. Light changes little at this distance, and the blur is over.
    """
    middle, reach = aligned.value.shape[1] // 2, _REACH // aligned.step
    outer = 2 * reach

    def line(part: slice) -> jax.Array:
        count = aligned.valid[:, part].sum(1)
        mean = aligned.value[:, part].sum(1) / jnp.maximum(count, 1.0)
        return edge_place(jnp.append(_polynomial(aligned.y, mean, count, 2), 0.0), aligned.y)

    return line(slice(max(middle - outer, 0), middle - reach // 2)), line(
        slice(middle + reach // 2 + 1, middle + outer + 1)
    )


def phased_rows(rows: AlignedRows, curve: jax.Array) -> PhasedRows:
    """Return all pixels' distances to a curve, and all rows' phases."""
    middle = rows.value.shape[1] // 2
    offset = (rows.x[:, middle] - edge_place(curve, rows.y)) / rows.step + 0.5
    count = _PHASES * rows.step
    phase = jnp.clip(jnp.floor(offset * count), 0, count - 1).astype(int)
    member = (phase == jnp.arange(count)[:, None]).astype(float)
    return PhasedRows(rows, curve, edge_distance(curve, rows.x, rows.y[:, None]), member, phase)


def edge_cells(phased: PhasedRows) -> EdgeCells:
    """Return the cells of aligned rows."""
    aligned, distance = phased.rows, phased.distance
    near = aligned.near

    def channels(part: slice) -> tuple[jax.Array, ...]:
        valid, apart, x = aligned.valid[:, part], distance[:, part], aligned.x[:, part]
        y = aligned.y[:, None]
        return valid, aligned.value[:, part], valid * apart, valid * apart**2, valid * x, valid * y

    # one product for all channels: six small ones cost three times as much
    width = near.stop - near.start
    inside = (phased.member @ jnp.concatenate(channels(near), 1)).reshape(-1, 6, width).swapaxes(0, 1)
    # two cells to a column far from the edge, upper and lower rows, for the sake of light that varies along the edge
    half = aligned.y.size // 2
    far = zip(channels(slice(None, near.start)), channels(slice(near.stop, None)), strict=True)
    outside = [[part.sum(0) for side in both for part in (side[:half], side[half:])] for both in far]
    sums = (jnp.concatenate([i.ravel(), *o]) for i, o in zip(inside, outside, strict=True))
    count = next(sums)
    # an empty cell stands at 0, where every model is finite; it has no weight
    value, mean, square, x, y = (total / jnp.where(count > 0, count, 1.0) for total in sums)
    return EdgeCells(count, value, mean, jnp.maximum(square - mean**2, 0.0), x, y)


def _two_levels(value: AnyArray) -> tuple[jax.Array, jax.Array]:
    """Return means of the samples below and above their own midpoint."""
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
    """Return coefficients of a weighted polynomial fit x(y)."""
    scale = jnp.max(jnp.abs(y))
    powers = (y[:, None] / scale) ** jnp.arange(terms)
    normal = (powers.T * weight) @ powers + 1e-9 * jnp.eye(terms)
    return jnp.linalg.solve(normal, (powers.T * weight) @ x) / scale ** jnp.arange(terms)
