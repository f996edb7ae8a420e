"""Record of a lobe and its derivatives, by a chain rule that evaluates each quadrature node only a few times.

The record is R = sum_n a_n D_n. D_n is the density of facet normals at node n, and a_n is the weight w_n of the node multiplied
by the masking G_n. The derivative of the record with respect to a coordinate q of the lobe is

    dR/dq = sum_n a_n dD_n/dq + sum_s e_s dLambda_s/dq,      e_s = sum_n w_n D_n dG_n/dLambda_s,

where Lambda_s are the values of Smith's Lambda from which masking is computed. The e_s are the same for all coordinates. Only
the few parameters of a family require the derivative of D at every node. A spline modification multiplies D by
exp(sum_k b_k B_k) / norm, with coefficients b_k and splines B_k. The derivatives with respect to b_k follow from the sums of
a_n D_n B_k and the derivative of the norm. Lambda is interpolated in a table, whose entries are differentiated. A parameter of
the rig changes only the weights, which are polynomials of the coordinate of the parameter.

Forward differentiation would store the derivatives at all nodes with respect to all coordinates, which takes hundreds of MB.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.inverse.operator.operator_nodes import OperatorNodes, facets, spline_parts
from matcam.material.lambda_table import table_of
from matcam.material.masking import smith_rule
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import SplineNDF, spline_at, spline_sums
from matcam.material.tabulated_masking import COTS, lobe_table


class RecordAndSlopes(NamedTuple):
    """Record of a lobe and its derivatives.

    Attributes:
        record: record at F = 1, 1/sr, (slices, cells).
        slopes: derivatives of the record with respect to the coordinates of the lobe, then of the rig, 1/sr,
            (coordinates, slices, cells).
    """

    record: np.ndarray
    slopes: np.ndarray


def lobe_record(operator: LobeOperator, kind: LobeKind, q: np.ndarray) -> np.ndarray:
    """Compute the record of a lobe at F = 1, 1/sr, (slices, cells).

    q: coordinates of the lobe, then of the rig.
    """
    return operator.record(kind.ndf(placed(q[: kind.size])), kind.masking, q[kind.size :])


def record_and_slopes(operator: LobeOperator, kind: LobeKind, q: np.ndarray) -> RecordAndSlopes:
    """Compute the record of a lobe and its derivatives.

    q: coordinates of the lobe, then of the rig, in the order of the axes of the operator.
    """
    lobe = _Lobe.of(kind, q[: kind.size])
    rows = operator.by_blocks(lambda nodes: _rows(nodes, lobe, q[kind.size :]))
    return RecordAndSlopes(rows[0], rows[1:])


class _Lobe(NamedTuple):
    """Lobe with the quantities that are common to all cells.

    Attributes:
        kind: parametrisation of the lobe.
        q: coordinates of the lobe, (lobe coordinates,).
        by_norm: derivatives of the logarithm of `SplineNDF.norm` with respect to q, (lobe coordinates,); None for other lobes.
        table: table of Lambda (`lambda_table.py`), (entries,); None without masking.
        by_table: derivatives of the table with respect to q, (lobe coordinates, entries); None without masking.
    """

    kind: LobeKind
    q: np.ndarray
    by_norm: np.ndarray | None
    table: np.ndarray | None
    by_table: np.ndarray | None

    @classmethod
    def of(cls, kind: LobeKind, q: np.ndarray) -> _Lobe:
        by_norm = np.asarray(_by_norm(kind, q)) if kind.spline_size else None
        if kind.masking is None:
            return cls(kind, q, by_norm, None, None)
        return cls(kind, q, by_norm, *(np.asarray(one) for one in table_slopes(kind, q)))


@kept_program
def table_slopes(kind: LobeKind, q: Any) -> tuple[jax.Array, jax.Array]:
    """Compute the table of Lambda of a lobe, and its derivatives with respect to q, (lobe coordinates, entries)."""
    if kind.spline_size and not kind.shadows:
        return _spline_table(kind, q)

    def table(q: jax.Array) -> jax.Array:
        return lobe_table(kind.ndf(q))

    return table(q), jax.jacfwd(table)(q).T


def _spline_table(kind: LobeKind, q: Any) -> tuple[jax.Array, jax.Array]:
    """Compute the results of `table_slopes` for a spline-modified lobe."""
    ndf = kind.ndf(q)
    slope2, weight = smith_rule(ndf.roughness, jnp.asarray(COTS))
    light, by_own = _lifted(kind, q, slope2, lambda ndf: ndf.slope_density(slope2))
    value = jnp.sum(weight * light, axis=-1)
    by_family = jnp.stack([jnp.sum(weight * slope, axis=-1) for slope in by_own])
    slopes = jnp.concatenate([by_family, spline_sums(slope2, weight * light)]) - _by_norm(kind, q)[:, None] * value
    return table_of(value), slopes / (1 + value)


@kept_program
def _by_norm(kind: LobeKind, q: Any) -> jax.Array:
    """Compute the derivatives of the logarithm of `SplineNDF.norm` with respect to q, (lobe coordinates,)."""

    def log_norm(q: jax.Array) -> jax.Array:
        modified = kind._replace(shadows=0).ndf(q)
        assert isinstance(modified, SplineNDF)
        return jnp.log(modified.norm)

    return jax.jacfwd(log_norm)(q)


def _lifted(
    kind: LobeKind, q: Any, slope2: Any, light_of: Callable[[NDF], jax.Array]
) -> tuple[jax.Array, list[jax.Array]]:
    """Compute a quantity proportional to D, and its derivatives with respect to the coordinates of the family.

    The derivative of the norm of a spline modification is not included. `light_of` computes the quantity at the squared slopes
    `slope2` for a lobe without modification.
    """
    plain, own = kind._replace(spline_size=0, shadows=0), len(kind.family_names)
    pairs = [jax.jvp(lambda own: light_of(plain.ndf(own)), (q[:own],), (unit,)) for unit in np.eye(own)]
    if not kind.spline_size:
        return pairs[0][0], [slope for _, slope in pairs]
    modified = kind._replace(shadows=0).ndf(q)
    assert isinstance(modified, SplineNDF)
    lift = jnp.exp(spline_at(modified.coefficients, slope2)) / modified.norm
    return pairs[0][0] * lift, [slope * lift for _, slope in pairs]


@kept_program
def _facet_slopes(kind: LobeKind, q: Any, slope2: Any) -> jax.Array:
    """Evaluate D at nodes, 1/sr, followed by its derivatives with respect to the coordinates of the family."""
    light, by_family = _lifted(kind, q, slope2, lambda ndf: facets(ndf, slope2))
    return jnp.stack([light, *by_family])


def _rows(nodes: OperatorNodes, lobe: _Lobe, rig: np.ndarray) -> np.ndarray:
    """Compute the record of cells, 1/sr, followed by its derivatives, (1 + coordinates, cells)."""
    kind, at = lobe.kind, nodes.at
    light, *by_family = np.asarray(_facet_slopes(kind, lobe.q, at.slope2))
    weight, masked = nodes.weight_at(rig), nodes.masked(kind.masking, lobe.table)
    seen = np.ones_like(weight) if masked is None else masked.value
    shown = weight * seen
    lit = shown * light
    record = _over_nodes(lit)
    by_lobe = np.zeros((kind.size, len(record)))
    for row, slope in zip(by_lobe, by_family, strict=False):
        row += _over_nodes(shown * slope)
    if kind.spline_size:
        own = len(kind.family_names)
        by_lobe[own : own + kind.spline_size] = spline_parts(at.slope2, lit)
    if masked is not None and lobe.by_table is not None:
        by_lobe += masked.by_tables(weight * light, lobe.by_table)
    if lobe.by_norm is not None:
        by_lobe -= lobe.by_norm[:, None] * record
    return np.stack([record, *by_lobe, *nodes.by_shifts(seen * light, rig)])


def _over_nodes(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.sum(axis=(1, 2)))
