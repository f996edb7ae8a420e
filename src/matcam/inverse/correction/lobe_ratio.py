"""The ratio of true over recorded lobe in every cell of a table, with its error: measured values are multiplied by it.

The response, recorded over true, is computed on a lattice of cells and interpolated. Across phi_d a folded cell is even about
0 and pi/2: a cubic spline, level at both ends, follows it. Along theta_h and theta_d the logarithm of the response is
interpolated by monotone cubics. Where the sphere's last pixels show a cell, nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.core.workspace import Workspace
from matcam.inverse.correction.doubts import Doubt, ShapeCorrection, shape_records
from matcam.inverse.correction.harmless import LobeRatio
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.chosen_cells import FAR_COSINE, NEAR_COSINE, ChosenCells, cell_places
from matcam.inverse.operator.lobe_operator import LobeOperator, operator_in, point_operator, rig_key, sphere_radius
from matcam.inverse.operator.rig_axes import Axis, axis_selection
from matcam.rigs import Rig

_PEAK_RINGS = 4
_LATTICES = 4
"""Lattices kept in memory, some ten MB each."""
_VANISHED = 1e-40
"""1/sr; no camera sees less, and the exponential tails of some lobes are: there is nothing to correct."""


class Spacing(NamedTuple):
    """Say where a lattice has its cells, crowded towards both ends, where the axes of the foreshortened lobe lie.

    Attributes:
        rings: rows of theta_h.
        slices: rows of theta_d.
        azimuths: phi_d, degrees.
    """

    rings: tuple[int, ...]
    slices: tuple[int, ...]
    azimuths: tuple[int, ...]


FINE = Spacing(
    (*range(15), 16, 18, 20, 22, 24, 27, 30, 34, 38, 43, 48, 53, 58, 62, 66, 70, 75, 80, 89),
    (0, 10, 20, 30, 38, 46, 52, 57, 61, 65, 68, 70, *range(72, 90)),
    (0, 4, 8, 12, 17, 24, 33, 43, 53, 62, 69, 75, 80, 84, 87, 90),
)
"""For the response itself."""
COARSE = Spacing(
    (*range(14), 15, 17, 19, 22, 25, 28, 32, 36, 46, 58, 72, 89),
    (0, 20, 38, 52, 61, 68, 73, 77, 80, 82, 84, 86, 88, 89),
    (0, 8, 20, 36, 53, 69, 80, 90),
)
"""For its errors and small changes."""


class ResponseLattice(NamedTuple):
    """Hold the cells of a lattice, and what is recorded in them.

    Attributes:
        cells: (slices, rings * azimuths).
        recorded: the rig's rule for them.
        true: the rule of a camera that sees points.
        spacing: where the cells are.
        sampling: of the table.
    """

    cells: ChosenCells
    recorded: LobeOperator
    true: LobeOperator
    spacing: Spacing
    sampling: Sampling


def response_lattice(
    rig: Rig, sampling: Sampling, spacing: Spacing, axes: tuple[Axis, ...], workspace: Workspace
) -> ResponseLattice:
    """Return the lattice of a rig. workspace: keeps it for the rig's next material."""
    key = ("lattice", rig_key(rig), sampling, spacing, axes)

    def make() -> ResponseLattice:
        cells = _lattice_cells(sphere_radius(rig), sampling, spacing)
        recorded = operator_in(rig, cells, axes, repr(key), workspace)
        return ResponseLattice(cells, recorded, point_operator(cells), spacing, sampling)

    return workspace.remember("response lattice", key, make, most=_LATTICES)


def _lattice_cells(radius: float, sampling: Sampling, spacing: Spacing) -> ChosenCells:
    """Return the cells of a lattice."""
    grid = merl_grid(sampling)
    ring, azimuth = (a.ravel() for a in np.meshgrid(spacing.rings, np.radians(spacing.azimuths), indexing="ij"))
    slices = np.array(spacing.slices)
    shape = (slices.size, ring.size)
    theta_h, theta_d = np.broadcast_to(grid.theta_h[ring], shape), grid.theta_d[slices]
    phi_d = np.broadcast_to(azimuth, shape)
    x, y, cos_i, cos_o = cell_places(radius, theta_h, theta_d[:, None], phi_d)
    valid = np.minimum(cos_i, cos_o).min(-1) > NEAR_COSINE
    safe = np.where(valid[..., None], cos_i, 1.0)
    none = np.zeros(shape, int)  # cells of the lattice lie between those of a table
    return ChosenCells(
        slices, theta_d, np.broadcast_to(ring, shape), none, theta_h, phi_d, valid, x, y, safe, cos_o, none.astype(bool)
    )


def seen_cells(sampling: Sampling) -> np.ndarray:
    """Return the cells of a whole table, (90, 90, 180), whose response is known."""
    grid = merl_grid(sampling)
    th, td = grid.theta_h[:, None, None], grid.theta_d[:, None]
    lowest = np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(grid.phi_d))
    return lowest > np.where(np.arange(GRID_SHAPE[0])[:, None, None] < _PEAK_RINGS, 1.1 * NEAR_COSINE, FAR_COSINE)


def on_table(values: np.ndarray, where: ResponseLattice) -> np.ndarray:
    """Interpolate a function known on the lattice, (slices, rings * azimuths), to every cell of a table: (90, 90, 180)."""
    rings, slices, azimuths = where.spacing
    lattice = np.where(where.cells.valid, values, np.nan).reshape(len(slices), len(rings), len(azimuths))
    # beyond where it is known it stays what it was there: towards the limb along theta_d
    for s in range(1, len(slices)):
        lattice[s] = np.where(np.isfinite(lattice[s]), lattice[s], lattice[s - 1])
    lattice = np.round(np.nan_to_num(lattice), 12)  # slopes of less overflow in the interpolator's harmonic means
    n_h, n_d, _ = GRID_SHAPE
    along = PchipInterpolator(slices, lattice, axis=0)(np.arange(n_d))
    along = PchipInterpolator(rings, along, axis=1)(np.arange(n_h))
    phi = merl_grid(where.sampling).phi_d
    across = CubicSpline(np.radians(azimuths), along, axis=2, bc_type="clamped")(np.minimum(phi, np.pi - phi))
    return np.ascontiguousarray(across.transpose(1, 0, 2))


class CorrectionFits(NamedTuple):
    """Hold the fits that a correction is made of.

    Attributes:
        fit: of the lobe that is corrected for.
        shape: what was changed of its shape.
        doubts: fits with a parameter of the rig free.
        others: fits of other lobes through the same camera, whose difference counts as uncertainty.
    """

    fit: MaterialFit
    shape: ShapeCorrection
    doubts: Sequence[Doubt]
    others: Sequence[MaterialFit] = ()


def lobe_ratio(rig: Rig, sampling: Sampling, fits: CorrectionFits, workspace: Workspace) -> LobeRatio:
    """Return the ratio of a fit and its shape's correction.

    It is computed on a fine lattice with the rig as given. Three things are smooth, so that a coarse lattice holds them: what
    fitted parameters of the rig change of the ratio, its derivatives, and what doubts and other lobes would make of it.
    """
    at = fits.fit.coordinates
    fine = response_lattice(rig, sampling, FINE, (), workspace)
    doubts = [doubt for doubt in fits.doubts if doubt.counted]
    alternatives = [(doubt.fit, doubt.counted) for doubt in doubts] + [(other, 1.0) for other in fits.others]
    axes = tuple(
        dict.fromkeys(axis for one in (fits.fit, *(fit for fit, _ in alternatives)) for axis in one.coordinates.axes)
    )
    coarse = response_lattice(rig, sampling, COARSE, axes, workspace)
    fitted = at.rig @ axis_selection(at.axes, axes)

    log = on_table(_shaped(fine, at, fits.shape), fine)
    here = _plain(coarse, at, fitted)
    if fitted.any():
        log += on_table(here - _plain(coarse, at, np.zeros(len(axes))), coarse)
    variance = np.maximum(on_table(_variance(coarse, at, fits.shape, fitted), coarse), 0.0)
    for other, weight in alternatives:
        there = other.coordinates
        change = _plain(coarse, there, there.rig @ axis_selection(there.axes, axes)) - here
        variance += (weight * on_table(change, coarse)) ** 2
    return LobeRatio(log, np.sqrt(variance))


@kept_program
def _log_ratio(where: ResponseLattice, kind: LobeKind, q: jax.Array, shifts: jax.Array) -> jax.Array:
    ndf = kind.ndf(q)
    recorded = where.recorded.record(ndf, kind.masking, shifts)
    true = where.true.record(ndf, kind.masking, jnp.zeros(0))
    ok = where.cells.valid
    true, recorded = (jnp.where(ok, jnp.maximum(lobe, _VANISHED), 1.0) for lobe in (true, recorded))
    return jnp.log(true) - jnp.log(recorded)


@kept_program
def _log_slopes(where: ResponseLattice, kind: LobeKind, q: jax.Array, shifts: jax.Array) -> jax.Array:
    """Return derivatives by the lobe's and all of the rig's coordinates, (coordinates, slices, cells)."""
    both = jax.jacfwd(_log_ratio, argnums=(2, 3))(where, kind, q, shifts)
    return jnp.moveaxis(jnp.concatenate(both, axis=-1), -1, 0)


def _plain(where: ResponseLattice, at: FitCoordinates, shifts: np.ndarray) -> np.ndarray:
    return np.asarray(_log_ratio(where, at.kind, jnp.asarray(at.lobe), jnp.asarray(shifts)))


class _Shares(NamedTuple):
    """Hold recorded and true lobe on the lattice, 1 where unknown, and what each part of a shape adds to them, relative."""

    lobes: list[np.ndarray]
    shares: list[np.ndarray]

    def lifts(self, shape: ShapeCorrection) -> list[np.ndarray]:
        """Return the factors that a shape's correction gives to both lobes."""
        return [np.maximum(1 + np.tensordot(shape.b, share, 1), 1e-3) for share in self.shares]


def _shares(where: ResponseLattice, at: FitCoordinates, shifts: np.ndarray) -> _Shares:
    pairs = [
        shape_records(operator, at.kind, jnp.asarray(at.lobe), jnp.asarray(rig))
        for operator, rig in ((where.recorded, shifts), (where.true, np.zeros(0)))
    ]
    lobes = [np.where(where.cells.valid, np.maximum(np.asarray(lobe), _VANISHED), 1.0) for lobe, _ in pairs]
    return _Shares(lobes, [np.asarray(parts) / lobe for (_, parts), lobe in zip(pairs, lobes, strict=True)])


def _shaped(where: ResponseLattice, at: FitCoordinates, shape: ShapeCorrection) -> np.ndarray:
    """Return ln(true / recorded) with the shape's correction, the rig as given."""
    both = _shares(where, at, np.zeros(len(where.recorded.axes)))
    (recorded, true), (lift_recorded, lift_true) = both.lobes, both.lifts(shape)
    return np.where(where.cells.valid, np.log(true / recorded) + np.log(lift_true / lift_recorded), 0.0)


def _variance(where: ResponseLattice, at: FitCoordinates, shape: ShapeCorrection, shifts: np.ndarray) -> np.ndarray:
    """Return the variance of the ratio, by the covariance of lobe, rig and shape."""
    both = _shares(where, at, shifts)
    by_recorded, by_true = (share / lift for share, lift in zip(both.shares, both.lifts(shape), strict=True))
    slopes = np.asarray(_log_slopes(where, at.kind, jnp.asarray(at.lobe), jnp.asarray(shifts)))
    own = len(at.lobe)
    by_rig = np.tensordot(axis_selection(at.axes, where.recorded.axes), slopes[own:], 1)
    columns = np.concatenate([slopes[:own], by_rig, by_true - by_recorded])
    columns = np.where(where.cells.valid, columns, 0.0)
    return np.einsum("psn,pq,qsn->sn", columns, shape.covariance, columns)
