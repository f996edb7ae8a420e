"""Quadrature nodes of some cells, at which a compiled program evaluates a lobe.

All programs take the same number of cells, so that few programs serve all rigs, tables and lattices of cells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
import numpy.typing as npt

from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.material.lambda_table import has_closed_lambda, lambda_at, quick_table
from matcam.material.masking import Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import spline_sums
from matcam.numerics.approximation import lagrange_basis

CELLS = 560
"""Number of cells in each call of a program: five slices of a table."""
_STEP = 112
"""Number of cells in each step of a call. Their arrays fit into the cache of the processor."""


class OperatorNodes(eqx.Module):
    """Quadrature nodes of cells. Masking is evaluated at fewer samples than the lobe.

    Attributes:
        slope2: squared tangent of the angle between normal and half vector, (cells, directions, nodes).
        weight: weight of each node, (cells, directions, nodes).
        along: for each axis, differences of the weights at the points of the axis, (points, cells, directions, nodes).
        cos_i: cosine of the angle of incidence, (cells, directions, groups of nodes, samples, 2).
        cos_o: cosine of the viewing angle, in the shape of `cos_i`.
        position_i: fractional index of the angle of incidence in a table of Lambda (`lambda_table`), in the shape of `cos_i`.
        position_o: fractional index of the viewing angle in this table, in the shape of `cos_i`.
        azimuth: azimuth between the directions of incidence and view, rad, in the shape of `cos_i`.
        share: shares of the two azimuths at which masking is evaluated, in the shape of `cos_i`; None: one half each.
        through_samples: matrix that interpolates from the samples to the nodes of a group, (nodes of a group, samples).
        points: points of each axis, (points,). They are arrays, so that one compiled program serves all rigs.
    """

    slope2: Any
    weight: Any
    along: tuple[Any, ...]
    cos_i: Any
    cos_o: Any
    position_i: Any
    position_o: Any
    azimuth: Any
    share: Any
    through_samples: Any
    points: tuple[Any, ...]

    def of_cells(self, select: Callable[[Any, int], Any]) -> OperatorNodes:
        """Apply a function to every array over cells. select: function of an array and of its axis of the cells."""
        own: dict[str, Any] = {
            name: None if getattr(self, name) is None else select(getattr(self, name), 0)
            for name in ("slope2", "weight", "cos_i", "cos_o", "position_i", "position_o", "azimuth", "share")
        }
        return dataclasses.replace(self, along=tuple(select(one, 1) for one in self.along), **own)

    def with_weights(self, weight: Any, along: Sequence[Any]) -> OperatorNodes:
        """Replace the weights and their differences along the axes."""
        return dataclasses.replace(self, weight=placed(weight), along=tuple(placed(one) for one in along))

    def moved(self, shifts: npt.ArrayLike) -> OperatorNodes:
        """Return the nodes of a rig with other parameters, without axes. shifts: coordinates along the axes, (axes,)."""
        weight = self.weight
        for points, differences, shift in zip(self.points, self.along, np.asarray(shifts, dtype=float), strict=True):
            if shift:
                basis = np.stack(lagrange_basis(np.asarray(points), shift))
                weight = placed(np.asarray(weight) + np.tensordot(basis, np.asarray(differences), 1))
        return dataclasses.replace(self, weight=weight, along=(), points=())

    def by_steps(self, function: Callable[[OperatorNodes], jax.Array]) -> jax.Array:
        """Apply a function to a few cells at a time. The result has shape (..., cells).

        function: function of the nodes of some cells that returns (..., cells).
        """

        def one(position: jax.Array) -> jax.Array:
            def cut(array: jax.Array, axis: int) -> jax.Array:
                return jax.lax.dynamic_slice_in_dim(array, position * _STEP, _STEP, axis)

            return function(self.of_cells(cut))

        positions = jnp.arange(CELLS // _STEP)
        # a GPU is faster if it processes all cells at once
        found = jax.lax.map(one, positions) if jax.default_backend() == "cpu" else jax.vmap(one)(positions)
        return jnp.moveaxis(found, 0, -2).reshape(*found.shape[1:-1], CELLS)

    def weighted(self, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
        """Evaluate D G at the nodes, multiplied by the weights, (cells, directions, nodes).

        table: table of Lambda; None: Lambda has a closed form, or there is no masking.
        """
        light = self.light(ndf)
        if masking is not None:
            light *= self.joint_masking(masking, *self.lambdas(ndf, table))
        return self.weight * light

    def lambdas(self, ndf: NDF, table: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        """Evaluate Lambda at the angles of incidence and view.

        table: table of Lambda; None: Lambda has a closed form.
        """
        if table is None:
            return ndf.smith_lambda(self.cos_i), ndf.smith_lambda(self.cos_o)
        return lambda_at(table, self.position_i), lambda_at(table, self.position_o)

    def light(self, ndf: NDF) -> jax.Array:
        """Evaluate D = P22 / cos^4 theta_h at the nodes, 1/sr."""
        return ndf.slope_density(self.slope2) * (1 + self.slope2) ** 2

    def joint_masking(self, masking: Masking, lambda_i: jax.Array, lambda_o: jax.Array) -> jax.Array:
        """Evaluate G at the nodes from Lambda at the samples."""
        both = g2(masking, lambda_i, lambda_o, self.azimuth)
        if self.share is None:
            mean = jnp.mean(both, axis=-1)
        else:  # jnp.sum over the pair takes five times as long in XLA
            mean = both[..., 0] * self.share[..., 0] + both[..., 1] * self.share[..., 1]
        joint = mean @ self.through_samples.T
        return joint.reshape(self.slope2.shape)


def in_blocks(nodes: OperatorNodes) -> tuple[OperatorNodes, ...]:
    """Divide nodes into blocks of `CELLS` cells. The last block is padded with copies of the last cell."""

    def block(cut: Callable[[Any, int], np.ndarray]) -> OperatorNodes:
        return nodes.of_cells(lambda array, axis: placed(cut(array, axis)))

    return tuple(block(cut) for cut in _cuts(len(nodes.weight)))


def weights_in_blocks(weight: np.ndarray, along: Sequence[np.ndarray]) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    """Divide weights, and their differences along the axes, in the same way."""
    return [(cut(weight, 0), [cut(one, 1) for one in along]) for cut in _cuts(len(weight))]


def _cuts(count: int) -> list[Callable[[Any, int], np.ndarray]]:
    """Build the functions that select the cells of each block from an array. count: number of cells."""

    def cut(first: int) -> Callable[[Any, int], np.ndarray]:
        index = np.minimum(np.arange(first, first + CELLS), count - 1)
        return lambda array, axis: np.take(np.asarray(array), index, axis)

    return [cut(first) for first in range(0, count, CELLS)]


def joined(blocks: Sequence[OperatorNodes], select: np.ndarray) -> OperatorNodes:
    """Join blocks, and select cells by their index."""
    rows = iter(zip(*(_over_cells(block) for block in blocks), strict=True))

    def joined_array(_: Any, axis: int) -> np.ndarray:
        return np.take(np.concatenate([np.asarray(part) for part in next(rows)], axis), select, axis)

    return blocks[0].of_cells(joined_array)


def _over_cells(nodes: OperatorNodes) -> list[Any]:
    found: list[Any] = []
    nodes.of_cells(lambda array, axis: found.append(array))
    return found


def lambda_table(ndf: NDF, masking: Masking) -> jax.Array | None:
    """Compute the table of Lambda; None if Lambda has a closed form, or without masking."""
    return None if masking is None or has_closed_lambda(ndf) else _table(ndf)


@kept_program
def _table(ndf: NDF) -> jax.Array:
    table = quick_table(ndf)
    assert table is not None
    return table


@kept_program
def directions_of(nodes: OperatorNodes, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
    """Compute the record of D G divided by cos_i in each direction, 1/sr, (directions, cells)."""
    return nodes.by_steps(lambda one: 2 * jnp.sum(one.weighted(ndf, masking, table), axis=-1).T)


@kept_program
def shape_sums(nodes: OperatorNodes, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
    """Compute the record, and its derivatives with respect to the coefficients of a smooth factor of D, (1 + k, cells)."""

    def one(nodes: OperatorNodes) -> jax.Array:
        lobe = nodes.weighted(ndf, masking, table)
        return jnp.concatenate([jnp.sum(lobe, axis=(-2, -1))[None], spline_sums(nodes.slope2, lobe, axes=2)])

    return nodes.by_steps(one)
