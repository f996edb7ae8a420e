"""Quadrature nodes of some cells, at which an operator evaluates a lobe.

Only D and its derivatives depend on the family of the lobe, so a small program is compiled for each family. Lambda is
interpolated in a table for every lobe, and the sums are computed by NumPy. A single program for these steps takes ten times
as long to compile, and more time to run. All programs take the same number of cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.inverse.operator.chosen_cells import SLICE_CELLS
from matcam.inverse.rig.rig_axes import Axis, scaled_changes
from matcam.material.lambda_table import TabulatedDirections
from matcam.material.masking import Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import spline_sums
from matcam.material.tabulated_masking import compiled_table
from matcam.numerics.approximation import lagrange_basis, lagrange_slopes

CELLS = 5 * SLICE_CELLS
"""Number of cells in each call of a program: five slices of a table, because fits use 5, 15 or 90 slices."""


class NodeArrays(NamedTuple):
    """Quantities at the quadrature nodes of cells. The first axis of every array is that of the cells.

    Attributes:
        slope2: squared tangent of the angle between normal and half vector, (cells, directions, nodes).
        weight: weight of each node, (cells, directions, nodes).
        along: for each axis, differences between the weights at the points of the axis and `weight`, (cells, points,
            directions, nodes).
        light_and_view: directions of light and view, (cells, 2, directions, nodes, azimuths).
        azimuth: azimuth between light and view, rad, (cells, directions, nodes, azimuths).
        share: shares of the azimuths at which masking is evaluated, in the shape of `azimuth`; None: equal shares.
    """

    slope2: np.ndarray
    weight: np.ndarray
    along: tuple[np.ndarray, ...]
    light_and_view: TabulatedDirections
    azimuth: np.ndarray
    share: np.ndarray | None = None


class OperatorNodes(NamedTuple):
    """Nodes of cells, and quantities that are common to all cells.

    Attributes:
        at: quantities at the nodes.
        axes: parameters of the rig that may change.
    """

    at: NodeArrays
    axes: tuple[Axis, ...]

    def with_weights(self, weight: np.ndarray, along: Sequence[np.ndarray]) -> OperatorNodes:
        return self._replace(at=self.at._replace(weight=weight, along=tuple(along)))

    def plus(self, other: OperatorNodes, factor: np.ndarray) -> OperatorNodes:
        """Add the weights of other nodes at the same positions.

        factor: factor of the added weights, (cells, 1, 1).
        """
        pairs = zip(self.at.along, other.at.along, strict=True)
        return self.with_weights(
            self.at.weight + factor * other.at.weight, [one + factor[:, None] * more for one, more in pairs]
        )

    def along_axes(self, indices: Sequence[int]) -> OperatorNodes:
        along = tuple(self.at.along[k] for k in indices)
        return self._replace(at=self.at._replace(along=along), axes=tuple(self.axes[k] for k in indices))

    def weight_at(self, shifts: npt.ArrayLike) -> np.ndarray:
        """Compute the weights of a rig with other parameters, (cells, directions, nodes).

        shifts: coordinates along the axes, (axes,).
        """
        weight, (scaled, _) = self.at.weight, scaled_changes(self.axes, np.asarray(shifts, dtype=float))
        for axis, differences, shift in zip(self.axes, self.at.along, scaled, strict=True):
            if shift:
                basis = np.array(lagrange_basis(np.array(axis.points), shift))
                weight = weight + _along_points(differences, basis)
        return weight

    def by_shifts(self, by_weight: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Differentiate the sum over the nodes of each cell with respect to the coordinates along the axes, (axes, cells).

        by_weight: derivatives of the sum with respect to the weights, (cells, directions, nodes).
        """
        scaled, slopes = scaled_changes(self.axes, shifts)
        column = by_weight.reshape(len(by_weight), -1, 1)
        own = np.zeros((len(self.axes), len(by_weight)))
        for row, axis, along, shift in zip(own, self.axes, self.at.along, scaled.tolist(), strict=True):
            by_points = (along.reshape(*along.shape[:2], -1) @ column)[..., 0]
            row += lagrange_slopes(np.array(axis.points), shift) @ by_points.T
        return slopes.T @ own

    def masked(self, masking: Masking, table: np.ndarray | None) -> JointMasking | None:
        if masking is None or table is None:
            return None
        return JointMasking(self, masking, self.at.light_and_view.one_plus_lambda(table))

    def weighted(self, ndf: NDF, masking: Masking, table: np.ndarray | None, shifts: npt.ArrayLike) -> np.ndarray:
        """Evaluate D G at the nodes, multiplied by the weights, (cells, directions, nodes)."""
        lobe = self.weight_at(shifts) * np.asarray(_facets(ndf, self.at.slope2))
        masked = self.masked(masking, table)
        return lobe if masked is None else lobe * masked.value


class JointMasking(NamedTuple):
    """Masking G at the nodes of cells.

    Attributes:
        nodes: the nodes.
        masking: model of the masking.
        lambdas: 1 + Lambda of light and view, in the shape of `NodeArrays.light_and_view`.
    """

    nodes: OperatorNodes
    masking: Masking
    lambdas: np.ndarray

    @property
    def value(self) -> np.ndarray:
        """G at the nodes, (cells, directions, nodes)."""
        at = self.nodes.at
        light, view = np.moveaxis(self.lambdas - 1, 1, 0)
        both = g2(self.masking, light, view, at.azimuth)
        return np.asarray(both.mean(axis=-1) if at.share is None else (both * at.share).sum(axis=-1))

    def by_tables(self, by_value: np.ndarray, tables: np.ndarray) -> np.ndarray:
        """Differentiate the sum over the nodes of each cell with respect to changes of the table of Lambda, (changes, cells).

        Args:
            by_value: derivatives of the sum with respect to G at the nodes, (cells, directions, nodes).
            tables: changes of the table, (changes, entries).
        """
        at = self.nodes.at
        by_both = by_value[..., None] * (1 / at.azimuth.shape[-1] if at.share is None else at.share)
        slopes = np.asarray(masking_slopes(self.masking, self.lambdas, at.azimuth))
        return at.light_and_view.by_tables(by_both[:, None] * slopes, tables)


def _along_points(differences: np.ndarray, basis: np.ndarray) -> np.ndarray:
    cells, points, *nodes = differences.shape
    return (basis @ differences.reshape(cells, points, -1)).reshape(cells, *nodes)


def facets(ndf: NDF, slope2: Any) -> jax.Array:
    """Evaluate D = P22 / cos^4 theta_h, 1/sr."""
    return ndf.slope_density(slope2) * (1 + slope2) ** 2


_facets = kept_program(facets)
"""Compiled `facets`."""


@kept_program
def masking_slopes(masking: Masking, lambdas: Any, azimuth: Any) -> jax.Array:
    """Differentiate G with respect to ln(1 + Lambda) of light and view.

    lambdas: 1 + Lambda, see `JointMasking`.
    """
    _, pull = jax.vjp(lambda both: g2(masking, both[:, 0] - 1, both[:, 1] - 1, azimuth), lambdas)
    return pull(jnp.ones_like(azimuth))[0] * lambdas


T = TypeVar("T")


def in_blocks(cells: T) -> list[T]:
    """Divide arrays over cells into blocks of `CELLS` cells.

    The blocks are views of the arrays. Only the last one is a copy, if it is padded with copies of the last cell.

    cells: array, or tree of arrays, whose first axis is that of the cells.
    """
    count = len(jax.tree.leaves(cells)[0])
    blocks: list[Any] = [slice(start, start + CELLS) for start in range(0, count - CELLS + 1, CELLS)]
    if count % CELLS:
        blocks.append(np.minimum(np.arange(len(blocks) * CELLS, (len(blocks) + 1) * CELLS), count - 1))
    return [jax.tree.map(lambda array, some=some: np.asarray(array)[some], cells) for some in blocks]


def joined(blocks: Sequence[T], count: int) -> T:
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *blocks)


def lambda_table(ndf: NDF, masking: Masking) -> np.ndarray | None:
    return None if masking is None else np.asarray(compiled_table(ndf))


@kept_program
def spline_parts(slope2: Any, weighted: Any) -> jax.Array:
    """Differentiate sums over the nodes with respect to the coefficients of a smooth factor of D, (coefficients, cells)."""
    return spline_sums(slope2, weighted, axes=2)
