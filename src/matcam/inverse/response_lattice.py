"""The camera's response, recorded over true, in every cell of a table: computed on a lattice of cells, read off in between.

Across phi_d a folded cell is even about 0 and pi/2: a cubic spline, level at both ends, holds it. Along theta_h and theta_d
the logarithm of the response is interpolated by monotone cubics. Where the sphere's last pixels show a cell, nothing is
claimed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from matcam.angles import GRID_SHAPE, Sampling, merl_grid
from matcam.inverse.chosen_cells import FAR_COSINE, NEAR_COSINE, ChosenCells, places
from matcam.inverse.lobe_operator import Axis, LobeOperator, described, operator_of, point_operator
from matcam.rigs import Rig

_RINGS = np.array([*range(15), 16, 18, 20, 22, 24, 27, 30, 34, 38, 43, 48, 53, 58, 62, 66, 70, 75, 80, 89])
_PEAK_RINGS = 4
_SLICES = np.array([0, 10, 20, 30, 38, 46, 52, 57, 61, 65, 68, 70, *range(72, 90)])
_AZIMUTHS = np.radians([0, 4, 8, 12, 17, 24, 33, 43, 53, 62, 69, 75, 80, 84, 87, 90])
"""Crowded towards both ends, where the axes of the foreshortened lobe lie."""


class Lattice(NamedTuple):
    """Cells of the lattice, (slices, rings * azimuths), the rig's rule for them and that of a camera that sees points."""

    cells: ChosenCells
    recorded: LobeOperator
    true: LobeOperator
    sampling: Sampling


def lattice(rig: Rig, sampling: Sampling, axes: tuple[Axis, ...]) -> Lattice:
    """Of a rig; the work of a second or two for each camera value that the axes run through."""
    grid = merl_grid(sampling)
    ring, azimuth = (a.ravel() for a in np.meshgrid(_RINGS, _AZIMUTHS, indexing="ij"))
    shape = (_SLICES.size, ring.size)
    theta_h, theta_d = np.broadcast_to(grid.theta_h[ring], shape), grid.theta_d[_SLICES]
    phi_d = np.broadcast_to(azimuth, shape)
    radius = float(rig.sample.radius)  # type: ignore[attr-defined]
    x, y, cos_i, cos_o = places(radius, theta_h, theta_d[:, None], phi_d)
    kept = np.minimum(cos_i, cos_o).min(-1) > NEAR_COSINE
    safe = np.where(kept[..., None], cos_i, 1.0)
    cells = ChosenCells(
        _SLICES, theta_d, np.broadcast_to(ring, shape), np.zeros(shape, int), kept, x, y, safe, np.zeros(shape, bool)
    )
    description = repr(
        ("lattice", described(rig), sampling, axes, _RINGS.tolist(), _SLICES.tolist(), _AZIMUTHS.tolist())
    )
    return Lattice(
        cells, operator_of(rig, cells, axes, description), point_operator(cells, theta_h, phi_d, cos_i, cos_o), sampling
    )


def seen_cells(sampling: Sampling) -> np.ndarray:
    """Cells of a whole table, (90, 90, 180), whose response is known."""
    grid = merl_grid(sampling)
    th, td = grid.theta_h[:, None, None], grid.theta_d[:, None]
    lowest = np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(grid.phi_d))
    return lowest > np.where(np.arange(GRID_SHAPE[0])[:, None, None] < _PEAK_RINGS, 1.1 * NEAR_COSINE, FAR_COSINE)


def on_table(values: np.ndarray, where: Lattice) -> np.ndarray:
    """A function known on the lattice, (slices, rings * azimuths), in every cell of a table: (90, 90, 180)."""
    known = np.where(where.cells.kept, values, np.nan).reshape(_SLICES.size, _RINGS.size, _AZIMUTHS.size)
    # beyond where it is known it stays what it was there: towards the limb along theta_d
    for s in range(1, _SLICES.size):
        known[s] = np.where(np.isfinite(known[s]), known[s], known[s - 1])
    known = np.nan_to_num(known)
    n_h, n_d, _ = GRID_SHAPE
    along = PchipInterpolator(_SLICES, known, axis=0)(np.arange(n_d))
    along = PchipInterpolator(_RINGS, along, axis=1)(np.arange(n_h))
    phi = merl_grid(where.sampling).phi_d
    across = CubicSpline(_AZIMUTHS, along, axis=2, bc_type="clamped")(np.minimum(phi, np.pi - phi))
    return np.ascontiguousarray(across.transpose(1, 0, 2))
