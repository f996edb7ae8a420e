"""The camera's response, recorded over true, in every cell of a table: computed on a lattice of cells, read off in between.

Across phi_d a folded cell is even about 0 and pi/2: a cubic spline, level at both ends, holds it. Along theta_h and theta_d
the logarithm of the response is interpolated by monotone cubics. Where the sphere's last pixels show a cell, nothing is
claimed.

True over recorded lobe in every cell of a table, and what is known of it: what a measured value is multiplied by.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.jax import jax, jnp
from matcam.core.workspace import Keyed
from matcam.inverse.correction.doubts import Doubt
from matcam.inverse.correction.shape_correction import ShapeCorrection, shape_records
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.fit.fit_result import MaterialFit
from matcam.inverse.operator.chosen_cells import FAR_COSINE, NEAR_COSINE, ChosenCells, places
from matcam.inverse.operator.lobe_operator import LobeOperator, described, operator_of, point_operator, radius_of
from matcam.inverse.operator.rig_axes import Axis, placed
from matcam.material.masking import Masking
from matcam.rigs import Rig

_PEAK_RINGS = 4


class Spacing(NamedTuple):
    """Rows of theta_h and of theta_d, and azimuths in degrees, crowded towards both ends, where the axes of the
    foreshortened lobe lie."""

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
    (0, 1, 2, 3, 5, 7, 10, 13, 17, 22, 28, 36, 46, 58, 72, 89),
    (0, 20, 38, 52, 61, 68, 73, 77, 80, 82, 84, 86, 88, 89),
    (0, 8, 20, 36, 53, 69, 80, 90),
)
"""For its errors and small changes."""


class Lattice(NamedTuple):
    """Cells of the lattice, (slices, rings * azimuths), the rig's rule for them and that of a camera that sees points."""

    cells: ChosenCells
    recorded: LobeOperator
    true: LobeOperator
    spacing: Spacing
    sampling: Sampling


def lattice(rig: Rig, sampling: Sampling, spacing: Spacing, axes: tuple[Axis, ...] = ()) -> Lattice:
    """Of a rig, kept for its next material."""
    return _lattice(Keyed(described(rig), rig), sampling, spacing, axes)


@lru_cache(maxsize=4)
def _lattice(rig_and_key: Keyed[Rig], sampling: Sampling, spacing: Spacing, axes: tuple[Axis, ...]) -> Lattice:
    rig = rig_and_key.thing
    grid = merl_grid(sampling)
    ring, azimuth = (a.ravel() for a in np.meshgrid(spacing.rings, np.radians(spacing.azimuths), indexing="ij"))
    slices = np.array(spacing.slices)
    shape = (slices.size, ring.size)
    theta_h, theta_d = np.broadcast_to(grid.theta_h[ring], shape), grid.theta_d[slices]
    phi_d = np.broadcast_to(azimuth, shape)
    x, y, cos_i, cos_o = places(radius_of(rig), theta_h, theta_d[:, None], phi_d)
    kept = np.minimum(cos_i, cos_o).min(-1) > NEAR_COSINE
    safe = np.where(kept[..., None], cos_i, 1.0)
    cells = ChosenCells(
        slices, theta_d, np.broadcast_to(ring, shape), np.zeros(shape, int), kept, x, y, safe, np.zeros(shape, bool)
    )
    recorded = operator_of(rig, cells, axes, repr(("lattice", rig_and_key.key, sampling, spacing, axes)))
    return Lattice(cells, recorded, point_operator(cells, theta_h, phi_d, cos_i, cos_o), spacing, sampling)


def seen_cells(sampling: Sampling) -> np.ndarray:
    """Cells of a whole table, (90, 90, 180), whose response is known."""
    grid = merl_grid(sampling)
    th, td = grid.theta_h[:, None, None], grid.theta_d[:, None]
    lowest = np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(grid.phi_d))
    return lowest > np.where(np.arange(GRID_SHAPE[0])[:, None, None] < _PEAK_RINGS, 1.1 * NEAR_COSINE, FAR_COSINE)


def on_table(values: np.ndarray, where: Lattice) -> np.ndarray:
    """A function known on the lattice, (slices, rings * azimuths), in every cell of a table: (90, 90, 180)."""
    rings, slices, azimuths = where.spacing
    known = np.where(where.cells.kept, values, np.nan).reshape(len(slices), len(rings), len(azimuths))
    # beyond where it is known it stays what it was there: towards the limb along theta_d
    for s in range(1, len(slices)):
        known[s] = np.where(np.isfinite(known[s]), known[s], known[s - 1])
    known = np.nan_to_num(known)
    n_h, n_d, _ = GRID_SHAPE
    along = PchipInterpolator(slices, known, axis=0)(np.arange(n_d))
    along = PchipInterpolator(rings, along, axis=1)(np.arange(n_h))
    phi = merl_grid(where.sampling).phi_d
    across = CubicSpline(np.radians(azimuths), along, axis=2, bc_type="clamped")(np.minimum(phi, np.pi - phi))
    return np.ascontiguousarray(across.transpose(1, 0, 2))


class LobeRatio(NamedTuple):
    """Arrays over a table's angles, (90, 90, 180)."""

    log: np.ndarray
    """ln(true / recorded)."""
    std: np.ndarray
    """Its standard deviation: fitted numbers, shape, camera, doubts."""


def lobe_ratio(
    rig: Rig,
    sampling: Sampling,
    found: MaterialFit,
    shape: ShapeCorrection,
    family: MaterialFit,
    doubts: Sequence[Doubt],
) -> LobeRatio:
    """Of a fit and its shape's correction. family: the fit that the doubts began from.

    The ratio is computed on a fine lattice with the rig as it is told. What fitted numbers of the rig change of it, its
    derivatives and what doubts would make of it are smooth: a coarse lattice holds them.
    """
    fine = lattice(rig, sampling, FINE)
    axes = (*found.prior.axes, *(doubt.axis for doubt in doubts))
    coarse = lattice(rig, sampling, COARSE, axes)
    at_rest = np.zeros(len(axes))
    fitted = found.solved.p[found.problem.layout.camera] @ placed(found.prior.axes, axes)
    before = family.solved.p[family.problem.layout.camera] @ placed(family.prior.axes, axes)

    log = on_table(_shaped(fine, found, shape), fine)
    if fitted.any():
        log += on_table(_plain(coarse, found, fitted) - _plain(coarse, found, at_rest), coarse)
    variance = np.maximum(on_table(_variance(coarse, found, shape, fitted), coarse), 0.0)
    for doubt in doubts:
        instead = doubt.coordinate * placed((doubt.axis,), axes)[0]
        change = _plain(coarse, doubt.fit, instead) - _plain(coarse, family, before)
        variance += (doubt.weight * on_table(change, coarse)) ** 2
    return LobeRatio(log, np.sqrt(variance))


def _lobe(found: MaterialFit) -> tuple[str, Masking, jax.Array]:
    layout = found.problem.layout
    return layout.family, layout.masking, jnp.asarray(found.solved.p[layout.lobe(0)])


@eqx.filter_jit
def _log_ratio(where: Lattice, family: str, masking: Masking, q: jax.Array, shifts: jax.Array) -> jax.Array:
    ndf = parameters.ndf_at(family, q)
    recorded = where.recorded.record(ndf, masking, shifts)
    true = where.true.record(ndf, masking, jnp.zeros(0))
    ok = where.cells.kept
    return jnp.log(jnp.where(ok, true, 1.0)) - jnp.log(jnp.where(ok, recorded, 1.0))


@eqx.filter_jit
def _log_slopes(where: Lattice, family: str, masking: Masking, q: jax.Array, shifts: jax.Array) -> jax.Array:
    """Derivatives by the lobe's numbers and all coordinates of the rig, (numbers, slices, cells)."""
    both = jax.jacfwd(_log_ratio, argnums=(3, 4))(where, family, masking, q, shifts)
    return jnp.moveaxis(jnp.concatenate(both, axis=-1), -1, 0)


def _plain(where: Lattice, found: MaterialFit, shifts: np.ndarray) -> np.ndarray:
    return np.asarray(_log_ratio(where, *_lobe(found), jnp.asarray(shifts)))


def _shares(where: Lattice, found: MaterialFit, shifts: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Recorded and true lobe on the lattice, 1 where unknown, and what each part of a shape adds to them, relative."""
    pairs = [
        shape_records(operator, *_lobe(found), jnp.asarray(at))
        for operator, at in ((where.recorded, shifts), (where.true, np.zeros(0)))
    ]
    lobes = [np.where(where.cells.kept, np.asarray(lobe), 1.0) for lobe, _ in pairs]
    return lobes, [np.asarray(parts) / lobe for (_, parts), lobe in zip(pairs, lobes, strict=True)]


def _lifts(shares: list[np.ndarray], shape: ShapeCorrection) -> list[np.ndarray]:
    return [np.maximum(1 + np.tensordot(shape.b, share, 1), 1e-3) for share in shares]


def _shaped(where: Lattice, found: MaterialFit, shape: ShapeCorrection) -> np.ndarray:
    """ln(true / recorded) with the shape's correction, the rig as it is told."""
    (recorded, true), shares = _shares(where, found, np.zeros(len(where.recorded.axes)))
    lift_recorded, lift_true = _lifts(shares, shape)
    return np.where(where.cells.kept, np.log(true / recorded) + np.log(lift_true / lift_recorded), 0.0)


def _variance(where: Lattice, found: MaterialFit, shape: ShapeCorrection, shifts: np.ndarray) -> np.ndarray:
    """Of the ratio, by the covariance of lobe, camera and shape."""
    _, shares = _shares(where, found, shifts)
    by_recorded, by_true = (share / lift for share, lift in zip(shares, _lifts(shares, shape), strict=True))
    slopes = np.asarray(_log_slopes(where, *_lobe(found), jnp.asarray(shifts)))
    numbers = len(found.solved.p[found.problem.layout.lobe(0)])
    by_rig = np.tensordot(placed(found.prior.axes, where.recorded.axes), slopes[numbers:], 1)
    columns = np.concatenate([slopes[:numbers], by_rig, by_true - by_recorded])
    columns = np.where(where.cells.kept, columns, 0.0)
    return np.einsum("psn,pq,qsn->sn", columns, shape.covariance, columns)
