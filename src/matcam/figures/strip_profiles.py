"""Recorded and fitted profiles of the strips of a cylinder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from matcam.core.arrays import evenly
from matcam.figures.style import CYCLE, drawing

if TYPE_CHECKING:
    from matcam.reconstruction.reconstruction import Reconstruction


def profile_figure(result: Reconstruction) -> Figure:
    """Draw the recorded and the fitted profiles about the highlight, and their residuals, in up to six images.

    Each strip has its own colour.
    """
    fit, solution = result.fit, result.fit.solution
    problem = solution.problem
    shown = evenly(len(fit.names), 6)
    channel = len(fit.channels) // 2
    with drawing(2.3 * len(shown) + 0.8, 5.2) as figure:
        grid = figure.subplots(2, len(shown), squeeze=False, height_ratios=(2, 1), sharex="col")
        for position, k in enumerate(shown):
            pixels = problem.pixels[k]
            columns = pixels.window.column
            model = problem.picture(solution.p, k, slopes=False).value
            std = np.hypot(pixels.std, solution.unexplained * np.abs(model))
            for s in range(len(columns)):
                first = (channel * len(columns) + s) * columns.shape[1]
                of = slice(first, first + columns.shape[1])
                used = pixels.used[of]
                at, colour = columns[s][used], CYCLE[s % len(CYCLE)]
                grid[0, position].plot(at, pixels.values[of][used], ".", color=colour, ms=4, label=f"strip {s + 1}")
                grid[0, position].plot(at, model[of][used], "-", color=colour, lw=0.9)
                left = np.where(pixels.clipped, np.nan, (pixels.values - model) / std)[of][used]
                grid[1, position].plot(at, left, ".", color=colour, ms=3)
            brightest = float(np.max(model[pixels.used], initial=0.0))
            grid[0, position].set_yscale("log")
            if brightest > 0:  # a narrow lobe decreases to values that no image shows
                grid[0, position].set_ylim(1e-5 * brightest, 2 * brightest)
            grid[0, position].set_title(
                f"{fit.names[k]}, {np.degrees(solution.theta_d[k]):.0f}°", loc="left", fontsize=8
            )
            grid[1, position].set_ylim(-5, 5)
            grid[1, position].set_xlabel("column [px]")
        grid[0, 0].set_ylabel("radiance [unit of the merged images]")
        grid[1, 0].set_ylabel("residual [std]")
        grid[0, 0].legend(loc="lower left", fontsize=7)
    return figure
