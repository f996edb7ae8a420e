"""Record of D G in chosen cells, as a function of lobe and camera that is valid for all materials.

D is the density of facet normals, G the masking, and F the Fresnel term. `record` is the integral of docs/model.md 3 without
F. If camera and lamp are distant, all nodes of a slice have the same theta_d, so the value of a table is F(theta_d) times this
record. The quadrature rule of each pixel (`sphere_rule`) depends on the rig only. It is computed once and stored.

With a near camera or lamp, theta_d differs between the nodes. The value of the table is then F A + F' B, where F' is
the derivative of F with respect to theta_d. A is the record at F = 1, and B is the record of D G times the deviation of
theta_d from its value for the cell (`rise_of`). The operator `moment` of B is the operator of A with other weights. The
second-order term is below 3e-5 of the value for lamps at three radii.

Uncertain parameters of the rig change the weights of the rule. Along the axis of each parameter (`rig_axes`) a polynomial
interpolates between a few values. Changes of the lens are scaled with its width (`scaled_changes`). Any other interaction of
two parameters is a product of two small errors and is neglected.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
import numpy.typing as npt

from matcam.camera.optics.colour import ColourOptics
from matcam.camera.optics.optics import checked_isotropic
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling, azimuth_at_cosines
from matcam.core.jax import jax
from matcam.core.threads import available_cores, in_order
from matcam.core.workspace import Workspace, default_workspace
from matcam.forward.cylinder_cells import check_cylinder
from matcam.forward.integral.blur import kernel_error
from matcam.forward.integral.kernel_residual import RESIDUAL_RULE
from matcam.forward.pixel_grid import PixelGrid, grid_of
from matcam.inverse.operator.cell_rules import MOMENT_ALONG, rule_arrays
from matcam.inverse.operator.chosen_cells import ChosenCells, chosen_cells
from matcam.inverse.operator.lamp_lines import DISC_RULE
from matcam.inverse.operator.operator_nodes import (
    NodeArrays,
    OperatorNodes,
    in_blocks,
    joined,
    lambda_table,
    spline_parts,
)
from matcam.inverse.operator.sample_view import FAR_AWAY, SampleView, sample_view
from matcam.inverse.operator.theta_nodes import NODE_RULE, RISE
from matcam.inverse.rig.rig_axes import APERTURE, LAMP, Axis
from matcam.material.lambda_table import TabulatedDirections
from matcam.material.masking import Masking
from matcam.material.ndf.distribution import NDF
from matcam.material.tabulated_masking import COTS
from matcam.numerics.disc_chords import CHORD_RULE
from matcam.rigs import ON_REAL_PIXELS, Rig
from matcam.sample.curved import Cylinder, Sphere

_LEAST_COSINE = 1e-4
"""Smallest cosine of incidence and view at which masking is evaluated. Lambda is therefore also finite below the horizon."""


@dataclasses.dataclass(frozen=True)
class LobeOperator:
    """Quadrature rule of all chosen cells.

    Attributes:
        blocks: nodes of the cells of all slices, in blocks of a fixed number of cells.
        shape: number of slices, and number of cells in each slice.
        moment: operator whose weights are multiplied by the deviation of theta_d from its value for the cell (`rise_of`), rad;
            None: no moment.
    """

    blocks: tuple[OperatorNodes, ...]
    shape: tuple[int, int]
    moment: LobeOperator | None = None

    @property
    def orders(self) -> tuple[LobeOperator, ...]:
        return (self,) if self.moment is None else (self, self.moment)

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.blocks[0].axes

    @property
    def at(self) -> NodeArrays:
        return joined([block.at for block in self.blocks], int(np.prod(self.shape)))

    def with_weights(self, weight: np.ndarray, along: Sequence[np.ndarray]) -> LobeOperator:
        """Build an operator with the same nodes and other weights, without a moment.

        Args:
            weight: weights, see `NodeArrays`.
            along: differences of the weights along each axis, see `NodeArrays`.
        """
        parts = zip(self.blocks, in_blocks((weight, tuple(along))), strict=True)
        return LobeOperator(tuple(block.with_weights(*part) for block, part in parts), self.shape)

    def in_slices(self, part: slice) -> LobeOperator:
        slices, count = self.shape
        cells = np.arange(slices * count).reshape(slices, count)[part]
        moment = None if self.moment is None else self.moment.in_slices(part)
        at = jax.tree.map(lambda array: array[cells.ravel()], self.at)
        return LobeOperator(_in_blocks(self.blocks[0]._replace(at=at)), cells.shape, moment)

    def along_axes(self, indices: Sequence[int]) -> LobeOperator:
        moment = None if self.moment is None else self.moment.along_axes(indices)
        return LobeOperator(tuple(block.along_axes(indices) for block in self.blocks), self.shape, moment)

    def leaning(self, lean: np.ndarray) -> LobeOperator:
        """Include the variation of F within a cell in the weights.

        F is 1 at theta_d of the cell.

        lean: derivative of ln F with respect to theta_d, 1/rad, (slices,).
        """
        if self.moment is None:
            return self
        parts = in_blocks(np.repeat(np.asarray(lean), self.shape[1])[:, None, None])
        blocks = [
            own.plus(moment, part) for own, moment, part in zip(self.blocks, self.moment.blocks, parts, strict=True)
        ]
        return LobeOperator(tuple(blocks), self.shape)

    def record(self, ndf: NDF, masking: Masking, shifts: npt.ArrayLike) -> np.ndarray:
        """Compute the record of D G divided by cos_i, 1/sr.

        F is 1. The result has shape (slices, cells) and is the mean of both directions, or of the real pixels of a cell.

        Args:
            ndf: the lobe.
            masking: masking G of the lobe.
            shifts: coordinates along the axes, (axes,).
        """
        return self.directions(ndf, masking, shifts).sum(axis=-1) / 2

    def directions(self, ndf: NDF, masking: Masking, shifts: npt.ArrayLike) -> np.ndarray:
        """Compute the record of each direction, 1/sr, (slices, cells, directions).

        `record` is half of the sum over the directions.
        """
        table = lambda_table(ndf, masking)
        found = self.by_blocks(lambda one: 2 * one.weighted(ndf, masking, table, shifts).sum(axis=-1).T)
        return np.moveaxis(found, 0, -1)

    def by_shape(self, ndf: NDF, masking: Masking, shifts: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Compute the record, and its derivative with respect to each coefficient of a smooth factor of D.

        Returns:
            Record, 1/sr, (slices, cells), and derivatives, 1/sr, (coefficients, slices, cells).
        """
        table = lambda_table(ndf, masking)

        def sums(one: OperatorNodes) -> np.ndarray:
            lobe = one.weighted(ndf, masking, table, shifts)
            return np.concatenate([lobe.sum(axis=(1, 2))[None], spline_parts(one.at.slope2, lobe)])

        found = self.by_blocks(sums)
        return found[0], found[1:]

    def by_blocks(self, function: Callable[[OperatorNodes], np.ndarray]) -> np.ndarray:
        """Apply a function to each block, on all cores. The result has shape (..., slices, cells).

        function: function of the nodes of a block, with values of shape (..., cells of the block).
        """
        parts = in_order(function, self.blocks, available_cores())
        whole = np.concatenate(list(parts), axis=-1)[..., : np.prod(self.shape)]
        return whole.reshape(*whole.shape[:-1], *self.shape)


def _in_blocks(nodes: OperatorNodes) -> tuple[OperatorNodes, ...]:
    return tuple(nodes._replace(at=block) for block in in_blocks(nodes.at))


def _operator(
    cells: ChosenCells,
    axes: tuple[Axis, ...],
    theta: np.ndarray,
    weight: np.ndarray,
    cos_psi: np.ndarray,
    theta_d: np.ndarray | None = None,
    share: np.ndarray | None = None,
    along: tuple[np.ndarray, ...] = (),
    moment: np.ndarray | None = None,
    moment_along: tuple[np.ndarray, ...] = (),
) -> LobeOperator:
    """Build an operator from the arrays of its nodes, as they are stored on disk."""
    if theta_d is None:
        theta_d = np.repeat(cells.theta_d, cells.valid.shape[1]).reshape(-1, *[1] * theta.ndim)
    # in blocks, whose intermediate arrays fit into the cache of a processor
    blocks = in_blocks((theta, theta_d, cos_psi, weight, along, share))
    own = LobeOperator(tuple(OperatorNodes(_nodes(*one), axes) for one in blocks), cells.valid.shape)
    return own if moment is None else dataclasses.replace(own, moment=own.with_weights(moment, moment_along))


def _nodes(
    theta: np.ndarray,
    theta_d: np.ndarray,
    cos_psi: np.ndarray,
    weight: np.ndarray,
    along: tuple[np.ndarray, ...],
    share: np.ndarray | None,
) -> NodeArrays:
    slope2, theta = np.tan(theta) ** 2, theta[..., None]
    mean = np.cos(theta) * np.cos(theta_d)
    half = np.sin(theta) * np.sin(theta_d) * cos_psi
    cos_i, cos_o = (np.maximum(c, _LEAST_COSINE) for c in (mean + half, mean - half))
    azimuth = np.asarray(azimuth_at_cosines(cos_i, cos_o, theta_d))
    light_and_view = TabulatedDirections.of(np.stack([cos_i, cos_o], axis=1), COTS.size)
    return NodeArrays(slope2, weight, along, light_and_view, azimuth, share)


class WholeRule(NamedTuple):
    """Slices and axes of a rule from which a smaller rule is selected.

    Attributes:
        slice_step: spacing of the slices, which include those of the smaller rule.
        axes: parameters of the rig that may change, which include those of the smaller rule.
    """

    slice_step: int
    axes: tuple[Axis, ...]


def lobe_operator(
    rig: Rig | None,
    sampling: Sampling,
    slice_step: int = 1,
    axes: tuple[Axis, ...] = (),
    workspace: Workspace | None = None,
    whole: WholeRule | None = None,
) -> tuple[ChosenCells, LobeOperator]:
    """Choose cells in every `slice_step`-th slice, and build their operator.

    Args:
        rig: the rig; None: a camera without blur.
        sampling: sampling of the table.
        slice_step: spacing of the slices of theta_d. Default: 1.
        axes: parameters of the rig that may change. Default: none.
        workspace: store of the operator for further calls with the same rig. Default: None, that of the process.
        whole: slices and axes of a larger rule from which the operator is selected. Default: None, a separate rule is computed.
    """
    if rig is None:
        return perfect_operator(sampling, slice_step, FAR_AWAY, workspace)
    workspace = checks.instance("workspace", default_workspace() if workspace is None else workspace, Workspace)
    known = rig_key(rig)  # raises for rigs that cannot be fitted
    pixels = grid_of(rig)
    key = (known, sampling, slice_step, axes, pixels)
    if whole is not None and whole != (slice_step, axes):
        cells, operator = lobe_operator(rig, sampling, *whole, workspace)
        operator = operator.along_axes([whole.axes.index(axis) for axis in axes])
        if whole.slice_step == slice_step:
            return cells, operator
        part = slice(
            (slice_step // 2 - whole.slice_step // 2) // whole.slice_step, None, slice_step // whole.slice_step
        )

        def cut() -> tuple[ChosenCells, LobeOperator]:
            return cells.in_slices(part), operator.in_slices(part)

        return workspace.remember("part of an operator", (key, whole), cut)

    def make() -> tuple[ChosenCells, LobeOperator]:
        cells = chosen_cells(sample_view(rig), sampling, slice_step, pixels)
        return cells, operator_in(rig, cells, axes, repr(key), workspace)

    return workspace.remember("lobe operator", key, make)


def rig_key(rig: Rig) -> tuple:
    """Check a rig, and list the properties that determine its pixels.

    All values are in full precision.
    """
    check_rig(rig)
    camera = eqx.tree_at(lambda c: (c.uncertainty, c.sensor), rig.camera, (None, None), is_leaf=lambda x: x is None)
    parameters = {name: float(value) for name, value in camera.parameters().items()}
    view = sample_view(rig)
    blurs = tuple(float(a) for a in (rig.lamp_radius, rig.jitter, rig.aperture, rig.focus))
    return repr(camera), tuple(sorted(parameters.items())), blurs, tuple(view)


def check_rig(rig: Rig) -> None:
    """Raise ArgumentError if a fit does not support the rig."""
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere | Cylinder):
        raise ArgumentError(
            f"the sample of the rig must be a Sphere or a Cylinder, got a {type(rig.sample).__name__}: blur does not change "
            "the table of a flat sample, so there is nothing to correct"
        )
    if isinstance(rig.sample, Cylinder):
        check_cylinder(rig)
        for one in rig.colours:
            checked_isotropic(one.camera.optics, "a fit of a cylinder")
    if isinstance(rig.camera.optics, ColourOptics):
        if any(np.any(shift) for shift in rig.camera.optics.shifts):
            raise ArgumentError(
                "a fit requires images without lateral colour, but ColourOptics has a shift: align the images of the colours "
                "before the table is made, and set red_shift, green_shift and blue_shift to (0, 0)"
            )
        if len({one.camera.optics.isotropic for one in rig.colours}) > 1:
            raise ArgumentError("a fit requires that the lenses of all colours are isotropic, or that none is")
    if rig.cell_value in (*ON_REAL_PIXELS, "mean") and not sample_view(rig).distant:
        raise ArgumentError(
            f"cell_value '{rig.cell_value}' requires a distant camera and lamp, because each cell has its own image if one of "
            "them is near; specify 'centre' or 'edge'"
        )


def operator_in(
    rig: Rig, cells: ChosenCells, axes: tuple[Axis, ...], description: str, workspace: Workspace
) -> LobeOperator:
    """Build the operator of given cells.

    description: string with all quantities on which the rule depends. It is the key of the rule in the files of the workspace.
    """
    if float(rig.lamp_radius) > 0 or any(axis.name == LAMP for axis in axes):
        description = f"{description}, discs by {DISC_RULE}"
    if float(rig.aperture) > 0 or any(axis.name == APERTURE for axis in axes):
        description = f"{description}, discs out of focus by {CHORD_RULE}"
    if kernel_error(rig) > 0:
        description = f"{description}, rings by {RESIDUAL_RULE}"
    view = sample_view(rig)
    description = f"{description}, {NODE_RULE}"
    if not view.distant:
        description = f"{description}, moments of {RISE}"
    stored = workspace.store(description, lambda: rule_arrays(rig, cells, axes))
    along, moment_along = (
        tuple(stored.pop(f"{name}{n}") for n in range(len(axes)) if f"{name}{n}" in stored)
        for name in ("along", MOMENT_ALONG)
    )
    return _operator(cells, axes, along=along, moment_along=moment_along, **stored)


def perfect_operator(
    sampling: Sampling,
    slice_step: int,
    view: SampleView,
    workspace: Workspace | None = None,
    pixels: PixelGrid | None = None,
) -> tuple[ChosenCells, LobeOperator]:
    """Choose cells, and build their operator for a camera without blur.

    pixels: grid of real pixels from which the cells are read; None: each cell has its own pixels.
    """

    def make() -> tuple[ChosenCells, LobeOperator]:
        cells = chosen_cells(view, sampling, slice_step, pixels)
        return cells, point_operator(cells)

    key = (sampling, slice_step, view, pixels)
    return (workspace or default_workspace()).remember("perfect operator", key, make)


def point_operator(cells: ChosenCells) -> LobeOperator:
    """Build the operator of given cells for a camera without blur.

    Each direction of a cell, or each real pixel of the cell, has one node.
    """
    valid, count = cells.valid[..., None], cells.x.shape[-1]
    weight = np.where(valid, cells.weight / (4 * np.where(valid, cells.cos_i * cells.cos_o, 1.0)), 0.0)
    if cells.real is None:
        theta = np.repeat(cells.theta_h.reshape(-1, 1, 1), 2, axis=1)
        psi = np.pi - cells.phi_d.ravel()[:, None, None] + np.array([0.0, np.pi])[:, None]
    else:
        theta, psi = cells.real.theta.reshape(-1, count, 1), cells.real.psi.reshape(-1, count, 1)
    return _operator(cells, (), theta, weight.reshape(-1, count, 1), np.cos(psi)[..., None])
