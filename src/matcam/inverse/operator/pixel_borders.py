"""Borders between the values of neighbouring cells near the highlight: those of a table, and those of a grid of pixels.

Neighbouring cells near the highlight are a twentieth of a pixel apart. Cells that were read from one pixel have exactly the
same value, so borders between values are borders of pixels (`pixel_phase`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.forward.pixel_grid import cell_positions, pixel_angles, turned

RINGS = 16
"""Number of rings about the highlight whose cells are compared. They extend to 2.8 degrees, 13 px on the sphere of the MERL
rig.
"""
SLICES = np.arange(3, 84, 6)
UNKNOWN_STD = 0.3
"""Standard deviation of an unknown phase, px. It is that of a uniform distribution over a pixel, 1 / sqrt(12)."""
_EQUAL = 1e-9
_SIGNATURES = np.random.default_rng(0).random((64, 64))
"""Random values that distinguish neighbouring pixels, and means of them."""


class Repeats(NamedTuple):
    """Comparison of the values of neighbouring cells near the highlight.

    In the shapes, s is the number of slices, r of rings, and k of azimuths.

    Attributes:
        outwards: (s, r - 1, k), 1 where a cell and its outer neighbour have equal values, 0 where they differ, -1 where a
            value is missing.
        around: (s, r, k - 1), the same for neighbours along phi_d.
    """

    outwards: np.ndarray
    around: np.ndarray

    @property
    def share(self) -> float:
        """Share of neighbouring cells with equal values.

        It is 0 if values repeat along the rings only, as they do for smooth lobes.
        """
        known = np.concatenate([self.outwards.ravel(), self.around.ravel()])
        outwards = self.outwards[self.outwards >= 0]
        if not outwards.size or outwards.mean() < 0.1:
            return 0.0
        return float(known[known >= 0].mean())


def repeats(table: xr.DataArray, slices: np.ndarray = SLICES) -> Repeats:
    values = table.values[:RINGS][:, slices].transpose(1, 0, 2, 3)

    def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            there = (np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)).any(axis=-1)
            different = (np.abs(a - b) > _EQUAL * np.abs(a)).any(axis=-1)
        return np.where(there, np.where(different, 0, 1), -1)

    return Repeats(same(values[:, :-1], values[:, 1:]), same(values[:, :, :-1], values[:, :, 1:]))


class Borders:
    """Comparison of the borders between values of some slices with the borders of a grid of pixels.

    azimuth: azimuth of the lamp relative to the rows of the grid, rad.
    """

    def __init__(self, radius: float, sampling: Sampling, slices: np.ndarray, shown: Repeats, azimuth: float = 0.0):
        self.positions = shown_positions(radius, sampling, slices, np.arange(RINGS), 1, azimuth)
        self.shown = shown
        self.count = int((shown.outwards == 0).sum() + (shown.around == 0).sum())

    def wrong(self, x: float, y: float) -> int:
        """Count the pairs of cells for which a grid with phase (x, y), px, contradicts the table."""
        values = self._values(x, y)
        total = 0
        for axis, one in ((1, self.shown.outwards), (2, self.shown.around)):
            total += int(((one >= 0) & (one != (np.abs(np.diff(values, axis=axis)) < _EQUAL))).sum())
        return total

    def _values(self, x: float, y: float) -> np.ndarray:
        """Simulate cells that are read from pixels with random values, (slices, rings, azimuths)."""
        column, row = (np.rint(a - b).astype(int) for a, b in zip(self.positions, (x, y), strict=True))
        return _signature(column, row).mean(axis=-1)

    def width(self, best: tuple[float, float], fewest: int, step: float) -> float:
        """Estimate the standard deviation of the phase, px.

        It is the smallest tested change of the phase that results in clearly more contradictions, or `UNKNOWN_STD` if no tested
        change does.

        Args:
            best: phase with the fewest contradictions, px.
            fewest: number of contradictions for this phase.
            step: smallest tested change, px.
        """
        limit = fewest + 3 + np.sqrt(fewest)
        for size in step * 2.0 ** np.arange(10):
            turns = [(size, 0.0), (-size, 0.0), (0.0, size), (0.0, -size)]
            if all(self.wrong(best[0] + u, best[1] + v) > limit for u, v in turns):
                return float(size)
        return UNKNOWN_STD


class MeanBorders(Borders):
    """Comparison of borders, as in `Borders`, for cells that are means of the pixels inside them."""

    def __init__(self, radius: float, sampling: Sampling, slices: np.ndarray, shown: Repeats, azimuth: float = 0.0):
        super().__init__(radius, sampling, slices, shown, azimuth)
        self.radius, self.theta_d = radius, merl_grid(sampling).theta_d[slices][:, None, None]
        self.azimuth = azimuth
        peak = radius * np.sin(self.theta_d)
        middle = [np.rint(a).astype(int) for a in turned(peak, 0 * peak, azimuth)]
        side = (
            int(np.ceil(max(np.abs(p - m[..., None]).max() for p, m in zip(self.positions, middle, strict=True)))) + 1
        )
        line = np.arange(-side, side + 1)
        self.columns, self.rows = np.broadcast_arrays(middle[0] + line[:, None], middle[1] + line)

    def _values(self, x: float, y: float) -> np.ndarray:
        whole = super()._values(x, y)
        at = pixel_angles(self.radius, self.theta_d, *turned(self.columns + x, self.rows + y, -self.azimuth))
        n_h, _, n_p = GRID_SHAPE
        ring = (n_h * np.sqrt(at.theta_h / (np.pi / 2))).astype(int)
        around = np.minimum((np.mod(np.pi - at.psi, np.pi) / np.pi * n_p).astype(int), n_p - 1)
        inside = (ring < RINGS) & (at.cos_i > 0) & (at.cos_o > 0)
        picture = np.broadcast_to(np.arange(len(self.theta_d))[:, None, None], ring.shape)
        cell = np.ravel_multi_index((picture[inside], ring[inside], around[inside]), whole.shape)
        count = np.bincount(cell, minlength=whole.size)
        total = np.bincount(cell, _signature(self.columns, self.rows)[inside], whole.size)
        mean = total / np.maximum(count, 1)
        return np.where(count > 0, mean, whole.ravel()).reshape(whole.shape)


def _signature(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    return _SIGNATURES[np.mod(column, 64), np.mod(row, 64)]


def shown_positions(
    radius: float, sampling: Sampling, slices: np.ndarray, rings: np.ndarray, every: int, azimuth: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the image positions of cells along the pixel axes.

    x and y, px, have shape (slices, rings, azimuths, 2), with two positions of each cell.

    Args:
        radius: radius of the sphere, px.
        sampling: sampling of the table.
        slices: indices of theta_d.
        rings: indices of theta_h.
        every: step in azimuths.
        azimuth: azimuth of the lamp relative to the rows of pixels, rad. Default: 0.
    """
    grid = merl_grid(sampling)
    theta_h, phi_d = np.meshgrid(grid.theta_h[rings], grid.phi_d[::every], indexing="ij")
    found = cell_positions(radius, theta_h, grid.theta_d[slices][:, None, None], phi_d)
    x, y = np.broadcast_arrays(found.x, found.y)
    return turned(x, y, azimuth)
