"""Effect of real pixels, from which cells are read, on the ratio of true to recorded lobe (docs/correct.md).

`lobe_ratio` computes the ratio for a pixel at the position of a cell. The recorded value of a cell is instead the record at the
centres of the pixels from which the cell was read. The record is smooth, because the camera has blurred it. It is computed for
both reciprocal configurations on the lattices of the ratio. Its logarithm is interpolated to the positions of the cells and to
the centres of the pixels. The same interpolant is used for both, so its error nearly cancels in the difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, RectBivariateSpline

from matcam.core.grid import GRID_SHAPE, merl_grid
from matcam.core.jax import placed
from matcam.forward.pixel_grid import PixelGrid, pixel_angles
from matcam.inverse.correction.corrected_table import OPERATOR_ACCURACY
from matcam.inverse.correction.response_lattice import VANISHED, ResponseLattice, Spacing, seen_cells
from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.operator.pixels_behind import PixelsBehind, pixels_behind

_CUBIC = 3
_OVERLAP = 4
"""Number of azimuths that are repeated at both ends of splines over a full circle, so that the splines are nearly periodic."""


class Lattices(NamedTuple):
    """Fine and coarse lattice of a ratio, and the fitted coordinates of the rig.

    Attributes:
        fine: lattice of the specified rig.
        coarse: lattice with axes for the parameters of the rig.
        fitted: coordinates along the axes of the coarse lattice, (axes,).
    """

    fine: ResponseLattice
    coarse: ResponseLattice
    fitted: np.ndarray


def pixel_log_ratio(
    lattices: Lattices, at: FitCoordinates, pixels: PixelGrid, radius: float, std: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute ln(record at the position of a cell / record of its pixels), and its variance, (90, 90, 180) each.

    The variance is due to the phase of the pixel grid.

    Args:
        lattices: lattices of the ratio.
        at: coordinates of the fit.
        pixels: pixel grid.
        radius: radius of the sphere, px.
        std: standard deviation of the phase of the pixel grid, px.
    """
    fine, coarse, fitted = lattices
    splines = [_splines(fine, np.log(np.maximum(_record(fine, at, np.zeros(0)), VANISHED)))]
    if fitted.any():
        records = (_record(coarse, at, shifts) for shifts in (np.zeros(fitted.size), fitted))
        splines.append(_splines(coarse, _log_change(*records)))
    mirrored = fine.spacing.mirrored
    grid = merl_grid(fine.sampling)
    seen = seen_cells(fine)
    log, variance = np.zeros(GRID_SHAPE), np.zeros(GRID_SHAPE)
    for j, theta_d in enumerate(grid.theta_d):
        i, k = np.nonzero(seen[:, j])
        if not i.size:
            continue
        theta_h = np.repeat(grid.theta_h[i][:, None], 2, axis=1)
        psi = np.pi - grid.phi_d[k][:, None] + np.array([0.0, np.pi])
        own = _SliceRecord([one[j] for one in splines], mirrored)
        behind = pixels_behind(pixels, radius, theta_d, j, i, k)
        recorded = _log_behind(own, radius, theta_d, behind)
        log[i, j, k] = np.nan_to_num(np.log(own.at(theta_h, psi).mean(axis=-1)) - recorded)
        if std:  # a cell remains assigned to the same pixel, whose centre moves
            for moved in (behind._replace(x=behind.x + std), behind._replace(y=behind.y + std)):
                variance[i, j, k] += np.nan_to_num(_log_behind(own, radius, theta_d, moved) - recorded) ** 2
    return log, variance


class _SliceRecord(NamedTuple):
    """Record of the pixels of a slice as a function of ring and azimuth.

    Attributes:
        splines: splines whose sum is the logarithm of the record, over (ring, azimuth in degrees).
        mirrored: True if the plane of camera and lamp is a plane of symmetry; the azimuths then end at 180 degrees.
    """

    splines: list[RectBivariateSpline]
    mirrored: bool

    def at(self, theta_h: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """Interpolate the record, 1/sr, (...).

        theta_h: angle between normal and half vector, rad, (...).
        psi: azimuth of the normal about the half vector, rad, (...).
        """
        ring = np.clip(GRID_SHAPE[0] * np.sqrt(theta_h / (np.pi / 2)) - 0.5, 0, GRID_SHAPE[0] - 1)
        if self.mirrored:
            around = np.degrees(np.abs(np.mod(psi + np.pi, 2 * np.pi) - np.pi))
        else:
            around = np.degrees(np.mod(psi, 2 * np.pi))
        return np.exp(sum(one.ev(ring, around) for one in self.splines))


def _log_behind(record: _SliceRecord, radius: float, theta_d: float, pixels: PixelsBehind) -> np.ndarray:
    """Compute the log record of cells from the record of their pixels; NaN if no pixel of a cell is lit."""
    angles = pixel_angles(radius, theta_d, pixels.x, pixels.y)
    weight = np.where((angles.cos_i > 0) & (angles.cos_o > 0), pixels.weight, 0.0)
    value = (weight * record.at(angles.theta_h, angles.psi)).sum(axis=-1)
    total = weight.sum(axis=-1)
    return np.log(np.where(total > 0, value / np.where(total > 0, total, 1.0), np.nan))


def _record(where: ResponseLattice, at: FitCoordinates, shifts: np.ndarray) -> np.ndarray:
    """Compute the record on a lattice, 1/sr, (slices, rings, azimuths of `_around`).

    Invalid cells of the first slice are NaN. Invalid cells of another slice have the value of the preceding slice.

    shifts: coordinates along the axes of the lattice.
    """
    rings, slices, azimuths = where.spacing
    both = where.recorded.directions(at.kind.ndf(placed(at.lobe)), at.kind.masking, shifts)
    both = np.where(where.cells.valid[..., None], both, np.nan).reshape(len(slices), len(rings), len(azimuths), 2)
    if where.spacing.mirrored:  # azimuths: 180 - phi_d in the first configuration, phi_d in the second
        whole = np.concatenate([both[..., 1], both[:, :, -2::-1, 0]], axis=-1)
    else:  # azimuths: 180 - phi_d in the first configuration, 360 - phi_d in the second
        turn = np.concatenate([both[:, :, ::-1, 0], both[:, :, ::-1, 1]], axis=-1)
        whole = np.concatenate([turn[..., -_OVERLAP:], turn, turn[..., :_OVERLAP]], axis=-1)
    for s in range(1, len(slices)):
        whole[s] = np.where(np.isfinite(whole[s]), whole[s], whole[s - 1])
    return whole


def _log_change(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Compute the change of the log record on a lattice.

    The change is 0 for records below the accuracy of the operator. The dependence of the record on the lens is approximated by
    a polynomial, so a faint record may become negative. The logarithm would then jump, and splines would spread the jump to
    brighter rings.
    """
    accuracy = OPERATOR_ACCURACY * np.nanmax(before, axis=(1, 2), keepdims=True)
    return np.log(np.maximum(after, 0) + accuracy) - np.log(np.maximum(before, 0) + accuracy)


def _splines(where: ResponseLattice, logs: np.ndarray) -> list[RectBivariateSpline]:
    """Build splines over (ring, azimuth in degrees) for every slice of a table.

    logs: logarithms on the lattice, (slices, rings, azimuths of `_around`); NaN is replaced by 0.
    """
    values = np.round(np.nan_to_num(logs), 12)  # smaller slopes overflow in the harmonic means of the interpolator
    along = PchipInterpolator(where.spacing.slices, values, axis=0)(np.arange(GRID_SHAPE[1]))
    around = _around(where.spacing)
    return [RectBivariateSpline(where.spacing.rings, around, one, kx=_CUBIC, ky=_CUBIC) for one in along]


def _around(spacing: Spacing) -> list[int]:
    """List the azimuths of normals on a lattice, degrees.

    They cover 180 degrees if the plane of camera and lamp is a plane of symmetry, otherwise 360 degrees and an overlap.
    """
    if spacing.mirrored:
        return [*spacing.azimuths, *(180 - a for a in spacing.azimuths[-2::-1])]
    turn = [180 * n - a for n in (1, 2) for a in spacing.azimuths[::-1]]
    return [*(a - 360 for a in turn[-_OVERLAP:]), *turn, *(a + 360 for a in turn[:_OVERLAP])]
