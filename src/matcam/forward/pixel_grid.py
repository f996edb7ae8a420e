"""Real pixels behind the cells of one image of a distant sphere (docs/model.md 3, *Cells on real pixels*).

The pixels of a measured table do not lie at the positions of its cells. The image has its own grid, and the value of a
cell is looked up in it: the pixel whose centre is nearest to the cell, the bilinear interpolation between four, or the
mean of the pixels that show directions of the cell. Near the peak many cells repeat one pixel. The value of a pixel is
its radiance over the cosine of the angle of incidence at its own centre, so repeated values agree to the last digit.

The phase of the grid specifies the positions of the pixels: their centres are whole numbers of px plus the phase from
the centre of the sphere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike
from scipy.sparse import csr_matrix

from matcam.core.grid import GRID_SHAPE, merl_grid
from matcam.rigs import ON_REAL_PIXELS, CellValue, PixelPhase, Rig

_SMALLEST = 1e-12
"""Weight below which an interpolation omits a pixel."""
_STRIDE = 1 << 16
"""Number of pixels per row in the number of a pixel. It exceeds the width of any image."""


class PixelGrid(NamedTuple):
    """Lookup of cells in a real grid of pixels.

    Attributes:
        rule: "nearest", "bilinear" or "mean".
        phase: phase of the grid, px; one for all images, or one for the image of each slice of theta_d. None: "mean" is
            averaged over all phases.
        azimuth: azimuth of the lamp relative to the rows of the grid, rad.
    """

    rule: CellValue
    phase: PixelPhase | None
    azimuth: float = 0.0

    def of_slices(self, slices: np.ndarray) -> np.ndarray:
        """Return the phase of the image of each slice, (slices, 2), px; 0 if it is unknown."""
        return phase_of_slices(self.phase or (0.0, 0.0))[slices]


def phase_of_slices(phase: PixelPhase) -> np.ndarray:
    """Return the phase of the image of every slice, (90, 2), px."""
    return np.broadcast_to(np.asarray(phase, dtype=float), (GRID_SHAPE[1], 2))


def grid_of(rig: Rig) -> PixelGrid | None:
    """Return the grid in which the cells of a rig are looked up; None if each cell has its own pixel, or if unknown."""
    if rig.cell_value == "mean" or (rig.cell_value in ON_REAL_PIXELS and rig.pixel_phase is not None):
        return PixelGrid(rig.cell_value, rig.pixel_phase, rig.lamp_azimuth or 0.0)
    return None


class PositionPixels(NamedTuple):
    """Pixels that are looked up for positions in an image; the last axis is over the pixels of one position.

    Attributes:
        x: centres to the right of the sphere's centre, px.
        y: centres upwards from the sphere's centre, px.
        weight: share of each pixel; the shares add up to 1.
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray


class SlicePixels(NamedTuple):
    """Pixels behind all cells of one theta_d slice.

    Attributes:
        x: (pixels,), centres in the plane of light and view, px from the sphere's centre, the lamp towards +x.
        y: (pixels,), centres across this plane, px.
        cos_i: (pixels,), cosine of the angle of incidence at each centre.
        share: (cells, pixels) matrix, cells over (theta_h, phi_d); rows add up to 1, or to 0 for invisible cells.
    """

    x: np.ndarray
    y: np.ndarray
    cos_i: np.ndarray
    share: csr_matrix


def looked_up(rule: CellValue, phase: ArrayLike, x: np.ndarray, y: np.ndarray) -> PositionPixels:
    """Find the pixels that a rule looks up for positions of an image.

    Args:
        rule: "nearest" or "bilinear".
        phase: phase of the pixel grid, px, (2,) or (..., 2), over the axes of the positions.
        x: positions, px from the centre of the sphere along the rows of the sensor.
        y: positions across the rows of the sensor, px.
    """
    shift = np.asarray(phase)
    a, b = shift[..., 0], shift[..., 1]
    u, v = np.broadcast_arrays(x - a, y - b)
    if rule == "nearest":
        return PositionPixels((np.rint(u) + a)[..., None], (np.rint(v) + b)[..., None], np.ones((*np.shape(u), 1)))
    left, low = np.floor(u), np.floor(v)
    right, up = u - left, v - low
    columns = np.stack([left, left + 1, left, left + 1], axis=-1) + a[..., None]
    rows = np.stack([low, low, low + 1, low + 1], axis=-1) + b[..., None]
    weight = np.stack([(1 - right) * (1 - up), right * (1 - up), (1 - right) * up, right * up], axis=-1)
    return PositionPixels(columns, rows, weight)


class PixelAngles(NamedTuple):
    """Angles at pixels of the image of a distant sphere; arrays of one shape.

    Attributes:
        theta_h: half angle, rad.
        psi: azimuth about the half vector from the lamp's side, rad.
        cos_i: cosine of the angle of incidence; -1 outside the sphere.
        cos_o: cosine of the viewing angle; -1 outside the sphere.
    """

    theta_h: np.ndarray
    psi: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray


def pixel_angles(radius: float, theta_d: np.ndarray | float, x: np.ndarray, y: np.ndarray) -> PixelAngles:
    """Compute the angles at the centres of pixels, in the plane of light and view."""
    n_x, n_y = x / radius, y / radius
    depth2 = 1 - n_x**2 - n_y**2
    n_z = np.sqrt(np.maximum(depth2, 0))
    sin, cos = np.sin(theta_d), np.cos(theta_d)
    along, up = n_x * cos - n_z * sin, n_x * sin + n_z * cos
    cos_i = n_x * np.sin(2 * theta_d) + n_z * np.cos(2 * theta_d)
    hit = depth2 > 0
    return PixelAngles(
        np.arctan2(np.hypot(along, n_y), up),
        np.arctan2(n_y, along),
        np.where(hit, cos_i, -1.0),
        np.where(hit, n_z, -1.0),
    )


def slice_pixels(
    rule: CellValue,
    phase: np.ndarray,
    radius: float,
    theta_d: float,
    crop: tuple[int, int] | None = None,
    azimuth: float = 0.0,
) -> SlicePixels:
    """Find the pixels behind all cells of a slice, both positions of a cell together.

    Args:
        rule: "nearest", "bilinear" or "mean".
        phase: phase of the pixel grid, px.
        radius: radius of the sphere, px.
        theta_d: theta_d of the slice, rad.
        crop: (height, width) of the sensor, px about the optical axis; None: unlimited.
        azimuth: azimuth of the lamp about the optical axis, rad.
    """
    n_h, _, n_p = GRID_SHAPE
    grid = merl_grid("centre")
    th, psi = grid.theta_h[:, None, None], np.pi - grid.phi_d[:, None] + np.array([0.0, np.pi])
    x = radius * (np.cos(th) * np.sin(theta_d) + np.sin(th) * np.cos(psi) * np.cos(theta_d))
    y = radius * np.sin(th) * np.sin(psi)
    above = np.cos(th) * np.cos(theta_d) > np.sin(th) * np.sin(theta_d) * np.abs(np.cos(psi))
    found = looked_up("bilinear" if rule == "bilinear" else "nearest", phase, *turned(x, y, azimuth))
    cell = np.broadcast_to(np.arange(n_h * n_p).reshape(n_h, n_p, 1, 1), found.x.shape)
    used = (found.weight > _SMALLEST) & above[..., None]
    cells, columns, rows, weight = (a[used] for a in (cell, found.x, found.y, found.weight))
    if rule == "mean":
        inside = _pixels_inside(phase, radius, theta_d, azimuth)
        empty = ~np.isin(cells, inside[0])
        cells, columns, rows, weight = (
            np.concatenate([a[empty], b])
            for a, b in zip((cells, columns, rows, weight), (*inside, np.ones(inside[0].size)), strict=True)
        )
    if crop is not None:
        shown = (np.abs(columns) <= crop[1] / 2) & (np.abs(rows) <= crop[0] / 2)
        cells, columns, rows, weight = (a[shown] for a in (cells, columns, rows, weight))
    number = np.rint(columns - phase[0]).astype(np.int64) * _STRIDE + np.rint(rows - phase[1]).astype(np.int64)
    _, first, index = np.unique(number, return_index=True, return_inverse=True)
    x, y = turned(columns[first], rows[first], -azimuth)
    at = pixel_angles(radius, theta_d, x, y)
    seen = (at.cos_i > 0) & (at.cos_o > 0)
    position = np.cumsum(seen) - 1
    there = seen[index]
    size = (n_h * n_p, int(seen.sum()))
    share = csr_matrix((weight[there], (cells[there], position[index[there]])), shape=size)
    total = np.asarray(share.sum(axis=1)).ravel()
    share.data /= np.repeat(total, np.diff(share.indptr))
    return SlicePixels(x[seen], y[seen], at.cos_i[seen], share)


def _pixels_inside(
    phase: np.ndarray, radius: float, theta_d: float, azimuth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find (cell, x, y) of every lit pixel, where the cell contains the directions at the centre of the pixel."""
    n_h, _, n_p = GRID_SHAPE
    size = int(np.ceil(radius)) + 1
    line = np.arange(-size, size + 1.0)
    columns, rows = (a.ravel() for a in np.meshgrid(line + phase[0], line + phase[1], indexing="ij"))
    at = pixel_angles(radius, theta_d, *turned(columns, rows, -azimuth))
    seen = (at.cos_i > 0) & (at.cos_o > 0)
    i = np.minimum((n_h * np.sqrt(at.theta_h[seen] / (np.pi / 2))).astype(int), n_h - 1)
    k = np.minimum((np.mod(np.pi - at.psi[seen], np.pi) / np.pi * n_p).astype(int), n_p - 1)
    return i * n_p + k, columns[seen], rows[seen]


def turned(x: np.ndarray, y: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotate positions of an image about the centre of the sphere by an angle, rad."""
    if angle == 0:
        return x, y
    return x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
