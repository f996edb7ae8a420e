"""Plots that the views share.

Curves and images have units on every axis, and colours that colour-blind readers can distinguish.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    HoverTool,
    LinearColorMapper,
    LogColorMapper,
    LogTicker,
    PrintfTickFormatter,
)
from bokeh.palettes import RdBu11, cividis
from bokeh.plotting import figure
from bokeh.themes import Theme

from matcam.figures.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
WIDTH = 300
"""Width of a column of controls, px of the screen."""
_CONTROL = {"margin": (2, 8, 2, 8), "width": WIDTH - 16}
THEME = Theme(
    json={
        "attrs": {
            "Axis": {
                "axis_label_text_font_style": "normal",
                "axis_label_text_font_size": "11px",
                "major_label_text_font_size": "10px",
            },
            "Button": {**_CONTROL, "height": 30},
            "FileInput": _CONTROL,
            "Grid": {"grid_line_color": "#DDDDDD"},
            "Legend": {"background_fill_alpha": 0.7, "label_text_font_size": "10px", "padding": 5, "spacing": 2},
            "Select": _CONTROL,
            "Title": {"text_font_size": "12px"},
            "Toolbar": {"logo": None},
        }
    }
)
"""Style of all plots and controls."""


def empty_source(name: str, *columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns}, name=name)


def follow_data(plot: Any) -> None:
    """Hide the entries of a legend without finite data, now and after every change of the data.

    The browser draws no symbol for such an entry.
    """

    def update(attr: str, old: Any, new: Any) -> None:
        for item in plot.legend.items:
            item.visible = any(map(_has_data, item.renderers))

    for source in {one.data_source for item in plot.legend.items for one in item.renderers}:
        source.on_change("data", update)
    update("data", None, None)


def _has_data(drawn: Any) -> bool:
    values = drawn.data_source.data[getattr(drawn.glyph, "y1", None) or drawn.glyph.y]
    return bool(np.isfinite(np.asarray(values, dtype=float)).any())


def curve_figure(title: str, x: str, y: str, *, height: int, **more: Any) -> Any:
    """Create a plot for curves. The names of the axes must include units.

    `height` is the height of the plot, px of the screen.
    """
    return figure(
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


def picture_figure(title: str, size: int, x: str, y: str, **more: Any) -> Any:
    """Create a plot for images. The names of the axes must include units.

    `size` is the width and height of the plot, px of the screen. The background is light until `on_black` is called for
    an image.
    """
    plot = figure(title=title, frame_width=size, frame_height=size, x_axis_label=x, y_axis_label=y, **more)
    plot.grid.visible = False
    plot.background_fill_color = WAITING
    return plot


WAITING = "#F2F2F2"
"""Background colour of a plot without an image."""


def on_black(plot: Any, picture: Any, *, shown: bool = True) -> None:
    """Show an image on a black background, or hide the image and show a light background.

    Args:
        plot: plot from `picture_figure`.
        picture: glyph renderer of the image.
        shown: False to hide the image. Default: True.
    """
    picture.visible = shown
    plot.background_fill_color = "#000000" if shown else WAITING


def hover(plot: Any, renderers: list[Any], tips: list[tuple[str, str]]) -> None:
    plot.add_tools(HoverTool(renderers=renderers, tooltips=tips))


class PictureColours:
    """Common colour scale of images of radiance: logarithmic, or symmetric about 0 for a difference.

    Args:
        decades: number of decades of radiance that the colours span. Default: 4.
        difference: True for images of a difference, with a linear scale. Default: False.
    """

    def __init__(self, *, decades: int = 4, difference: bool = False):
        self._least = 10.0**-decades
        self._difference = difference
        self.mapper: Any
        if difference:
            self.mapper = LinearColorMapper(palette=RdBu11[::-1], low=-1, high=1, nan_color="#BBBBBB")
        else:
            self.mapper = LogColorMapper(
                palette=cividis(256), low=self._least, high=1, low_color="#000000", nan_color="#BBBBBB"
            )

    def scale(self, largest: float) -> None:
        """Set the largest radiance of the scale, rounded up to half a decade.

        The rounding keeps the scale constant during most moves of a slider. The browser then maps the pixels of an image
        once instead of three times.

        Args:
            largest: largest radiance of the images, 1/sr.
        """
        high = 10 ** (math.ceil(2 * math.log10(max(largest, 1e-300)) - 1e-9) / 2)
        self.mapper.update(low=-high if self._difference else high * self._least, high=high)

    def bar(self) -> ColorBar:
        return ColorBar(
            color_mapper=self.mapper,
            width=10,
            title="1/sr",
            ticker=BasicTicker(desired_num_ticks=5) if self._difference else LogTicker(desired_num_ticks=5),
            formatter=PrintfTickFormatter(format="%8.1e" if self._difference else "%.0e"),
            major_label_text_font="monospace",
            major_label_text_font_size="9px",
            title_text_font_size="10px",
        )


class PictureFigure:
    """Plot of an image of radiance.

    Several plots share one data source, so that one message to the browser changes all images. The labels of axes and
    colours have a constant width, because a change of the width would trigger a new layout. A layout is slower than drawing.

    Args:
        title: title of the plot.
        size: width and height of the image, px of the screen.
        source: data source, whose column `name` contains the image.
        name: name of the image.
        colours: colour scale.
        bar: True for a colour bar, which widens the plot. Default: False.
        beside: figure whose axes this figure shares. Default: None, the figure has axes of its own.
    """

    def __init__(
        self,
        title: str,
        size: int,
        source: ColumnDataSource,
        name: str,
        colours: PictureColours,
        *,
        bar: bool = False,
        beside: PictureFigure | None = None,
    ):
        self.plot: Any
        ranges = {} if beside is None else {"x_range": beside.plot.x_range, "y_range": beside.plot.y_range}
        self.plot = picture_figure(
            title, size, "x, towards the lamp [px]", "y [px]", match_aspect=True, tools="pan,wheel_zoom,reset",
            toolbar_location=None, **ranges,
        )  # fmt: skip
        self.plot.yaxis.visible = beside is None
        self.plot.axis.ticker = BasicTicker(desired_num_ticks=3)
        self.plot.yaxis.formatter = PrintfTickFormatter(format="%5.4g")
        self.plot.yaxis.major_label_text_font = "monospace"
        self.plot.yaxis.major_label_text_font_size = "9px"
        self.plot.x_range.range_padding = self.plot.y_range.range_padding = 0
        self._drawn = self.plot.image(
            name,
            x=f"{name} x",
            y=f"{name} y",
            dw=f"{name} dw",
            dh=f"{name} dh",
            color_mapper=colours.mapper,
            source=source,
        )
        self._drawn.visible = False  # the image appears after its data
        hover(self.plot, [self._drawn], [("x, y", "$x, $y px"), ("radiance", "@image 1/sr")])
        if bar:
            self.plot.add_layout(colours.bar(), "right")

    def arrived(self) -> None:
        if not self._drawn.visible:
            on_black(self.plot, self._drawn)


def picture_columns(name: str, values: np.ndarray, x: np.ndarray, y: np.ndarray) -> dict[str, list[Any]]:
    """Compute the columns of an image for a data source.

    `values` is the radiance, 1/sr, (y, x). `x` and `y` are the positions of the values, px. Each value is drawn as a square.
    """
    side = float(x[1] - x[0])
    return {
        name: [np.ascontiguousarray(values, dtype=np.float32)],
        f"{name} x": [float(x[0]) - side / 2],
        f"{name} y": [float(y[0]) - side / 2],
        f"{name} dw": [values.shape[1] * side],
        f"{name} dh": [values.shape[0] * side],
    }


def no_pictures(*names: str) -> dict[str, list[Any]]:
    nothing, at = np.zeros((2, 2), np.float32), np.array([-0.5, 0.5])
    return {key: value for name in names for key, value in picture_columns(name, nothing, at, at).items()}
