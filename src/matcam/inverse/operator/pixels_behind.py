"""Pixels from which the cells of one image of a distant sphere are read (docs/model.md 3, *Cells on real pixels*).

A fit models a cell as a weighted mean over at most eight positions in the image, four on either side of the plane of
camera and lamp. Cells that are read from the nearest pixel, or interpolated between four pixels, are such means. A cell
that is the mean of the pixels inside may contain dozens of pixels. More than four pixels on one side are replaced by four
positions with the same mean and covariance. The mean of a quadratic function over the four positions is exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.grid import GRID_SHAPE, merl_grid, theta_h_edges
from matcam.forward.pixel_grid import (
    PixelGrid,
    cell_positions,
    looked_up,
    phase_of_slices,
    pixel_numbers,
    slice_pixels,
    turned,
)
from matcam.inverse.operator.sample_view import BOTH_DIRECTIONS

_POINTS = 4
"""Number of positions that represent the pixels of a cell on one side: two opposite pairs represent any covariance."""
_GAUSS = 0.5 + np.array([-1.0, 1.0]) / np.sqrt(12)
"""Two Gauss-Legendre points along a side of a cell, as shares of its length."""


class PixelsBehind(NamedTuple):
    """Pixels from which cells are read.

    The last axis is that of the pixels of a cell in both directions.

    Attributes:
        x: distance of the pixel centres from the centre of the sphere, towards the lamp, px.
        y: distance of the pixel centres from the centre of the sphere, perpendicular to x, px.
        weight: share of each pixel in the value of its cell; 0 for padding.
        noise_share: ratio of the variance of a cell to that of a pixel, without the last axis.
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    noise_share: np.ndarray


def pixel_counts(radius: float, theta_d: np.ndarray) -> np.ndarray:
    """Compute the mean number of pixels in each cell, in both directions together, (90, slices, 1).

    Args:
        radius: radius of the sphere, px.
        theta_d: difference angles of the slices, rad, (slices,).
    """
    edges = theta_h_edges()
    theta_h = (edges[1:] + edges[:-1]) / 2
    solid = np.sin(theta_h) * np.diff(edges) * np.pi / GRID_SHAPE[2]
    return radius**2 * (2 * solid * np.cos(theta_h))[:, None, None] * np.cos(theta_d)[:, None]


def pixels_behind(
    pixels: PixelGrid, radius: float, theta_d: float, j: int, i: np.ndarray, k: np.ndarray
) -> PixelsBehind:
    """Find the pixels from which cells of a slice are read.

    Args:
        pixels: grid of pixels from which the cells are read.
        radius: radius of the sphere, px.
        theta_d: theta_d of the slice, rad.
        j: index of the slice.
        i: indices of theta_h, (cells,).
        k: indices of phi_d, (cells,).
    """
    if pixels.phase is None:
        return _anywhere_in(radius, theta_d, i, k, pixels.azimuth)
    phase = phase_of_slices(pixels.phase)[j]
    if pixels.rule == "mean":
        return _inside(phase, radius, theta_d, i, k, pixels.azimuth)
    grid = merl_grid("centre")
    position = cell_positions(radius, grid.theta_h[i], np.full(i.size, theta_d), grid.phi_d[k])
    found = looked_up(pixels.rule, phase, *turned(position.x, position.y, pixels.azimuth))
    x, y, weight = (a.reshape(i.size, -1) for a in (found.x, found.y, found.weight / 2))
    numbers = pixel_numbers(x, y, phase)
    x, y = turned(x, y, -pixels.azimuth)
    same = numbers[:, :, None] == numbers[:, None, :]
    return PixelsBehind(x, y, weight, np.einsum("ca,cab,cb->c", weight, same, weight))


def _anywhere_in(radius: float, theta_d: float, i: np.ndarray, k: np.ndarray, azimuth: float) -> PixelsBehind:
    """Represent pixels of unknown phase inside cells by Gauss-Legendre points, weighted by area in the image."""
    n_h, _, n_p = GRID_SHAPE
    share = (i[:, None, None, None] + _GAUSS[:, None, None]) / n_h
    theta_h = share**2 * np.pi / 2
    phi_d = (k[:, None, None, None] + _GAUSS[:, None]) / n_p * np.pi + BOTH_DIRECTIONS
    theta_h, phi_d = np.broadcast_arrays(theta_h, phi_d)
    position = cell_positions(radius, theta_h, np.array(theta_d), phi_d)
    x, y = position.x[..., 0], position.y[..., 0]
    cos_i, cos_o = position.cos_i[..., 0], position.cos_o[..., 0]
    weight = np.where((cos_i > 0) & (cos_o > 0), cos_o * share * np.sin(theta_h), 0.0)
    count = pixel_counts(radius, np.array([theta_d]))[i, 0, 0]
    x, y, weight = (a.reshape(i.size, -1) for a in (x, y, weight))
    total = weight.sum(axis=1, keepdims=True)
    weight = weight / np.where(total > 0, total, 1.0)
    middle = pixel_numbers(x, y, np.zeros(2), azimuth)
    alone = (middle == middle[:, :1]).all(axis=1)
    return PixelsBehind(x, y, weight, np.minimum(np.where(alone, 1.0, 0.5), 1 / np.maximum(count, 1.0)))


def _inside(
    phase: np.ndarray, radius: float, theta_d: float, i: np.ndarray, k: np.ndarray, azimuth: float
) -> PixelsBehind:
    """Find the pixels of a grid inside each cell, or the nearest pixel if a cell contains none.

    More than four pixels on one side are replaced by the positions of `_same_moments`.
    """
    n_p = GRID_SHAPE[2]
    whole = slice_pixels("mean", phase, radius, theta_d, azimuth=azimuth)
    rows = whole.share[i * n_p + k]
    cell = np.repeat(np.arange(i.size), np.diff(rows.indptr))
    x, y, share = whole.x[rows.indices], whole.y[rows.indices], rows.data
    noise_share = np.bincount(cell, share**2, i.size)
    side = 2 * cell + (y < 0)
    order = np.argsort(side, kind="stable")
    side, x, y, share = (a[order] for a in (side, x, y, share))
    count = np.bincount(side, minlength=2 * i.size)
    rank = np.arange(side.size) - np.repeat(np.cumsum(count) - count, count)
    grid = merl_grid("centre")
    own = cell_positions(radius, grid.theta_h[i], np.full(i.size, theta_d), grid.phi_d[k])
    found = [np.repeat(a.reshape(-1, 1), _POINTS, axis=1) for a in (own.x, own.y, np.zeros((i.size, 2)))]
    few = count[side] <= _POINTS
    for target, values in zip(found, (x, y, share), strict=True):
        target[side[few], rank[few]] = values[few]
    many = np.flatnonzero(count > _POINTS)
    if many.size:
        for target, values in zip(found, _same_moments(side, x, y, share, count), strict=True):
            target[many] = values[many]
    x, y, weight = (a.reshape(i.size, -1) for a in found)
    return PixelsBehind(x, y, weight, np.where(noise_share > 0, noise_share, 1.0))


def _same_moments(
    side: np.ndarray, x: np.ndarray, y: np.ndarray, share: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute four positions with the same mean and covariance as the pixels of each side.

    The results are x, y and weight of the positions, (sides, 4) each.
    """
    sides = count.size
    total = np.bincount(side, share, sides)
    safe = np.where(total > 0, total, 1.0)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(side, share * values, sides) / safe

    middle = np.stack([mean(x), mean(y)], axis=-1)
    dx, dy = x - middle[side, 0], y - middle[side, 1]
    covariance = np.stack(
        [np.stack([mean(dx * dx), mean(dx * dy)], -1), np.stack([mean(dx * dy), mean(dy * dy)], -1)], -1
    )
    variances, axes = np.linalg.eigh(covariance)
    reach = axes * np.sqrt(2 * np.maximum(variances, 0))[:, None, :]
    positions = middle[:, :, None] + np.concatenate([reach, -reach], axis=-1)
    return positions[:, 0], positions[:, 1], np.repeat(total[:, None] / _POINTS, _POINTS, axis=1)
