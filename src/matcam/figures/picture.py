"""A picture for the eye: tone-mapped, with axes in pixels."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.figures.style import styled


def picture_figure(data: xr.DataArray, title: str) -> Figure:
    """The picture (row, column[, channel]) of `forward.image.picture` beside the profile through its axis.

    Left: display-encoded, the 99.5th percentile of what is lit as white; right: the row through the optical axis on a
    logarithmic scale, which shows what the eye does not.
    """
    values = np.nan_to_num(data.values)
    lit = values[values > 0]
    white = np.percentile(lit, 99.5) if lit.size else 1.0
    shown = np.clip(values / white, 0, 1) ** (1 / 2.2)
    x, y = data["x"].values, data["y"].values
    with styled():
        figure = Figure(figsize=(8.6, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        left.grid(False)
        edges = (x[0] - 0.5, x[-1] + 0.5, y[-1] - 0.5, y[0] + 0.5)
        grey = shown[..., 0] if shown.ndim == 3 and shown.shape[2] == 1 else shown
        left.imshow(grey, extent=edges, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        left.set_xlabel("x, towards the lamp [px]")
        left.set_ylabel("y [px]")
        row = values[len(y) // 2]
        row = row.mean(axis=-1) if row.ndim == 2 else row
        above = row > 0
        right.semilogy(x[above], row[above])
        right.set_xlabel("x [px]")
        what = data.attrs["quantity"].replace("digital", "raw value")
        right.set_ylabel(f"{what} in the row through the axis [{data.attrs['units']}]")
        figure.suptitle(title, x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    return figure
