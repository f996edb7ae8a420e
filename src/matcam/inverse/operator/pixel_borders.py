"""Borders between values of neighbouring cells near the highlight, in a table and from a grid of pixels.

Cells near the highlight lie a twentieth of a pixel apart. Cells that were read from one pixel have one value, to the
last digit, so borders between values are borders of pixels (`pixel_phase`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.forward.pixel_grid import pixel_angles, turned
from matcam.inverse.operator.pixels_behind import cell_positions

RINGS = 16
"""Rings about the highlight whose cells are compared: up to 1.1 degrees, 5 px on the MERL rig's sphere."""
SLICES = np.arange(3, 84, 6)
UNKNOWN_STD = 0.3
"""Standard deviation of an unknown phase, px: it may lie anywhere in a pixel."""
_LEAST_OUTWARDS = 0.1
_EQUAL = 1e-9
_SIGNATURES = np.random.default_rng(0).random((64, 64))
"""Random values that distinguish neighbouring pixels, and means of them."""


class Repeats(NamedTuple):
    """Pairs of neighbouring cells near the highlight with equal values. Shapes: s slices, r rings, k azimuths.

    Attributes:
        outwards: (s, r - 1, k), 1 where a cell repeats the value of its outer neighbour, 0 where not, -1 where a value
            is missing.
        around: (s, r, k - 1), the same along phi_d.
    """

    outwards: np.ndarray
    around: np.ndarray

    @property
    def share(self) -> float:
        """Return the share of neighbours with equal values; 0 if only rings repeat, as for smooth lobes."""
        known = np.concatenate([self.outwards.ravel(), self.around.ravel()])
        outwards = self.outwards[self.outwards >= 0]
        if not outwards.size or outwards.mean() < _LEAST_OUTWARDS:
            return 0.0
        return float(known[known >= 0].mean())


def repeats(table: xr.DataArray, slices: np.ndarray = SLICES) -> Repeats:
    """Find the neighbouring cells near the highlight of a table with equal values."""
    values = table.values[:RINGS][:, slices].transpose(1, 0, 2, 3)

    def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            there = (np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)).any(axis=-1)
            different = (np.abs(a - b) > _EQUAL * np.abs(a)).any(axis=-1)
        return np.where(there, np.where(different, 0, 1), -1)

    return Repeats(same(values[:, :-1], values[:, 1:]), same(values[:, :, :-1], values[:, :, 1:]))


class Borders:
    """Borders between values of some slices that the borders of a grid of pixels do not explain.

    azimuth: azimuth of the lamp relative to the rows of the grid, rad.
    """

    def __init__(self, radius: float, sampling: Sampling, slices: np.ndarray, shown: Repeats, azimuth: float = 0.0):
        self.positions = shown_positions(radius, sampling, slices, np.arange(RINGS), 1, azimuth)
        self.shown = shown
        self.count = int((shown.outwards == 0).sum() + (shown.around == 0).sum())

    def wrong(self, x: float, y: float) -> int:
        """Count the unexplained borders for a grid of this phase, px."""
        values = self._values(x, y)
        total = 0
        for axis, one in ((1, self.shown.outwards), (2, self.shown.around)):
            total += int(((one >= 0) & (one != (np.abs(np.diff(values, axis=axis)) < _EQUAL))).sum())
        return total

    def _values(self, x: float, y: float) -> np.ndarray:
        """Read cells from pixels of random values, (slices, rings, azimuths)."""
        column, row = (np.rint(a - b).astype(int) for a, b in zip(self.positions, (x, y), strict=True))
        return _signature(column, row).mean(axis=-1)

    def width(self, best: tuple[float, float], fewest: int, step: float) -> float:
        """Return the change of the phase that misses clearly more borders."""
        limit = fewest + 3 + np.sqrt(fewest)
        for size in step * 2.0 ** np.arange(10):
            turns = [(size, 0.0), (-size, 0.0), (0.0, size), (0.0, -size)]
            if all(self.wrong(best[0] + u, best[1] + v) > limit for u, v in turns):
                return float(size)
        return UNKNOWN_STD


class MeanBorders(Borders):
    """The same for cells that are means of the pixels inside."""

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
    """Compute the positions of cells, (slices, rings, azimuths, 2), along the axes of the pixels.

    azimuth: azimuth of the lamp relative to the rows of pixels, rad.
    """
    grid = merl_grid(sampling)
    theta_h, phi_d = np.meshgrid(grid.theta_h[rings], grid.phi_d[::every], indexing="ij")
    found = cell_positions(radius, theta_h, grid.theta_d[slices][:, None, None], phi_d)
    x, y = np.broadcast_arrays(found.x, found.y)
    return turned(x, y, azimuth)
