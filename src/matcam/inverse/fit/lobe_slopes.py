"""Record of a lobe and its derivatives, by a chain rule that evaluates each quadrature node only a few times.

The record is R = sum_n a_n D_n, where a_n is the weight w_n of node n multiplied by its masking G_n. The derivative of the
record with respect to a coordinate q of the lobe is

    dR/dq = sum_n a_n dD_n/dq + sum_s e_s dLambda_s/dq,      e_s = sum_n w_n D_n dG_n/dLambda_s,

where Lambda_s are the values of Lambda from which masking is computed. The e_s are the same for all coordinates. Only the one
or two parameters of a family require the derivative of D at every node. A spline modification multiplies D by
exp(sum_k b_k B_k) / norm, so the derivatives with respect to b_k follow from the sums of a_n D_n B_k and the derivative of the
norm. Lambda is linear in D and tabulated; the entries of the table are differentiated. A parameter of the rig changes only the
weights, by a polynomial through few points.

Forward differentiation would store the derivatives at all nodes with respect to all coordinates, which takes hundreds of MB.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.inverse.operator.operator_nodes import OperatorNodes
from matcam.material.lambda_table import lambda_at, table_of
from matcam.material.masking import smith_rule
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import SplineNDF, spline_at, spline_sums
from matcam.material.tabulated_masking import COTS, by_entries, has_closed_lambda, quick_table
from matcam.numerics.approximation import lagrange_basis, lagrange_slopes

_FEW = 2
"""Largest number of coordinates of a lobe for which Lambda is differentiated with respect to one coordinate after the other.
For more coordinates, reverse differentiation is faster.
"""


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
    lobe = _Lobe.of(kind, placed(q[: kind.size]))
    # inside the program, the polynomials of all axes would double its compile time
    bases = [
        _basis(np.asarray(points), at) for points, at in zip(operator.points, q[kind.size :].tolist(), strict=True)
    ]
    rows = operator.by_blocks(lambda nodes: _rows(nodes._replace(points=()), lobe, bases))
    return RecordAndSlopes(rows[0], rows[1:])


class _Lobe(NamedTuple):
    """Lobe with the quantities that are common to all cells.

    Attributes:
        kind: parametrisation of the lobe.
        q: coordinates of the lobe, (lobe coordinates,).
        by_norm: derivatives of ln(norm) of a spline-modified lobe with respect to q, (lobe coordinates,); None for other lobes.
        table: table of Lambda, (entries,); None if Lambda has a closed form, or without masking.
        by_table: derivatives of the table with respect to q, (lobe coordinates, entries); None without a table.
    """

    kind: LobeKind
    q: jax.Array
    by_norm: jax.Array | None
    table: jax.Array | None
    by_table: jax.Array | None

    @classmethod
    def of(cls, kind: LobeKind, q: jax.Array) -> _Lobe:
        """Compute the common quantities from the coordinates of a lobe."""
        by_norm = _by_norm(kind, q) if kind.spline_size else None
        return cls(kind, q, by_norm, *table_slopes(kind, q))

    def directions(self, nodes: OperatorNodes) -> tuple[jax.Array, jax.Array]:
        """Return the directions of light and view in the form that `lambda_of` requires."""
        return (nodes.at.cos_i, nodes.at.cos_o) if self.table is None else (nodes.at.position_i, nodes.at.position_o)

    @property
    def masked_by(self) -> jax.Array:
        """Return the array from which Lambda is computed: its table, or the coordinates of the lobe."""
        return self.q if self.table is None else self.table

    @property
    def masked_slopes(self) -> jax.Array:
        """Return the derivatives of `masked_by` with respect to the coordinates, (lobe coordinates, values)."""
        return jnp.eye(self.q.size) if self.by_table is None else self.by_table

    def lambda_of(self, by: jax.Array, direction: jax.Array) -> jax.Array:
        """Compute Lambda. by: array of the kind of `masked_by`. direction: light or view from `directions`."""
        return self.kind.ndf(by).smith_lambda(direction) if self.table is None else lambda_at(by, direction)


def table_slopes(kind: LobeKind, q: jax.Array) -> tuple[jax.Array | None, jax.Array | None]:
    """Compute the table of Lambda of a lobe, and its derivatives, (lobe coordinates, entries).

    Both are None for a lobe without masking, or if Lambda has a closed form.
    """
    return (None, None) if kind.masking is None or has_closed_lambda(kind.ndf(q)) else _table_slopes(kind, q)


@kept_program
def _table_slopes(kind: LobeKind, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    if kind.spline_size:
        return _spline_table(kind, q)

    def table(q: jax.Array) -> jax.Array:
        found = quick_table(kind.ndf(q))
        assert found is not None
        return found

    return table(q), jax.jacfwd(table)(q).T


@kept_program
def _rows(nodes: OperatorNodes, lobe: _Lobe, bases: list[tuple[AnyArray, AnyArray]]) -> jax.Array:
    """Compute the record of cells, followed by its derivatives, (1 + coordinates, cells)."""
    return nodes.by_steps(lambda one: _step(one, lobe, bases))


def _spline_table(kind: LobeKind, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute the table of Lambda of a spline-modified lobe, and its derivatives, (lobe coordinates, values)."""
    ndf = kind.ndf(q)
    slope2, weight = smith_rule(ndf.roughness, jnp.asarray(COTS))
    light, by_own = _lifted(kind, q, slope2, lambda ndf: ndf.slope_density(slope2))
    value = jnp.sum(weight * light, axis=-1)
    by_family = jnp.stack([jnp.sum(weight * slope, axis=-1) for slope in by_own])
    slopes = jnp.concatenate([by_family, spline_sums(slope2, weight * light)]) - _by_norm(kind, q)[:, None] * value
    return table_of(value), slopes / (1 + value)


@kept_program
def _by_norm(kind: LobeKind, q: jax.Array) -> jax.Array:
    """Compute the derivatives of ln(norm) of a spline-modified lobe, (lobe coordinates,)."""

    def log_norm(q: jax.Array) -> jax.Array:
        modified = kind._replace(shadows=0).ndf(q)
        assert isinstance(modified, SplineNDF)
        return jnp.log(modified.norm)

    return jax.jacfwd(log_norm)(q)


def _lifted(
    kind: LobeKind, q: jax.Array, slope2: jax.Array, light_of: Callable[[NDF], jax.Array]
) -> tuple[jax.Array, list[jax.Array]]:
    """Compute a quantity proportional to D, and its derivatives with respect to the coordinates of the family.

    The derivatives do not include that of the norm of a spline modification.

    slope2: squared slopes. light_of: function that computes the quantity of a lobe at these slopes; it is called with the lobe
        without modification.
    """
    plain, own = kind._replace(spline_size=0, shadows=0), len(kind.family_names)
    pairs = [jax.jvp(lambda own: light_of(plain.ndf(own)), (q[:own],), (unit,)) for unit in np.eye(own)]
    if not kind.spline_size:
        return pairs[0][0], [slope for _, slope in pairs]
    modified = kind._replace(shadows=0).ndf(q)
    assert isinstance(modified, SplineNDF)
    lift = jnp.exp(spline_at(modified.coefficients, slope2)) / modified.norm
    return pairs[0][0] * lift, [slope * lift for _, slope in pairs]


def _step(nodes: OperatorNodes, lobe: _Lobe, bases: list[tuple[AnyArray, AnyArray]]) -> jax.Array:
    """Compute the rows of `_rows` for a few cells. bases: results of `_basis` for each axis."""
    kind, q = lobe.kind, lobe.q
    weight = nodes.at.weight
    for (basis, _), differences in zip(bases, nodes.at.along, strict=True):
        weight = weight + jnp.tensordot(differences, basis, (1, 0))
    light, by_own = _lifted(kind, q, nodes.at.slope2, nodes.light)
    seen, by_lambda = jnp.ones_like(weight), jnp.zeros(())
    if kind.masking is not None:
        directions = lobe.directions(nodes)
        lambdas = [lobe.lambda_of(lobe.masked_by, one) for one in directions]
        seen, pull = jax.vjp(lambda i, o: nodes.joint_masking(kind.masking, i, o), *lambdas)
        pulled = pull(weight * light)

        def along(direction: jax.Array) -> jax.Array:
            """Compute the contribution of masking to a derivative of the record. direction: derivative of `lobe.masked_by`."""
            total = jnp.zeros(())
            for one, share in zip(directions, pulled, strict=True):
                _, change = jax.jvp(lambda by, one=one: lobe.lambda_of(by, one), (lobe.masked_by,), (direction,))
                total = total + jnp.sum(share * change, axis=(1, 2, 3, 4))
            return total

        if kind.size > _FEW and lobe.table is not None:
            by_logs = [share * (1 + own) for share, own in zip(pulled, lambdas, strict=True)]
            light_and_view = [by_entries(*pair).T for pair in zip(directions, by_logs, strict=True)]
            by_lambda = lobe.masked_slopes @ (light_and_view[0] + light_and_view[1])
        elif kind.size > _FEW:  # each cell has its own copy of the coordinates, so one reverse pass suffices

            def of_cells(own: jax.Array) -> list[jax.Array]:
                return [jax.vmap(lobe.lambda_of)(own, one) for one in directions]

            _, back = jax.vjp(of_cells, jnp.broadcast_to(lobe.masked_by, (len(nodes.at.slope2), lobe.masked_by.size)))
            by_lambda = lobe.masked_slopes @ back(list(pulled))[0].T
        else:
            by_lambda = jax.vmap(along)(lobe.masked_slopes)

    visible = seen * light
    record = _over_nodes(weight * visible)
    by_family = jnp.stack([_over_nodes(weight * seen * slope) for slope in by_own])
    by_spline = [spline_sums(nodes.at.slope2, weight * visible, axes=2)] if kind.spline_size else []
    by_lobe = jnp.pad(jnp.concatenate([by_family, *by_spline]), ((0, kind.shadows), (0, 0))) + by_lambda
    if lobe.by_norm is not None:
        by_lobe -= lobe.by_norm[:, None] * record
    by_rig = [
        slopes @ jnp.sum(visible[:, None] * differences, axis=(-2, -1)).T
        for (_, slopes), differences in zip(bases, nodes.at.along, strict=True)
    ]
    return jnp.stack([record, *by_lobe, *by_rig])


def _over_nodes(values: jax.Array) -> jax.Array:
    return jnp.sum(values, axis=(-2, -1))


def _basis(points: np.ndarray, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the Lagrange polynomials of some points, and their derivatives with respect to the position.

    shift: position at which the polynomials are evaluated.
    """
    return np.array(lagrange_basis(points, shift)), lagrange_slopes(points, shift)
