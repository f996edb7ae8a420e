"""True over recorded lobe in every cell of a table, and what is known of it: what a measured value is multiplied by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam._jax import jax, jnp
from matcam.angles import Sampling
from matcam.inverse import fit_parameters as parameters
from matcam.inverse.doubts import Doubt
from matcam.inverse.fit_result import MaterialFit
from matcam.inverse.response_lattice import COARSE, FINE, Lattice, lattice, on_table
from matcam.inverse.rig_axes import placed
from matcam.inverse.shape_correction import ShapeCorrection, shape_records
from matcam.material.masking import Masking
from matcam.rigs import Rig


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
