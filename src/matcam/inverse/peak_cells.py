"""The data around the highlight that a lobe is fitted to: a thinned set of cells, the same in every theta_d slice.

Near the peak about 75 cells of a MERL table were read from one pixel. Keeping all of them adds work, not knowledge:
cells are kept a few tenths of a pixel apart, and each carries the pixel content of those that it stands for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.angles import GRID_SHAPE, Sampling, cosines, merl_grid
from matcam.errors import FitError
from matcam.forward.cells import CellPixels, CellSet, cell_pixels
from matcam.sample.sphere import Sphere
from matcam.table import sampling_of

_SPACING = 0.4  # px between kept cells of one ring, for a lobe of pixel size
_REACH = 2.5  # px from the peak that a ring must cover, whatever the lobe, because the camera spreads it
_STEEPEST = np.radians(75)  # ... up to this theta_d, where the foreshortening stretches them by 1 / cos
_LOWEST = 0.01  # of the peak: where the data around it end
_MOST_RINGS = 24
_QUIET_SLICES = slice(6, 60, 3)  # theta_d degrees where lobes of real tables are whole


class PeakData(NamedTuple):
    """Values around the peak. Shapes: slices = theta_d of the grid, cells = kept (theta_h, phi_d)."""

    values: np.ndarray
    """(channels, slices, cells), 1/sr; 0 where missing."""
    content: np.ndarray
    """(channels, slices, cells): pixels behind each value, 0 where missing."""
    pixels: CellPixels
    theta_h: np.ndarray
    """(cells,) rad."""
    theta_d: np.ndarray
    """(slices,) rad."""
    phi_d: np.ndarray
    """(cells,) rad."""
    off_mirror: np.ndarray
    """(slices, cells): cos^2 theta_d / (cos_i cos_o), the cosines of F D G / (4 cos_i cos_o) against the peak's."""
    half_width: float
    """Apparent half width at half maximum of the lobe, theta_h in rad, blurred as it is."""

    def every(self, step: int) -> PeakData:
        """Only every `step`-th slice."""
        return self._replace(
            values=self.values[:, ::step],
            content=self.content[:, ::step],
            pixels=CellPixels(*(numbers[::step] for numbers in self.pixels)),
            theta_d=self.theta_d[::step],
            off_mirror=self.off_mirror[::step],
        )


def peak_data(brdf: xr.DataArray, sphere: Sphere) -> PeakData:
    """Collect the data around the peak of a table. FitError where no highlight can be seen."""
    sampling = sampling_of(brdf)
    grid = merl_grid(sampling)
    profile = _profile(brdf)
    half_width = _half_width(profile, grid.theta_h)
    cells = _choose_cells(profile, half_width, float(sphere.radius), sampling)
    pixels = cell_pixels(sphere, sampling, cells)
    values = brdf.values[cells.i_theta_h, :, cells.i_phi_d, :].transpose(2, 1, 0)  # channels, slices, cells
    present = np.isfinite(values)
    theta_h, phi_d = grid.theta_h[cells.i_theta_h], grid.phi_d[cells.i_phi_d]
    cos_i, cos_o = (np.asarray(a) for a in cosines(theta_h, grid.theta_d[:, None], phi_d))
    below = (cos_i <= 0) | (cos_o <= 0)
    present &= ~below
    return PeakData(
        values=np.where(present, values, 0.0),
        content=pixels.content * present,
        pixels=pixels,
        theta_h=theta_h,
        theta_d=grid.theta_d,
        phi_d=phi_d,
        off_mirror=np.cos(grid.theta_d[:, None]) ** 2 / np.where(below, 1.0, cos_i * cos_o),
        half_width=half_width,
    )


def _profile(brdf: xr.DataArray) -> np.ndarray:
    """Typical fall of the lobe with theta_h, (90,), 1 at the peak; NaN beyond what is there."""
    quiet = brdf.values[:, _QUIET_SLICES]
    count = np.maximum(np.isfinite(quiet).sum(axis=2), 1)
    rings = np.nansum(quiet, axis=2) / count  # theta_h, theta_d, channel
    rings = np.where(np.isfinite(quiet).any(axis=2), rings, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = rings / rings[0]
    valid = np.isfinite(relative[0]) & (rings[0] > 0)
    if valid.sum() < 5:
        raise FitError("no highlight: the table's peak (theta_h = 0) is missing or not positive at most theta_d")
    relative = relative[:, valid]
    seen = np.isfinite(relative).any(axis=1)
    return np.array([np.nanmedian(row) if ok else np.nan for row, ok in zip(relative, seen, strict=True)])


def _half_width(profile: np.ndarray, theta_h: np.ndarray) -> float:
    below = np.flatnonzero(profile < 0.5)
    if not below.size:
        raise FitError("no highlight: the table does not fall to half of its peak value anywhere")
    i = below[0]
    return float(np.interp(-0.5, -profile[i - 1 : i + 1], theta_h[i - 1 : i + 1]))


def _choose_cells(profile: np.ndarray, half_width: float, radius: float, sampling: Sampling) -> CellSet:
    theta_h = merl_grid(sampling).theta_h
    dark = np.flatnonzero(~(profile >= _LOWEST))
    lobe_end = theta_h[dark[0]] if dark.size else theta_h[-1]
    camera_end = _REACH / (radius * np.cos(_STEEPEST))
    rings = int(np.searchsorted(theta_h, max(lobe_end, camera_end)).clip(4, GRID_SHAPE[0] - 1))
    kept_rings = np.unique(np.rint(np.linspace(0, rings, min(rings + 1, _MOST_RINGS))).astype(int))
    rings_per_kept = np.gradient(kept_rings.astype(float)) if kept_rings.size > 1 else np.ones(1)
    spacing = max(_SPACING, 0.3 * half_width * radius)
    i_theta_h, i_phi_d, share = [], [], []
    n_phi = GRID_SHAPE[2]
    for ring, rings_each in zip(kept_rings, rings_per_kept, strict=True):
        count = int(np.clip(np.ceil(np.pi * radius * theta_h[ring] / spacing), 4, n_phi))
        places = ((np.arange(count) + 0.5) * n_phi / count).astype(int)
        i_theta_h += [ring] * count
        i_phi_d += places.tolist()
        share += [n_phi / count * rings_each] * count
    return CellSet(np.array(i_theta_h), np.array(i_phi_d), np.array(share))
