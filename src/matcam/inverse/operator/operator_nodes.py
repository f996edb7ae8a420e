"""Quadrature nodes of some cells, at which a compiled program evaluates a lobe.

All programs take the same number of cells, so that few programs serve all rigs, tables and lattices of cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from matcam.core.jax import computes_on_gpu, jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.inverse.operator.chosen_cells import SLICE_CELLS
from matcam.material.lambda_table import lambda_at
from matcam.material.masking import Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import spline_sums
from matcam.material.tabulated_masking import compiled_table, has_closed_lambda
from matcam.numerics.approximation import lagrange_basis

CELLS = 5 * SLICE_CELLS
"""Number of cells in each call of a program: five slices of a table, because fits use 5, 15 or 90 slices."""
_STEP = SLICE_CELLS
"""Number of cells in each step of a call: one slice of a table, whose arrays fit into the cache of the processor."""


class NodeArrays(NamedTuple):
    """Quantities at the quadrature nodes of cells. The first axis of every array is that of the cells.

    Masking is evaluated at fewer samples than the lobe.

    Attributes:
        slope2: squared tangent of the angle between normal and half vector, (cells, directions, nodes).
        weight: weight of each node, (cells, directions, nodes).
        along: for each axis, differences of the weights at the points of the axis, (cells, points, directions, nodes).
        cos_i: cosine of the angle of incidence, (cells, directions, groups of nodes, samples, 2).
        cos_o: cosine of the viewing angle, in the shape of `cos_i`.
        position_i: position of the angle of incidence in a table of Lambda (`position_of`), in the shape of `cos_i`.
        position_o: position of the viewing angle in this table, in the shape of `cos_i`.
        azimuth: azimuth between the directions of incidence and view, rad, in the shape of `cos_i`.
        share: shares of the two azimuths at which masking is evaluated, in the shape of `cos_i`; None: one half each.
    """

    slope2: Any
    weight: Any
    along: tuple[Any, ...]
    cos_i: Any
    cos_o: Any
    position_i: Any
    position_o: Any
    azimuth: Any
    share: Any = None


class OperatorNodes(NamedTuple):
    """Nodes of cells, and what all cells have in common.

    Attributes:
        at: quantities at the nodes.
        through_samples: matrix that interpolates from the samples to the nodes of a group, (nodes of a group, samples).
        points: points of each axis, (points,). They are arrays, so that one compiled program serves all rigs.
    """

    at: NodeArrays
    through_samples: jax.Array
    points: tuple[jax.Array, ...]

    def with_weights(self, weight: Any, along: Sequence[Any]) -> OperatorNodes:
        """Replace the weights and their differences along the axes."""
        return self._replace(at=self.at._replace(weight=placed(weight), along=tuple(placed(one) for one in along)))

    def plus(self, other: OperatorNodes, factor: np.ndarray) -> OperatorNodes:
        """Add the weights of other nodes at the same positions, multiplied by a factor of each cell, (cells, 1, 1)."""
        weight = np.asarray(self.at.weight) + factor * np.asarray(other.at.weight)
        pairs = zip(self.at.along, other.at.along, strict=True)
        return self.with_weights(weight, [np.asarray(one) + factor[:, None] * np.asarray(more) for one, more in pairs])

    def along_axes(self, indices: Sequence[int]) -> OperatorNodes:
        """Restrict the nodes to some of the axes."""
        along, points = (tuple(every[k] for k in indices) for every in (self.at.along, self.points))
        return self._replace(at=self.at._replace(along=along), points=points)

    def moved(self, shifts: npt.ArrayLike) -> OperatorNodes:
        """Return the nodes of a rig with other parameters, without axes. shifts: coordinates along the axes, (axes,)."""
        weight = np.asarray(self.at.weight)
        for points, differences, shift in zip(self.points, self.at.along, np.asarray(shifts, dtype=float), strict=True):
            if shift:
                basis = np.stack(lagrange_basis(np.asarray(points), shift))
                weight = weight + np.tensordot(np.asarray(differences), basis, (1, 0))
        return self._replace(at=self.at._replace(weight=placed(weight), along=()), points=())

    def by_steps(self, function: Callable[[OperatorNodes], jax.Array]) -> jax.Array:
        """Apply a function to a few cells at a time. The result has shape (..., cells).

        function: function of the nodes of some cells that returns (..., cells).
        """

        def one(at: NodeArrays) -> jax.Array:
            return function(self._replace(at=at))

        steps = jax.tree.map(lambda array: array.reshape(-1, _STEP, *array.shape[1:]), self.at)
        # a GPU is faster if it processes all cells at once
        found = jax.vmap(one)(steps) if computes_on_gpu() else jax.lax.map(one, steps)
        return jnp.moveaxis(found, 0, -2).reshape(*found.shape[1:-1], -1)

    def weighted(self, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
        """Evaluate D G at the nodes, multiplied by the weights, (cells, directions, nodes).

        table: table of Lambda; None: Lambda has a closed form, or there is no masking.
        """
        light = self.light(ndf)
        if masking is not None:
            light *= self.joint_masking(masking, *self.lambdas(ndf, table))
        return self.at.weight * light

    def lambdas(self, ndf: NDF, table: jax.Array | None) -> tuple[jax.Array, jax.Array]:
        """Evaluate Lambda at the angles of incidence and view.

        table: table of Lambda; None: Lambda has a closed form.
        """
        if table is None:
            return ndf.smith_lambda(self.at.cos_i), ndf.smith_lambda(self.at.cos_o)
        return lambda_at(table, self.at.position_i), lambda_at(table, self.at.position_o)

    def light(self, ndf: NDF) -> jax.Array:
        """Evaluate D = P22 / cos^4 theta_h at the nodes, 1/sr."""
        return ndf.slope_density(self.at.slope2) * (1 + self.at.slope2) ** 2

    def joint_masking(self, masking: Masking, lambda_i: jax.Array, lambda_o: jax.Array) -> jax.Array:
        """Evaluate G at the nodes from Lambda at the samples."""
        both = g2(masking, lambda_i, lambda_o, self.at.azimuth)
        if self.at.share is None:
            mean = jnp.mean(both, axis=-1)
        else:  # jnp.sum over the pair takes five times as long in XLA
            mean = both[..., 0] * self.at.share[..., 0] + both[..., 1] * self.at.share[..., 1]
        joint = mean @ self.through_samples.T
        return joint.reshape(self.at.slope2.shape)


T = TypeVar("T")


def in_blocks(cells: T) -> list[T]:
    """Divide arrays over cells into blocks of `CELLS` cells. The last block is padded with copies of the last cell.

    cells: array, or tree of arrays, whose first axis is that of the cells.
    """
    count = len(jax.tree.leaves(cells)[0])
    index = np.minimum(np.arange(-(-count // CELLS) * CELLS), count - 1).reshape(-1, CELLS)
    return [jax.tree.map(lambda array, some=some: np.asarray(array)[some], cells) for some in index]


def joined(blocks: Sequence[T], count: int) -> T:
    """Join blocks. count: number of cells without the padding."""
    return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[:count], *blocks)


def lambda_table(ndf: NDF, masking: Masking) -> jax.Array | None:
    """Compute the table of Lambda; None if Lambda has a closed form, or without masking."""
    return None if masking is None or has_closed_lambda(ndf) else compiled_table(ndf)


@kept_program
def directions_of(nodes: OperatorNodes, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
    """Compute the record of D G divided by cos_i in each direction, 1/sr, (directions, cells)."""
    return nodes.by_steps(lambda one: 2 * jnp.sum(one.weighted(ndf, masking, table), axis=-1).T)


@kept_program
def shape_sums(nodes: OperatorNodes, ndf: NDF, masking: Masking, table: jax.Array | None) -> jax.Array:
    """Compute the record, and its derivatives with respect to the coefficients of a smooth factor of D, (1 + k, cells)."""

    def one(nodes: OperatorNodes) -> jax.Array:
        lobe = nodes.weighted(ndf, masking, table)
        return jnp.concatenate([jnp.sum(lobe, axis=(-2, -1))[None], spline_sums(nodes.at.slope2, lobe, axes=2)])

    return nodes.by_steps(one)
