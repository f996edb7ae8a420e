"""Figure of a through-focus series: MTF50 over the focus position."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.figures.style import CYCLE, channel_colour, drawing

if TYPE_CHECKING:
    from matcam.calibration.readings.through_focus import BestFocus


FocusSeries = tuple[np.ndarray, np.ndarray, np.ndarray, "BestFocus | None"]
"""Focus positions of a series, MTF50 and its standard deviations, cycles/px, shape (n,) each, and the best focus. The best
focus is None if the series does not determine it.
"""


def through_focus_figure(series: Mapping[str, FocusSeries]) -> Figure:
    """Draw MTF50 over the focus position, with the fitted curves.

    Args:
        series: measured series (see `FocusSeries`) by label, such as region and channel.
    """
    with drawing(7.2, 4.6) as figure:
        axes = figure.subplots()
        draw_through_focus(axes, series)
        axes.set_title("Through-focus series", loc="left")
    return figure


def draw_through_focus(axes: Axes, series: Mapping[str, FocusSeries]) -> None:
    """Draw the values, the fitted curve and the best focus of each series.

    `series` is described in `through_focus_figure`.
    """
    channels = [label.rsplit(" ", 1)[-1] for label in series]
    by_channel = len(set(channels)) == len(channels)
    for n, (label, (position, mtf50, std, focus)) in enumerate(series.items()):
        colour = channel_colour(channels[n], n) if by_channel else CYCLE[n % len(CYCLE)]
        text = label
        if focus is not None:
            at = np.linspace(position.min(), position.max(), 200)
            curve = focus.mtf50_at(at)
            axes.plot(at[curve > focus.mtf50 / 2], curve[curve > focus.mtf50 / 2], color=colour)
            axes.axvline(focus.position, color=colour, lw=0.8, ls=":")
            text = f"{label}: best focus {focus.position:.4g} ± {focus.position_std:.2g}"
        axes.errorbar(position, mtf50, std, fmt="o", ms=4, color=colour, label=text)
    axes.set(xlabel="focus position (unit of the series)", ylabel="MTF50 [cycles/px]")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8.2)
