"""Pixels of a real image that determine the values of the cells of a table (docs/model.md 3, *Cells on real pixels*).

In a measured image of a distant sphere, the centres of the pixels do not coincide with the positions of the cells. The
value of a cell is the value of the nearest pixel, an interpolation between four pixels, or the mean of all pixels with
directions inside the cell. Near the peak, many cells have the value of the same pixel. The value of a pixel is its
radiance divided by the cosine of the angle of incidence at its centre, so these cells have exactly equal values.

The phase of the grid specifies the positions of the pixels: relative to the centre of the sphere, the coordinates of
their centres are integers plus the phase, px.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from matcam.core.grid import GRID_SHAPE, merl_grid
from matcam.rigs import ON_REAL_PIXELS, CellValue, PixelPhase, Rig

if TYPE_CHECKING:
    from jax.typing import ArrayLike


class PixelGrid(NamedTuple):
    """Real pixel grid, and the rule for the values of cells on this grid.

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
        """Select the phase of the image of each slice, (slices, 2), px; 0 if the phase is unknown.

        slices: indices of the slices.
        """
        return phase_of_slices(self.phase or (0.0, 0.0))[slices]


def phase_of_slices(phase: PixelPhase) -> np.ndarray:
    """Broadcast a phase to the images of all slices, (90, 2), px."""
    return np.broadcast_to(np.asarray(phase, dtype=float), (GRID_SHAPE[1], 2))


def grid_of(rig: Rig) -> PixelGrid | None:
    """Build the real pixel grid of the cells of a rig.

    The result is None if each cell has a separate pixel, or if the phase is unknown and the rule is "nearest" or "bilinear".
    """
    if rig.cell_value == "mean" or (rig.cell_value in ON_REAL_PIXELS and rig.pixel_phase is not None):
        return PixelGrid(rig.cell_value, rig.pixel_phase, rig.lamp_azimuth or 0.0)
    return None


class PositionPixels(NamedTuple):
    """Pixels that determine the values at positions in an image; the last axis is over the pixels of one position.

    Attributes:
        x: positions of the centres to the right of the sphere's centre, px.
        y: positions of the centres above the sphere's centre, px.
        weight: share of each pixel in the value at its position; the shares add up to 1.
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray


class CellPositions(NamedTuple):
    """Two positions on a sphere that show a cell.

    The last axis is that of the two positions.

    Attributes:
        x: distance from the optical axis towards the lamp, px.
        y: distance from the optical axis, perpendicular to x, px.
        cos_i: cosine of the angle of incidence.
        cos_o: cosine of the viewing angle.
    """

    x: np.ndarray
    y: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray


class SlicePixels(NamedTuple):
    """Pixels that determine the values of all cells of one theta_d slice.

    Attributes:
        x: positions of the centres along the plane of lamp and camera, (pixels,), px from the sphere's centre, positive
            towards the lamp.
        y: positions of the centres perpendicular to this plane, (pixels,), px.
        cos_i: cosine of the angle of incidence at each centre, (pixels,).
        share: share of each pixel in the value of each cell, a matrix (cells, pixels), cells over (theta_h, phi_d). Each row
            adds up to 1, or to 0 for an invisible cell.
    """

    x: np.ndarray
    y: np.ndarray
    cos_i: np.ndarray
    share: csr_matrix


def cell_positions(radius: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> CellPositions:
    """Compute the two image positions that show each cell.

    Camera and lamp are distant (docs/model.md 3).
    """
    psi = np.pi - phi_d[..., None] + np.array([0.0, np.pi])
    th, td = theta_h[..., None], theta_d[..., None]
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(psi)
    x = radius * (np.cos(th) * np.sin(td) + np.sin(th) * np.cos(psi) * np.cos(td))
    return CellPositions(x, radius * np.sin(th) * np.sin(psi), mean + half, mean - half)


def looked_up(rule: CellValue, phase: ArrayLike, x: np.ndarray, y: np.ndarray) -> PositionPixels:
    """Find the pixels, and their weights, from which the values at positions in an image are computed.

    Args:
        rule: "nearest" or "bilinear".
        phase: phase of the pixel grid, px: (2,) for one phase, or (..., 2) for one phase per position. The axes before
            the last one broadcast with `x` and `y`.
        x: positions along the rows of the sensor, px from the centre of the sphere.
        y: positions along the columns of the sensor, px from the centre of the sphere.
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
    """Angles at pixels of the image of a distant sphere. All arrays have the same shape.

    Attributes:
        theta_h: half angle, rad.
        psi: azimuth of the normal about the half vector, rad; 0 on the side of the lamp.
        cos_i: cosine of the angle of incidence; -1 outside the sphere.
        cos_o: cosine of the viewing angle; -1 outside the sphere.
    """

    theta_h: np.ndarray
    psi: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray


def pixel_angles(radius: float, theta_d: np.ndarray | float, x: np.ndarray, y: np.ndarray) -> PixelAngles:
    """Compute the angles at the centres of pixels.

    Args:
        radius: radius of the sphere, px.
        theta_d: difference angle, rad.
        x: positions along the plane of lamp and camera, px from the centre of the sphere, positive towards the lamp.
        y: positions perpendicular to this plane, px.
    """
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
    """Find the pixels that determine the values of all cells of a slice.

    A cell has pixels at both of its positions.

    Args:
        rule: "nearest", "bilinear" or "mean".
        phase: phase of the pixel grid, (2,), px.
        radius: radius of the sphere, px.
        theta_d: difference angle of the slice, rad.
        crop: (height, width) of the sensor, px about the optical axis; None: unlimited.
        azimuth: azimuth of the lamp about the optical axis, rad.
    """
    n_h, _, n_p = GRID_SHAPE
    grid = merl_grid("centre")
    own = cell_positions(radius, grid.theta_h[:, None], np.array(theta_d), grid.phi_d)
    above = (own.cos_i > 0) & (own.cos_o > 0)
    found = looked_up("bilinear" if rule == "bilinear" else "nearest", phase, *turned(own.x, own.y, azimuth))
    cell = np.broadcast_to(np.arange(n_h * n_p).reshape(n_h, n_p, 1, 1), found.x.shape)
    used = (found.weight > 1e-12) & above[..., None]  # smaller weights are rounding errors
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
    number = pixel_numbers(columns, rows, phase)
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
    """Find the cell that contains the directions at the centre of each visible and lit pixel.

    Returns:
        Index of the cell, and x and y of the centre, px, (pixels,) each.
    """
    n_h, _, n_p = GRID_SHAPE
    size = int(np.ceil(radius)) + 1
    line = np.arange(-size, size + 1.0)
    columns, rows = (a.ravel() for a in np.meshgrid(line + phase[0], line + phase[1], indexing="ij"))
    at = pixel_angles(radius, theta_d, *turned(columns, rows, -azimuth))
    seen = (at.cos_i > 0) & (at.cos_o > 0)
    i = np.minimum((n_h * np.sqrt(at.theta_h[seen] / (np.pi / 2))).astype(int), n_h - 1)
    k = np.minimum((np.mod(np.pi - at.psi[seen], np.pi) / np.pi * n_p).astype(int), n_p - 1)
    return i * n_p + k, columns[seen], rows[seen]


def pixel_numbers(x: np.ndarray, y: np.ndarray, phase: npt.ArrayLike = (0.0, 0.0), azimuth: float = 0.0) -> np.ndarray:
    """Number the pixels that contain the given positions, px. Each pixel of an image has a unique number.

    phase: phase of the pixel grid, px, (..., 2). Default: a pixel is centred on the axis. azimuth: azimuth of the lamp
        relative to the rows of pixels, rad.
    """
    (x, y), phase = turned(x, y, azimuth), np.asarray(phase)
    # the factor of the column exceeds the height of any image, px
    return np.rint(x - phase[..., 0]) * 65536 + np.rint(y - phase[..., 1])


def turned(x: np.ndarray, y: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotate positions in an image about the centre of the sphere by an angle, rad."""
    if angle == 0:
        return x, y
    return x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
