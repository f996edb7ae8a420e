"""Integration and interpolation of functions that are known at some points.

Integrals use Gauss-Legendre nodes on intervals and on panels. Interpolation uses Lagrange polynomials through a few points,
and cubic B-splines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from matcam.core.arrays import constant, xp

if TYPE_CHECKING:
    from matcam.core.jax import jax

AnyValues = TypeVar("AnyValues", bound=Any)


def nodes_between(low: AnyValues, high: AnyValues, order: int) -> tuple[AnyValues, AnyValues]:
    """Compute Gauss-Legendre nodes and weights on [low, high].

    The results have the shape of the limits, followed by (order,). They are NumPy arrays if the limits are NumPy arrays.
    """
    unit, weight = np.polynomial.legendre.leggauss(order)
    half = (high - low)[..., None] / 2
    return (high + low)[..., None] / 2 + half * unit, half * weight


def nodes_in_panels(cuts: AnyValues, order: int) -> tuple[AnyValues, AnyValues]:
    """Compute Gauss-Legendre nodes and weights on panels between neighbouring cuts.

    The last axis of `cuts` contains the limits of the panels in ascending order. The last axis of the results contains
    the nodes or weights of all panels, `order` for each panel.
    """
    nodes, weights = nodes_between(cuts[..., :-1], cuts[..., 1:], order)
    return nodes.reshape(*nodes.shape[:-2], -1), weights.reshape(*nodes.shape[:-2], -1)


def between_entries(table: jax.Array, position: jax.Array) -> jax.Array:
    """Interpolate a table by Lagrange cubics through four entries.

    position: positions among the entries, counted from 0.
    """
    first, shares = four_about(position, table.size)
    return sum((xp.take(table, first + k, mode="clip") * share for k, share in enumerate(shares)), xp.zeros(()))


def four_about(position: Any, entries: int) -> tuple[Any, list[Any]]:
    """Compute the index of the first of the four entries about each position, and the Lagrange weights of these entries."""
    first = first_of_four(position, entries)
    return first, lagrange_basis(np.arange(-1.0, 3.0), position - first - 1)


def first_of_four(position: Any, entries: int) -> Any:
    """Compute the index of the first of the four entries about each position."""
    return constant(xp.clip(xp.floor(position), 1, entries - 3)).astype(int) - 1


def lagrange_basis(points: Any, at: Any) -> list[Any]:
    """Evaluate the Lagrange basis polynomials of points.

    points: points of the interpolation, (n,). at: positions, any shape. The result is a list of n arrays in the shape of `at`.
    The polynomial through values v_k is `sum_k v_k basis_k`. Its derivatives are also finite at the points.
    """
    differences = points[:, None] - points + np.eye(points.size)
    factors = [at - point for point in points]
    # products of all but one factor, from the left and from the right
    left, right = [1.0], [1.0]
    for k in range(points.size - 1):
        left.append(left[-1] * factors[k])
        right.append(right[-1] * factors[-1 - k])
    return [below * above / row.prod() for below, above, row in zip(left, right[::-1], differences, strict=True)]


def lagrange_slopes(points: np.ndarray, at: float) -> np.ndarray:
    """Compute the derivatives, (n,), of the polynomials of `lagrange_basis` at one position."""
    n = points.size
    own = np.eye(n, dtype=bool)
    others = ~own[:, None] & ~own  # the product rule: term m of polynomial k lacks the factors k and m
    terms = np.where(others, at - points, 1.0).prod(axis=-1)
    return np.where(own, 0.0, terms).sum(axis=1) / (points[:, None] - points + own).prod(axis=1)


def cubic_basis(position: jax.Array, count: int) -> jax.Array:
    """Evaluate `count` cubic B-splines at positions. The result has the shape (count, ...).

    position: positions in [0, count - 1], shape (...). The splines are local, smooth to the second derivative, and add up
    to 1. They are mirrored at 0 and constant at the end.
    """
    # one operation for all splines: a program with separate operations takes three times as long to compile and to load
    knots = np.arange(-1.0, count + 1).reshape(-1, *[1] * position.ndim)
    return _mirrored(_cubic(position - knots))


def _mirrored(splines: jax.Array) -> jax.Array:
    """Apply the boundary conditions: mirrored at 0, constant at the end.

    The input contains one spline before the first knot, and one after the last knot.
    """
    return xp.concatenate(
        [splines[1:2], splines[2:3] + splines[:1], splines[3:-2], splines[-2:-1] + splines[-1:]], axis=0
    )


def cubic_spline(coefficients: jax.Array, position: jax.Array) -> jax.Array:
    """Evaluate sum_k coefficient_k B_k at positions.

    B_k are the splines of `cubic_basis`. Four of them are non-zero at each position.
    """
    ends = coefficients[-1:]
    beyond = xp.concatenate([coefficients[1:2], coefficients, ends, ends])
    left = constant(xp.clip(xp.floor(position), 0, coefficients.size - 2))
    first, right = left.astype(int), position - left
    return sum(
        (xp.take(beyond, first + k, mode="clip") * _cubic(right + 1 - k) for k in range(4)), xp.zeros_like(position)
    )


def cubic_sums(position: jax.Array, weights: jax.Array, count: int, axes: int = 1) -> jax.Array:
    """Compute the sum of weights times B_k over positions. The result has the shape (count, ...).

    B_k are the splines of `cubic_basis`. The sum is over the last `axes` axes of the positions and weights.
    """
    over = tuple(range(-axes, 0))
    # one sum after the other, because all splines at all positions would not fit into the cache
    from matcam.core.jax import jax

    return _mirrored(
        jax.lax.map(lambda knot: xp.sum(_cubic(position - knot) * weights, over), np.arange(-1.0, count + 1))
    )


def combined(coefficients: jax.Array, basis: jax.Array) -> jax.Array:
    return xp.tensordot(coefficients, basis, 1)


def smoothness(count: int) -> np.ndarray:
    """Build the smoothness penalty of a spline, (rows, count).

    The products of the rows with the coefficients of the spline are penalised. The rows are second differences, first
    differences times 1/3, and the mean times 0.1. The penalty of the mean is small, because another parameter of the fit
    absorbs the mean.
    """
    unit = np.eye(count)
    return np.concatenate([np.diff(unit, 2, axis=0), np.diff(unit, axis=0) / 3, np.full((1, count), 0.1 / count)])


def _cubic(x: jax.Array) -> jax.Array:
    """Evaluate the cardinal cubic B-spline, which is non-zero for |x| < 2."""
    x = xp.abs(x)
    return xp.maximum(2 - x, 0.0) ** 3 / 6 - 4 * xp.maximum(1 - x, 0.0) ** 3 / 6
