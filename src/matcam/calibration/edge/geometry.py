"""Geometry of an edge: its curve, the distance of each pixel from the curve, and bins of pixels at similar distances.

The edge is a curve x0(y), a sum of Legendre polynomials of y up to order 5, in the coordinates of the region: px from its
centre, x along the rows, y down. The bright side lies at larger x.

A bin contains the pixels of one column of the aligned rows for which the edge lies in the same eighth of a px.
`EdgeCells` stores the mean and the variance of the distances of these pixels, so that a correction for a bin width is
not needed. The mean of a model over the bin is the model at the mean distance, blurred by this variance (with an error
of 1e-6 of the step). Far from the edge, the response varies slowly, and half a column is one bin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core.arrays import as_index, xp

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

CURVE = 6
"""Number of coefficients of the curve of an edge. Lens distortion curves the image of a straight edge."""
_SLOPES = np.array([np.pad(np.polynomial.legendre.legder(one), (0, 1))[:CURVE] for one in np.eye(CURVE)])
"""Matrix (CURVE, CURVE) that converts the coefficients of a curve to those of its derivative with respect to y / length."""


class Rows(NamedTuple):
    """Region as rows of samples.

    Attributes:
        value: (rows, columns) values; NaN for missing samples.
        y: (rows,) y of each row, px.
        start: (rows,) x of the first sample in each row, px.
        step: distance of neighbouring samples of a row, px.
        length: largest |y| of the rows that are not empty, px; unit of length of the curve and of the light.
        powers: (ROW_ORDERS, rows) Legendre polynomials of y / length.
    """

    value: AnyArray
    y: AnyArray
    start: AnyArray
    step: int
    length: jax.Array
    powers: jax.Array

    @classmethod
    def of(cls, value: AnyArray, y: AnyArray, start: AnyArray, step: int) -> Rows:
        length = xp.maximum(xp.max(xp.where(xp.isfinite(value).any(1), xp.abs(y), 0.0)), 1.0)
        # The light of the rows has order 10 at most.
        return cls(value, y, start, step, length, legendre(y / length, 11))


class AlignedRows(NamedTuple):
    """Rows whose middle sample is the nearest to the edge.

    Attributes:
        value: (rows, columns) values; 0 for missing samples.
        valid: (rows, columns) 1 for samples with data, else 0.
        x: (rows, columns) x of each sample, px.
        y: (rows,) y of each row, px.
        step: distance of neighbouring samples of a row, px.
        length: unit of length, as in `Rows`.
        powers: Legendre polynomials, as in `Rows`.
        light: (rows,) light of each row, relative to a linear function of y. `value` was divided by this light.
    """

    value: jax.Array
    valid: jax.Array
    x: AnyArray
    y: AnyArray
    step: int
    length: jax.Array
    powers: jax.Array
    light: jax.Array

    @property
    def near(self) -> slice:
        """Columns within 7 px of the edge. They are split by phase, because the response varies rapidly there."""
        middle, half = self.value.shape[1] // 2, 7 // self.step
        return slice(max(middle - half, 0), middle + half + 1)


class PhasedRows(NamedTuple):
    """Aligned rows with distances to a curve, and phases.

    The phase of a row is the position of the edge between two samples, in eighths of a px.

    Attributes:
        rows: the aligned rows.
        curve: (CURVE,) coefficients of the edge.
        distance: (rows, columns) distances from the edge, px.
        member: (phases, rows) 1 if the row has the phase, else 0.
        phase: (rows,) index of the phase of each row.
    """

    rows: AlignedRows
    curve: jax.Array
    distance: AnyArray
    member: jax.Array
    phase: jax.Array


class EdgeCells(NamedTuple):
    """Means over the pixels of n bins.

    The bins near the edge come first, ordered by phase and column.

    Attributes:
        pixels: (n,) number of pixels; 0 if the bin is empty (its means are then meaningless).
        value: (n,) mean value.
        distance: (n,) mean distance from the edge along its normal, px.
        spread: (n,) variance of the distances in the bin, px^2.
        dim: (n,) mean of the inverse of `AlignedRows.light`.
        terms: (TERMS, n) light terms, as in `light_terms`.
    """

    pixels: jax.Array
    value: jax.Array
    distance: jax.Array
    spread: jax.Array
    dim: jax.Array
    terms: jax.Array


def edge_position(curve: AnyArray, powers: AnyArray) -> AnyArray:
    """Compute the positions x0 of a curve (k,) in all rows, px. `powers`: Legendre polynomials of the rows."""
    return curve @ powers[: len(curve)]


def edge_slope(curve: AnyArray, powers: AnyArray, length: AnyArray) -> AnyArray:
    return edge_position(curve @ _SLOPES, powers) / length


def edge_distance(curve: AnyArray, x: AnyArray, powers: AnyArray, length: AnyArray) -> AnyArray:
    """Compute the distance of samples (rows, columns) from the curve, px, to second order.

    The distance is positive on the bright side. Let e be the distance of a sample from the curve along the row. Let t be
    the slope and k the second derivative of the curve in this row. The distance along the normal is e c - k e^2 t^2 c^5 / 2,
    where c = 1 / sqrt(1 + t^2). The first term is the distance from a straight edge. The second term corrects for
    curvature.
    """
    slope = edge_slope(curve, powers, length)
    curvature = edge_slope(curve @ _SLOPES, powers, length) / length
    c = 1 / xp.sqrt(1 + slope**2)
    normal = (x - edge_position(curve, powers)[:, None]) * c[:, None]
    return normal - (curvature / 2 * slope**2 * c**3)[:, None] * normal * normal


def legendre(t: AnyArray, terms: int) -> jax.Array:
    """Evaluate the Legendre polynomials (terms, ...) at t in [-1, 1] by Bonnet's recursion."""
    found = [xp.ones_like(t), t]
    for k in range(2, terms):
        found.append((2 - 1 / k) * t * found[-1] - (1 - 1 / k) * found[-2])
    return xp.stack(found[:terms])


def aligned_rows(rows: Rows, curve: jax.Array) -> AlignedRows:
    """Shift rows so that the edge is in the middle column."""
    width = rows.value.shape[1]
    half = width // 2
    first = as_index(xp.round((edge_position(curve, rows.powers) - rows.start) / rows.step)) - half
    first = xp.clip(first, -width - half, 2 * width)
    column = first[:, None] + np.arange(2 * half + 1)
    value = xp.take(rows.value, xp.clip(column, 0, width - 1) + width * np.arange(len(rows.y))[:, None])
    valid = xp.isfinite(value) & (column >= 0) & (column < width)
    x = rows.start[:, None] + rows.step * column
    value, light = xp.where(valid, value, 0.0), xp.ones(rows.y.shape)
    return AlignedRows(value, valid.astype(float), x, rows.y, rows.step, rows.length, rows.powers, light)


def phased_rows(rows: AlignedRows, curve: jax.Array) -> PhasedRows:
    middle = rows.value.shape[1] // 2
    offset = (rows.x[:, middle] - edge_position(curve, rows.powers)) / rows.step + 0.5
    # The distances in a bin near the edge differ by at most an eighth of a px.
    count = 8 * rows.step
    phase = as_index(xp.clip(xp.floor(offset * count), 0, count - 1))
    member = (phase == xp.arange(count)[:, None]).astype(float)
    return PhasedRows(rows, curve, edge_distance(curve, rows.x, rows.powers, rows.length), member, phase)


def edge_cells(phased: PhasedRows) -> EdgeCells:
    """Compute the means over the pixels in bins of equal phase and column.

    Far from the edge, the upper and the lower half of a column are one bin each.
    """
    aligned, near = phased.rows, phased.rows.near
    count, columns = aligned.valid.shape
    length, v = aligned.length, aligned.y / aligned.length
    # All means follow from sums over rows of a quantity times a function of the row, which are matrix products.
    of_row = xp.stack([xp.ones_like(v), v, v * v, aligned.x[:, 0], 1 / aligned.light])
    quantities = [aligned.value, aligned.valid]
    for _ in range(3):
        quantities.append(quantities[-1] * phased.distance)

    def summed(groups: AnyArray, part: slice) -> list[jax.Array]:
        """Sum the products of row functions and quantities over groups of rows, (functions, groups * columns) each."""
        weights = (of_row[:, None] * groups).reshape(-1, count)
        return [(weights @ quantity[:, part]).reshape(len(of_row), -1) for quantity in quantities]

    # Far from the edge, a column has one bin for the upper and one for the lower rows, to resolve changes of the light.
    upper = np.arange(count) < count // 2
    halves = np.stack([upper, ~upper]).astype(float)
    parts: list[tuple[AnyArray, slice]] = [
        (phased.member, near),
        (halves, slice(near.start)),
        (halves, slice(near.stop, None)),
    ]
    sums = [xp.concatenate(some, 1) for some in zip(*(summed(*part) for part in parts), strict=True)]
    pixels = sums[1][0]
    # An empty bin has weight 0. Its distance is set to 0, where every model is finite.
    value, *moments = (total / xp.where(pixels > 0, pixels, 1.0) for total in sums)
    column = np.concatenate([np.tile(np.arange(columns)[part], len(groups)) for groups, part in parts])
    x, mean = moments[0][3] + aligned.step * column, moments[1][0]
    terms = [x, moments[0][1] * length, *(moments[i][j] / length**i for i, j in _ORDERS)]
    spread = xp.maximum(moments[2][0] - mean**2, 0.0)
    return EdgeCells(pixels, value[0], mean, spread, xp.where(pixels > 0, moments[0][4], 1.0), xp.stack(terms))


def light_terms(x: AnyArray, y: AnyArray, distance: AnyArray, length: AnyArray) -> jax.Array:
    """Compute the polynomial terms of the light in a region, (TERMS, ...).

    The terms are x and y (px), then products of powers of d and y up to third order, where d is the distance from the edge.
    In these products, d and y are in units of `length`. Higher orders of y alone have been divided out of the rows, or are
    negligible.
    """
    d, v = distance / length, y / length
    powers = ((1.0, d, d * d, d * d * d), (1.0, v, v * v))
    return xp.stack([x, y * xp.ones_like(d), *(powers[0][i] * powers[1][j] for i, j in _ORDERS)])


_ORDERS = ((2, 0), (1, 1), (3, 0), (2, 1), (1, 2))
"""Orders of the light terms in the distance from the edge and in y, after the terms x and y."""
TERMS = 2 + len(_ORDERS)
"""Number of polynomial terms of the light: all up to third order that are not functions of y alone, and y itself."""
