"""Ratio of true to recorded lobe in every cell of a table, and its variance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.grid import Sampling
from matcam.core.jax import placed
from matcam.core.workspace import Workspace
from matcam.forward.pixel_grid import grid_of
from matcam.inverse.correction.corrected_table import OPERATOR_ACCURACY
from matcam.inverse.correction.correction_limits import PEAK, LobeRatio
from matcam.inverse.correction.evidence import OtherLobe
from matcam.inverse.correction.lobe_shape import ShapeUncertainty, known_shape
from matcam.inverse.correction.other_maskings import OtherMasking
from matcam.inverse.correction.real_pixels import Lattices, pixel_log_ratio
from matcam.inverse.correction.response_lattice import (
    COARSE,
    FINE,
    VANISHED,
    ResponseLattice,
    on_table,
    response_lattice,
    seen_cells,
)
from matcam.inverse.correction.rig_refits import RigRefit
from matcam.inverse.fit.fit_problem import BASE
from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.fit.fit_statements import fit_readings_source
from matcam.inverse.fit.lobe_slopes import record_and_slopes
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.normalised_fresnel import OTHER_LOBES
from matcam.inverse.operator.sample_view import sample_view
from matcam.inverse.rig.rig_axes import Axis, axis_selection
from matcam.material.ndf.free_lobe import KNOTS
from matcam.numerics.fit_budget import VariancePart, scaled_parts, statement_parts
from matcam.rigs import Rig


class CorrectionFits(NamedTuple):
    """Fits from which a correction is computed.

    Attributes:
        fit: fit of the lobe.
        shape: uncertainty of the shape of the lobe.
        base: fit of the lobe of `fit` in the slices of `refits`, for comparison with `refits`.
        refits: fits with a parameter of the rig free.
        others: fits of other lobes through the camera of `fit`. The ratio is averaged over `fit` and these fits.
        maskings: predictions of `fit` with other maskings, whose differences are included in the uncertainty.
        expected: parameters of the rig that may be fitted, as given to `lattices_ahead`.
    """

    fit: MaterialFit
    shape: ShapeUncertainty
    base: MaterialFit
    refits: Sequence[RigRefit]
    others: Sequence[OtherLobe] = ()
    maskings: Sequence[OtherMasking] = ()
    expected: tuple[Axis, ...] = ()

    @property
    def alternatives(self) -> list[tuple[str, FitCoordinates, FitCoordinates, float]]:
        """Alternative fits whose difference from a reference fit is part of the uncertainty.

        Each item contains: name, coordinates of the reference, coordinates of the alternative, factor of the difference.
        """
        at, base = self.fit.coordinates, self.base.coordinates
        return [
            *(
                (f"{refit.axis.name} left free", base, refit.fit.coordinates, refit.counted)
                for refit in self.refits
                if refit.counted
            ),
            *(
                (f"masking: {other.coordinates.kind.masking}", at, other.coordinates, other.weight)
                for other in self.maskings
            ),
        ]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Expected parameters of the rig, followed by those of the fits."""
        fitted = (
            self.fit.coordinates,
            *(there for _, _, there, _ in self.alternatives),
            *(other.fit.coordinates for other in self.others),
        )
        return tuple(dict.fromkeys((*self.expected, *(axis for one in fitted for axis in one.axes))))


def lattices_ahead(rig: Rig, sampling: Sampling, expected: tuple[Axis, ...], workspace: Workspace) -> None:
    """Compute the lattices that `lobe_ratio` requires, and store them in the workspace."""
    for one in rig.colours:
        response_lattice(one, sampling, FINE, (), workspace)
        response_lattice(one, sampling, COARSE, expected, workspace)


def lobe_ratio(
    rig: Rig, sampling: Sampling, fits: CorrectionFits, workspace: Workspace, phase_std: float = 0.0
) -> LobeRatio:
    """Compute the ratio of true to recorded lobe of each colour of the rig, averaged over the explanations.

    The ratio is computed on a fine lattice for the specified rig. The derivatives of the ratio, and its changes due to fitted
    parameters of the rig and due to alternatives, are smooth and are computed on a coarse lattice. Alternatives are free
    parameters, other lobes and other maskings.

    phase_std: standard deviation of the phase of the real pixels from which cells are read, px. Default: 0.
    """
    return LobeRatio.of_colours([_ratio_of_lens(one, sampling, fits, workspace, phase_std) for one in rig.colours])


def _ratio_of_lens(
    rig: Rig, sampling: Sampling, fits: CorrectionFits, workspace: Workspace, phase_std: float
) -> LobeRatio:
    """Compute the ratio for an achromatic lens. The arrays have no axis of the colours."""
    at = fits.fit.coordinates
    log_slope = fits.fit.log_slope  # the mean of all channels, because they have one ratio
    fine = response_lattice(rig, sampling, FINE, (), workspace).of_fresnel(log_slope)
    axes = fits.axes
    plain = response_lattice(rig, sampling, COARSE, axes, workspace)
    coarse = plain.of_fresnel(log_slope)
    fitted = at.rig @ axis_selection(at.axes, axes)

    log_ratio, log_recorded = _log_ratio_and_record(fine, at)
    log = on_table(log_ratio, fine)
    recorded = np.exp(on_table(log_recorded, fine))
    here = _plain(coarse, at, fitted)
    if fitted.any():
        log += on_table(here - _plain(coarse, at, np.zeros(len(axes))), coarse)
    columns = _columns(coarse, at, axes, fitted)
    variance = np.maximum(on_table(_variance(columns, fits.shape), coarse), 0.0)
    parts = _peak_parts(columns, fits.fit, fits.shape, coarse, variance[PEAK])
    for name, from_, there, weight in fits.alternatives:
        change = _at(coarse, there, axes) - (here if from_ is at else _at(coarse, from_, axes))
        added = (weight * on_table(change, coarse)) ** 2
        variance += added
        parts = (*parts, VariancePart(name, "B", added[PEAK]))
    shift, spread = np.zeros(log.shape), np.zeros(log.shape)
    apart, others, share = np.zeros(log.shape[1]), np.zeros(log.shape[1]), 0.0
    for other in fits.others:
        there = other.fit.coordinates
        moved = there.rig @ axis_selection(there.axes, axes)
        change = on_table(_plain(coarse, there, moved) - here, coarse)
        shape = known_shape(other.fit, 0.0)
        own = np.maximum(on_table(_variance(_columns(coarse, there, axes, moved), shape), coarse), 0.0)
        shift += other.probability * change
        spread += other.probability * (change**2 + own - variance)
        apart += other.probability * change[PEAK] ** 2
        others, share = others + other.probability * own[PEAK], share + other.probability
    log, variance = log + shift, variance + spread - shift**2  # mean and variance of the mixture
    if fits.others:
        own_errors = VariancePart("errors of the other lobes", "A", others)
        parts = (*scaled_parts(parts, 1 - share), own_errors, VariancePart(OTHER_LOBES, "B", apart - shift[PEAK] ** 2))
    pixels = grid_of(rig)
    if pixels is not None:
        lattices = Lattices(fine, coarse, fitted)
        moved, by_phase = pixel_log_ratio(lattices, at, pixels, sample_view(rig).radius, phase_std)
        log, variance = log + moved, variance + by_phase
        parts = (*parts, VariancePart("phase of the pixels", "B", np.broadcast_to(by_phase, log.shape)[PEAK]))
    base = np.ones(log.shape)
    if fits.fit.base is not None:
        lobe = at._replace(kind=BASE, lobe=np.log([fits.fit.base.roughness]))
        base = np.exp(-on_table(_plain(plain, lobe, fitted), plain))
    mixing = np.clip(on_table(np.sqrt((columns[-KNOTS:] ** 2).sum(axis=0)), coarse), 0.0, 1.0)
    return LobeRatio(log, np.sqrt(variance), seen_cells(fine), recorded, base, mixing, parts)


def _plain(where: ResponseLattice, at: FitCoordinates, shifts: np.ndarray) -> np.ndarray:
    """Compute a damped ln(true / recorded), (slices, cells).

    Callers use only differences between two results. The result tends to 0 for records below the accuracy of the
    operator. The dependence of a record on the lens is a polynomial, so a faint record may become negative, and its
    logarithm would be arbitrary.

    shifts: coordinates along the axes of the lattice.
    """
    ndf, valid = at.kind.ndf(placed(at.lobe)), where.cells.valid
    true, recorded = (
        np.where(valid, np.maximum(operator.record(ndf, at.kind.masking, along), 0.0), 0.0)
        for operator, along in ((where.true, ()), (where.recorded, shifts))
    )
    least = np.maximum(OPERATOR_ACCURACY * recorded.max(axis=1, keepdims=True), VANISHED)
    return np.log(true + least) - np.log(recorded + least)


def _log_slopes(where: ResponseLattice, at: FitCoordinates, shifts: np.ndarray) -> np.ndarray:
    """Compute the derivatives of the log ratio with respect to lobe and rig, (coordinates, slices, cells)."""
    by_true, by_recorded = (
        _relative(where, *record_and_slopes(operator, at.kind, np.concatenate([at.lobe, along])))
        for operator, along in ((where.true, np.zeros(0)), (where.recorded, shifts))
    )
    return np.pad(by_true, ((0, len(shifts)), (0, 0), (0, 0))) - by_recorded


def _at(where: ResponseLattice, at: FitCoordinates, axes: tuple[Axis, ...]) -> np.ndarray:
    return _plain(where, at, at.rig @ axis_selection(at.axes, axes))


def _log_ratio_and_record(where: ResponseLattice, at: FitCoordinates) -> tuple[np.ndarray, np.ndarray]:
    """Compute ln(true / recorded) and ln(recorded) for the specified rig, (slices, cells) each."""
    ndf, valid = at.kind.ndf(placed(at.lobe)), where.cells.valid
    recorded, true = (
        np.log(np.maximum(operator.record(ndf, at.kind.masking, np.zeros(axes)), VANISHED))
        for operator, axes in ((where.recorded, len(where.recorded.axes)), (where.true, 0))
    )
    return np.where(valid, true - recorded, 0.0), np.where(valid, recorded, np.log(VANISHED))


def _columns(where: ResponseLattice, at: FitCoordinates, axes: tuple[Axis, ...], shifts: np.ndarray) -> np.ndarray:
    """Compute the derivatives of the log ratio with respect to lobe, rig and shape, (coordinates, slices, cells).

    The coordinates of the shape are the coefficients b_k of a factor 1 + sum_k b_k B_k of D (`lobe_shape.py`). `shifts` are
    coordinates along the axes `axes` of the lattice.
    """
    ndf = at.kind.ndf(placed(at.lobe))
    by_true, by_recorded = (
        _relative(where, *operator.by_shape(ndf, at.kind.masking, along))
        for operator, along in ((where.true, ()), (where.recorded, shifts))
    )
    slopes = _log_slopes(where, at, shifts)
    own = len(at.lobe)
    by_rig = np.tensordot(axis_selection(at.axes, axes), slopes[own:], 1)
    return np.concatenate([slopes[:own], by_rig, by_true - by_recorded])


def _relative(where: ResponseLattice, record: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Divide the derivatives of a record by the record. The result is 0 for invalid cells and vanished records."""
    known = where.cells.valid & (record > VANISHED)
    return np.where(known, slopes / np.where(known, record, 1.0), 0.0)


def _variance(columns: np.ndarray, shape: ShapeUncertainty) -> np.ndarray:
    return np.einsum("psn,pq,qsn->sn", columns, shape.covariance, columns)


def _peak_parts(
    columns: np.ndarray, found: MaterialFit, shape: ShapeUncertainty, where: ResponseLattice, variance: np.ndarray
) -> tuple[VariancePart, ...]:
    """Split the variance of the ratio at the peak of each slice into its sources.

    The shares of the sources in the variance are computed on the lattice and interpolated linearly, so their sum is 1.

    `columns` is the result of `_columns`, and `variance` is the variance of the log ratio at the peak of each slice, (90,).
    """
    rings, slices, azimuths = where.spacing
    position = int(np.argmin(np.abs(np.array(rings)))) * len(azimuths) + int(np.argmin(np.abs(np.array(azimuths) - 90)))
    at_peaks = columns[:, :, position].T
    whole = np.einsum("sp,pq,sq->s", at_peaks, shape.covariance, at_peaks)
    readings = fit_readings_source(found.freedom, noise_given=found.noise_given)
    parts = statement_parts(shape.statements, at_peaks, shape.covariance, whole, readings)
    total = sum((part.variance for part in parts), np.zeros_like(whole))
    found_parts = []
    for index, part in enumerate(parts):
        share = np.where(total > 0, part.variance / np.where(total > 0, total, 1.0), float(index == 0))
        found_parts.append(part._replace(variance=variance * np.interp(np.arange(variance.size), slices, share)))
    return tuple(found_parts)
