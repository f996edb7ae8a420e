"""Record of D G in chosen cells, as a compiled function of lobe and camera that is valid for all materials.

`record` is the integral of docs/model.md 3 without F. The value of a table is F(theta_d) times this record, because all
nodes of a slice have the same theta_d if camera and lamp are distant. The quadrature rule of each pixel (`sphere_rule`)
depends on the rig only. It is computed once and stored.

With a near camera or lamp, theta_d differs between the nodes. The value of the table is then F A + F' B, where F' is
the derivative of F with respect to theta_d. A is the record at F = 1, and B is the record of D G times the deviation of
theta_d from its value for the cell (`rise_of`).
The operator `moment` of B is the operator of A with other weights. The second-order term is below 3e-5 of the value for
lamps at three radii.

Uncertain parameters of the rig change the weights of the rule. Along the axis of each parameter (`rig_axes`) a polynomial
interpolates between a few values. The interaction of two parameters is a product of two small errors and is neglected.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.optics.optics import checked_isotropic
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling, azimuth_difference
from matcam.core.jax import jax, jnp, placed
from matcam.core.workspace import Workspace, default_workspace
from matcam.forward.cylinder_cells import check_cylinder
from matcam.forward.integral.blur import kernel_error
from matcam.forward.integral.kernel_residual import RESIDUAL_RULE
from matcam.forward.pixel_grid import PixelGrid, grid_of
from matcam.inverse.operator.cell_rules import MOMENT_ALONG, rule_arrays
from matcam.inverse.operator.chosen_cells import ChosenCells, chosen_cells
from matcam.inverse.operator.lamp_lines import DISC_RULE
from matcam.inverse.operator.rig_axes import APERTURE, LAMP, Axis
from matcam.inverse.operator.sample_view import FAR_AWAY, SampleView, sample_view
from matcam.inverse.operator.theta_nodes import NODE_RULE, RISE, SAMPLED, THROUGH_SAMPLES
from matcam.material.lambda_table import STEEPEST, lambda_at, position_of, quick_table
from matcam.material.masking import Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.numerics.approximation import lagrange_basis
from matcam.numerics.disc_chords import CHORD_RULE
from matcam.rigs import ON_REAL_PIXELS, Rig
from matcam.sample.curved import Cylinder, Sphere


class LobeOperator(eqx.Module):
    """Quadrature rule of all chosen cells. Masking is evaluated at fewer samples than the lobe.

    Attributes:
        slope2: squared tangent of the angle between normal and half vector, (cells of all slices, directions, nodes).
        weight: weight of each node, (cells, directions, nodes).
        along: for each axis, differences of the weights at the points of the axis, (points, cells, directions, nodes).
        cos_i: cosine of the angle of incidence, (cells, directions, groups of nodes, samples, 2).
        cos_o: cosine of the viewing angle, in the shape of `cos_i`.
        position_i: fractional index of the angle of incidence in a table of Lambda (`lambda_table`), in the shape of `cos_i`.
        position_o: fractional index of the viewing angle in this table, in the shape of `cos_i`.
        azimuth: azimuth between the directions of incidence and view, rad, in the shape of `cos_i`.
        through_samples: matrix that interpolates from the samples to the nodes of a group, (nodes of a group, samples).
        points: points of each axis, (points,). They are arrays, so that one compiled program serves all rigs.
        shape: number of slices, and number of cells in each slice.
        share: shares of the two azimuths at which masking is evaluated, in the shape of `cos_i`; None: one half each.
        moment: operator whose weights are multiplied by the deviation of theta_d from that of the cell, rad; None: no moment.
    """

    slope2: jax.Array
    weight: jax.Array
    along: tuple[jax.Array, ...]
    cos_i: jax.Array
    cos_o: jax.Array
    position_i: jax.Array
    position_o: jax.Array
    azimuth: jax.Array
    through_samples: jax.Array
    points: tuple[jax.Array, ...]
    shape: tuple[int, int] = eqx.field(static=True)
    share: jax.Array | None = None
    moment: LobeOperator | None = None

    @property
    def orders(self) -> tuple[LobeOperator, ...]:
        """Return the operator and, if it has one, that of the moment."""
        return (self,) if self.moment is None else (self, self.moment)

    def in_slices(self, part: slice) -> LobeOperator:
        """Restrict the operator to some of the slices."""
        slices, count = self.shape
        cells = np.arange(slices * count).reshape(slices, count)[part]

        def own(array: jax.Array, axis: int = 0) -> jax.Array:
            return placed(np.take(np.asarray(array), cells.ravel(), axis))

        moment = None if self.moment is None else self.moment.in_slices(part)
        return dataclasses.replace(self._of_cells(own, cells.shape[0]), moment=moment)

    def along_axes(self, indices: Sequence[int]) -> LobeOperator:
        """Restrict the operator to some of the axes."""
        along, points = (tuple(every[k] for k in indices) for every in (self.along, self.points))
        moment = None if self.moment is None else self.moment.along_axes(indices)
        return dataclasses.replace(self, along=along, points=points, moment=moment)

    def leaning(self, lean: np.ndarray) -> LobeOperator:
        """Include the variation of F within a slice in the weights.

        F is 1 at theta_d of the cells. lean: derivative of ln F with respect to theta_d, 1/rad, (slices,).
        """
        if self.moment is None:
            return self
        rise = jnp.repeat(jnp.asarray(lean), self.shape[1])[:, None, None]
        pairs = zip(self.along, self.moment.along, strict=True)
        return dataclasses.replace(
            self,
            weight=self.weight + rise * self.moment.weight,
            along=tuple(own + rise * moment for own, moment in pairs),
            moment=None,
        )

    def record(self, ndf: NDF, masking: Masking, shifts: jax.Array) -> jax.Array:
        """Compute the record of D G divided by cos_i, 1/sr.

        F is 1. The result has shape (slices, cells) and is the mean of both directions. shifts: coordinates along the
        axes, (axes,).
        """
        table = None if masking is None else quick_table(ndf)
        if table is None:
            return jnp.sum(self.weighted(ndf, masking, shifts), axis=(-2, -1)).reshape(self.shape)

        def one(slice_: LobeOperator) -> jax.Array:
            return jnp.sum(slice_.weighted(ndf, masking, shifts, table), axis=(-2, -1))

        return self.slice_by_slice(one)

    def directions(self, ndf: NDF, masking: Masking, shifts: jax.Array) -> jax.Array:
        """Compute the record of each direction, 1/sr, (slices, cells, directions).

        `record` is their mean.
        """
        return 2 * jnp.sum(self.weighted(ndf, masking, shifts), axis=-1).reshape(*self.shape, -1)

    def weighted(self, ndf: NDF, masking: Masking, shifts: jax.Array, table: jax.Array | None = None) -> jax.Array:
        """Evaluate D G at the nodes, multiplied by the weights.

        The result has shape (cells, directions, nodes). shifts: coordinates along the axes, (axes,). table:
        table of Lambda. Default: None, it is computed if Lambda has no closed form.
        """
        weight = self.weight
        for points, differences, shift in zip(self.points, self.along, shifts, strict=True):
            weight = weight + jnp.tensordot(jnp.stack(lagrange_basis(points, shift)), differences, 1)
        light = self.light(ndf)
        if masking is not None:
            light *= self.joint_masking(masking, *self.lambdas(ndf, quick_table(ndf) if table is None else table))
        return weight * light

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

    def slice_by_slice(self, function: Callable[[LobeOperator], jax.Array]) -> jax.Array:
        """Apply a function to the operator of each slice in turn.

        The result has shape (slices, ...). The arrays of all slices would require hundreds of MB. Those of
        one slice fit into the cache of the processor.
        """

        def one(position: jax.Array) -> jax.Array:
            return function(self._in_slice(position))

        positions = jnp.arange(self.shape[0])
        # a GPU is faster if it processes all slices at once
        return jax.lax.map(one, positions) if jax.default_backend() == "cpu" else jax.vmap(one)(positions)

    def _in_slice(self, position: jax.Array) -> LobeOperator:
        count = self.shape[1]

        def own(array: jax.Array, axis: int = 0) -> jax.Array:
            return jax.lax.dynamic_slice_in_dim(array, position * count, count, axis)

        return self._of_cells(own, 1)

    def _of_cells(self, own: Callable[..., jax.Array], slices: int) -> LobeOperator:
        """Restrict the operator to some of the cells, without its moment.

        own: function that selects the cells of an array along their axis, by default the first. slices: number of slices of
        these cells.
        """
        return dataclasses.replace(
            self, slope2=own(self.slope2), weight=own(self.weight), along=tuple(own(one, 1) for one in self.along),
            cos_i=own(self.cos_i), cos_o=own(self.cos_o), position_i=own(self.position_i), position_o=own(self.position_o),
            azimuth=own(self.azimuth), shape=(slices, self.shape[1]), share=None if self.share is None else own(self.share),
            moment=None,
        )  # fmt: skip


class _Rules(NamedTuple):
    """Arrays of an operator as they are stored on disk."""

    theta: np.ndarray
    weight: np.ndarray
    sample_theta: np.ndarray
    sample_cos_psi: np.ndarray
    along: tuple[np.ndarray, ...]
    sample_theta_d: np.ndarray | None = None
    sample_share: np.ndarray | None = None
    moment: np.ndarray | None = None
    moment_along: tuple[np.ndarray, ...] = ()

    def operator(self, cells: ChosenCells, through: np.ndarray, axes: tuple[Axis, ...]) -> LobeOperator:
        """Build the operator, with the angles that masking requires."""
        theta = self.sample_theta[..., None]
        theta_d = np.repeat(cells.theta_d, cells.valid.shape[1]).reshape(-1, *[1] * (theta.ndim - 1))
        if self.sample_theta_d is not None:
            theta_d = self.sample_theta_d
        mean = np.cos(theta) * np.cos(theta_d)
        half = np.sin(theta) * np.sin(theta_d) * self.sample_cos_psi
        azimuth = azimuth_difference(theta, theta_d, np.pi - np.arccos(self.sample_cos_psi))
        cos_i, cos_o = (np.maximum(c, STEEPEST) for c in (mean + half, mean - half))
        slices, count = cells.valid.shape
        own = LobeOperator(
            slope2=placed(np.tan(self.theta) ** 2),
            weight=placed(self.weight),
            along=tuple(placed(a) for a in self.along),
            cos_i=placed(cos_i),
            cos_o=placed(cos_o),
            position_i=placed(position_of(cos_i)),
            position_o=placed(position_of(cos_o)),
            azimuth=azimuth,
            through_samples=placed(through),
            points=tuple(placed(np.array(axis.points)) for axis in axes),
            shape=(slices, count),
            share=None if self.sample_share is None else placed(self.sample_share),
        )
        if self.moment is None:
            return own
        along = tuple(placed(a) for a in self.moment_along)
        return dataclasses.replace(own, moment=dataclasses.replace(own, weight=placed(self.moment), along=along))


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

    rig: the rig; None: a camera without blur. workspace: store of the operator for further calls with the same rig. whole:
    slices and axes of a larger rule from which the operator is selected. Default: None, its rule is computed separately.
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
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), or None, got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere | Cylinder):
        raise ArgumentError(
            f"a fit needs a table recorded from a Sphere or Cylinder, but this rig has a {type(rig.sample).__name__}"
        )
    if isinstance(rig.sample, Cylinder):
        check_cylinder(rig)
        checked_isotropic(rig.camera.optics, "a fit of a cylinder")
    if rig.cell_value in (*ON_REAL_PIXELS, "mean") and not sample_view(rig).distant:
        raise ArgumentError(
            f"cell_value '{rig.cell_value}' requires a distant camera and lamp, because with near ones each cell has its own "
            "image: specify 'centre' or 'edge'"
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
    description = f"{description}, masking at {'every node' if view.azimuth else f'{SAMPLED.size} nodes'}, {NODE_RULE}"
    if not view.distant:
        description = f"{description}, moments of {RISE}"
    stored = workspace.store(description, lambda: rule_arrays(rig, cells, axes))
    along, moment_along = (
        tuple(stored.pop(f"{name}{n}") for n in range(len(axes)) if f"{name}{n}" in stored)
        for name in ("along", MOMENT_ALONG)
    )
    every_node = stored["sample_theta"].shape[-1] == THROUGH_SAMPLES.shape[0]
    through = np.eye(THROUGH_SAMPLES.shape[0]) if every_node else THROUGH_SAMPLES
    return _Rules(along=along, moment_along=moment_along, **stored).operator(cells, through, axes)


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
        psi = np.pi - cells.phi_d.ravel()[:, None, None, None] + np.array([0.0, np.pi])[:, None, None]
    else:
        theta, psi = cells.real.theta.reshape(-1, count, 1), cells.real.psi.reshape(-1, count, 1, 1)
    rules = _Rules(theta, weight.reshape(-1, count, 1), theta[:, :, None], np.cos(psi).reshape(-1, count, 1, 1, 1), ())
    return rules.operator(cells, np.ones((1, 1)), ())
