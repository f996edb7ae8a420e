"""Figure of a through-focus series: MTF50 over the focus position."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, styled

if TYPE_CHECKING:
    from matcam.calibration.readings.through_focus import BestFocus

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, BLACK, GREY)
_COLOUR_OF = {"R": VERMILION, "G": GREEN, "B": BLUE}


class FocusSeries(NamedTuple):
    """Measured series of one region and channel.

    Attributes:
        position: focus positions, (n,).
        mtf50: MTF50, (n,), cycles/px.
        std: standard deviations of `mtf50`, (n,), cycles/px.
        focus: best focus; None if the series does not show it.
    """

    position: np.ndarray
    mtf50: np.ndarray
    std: np.ndarray
    focus: BestFocus | None


def through_focus_figure(series: Mapping[str, FocusSeries], title: str = "") -> Figure:
    """Draw MTF50 over the focus position, with the fitted curves.

    Args:
        series: measured series by label, such as region and channel.
        title: title. Default: "Through-focus series".
    """
    with styled():
        figure = Figure(figsize=(7.2, 4.6), layout="constrained")
        axes = figure.subplots()
        draw_through_focus(axes, series)
        axes.set_title(title or "Through-focus series", loc="left")
    return figure


def draw_through_focus(axes: Axes, series: Mapping[str, FocusSeries]) -> None:
    """Draw the values, the fitted curve and the best focus of each series. series: see `through_focus_figure`."""
    channels = [label.rsplit(" ", 1)[-1] for label in series]
    by_channel = len(set(channels)) == len(channels)
    for n, (label, one) in enumerate(series.items()):
        colour = _COLOURS[n % len(_COLOURS)]
        if by_channel:
            colour = _COLOUR_OF.get(channels[n], colour)
        text = label
        if one.focus is not None:
            at = np.linspace(one.position.min(), one.position.max(), 200)
            curve = one.focus.mtf50_at(at)
            axes.plot(at[curve > one.focus.mtf50 / 2], curve[curve > one.focus.mtf50 / 2], color=colour)
            axes.axvline(one.focus.position, color=colour, lw=0.8, ls=":")
            text = f"{label}: best focus {one.focus.position:.4g} ± {one.focus.position_std:.2g}"
        axes.errorbar(one.position, one.mtf50, one.std, fmt="o", ms=4, color=colour, label=text)
    axes.set(xlabel="focus position (unit of the series)", ylabel="MTF50 [cycles/px]")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8.2)
