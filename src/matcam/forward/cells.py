"""Which pixels stand behind the cells of a table (MODEL 3, 8).

A picture of a sphere with lamp and camera 2 theta_d apart is one theta_d slice of the table, and holds each cell twice:
at azimuth psi = pi - phi_d about the half vector, and opposite. The recorded value is the mean of the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.angles import Sampling, merl_grid, theta_h_edges
from matcam.sample.shape import Place
from matcam.sample.sphere import Sphere

PICTURE_STRIDE = 1 << 13
"""Pixels per picture row in a pixel's number; a picture is never that wide."""


class CellSet(NamedTuple):
    """Some (theta_h, phi_d) cells, the same in every theta_d slice. Indices have shape (cells,)."""

    i_theta_h: np.ndarray
    i_phi_d: np.ndarray
    share: np.ndarray
    """How many cells of the table each one stands for."""


class CellPixels(NamedTuple):
    """Where a `CellSet` lies in the pictures; arrays of shape (slices, cells)."""

    content: np.ndarray
    """Pixels that the cells stand for, both ways counted: 2 r^2 cos(theta_o) sin(theta_h) dtheta_h dphi_d."""
    first: np.ndarray
    """Number of the pixel that holds the cell one way, unique within its slice (sphere's axis on a pixel centre)."""
    second: np.ndarray
    """The same the other way."""


def cell_pixels(sphere: Sphere, sampling: Sampling, cells: CellSet) -> CellPixels:
    """Pixels behind `cells` in every theta_d slice of a table that the picture of `sphere` fills."""
    grid = merl_grid(sampling)
    radius = float(sphere.radius)
    theta_h = grid.theta_h[cells.i_theta_h]
    phi_d = grid.phi_d[cells.i_phi_d]
    theta_d = grid.theta_d[:, None]
    height = np.diff(theta_h_edges())[cells.i_theta_h]
    # the cell's own size, not sin(theta_h) at its sampling point, which is 0 at the edge of the first
    middle = (theta_h_edges()[:-1] + np.diff(theta_h_edges()) / 2)[cells.i_theta_h]
    solid_angle = np.sin(middle) * height * np.pi / grid.phi_d.size * cells.share
    first, second = (_pixel_number(sphere.place(theta_h, theta_d, phi_d + turn)) for turn in (0, np.pi))
    return CellPixels(
        content=2 * radius**2 * np.cos(theta_d) * solid_angle,
        first=first,
        second=second,
    )


def _pixel_number(place: Place) -> np.ndarray:
    x, y = (np.rint(np.asarray(a)).astype(np.int64) for a in (place.x, place.y))
    return x * PICTURE_STRIDE + y
