"""The camera's response, recorded over true, in every cell of a table: computed on a lattice of cells, read off in between.

Across phi_d a folded cell is even about 0 and pi/2: a cubic spline, level at both ends, holds it. Along theta_h and theta_d
the logarithm of the response is interpolated by monotone cubics. Where the sphere's last pixels show a cell, nothing is
claimed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.angles import GRID_SHAPE, Sampling, merl_grid
from matcam.inverse.chosen_cells import FAR_COSINE, NEAR_COSINE, ChosenCells, places
from matcam.inverse.lobe_operator import LobeOperator, described, operator_of, point_operator, radius_of
from matcam.inverse.rig_axes import Axis
from matcam.keyed import Keyed
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
