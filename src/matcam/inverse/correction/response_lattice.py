"""Lattice of cells on which the ratio of true to recorded lobe is computed, and interpolation to a whole table.

The response (recorded / true lobe) is computed on a lattice of cells, and its logarithm is interpolated. Along phi_d the
response is even about 0 and pi/2, and a cubic spline with zero slopes at both ends interpolates it. If the lens or the azimuth
of the lamp breaks this symmetry, the response has the period pi instead, and the spline is periodic. Along theta_h and theta_d
monotone cubic polynomials are used. Cells within a few pixels of the limb are not corrected.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.workspace import Workspace
from matcam.forward.integral.blur import blur_of
from matcam.inverse.operator.chosen_cells import ChosenCells, positions_in
from matcam.inverse.operator.lobe_operator import LobeOperator, operator_in, point_operator, rig_key
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.inverse.rig.rig_axes import Axis
from matcam.rigs import Rig

_DENSE_RINGS = 20
"""Number of rings of theta_h about the highlight in which the lattices are dense."""
_DENSE_COSINE, _SPARSE_COSINE = 0.02, 0.12
"""Smallest cosine of the angles of light and view of an entry that is corrected, in the dense rings and beyond them. For larger
cosines the interpolated response agrees with a direct computation to 3 % (typically 0.1 %). The blurred highlight of a slice
extends to the limb. If its peak were corrected and the light beside the peak were not, this light would be counted twice.
The cells of a fit have larger cosines (`FAR_COSINE`).
"""
_CLEAR = 3.0
"""Smallest distance of the border of a pixel from the limb, in standard deviations of the lens, for an entry beyond the dense
rings. 0.1 % of a Gaussian lies farther away on one side. Closer entries are not corrected, because the lattice does not resolve
the effect of the limb there.
"""
_LATTICE_COSINE = 0.005
"""Smallest cosine of the angles of light and view of a valid cell of a lattice. It is smaller than the limit of the entries,
because entries lie between the cells of the lattice. In rings beyond `_LIMB_RINGS` the limit is that of the entries, because
the slices of the lattice are too far apart there for the effect of the limb.
"""
_LIMB_RINGS = _DENSE_RINGS + 4
"""Number of rings from which values in the dense rings are interpolated: up to two rings of the lattice beyond them."""
_LATTICES = 6
"""Number of lattices that are stored in memory, about 10 MB each: two for each of three colours."""
VANISHED = 1e-40
"""Smallest value of a lobe that is corrected, 1/sr. No camera records such small values, which exponential tails reach."""


class Spacing(NamedTuple):
    """Positions of the cells of a lattice.

    Rings are denser near the highlight, and slices at large theta_d. Azimuths are denser at 0 and 90 degrees, the directions of
    the axes of the foreshortened lobe.

    Attributes:
        rings: indices of theta_h in a table.
        slices: indices of theta_d in a table.
        azimuths: values of phi_d, degrees.
    """

    rings: tuple[int, ...]
    slices: tuple[int, ...]
    azimuths: tuple[int, ...]

    @property
    def mirrored(self) -> bool:
        """True if the azimuths cover only 90 degrees, because the plane of light and view is a plane of symmetry."""
        return self.azimuths[-1] == 90

    def all_round(self) -> Spacing:
        """Extend the azimuths to 180 degrees, for cells that are not symmetric about the plane of light and view."""
        return self._replace(azimuths=(*self.azimuths, *(180 - a for a in self.azimuths[-2:0:-1])))

    def of_line(self) -> Spacing:
        """Add slices at small theta_d, where the normals of a cylinder are closer to the half vector."""
        return self._replace(slices=tuple(sorted({*self.slices, *_SMALL_ANGLES})))


_SMALL_ANGLES = (*range(10), 12, 15)
FINE = Spacing(
    (*range(19), 20, 22, 24, 27, 30, 34, 38, 43, 48, 53, 58, 62, 66, 70, 75, 80, 89),
    (0, 10, 20, 30, 38, 46, 52, 57, 61, 65, 68, 70, *range(72, 90)),
    (0, 4, 8, 12, 17, 24, 33, 43, 53, 62, 69, 75, 80, 84, 87, 90),
)
"""Positions of the cells for the response of a specified rig."""
COARSE = Spacing(
    (*range(14), 15, 17, 19, 22, 25, 28, 32, 36, 46, 58, 72, 89),
    (0, 20, 38, 52, 61, 68, 73, 77, 80, 82, 84, 86, 88, 89),
    (0, 8, 20, 36, 53, 69, 80, 90),
)
"""Positions of the cells for the errors and the small changes of the response, which are smooth."""


class ResponseLattice(NamedTuple):
    """Cells of a lattice and their operators.

    Attributes:
        cells: cells of the lattice, (slices, rings * azimuths).
        recorded: operator from a lobe to its record by the rig.
        true: operator from a lobe to its record without blur.
        spacing: positions of the cells.
        sampling: sampling of the table.
        far_cosine: limit for entries beyond the dense rings. An entry is corrected if the cosines of the angles of light and
            view both exceed this limit.
    """

    cells: ChosenCells
    recorded: LobeOperator
    true: LobeOperator
    spacing: Spacing
    sampling: Sampling
    far_cosine: float

    def of_fresnel(self, log_slope: Callable[[np.ndarray], np.ndarray]) -> ResponseLattice:
        """Include the variation of the Fresnel term F within the cells of a near rig.

        log_slope: function that computes the derivative of ln F with respect to theta_d, 1/rad, at angles theta_d, rad.
        """
        return self._replace(recorded=self.recorded.leaning(log_slope(self.cells.theta_d)))


def response_lattice(
    rig: Rig, sampling: Sampling, spacing: Spacing, axes: tuple[Axis, ...], workspace: Workspace
) -> ResponseLattice:
    """Build the lattice of a rig.

    Args:
        rig: the rig.
        sampling: sampling of the table.
        spacing: positions of the cells for a symmetric rig with a sphere.
        axes: parameters of the rig that may change.
        workspace: store of the lattice for other materials.
    """
    view = sample_view(rig)
    if view.azimuth or not rig.camera.optics.isotropic:
        spacing = spacing.all_round()
    elif view.line:
        spacing = spacing.of_line()
    clear = float(rig.camera.pixel.half_width) + _CLEAR * blur_of(rig).std_of_half
    far_cosine = max(_SPARSE_COSINE, float(np.sqrt(min(2 * clear / view.radius, 1.0))))
    key = ("lattice", rig_key(rig), sampling, spacing, axes, _LATTICE_COSINE, _LIMB_RINGS, far_cosine)

    def make() -> ResponseLattice:
        cells = _lattice_cells(view, sampling, spacing, far_cosine)
        recorded = operator_in(rig, cells, axes, repr(key), workspace)
        return ResponseLattice(cells, recorded, point_operator(cells), spacing, sampling, far_cosine)

    return workspace.remember("response lattice", key, make, most=_LATTICES)


def _lattice_cells(view: SampleView, sampling: Sampling, spacing: Spacing, far_cosine: float) -> ChosenCells:
    grid = merl_grid(sampling)
    ring, azimuth = (a.ravel() for a in np.meshgrid(spacing.rings, np.radians(spacing.azimuths), indexing="ij"))
    slices = np.array(spacing.slices)
    shape = (slices.size, ring.size)
    theta_h, theta_d = np.broadcast_to(grid.theta_h[ring], shape), grid.theta_d[slices]
    phi_d = np.broadcast_to(azimuth, shape)
    x, y, cos_i, cos_o = positions_in(view, theta_h, theta_d[:, None], phi_d)
    valid = np.minimum(cos_i, cos_o).min(-1) > np.where(ring < _LIMB_RINGS, _LATTICE_COSINE, far_cosine)
    safe = np.where(valid[..., None], cos_i, 1.0)
    none = np.zeros(shape, int)  # cells of the lattice lie between those of a table
    return ChosenCells(
        slices, theta_d, np.broadcast_to(ring, shape), none, theta_h, phi_d, valid, x, y, safe, cos_o, none.astype(bool)
    )


def seen_cells(where: ResponseLattice) -> np.ndarray:
    """Select the entries of a table that are corrected, bool, (90, 90, 180)."""
    grid = merl_grid(where.sampling)
    th, td = grid.theta_h[:, None, None], grid.theta_d[:, None]
    lowest = np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(grid.phi_d))
    return lowest > np.where(np.arange(GRID_SHAPE[0])[:, None, None] < _DENSE_RINGS, _DENSE_COSINE, where.far_cosine)


def on_table(values: np.ndarray, where: ResponseLattice) -> np.ndarray:
    """Interpolate values on a lattice, (slices, rings * azimuths), to all cells of a table, (90, 90, 180)."""
    rings, slices, azimuths = where.spacing
    lattice = np.where(where.cells.valid, values, np.nan).reshape(len(slices), len(rings), len(azimuths))
    # invalid cells near the limb have the value of the nearest valid cell at smaller theta_d
    for s in range(1, len(slices)):
        lattice[s] = np.where(np.isfinite(lattice[s]), lattice[s], lattice[s - 1])
    lattice = np.round(np.nan_to_num(lattice), 12)  # smaller slopes overflow in the harmonic means of the interpolator
    n_h, n_d, _ = GRID_SHAPE
    along = PchipInterpolator(slices, lattice, axis=0)(np.arange(n_d))
    along = PchipInterpolator(rings, along, axis=1)(np.arange(n_h))
    return np.ascontiguousarray(along.transpose(1, 0, 2)) @ _across(where.spacing, where.sampling)


@cache
def _across(spacing: Spacing, sampling: Sampling) -> np.ndarray:
    """Compute the weights of the azimuths of a lattice at phi_d of a table, (azimuths, 180)."""
    azimuths, phi = np.radians(spacing.azimuths), merl_grid(sampling).phi_d
    unit = np.eye(azimuths.size)
    if spacing.mirrored:
        return np.asarray(CubicSpline(azimuths, unit, axis=1, bc_type="clamped")(np.minimum(phi, np.pi - phi)))
    period = np.concatenate([unit, unit[:, :1]], axis=1)
    return np.asarray(CubicSpline([*azimuths, np.pi], period, axis=1, bc_type="periodic")(phi))
