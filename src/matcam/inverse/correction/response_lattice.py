"""Lattice of cells on which the ratio of true to recorded lobe is computed, and interpolation to a whole table.

The response, recorded over true, is computed on a lattice of cells and interpolated. Along phi_d a folded cell is even
about 0 and pi/2, and a cubic spline with zero end slopes interpolates it. If the azimuth of the lamp turns the pixels,
it has period pi instead, and the spline is periodic. Along theta_h and theta_d the logarithm of the response is
interpolated by monotone cubics. Cells in the last pixels of the sphere are not corrected.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.workspace import Workspace
from matcam.inverse.operator.chosen_cells import ChosenCells, positions_in
from matcam.inverse.operator.lobe_operator import LobeOperator, operator_in, point_operator, rig_key
from matcam.inverse.operator.rig_axes import Axis
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.rigs import Rig

_DENSE_RINGS = 20
"""Rings of theta_h about the highlight in which the lattices are dense."""
_DENSE_COSINE, _SPARSE_COSINE = 0.02, 0.12
"""Least cosine of light and view of an entry that is corrected, in the dense rings and beyond them. Down to it the interpolated
response agrees with a direct computation to 4 % (typically 0.1 %). The blurred highlight of a slice reaches to the limb: if its
peak were corrected and the light beside it were not, this light would count twice. The cells that a fit uses end earlier
(`FAR_COSINE`)."""
_LATTICE_COSINE = 0.005
"""Least cosine of light and view of a cell of a lattice; smaller than that of the entries, which lie between its cells."""
_LATTICES = 4
"""Lattices kept in memory, some ten MB each."""
VANISHED = 1e-40
"""Radiance of a lobe below which there is nothing to correct, 1/sr. Exponential tails fall below what any camera records."""


class Spacing(NamedTuple):
    """Positions of the cells of a lattice, denser towards both ends, where the axes of the foreshortened lobe lie.

    Attributes:
        rings: rows of theta_h.
        slices: rows of theta_d.
        azimuths: phi_d, degrees.
    """

    rings: tuple[int, ...]
    slices: tuple[int, ...]
    azimuths: tuple[int, ...]

    @property
    def mirrored(self) -> bool:
        """Check whether the plane of light and view is a plane of symmetry, so that a quarter of a turn suffices."""
        return self.azimuths[-1] == 90

    def all_round(self) -> Spacing:
        """Extend the azimuths to half a turn, for cells without symmetry."""
        return self._replace(azimuths=(*self.azimuths, *(180 - a for a in self.azimuths[-2:0:-1])))

    def of_line(self) -> Spacing:
        """Refine small theta_d for a cylinder, whose line of normals passes closer to the half vector there."""
        return self._replace(slices=tuple(sorted({*self.slices, *_SMALL_ANGLES})))


_SMALL_ANGLES = (*range(10), 12, 15)
FINE = Spacing(
    (*range(15), 16, 18, 20, 22, 24, 27, 30, 34, 38, 43, 48, 53, 58, 62, 66, 70, 75, 80, 89),
    (0, 10, 20, 30, 38, 46, 52, 57, 61, 65, 68, 70, *range(72, 90)),
    (0, 4, 8, 12, 17, 24, 33, 43, 53, 62, 69, 75, 80, 84, 87, 90),
)
"""Spacing for the response."""
COARSE = Spacing(
    (*range(14), 15, 17, 19, 22, 25, 28, 32, 36, 46, 58, 72, 89),
    (0, 20, 38, 52, 61, 68, 73, 77, 80, 82, 84, 86, 88, 89),
    (0, 8, 20, 36, 53, 69, 80, 90),
)
"""Spacing for the errors of the response and for small changes."""


class ResponseLattice(NamedTuple):
    """Cells of a lattice and their operators.

    Attributes:
        cells: cells of the lattice, (slices, rings * azimuths).
        recorded: operator of the rig.
        true: operator of a camera without blur.
        spacing: positions of the cells.
        sampling: sampling of the table.
    """

    cells: ChosenCells
    recorded: LobeOperator
    true: LobeOperator
    spacing: Spacing
    sampling: Sampling

    def of_fresnel(self, log_slope: Callable[[np.ndarray], np.ndarray]) -> ResponseLattice:
        """Apply an F that varies within a cell, as in a near rig. log_slope: slope of ln F at angles, 1/rad."""
        return self._replace(recorded=self.recorded.leaning(log_slope(self.cells.theta_d)))


def response_lattice(
    rig: Rig, sampling: Sampling, spacing: Spacing, axes: tuple[Axis, ...], workspace: Workspace
) -> ResponseLattice:
    """Build the lattice of a rig. workspace: keeps it for the next material of the rig."""
    view = sample_view(rig)
    if view.azimuth or not rig.camera.optics.isotropic:
        spacing = spacing.all_round()
    elif view.line:
        spacing = spacing.of_line()
    key = ("lattice", rig_key(rig), sampling, spacing, axes, _LATTICE_COSINE)

    def make() -> ResponseLattice:
        cells = _lattice_cells(view, sampling, spacing)
        recorded = operator_in(rig, cells, axes, repr(key), workspace)
        return ResponseLattice(cells, recorded, point_operator(cells), spacing, sampling)

    return workspace.remember("response lattice", key, make, most=_LATTICES)


def _lattice_cells(view: SampleView, sampling: Sampling, spacing: Spacing) -> ChosenCells:
    """Return the cells of a lattice."""
    grid = merl_grid(sampling)
    ring, azimuth = (a.ravel() for a in np.meshgrid(spacing.rings, np.radians(spacing.azimuths), indexing="ij"))
    slices = np.array(spacing.slices)
    shape = (slices.size, ring.size)
    theta_h, theta_d = np.broadcast_to(grid.theta_h[ring], shape), grid.theta_d[slices]
    phi_d = np.broadcast_to(azimuth, shape)
    x, y, cos_i, cos_o = positions_in(view, theta_h, theta_d[:, None], phi_d)
    valid = np.minimum(cos_i, cos_o).min(-1) > _LATTICE_COSINE
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
    return lowest > np.where(np.arange(GRID_SHAPE[0])[:, None, None] < _DENSE_RINGS, _DENSE_COSINE, _SPARSE_COSINE)


def on_table(values: np.ndarray, where: ResponseLattice) -> np.ndarray:
    """Interpolate a function known on the lattice, (slices, rings * azimuths), to every cell of a table: (90, 90, 180)."""
    rings, slices, azimuths = where.spacing
    lattice = np.where(where.cells.valid, values, np.nan).reshape(len(slices), len(rings), len(azimuths))
    # beyond the known cells, towards the limb along theta_d, the last known value is used
    for s in range(1, len(slices)):
        lattice[s] = np.where(np.isfinite(lattice[s]), lattice[s], lattice[s - 1])
    lattice = np.round(np.nan_to_num(lattice), 12)  # smaller slopes overflow in the harmonic means of the interpolator
    n_h, n_d, _ = GRID_SHAPE
    along = PchipInterpolator(slices, lattice, axis=0)(np.arange(n_d))
    along = PchipInterpolator(rings, along, axis=1)(np.arange(n_h))
    phi = merl_grid(where.sampling).phi_d
    if where.spacing.mirrored:
        across = CubicSpline(np.radians(azimuths), along, axis=2, bc_type="clamped")(np.minimum(phi, np.pi - phi))
    else:
        whole = np.concatenate([along, along[:, :, :1]], axis=2)
        across = CubicSpline(np.radians([*azimuths, 180]), whole, axis=2, bc_type="periodic")(phi)
    return np.ascontiguousarray(across.transpose(1, 0, 2))
