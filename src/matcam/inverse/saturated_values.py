"""Entries of a table whose pixels were saturated: they are at most lower bounds, and are treated as missing.

A saturated image has a flat top: many pixels have exactly the same, largest value. Pixels that are not saturated have the same
value only if they see the same radiance, as on both sides of a symmetric lobe without noise.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.core.grid import sampling_of
from matcam.core.remark import Remark
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import FAR_AWAY, sample_view
from matcam.rigs import Rig

_NEXT = 10
"""Number of values below the largest one that show how many pixels see the same radiance."""
_FLAT = 3
"""Smallest ratio of the number of pixels with the largest value to that of any of the `_NEXT` values below.

Without saturation it is at most 2: a pixel and its mirror image may have the largest value, while all values below differ.
"""
_DIFFERENT = 0.4
"""Smallest share of different values among the pixels below the largest values. It is 1/2 for a symmetric lobe without noise,
and small for values that were rounded to few digits, which may also have a flat top.
"""
_FLAT_BESIDE = 2
"""The same ratio for the other images of a channel in which one image is saturated: the others probably are, too, but narrow
highlights cover only two pixels.
"""
_BELOW = 0.9
"""Smallest value of a missing entry, divided by the saturation level. An entry is the mean of two directions. If only one of
them is saturated, the mean is below the level. The response of a sensor may also flatten just below its saturation.
"""


def without_saturated(table: xr.DataArray, rig: Rig | None) -> tuple[xr.DataArray, tuple[Remark, ...]]:
    """Replace saturated entries of a checked table by NaN.

    Args:
        table: recorded table, 1/sr.
        rig: rig that recorded the table; None: a distant camera and lamp.

    Returns:
        The table, and a remark if entries were replaced.
    """
    cells = chosen_cells(FAR_AWAY if rig is None else sample_view(rig), sampling_of(table))
    values = table.values[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d].transpose(2, 0, 1)
    values = np.where(cells.valid, values, np.nan)
    levels = np.array([_levels(channel) for channel in values])
    saturated = table.values >= _BELOW * levels.T[None, :, None]
    if not saturated.any():
        return table, ()
    slices = int(saturated.any((0, 2, 3)).sum())
    text = (
        f"many pixels have exactly the largest value, so the highlight was saturated in {slices} of {levels.shape[1]} slices; "
        f"{saturated.sum()} entries at or near this value are treated as missing: record the highlight with a shorter exposure"
    )
    return table.copy(data=np.where(saturated, np.nan, table.values)), (Remark("saturated", text),)


def _levels(values: np.ndarray) -> np.ndarray:
    """Find the saturation level of each slice of a channel, (slices,); infinite if its pixels are not saturated.

    values: values of the pixels, (slices, pixels); NaN if missing.
    """
    tops, flatness = np.array([_top(of_slice) for of_slice in values]).T
    below = values[values < tops[:, None]]
    if np.unique(below).size < _DIFFERENT * below.size:
        return np.full(tops.shape, np.inf)
    top, flat = _top(values)  # all images may have one level
    least = _FLAT if max(flat, flatness.max()) < _FLAT else _FLAT_BESIDE
    levels = np.where(flatness >= least, tops, np.inf)
    return np.minimum(levels, top if flat >= _FLAT else np.inf)


def _top(values: np.ndarray) -> tuple[float, float]:
    """Find the largest value, and how many times as many pixels have this value as any of the `_NEXT` values below."""
    distinct, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if distinct.size <= _NEXT:
        return np.inf, 0.0
    return float(distinct[-1]), float(counts[-1] / counts[-1 - _NEXT : -1].max())
