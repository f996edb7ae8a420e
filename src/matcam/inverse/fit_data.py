"""The values that a material is fitted to, and what makes a table unfit for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.errors import FitError
from matcam.inverse.chosen_cells import ChosenCells

_FEWEST = 0.2
"""Share of the chosen cells that must be there."""
_FEWEST_SLICES = 3


class FitData(NamedTuple):
    """Shapes: u units (a channel of a table), s slices, n cells."""

    values: np.ndarray
    """(u, s, n), 1/sr; 0 where unused."""
    used: np.ndarray
    """(u, s, n) bool."""
    share: np.ndarray
    """(s, n): variance of a cell over that of one of its pixels: half, unless both places are one pixel."""
    peak: np.ndarray
    """(u, s): brightest value of the picture, 1/sr; 1 where there is none."""
    labels: tuple[str, ...]
    """(u,): the channels' names."""


def fit_data(brdf: xr.DataArray, cells: ChosenCells) -> FitData:
    """Collect them from a checked table. FitError naming the channel that cannot be fitted, and why."""
    values = brdf.values[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d].transpose(2, 0, 1)
    pictures = brdf.values[:, cells.slices]
    peak = np.nanmax(np.where(np.isfinite(pictures), pictures, -np.inf), axis=(0, 2)).T
    used = np.isfinite(values) & cells.kept & (peak > 0)[..., None]
    used &= used.sum(-1, keepdims=True) >= 4
    labels = tuple(str(c) for c in (brdf["channel"].values if "channel" in brdf.coords else range(brdf.shape[3])))
    for label, one, there, bright in zip(labels, values, used, peak, strict=True):
        if not np.isfinite(one[cells.kept]).any():
            raise FitError(f"channel {label}: every value is missing")
        if not (bright > 0).any():
            raise FitError(f"channel {label}: no value is above 0: there is no highlight to fit")
        share, slices = there.sum() / cells.kept.sum(), int(there.any(-1).sum())
        if share < _FEWEST or slices < _FEWEST_SLICES:
            raise FitError(
                f"channel {label}: {share:.0%} of the values that a fit needs are there, in {slices} of {cells.slices.size} "
                f"slices of theta_d; at least {_FEWEST:.0%} in {_FEWEST_SLICES} slices are needed"
            )
    return FitData(
        np.where(used, values, 0.0),
        used,
        np.where(cells.one_pixel, 1.0, 0.5),
        np.where(peak > 0, peak, 1.0),
        labels,
    )


def joined(parts: list[FitData]) -> FitData:
    """The units of several tables of one rig, one after the other."""
    first = parts[0]
    values, used, peak = (np.concatenate(c) for c in zip(*((p.values, p.used, p.peak) for p in parts), strict=True))
    return FitData(values, used, first.share, peak, tuple(label for p in parts for label in p.labels))
