"""Plots that the views share: curves and pictures with units on every axis, in colours that colour-blind readers tell apart."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import BasicTicker, ColorBar, ColumnDataSource, HoverTool, LinearColorMapper, LogColorMapper
from bokeh.palettes import RdBu11, cividis
from bokeh.plotting import figure

from matcam.figures.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)


def curve_figure(title: str, x: str, y: str, *, height: int, **more: Any) -> Any:
    """Return a plot for curves whose axes have names with units."""
    plot = figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        height=height,
        sizing_mode="stretch_width",
        min_width=300,
        tools="pan,box_zoom,reset",
        toolbar_location="above",
        **more,
    )
    plain(plot)
    return plot


def plain(plot: Any) -> None:
    """Give a plot the style of all."""
    plot.toolbar.logo = None
    plot.title.text_font_size = "12px"
    plot.xaxis.axis_label_text_font_style = plot.yaxis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = "11px"
    plot.axis.major_label_text_font_size = "10px"
    plot.grid.grid_line_color = "#DDDDDD"
    plot.output_backend = "canvas"


def hover(plot: Any, renderers: list[Any], tips: list[tuple[str, str]], mode: str = "mouse") -> None:
    """Show values under the pointer."""
    plot.add_tools(HoverTool(renderers=renderers, tooltips=tips, mode=mode))


class PictureFigure:
    """A picture with its own colours: logarithmic radiance, or a difference about 0.

    Args:
        title: title.
        size: width of the picture on the screen, px.
        decades: of radiance that the colours span. Default: 4.
        bar: True for a colour bar, which widens the plot.
        difference: True for a difference.
        name: name of the data, for tests.
    """

    def __init__(
        self, title: str, size: int, *, decades: int = 4, bar: bool = False, difference: bool = False, name: str = ""
    ):
        self.source = ColumnDataSource(
            {"image": [np.zeros((2, 2), np.float32)], "x": [-1.0], "y": [-1.0], "dw": [2.0], "dh": [2.0]}, name=name
        )
        self.mapper: Any
        self._least = 10.0**-decades
        if difference:
            self.mapper = LinearColorMapper(palette=RdBu11[::-1], low=-1, high=1, nan_color="#BBBBBB")
        else:
            self.mapper = LogColorMapper(
                palette=cividis(256), low=self._least, high=1, low_color="#000000", nan_color="#BBBBBB"
            )
        self.plot = figure(
            title=title,
            x_axis_label="x, towards the lamp [px]",
            y_axis_label="y [px]",
            frame_width=size,
            frame_height=size,
            match_aspect=True,
            tools="pan,wheel_zoom,reset",
            toolbar_location=None,
        )
        plain(self.plot)
        self.plot.grid.visible = False
        self.plot.background_fill_color = "#000000"
        self.plot.axis.ticker = BasicTicker(desired_num_ticks=3)
        self.plot.x_range.range_padding = self.plot.y_range.range_padding = 0
        drawn = self.plot.image("image", x="x", y="y", dw="dw", dh="dh", color_mapper=self.mapper, source=self.source)
        hover(self.plot, [drawn], [("x, y", "$x, $y px"), ("radiance", "@image 1/sr")])
        if bar:
            self.plot.add_layout(
                ColorBar(
                    color_mapper=self.mapper,
                    width=10,
                    title="1/sr",
                    major_label_text_font_size="9px",
                    title_text_font_size="10px",
                ),
                "right",
            )

    def show(self, values: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        """Show values (y, x), each as a square about its place, px."""
        side = float(x[1] - x[0])
        wide, high = values.shape[1] * side, values.shape[0] * side
        self.source.data = {
            "image": [np.ascontiguousarray(values, dtype=np.float32)],
            "x": [float(x[0]) - side / 2],
            "y": [float(y[0]) - side / 2],
            "dw": [wide],
            "dh": [high],
        }

    def scale(self, largest: float) -> None:
        """Set the radiance that is brightest, 1/sr."""
        low = -largest if isinstance(self.mapper, LinearColorMapper) else largest * self._least
        self.mapper.update(low=low, high=largest)


__all__ = ["BLUE", "COLOURS", "GREY", "ORANGE", "VERMILION", "PictureFigure", "curve_figure", "hover", "plain"]
