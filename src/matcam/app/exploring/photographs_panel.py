"""Panel for the images of a reconstruction: photograph with fitted outline and highlight, and windows with residual."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import ColorBar, LinearColorMapper, LogColorMapper, Range1d
from bokeh.models.widgets import Select
from bokeh.palettes import Greys256, RdBu11

from matcam.app.controls import note, watch
from matcam.app.exploring.fitted_pictures import WINDOWS, FittedPicture, Shot, shots_of
from matcam.app.plots import empty_source, follow_data, hover, picture_figure
from matcam.app.worker import Newest
from matcam.core.errors import MatcamError
from matcam.figures.style import ORANGE, SKY, VERMILION
from matcam.files.capture import Capture

_DECADES = 1e-3  # smallest radiance that differs from black, as a share of the peak of a window: three decades
_RESIDUAL = 5.0  # limit of the colour scale of the residual, standard deviations


class PhotographsPanel:
    """Display of the images of a reconstruction, one at a time.

    Args:
        work: queue for slow jobs.
        complain: function that shows a message of one line.
    """

    def __init__(self, work: Newest, complain: Any):
        self._work, self._complain = work, complain
        self._captures: Sequence[Capture] = ()
        self._pictures: Sequence[FittedPicture] = ()
        self._shots: list[Shot] = []
        self._picture = Select(title="lamp position", value="", options=[], width=220, name="fitted-picture")
        self._shot = Select(title="photograph", value="", options=[], width=260, name="shot")
        watch(self._picture, self._choose)
        watch(self._shot, self._look)
        self._about = note("fitted-about")
        self.layout = column(
            row(self._picture, self._shot), self._about, row(self._photograph(), column(*self._windows())),
            sizing_mode="stretch_width", name="photographs", visible=False,
        )  # fmt: skip

    def open(self, captures: Sequence[Capture]) -> None:
        self._captures = captures

    def show(self, pictures: Sequence[FittedPicture]) -> None:
        if pictures is self._pictures:
            return
        self._pictures = pictures
        options = [(str(k), f"{one.name}, θ_d {np.degrees(one.theta_d):.1f}°") for k, one in enumerate(pictures)]
        self._picture.options = list(options)
        if pictures:
            self._picture.value = "0"
            self._choose()

    def _photograph(self) -> Any:
        self._image = empty_source("shot-image", "image", "x", "y", "dw", "dh")
        self._outline = empty_source("fitted-outline", "x", "y", "radius")
        self._highlight = empty_source("fitted-highlight", "x", "y")
        self._box = empty_source("fitted-window", "x", "y", "width", "height")
        self._plot = picture_figure(
            "photograph", 400, "column [px]", "row [px]", tools="pan,wheel_zoom,box_zoom,reset", active_scroll="wheel_zoom",
            toolbar_location="above", x_range=Range1d(0, 1), y_range=Range1d(1, 0),
        )  # fmt: skip
        self._plot.image(
            "image", x="x", y="y", dw="dw", dh="dh", source=self._image,
            color_mapper=LinearColorMapper(palette=Greys256, low=0, high=1),
        )  # fmt: skip
        self._plot.circle(
            "x", "y", radius="radius", source=self._outline, fill_alpha=0, line_color=SKY, line_width=1.5,
            legend_label="fitted outline",
        )  # fmt: skip
        cross = self._plot.scatter(
            "x", "y", source=self._highlight, marker="cross", size=14, line_color=VERMILION, line_width=2,
            legend_label="fitted highlight",
        )  # fmt: skip
        self._plot.rect(
            "x", "y", width="width", height="height", source=self._box, fill_alpha=0, line_color=ORANGE,
            line_dash="dashed", legend_label="window",
        )  # fmt: skip
        self._plot.legend.location = "bottom_left"
        follow_data(self._plot)
        hover(self._plot, [cross], [("highlight", "column @x, row @y px")])
        return self._plot

    def _windows(self) -> list[Any]:
        self._light = LogColorMapper(palette=Greys256, low=_DECADES, high=1, nan_color=SKY, low_color="#000000")
        left = LinearColorMapper(palette=RdBu11[::-1], low=-_RESIDUAL, high=_RESIDUAL, nan_color="#BBBBBB")
        self._values = empty_source("fitted-windows", *WINDOWS, "x", "y", "dw", "dh")
        plots: list[Any] = []
        self._ranges = {"x_range": Range1d(0, 1), "y_range": Range1d(1, 0)}
        for name, title in zip(WINDOWS, ("recorded", "fitted", "recorded - fitted [std]"), strict=True):
            mapper = left if name == WINDOWS[2] else self._light
            plot = picture_figure(
                title, 150, "column [px]", "row [px]", tools="", toolbar_location=None, **self._ranges
            )  # fmt: skip
            drawn = plot.image(name, x="x", y="y", dw="dw", dh="dh", source=self._values, color_mapper=mapper)
            unit = "standard deviations" if name == WINDOWS[2] else "in the unit of the merged images"
            hover(plot, [drawn], [("column, row", "$x{0}, $y{0} px"), ("value", f"@image {unit}")])
            if name != WINDOWS[0]:
                plot.add_layout(ColorBar(color_mapper=mapper, width=10, major_label_text_font_size="9px"), "right")
            plots.append(plot)
        return [row(*plots[:2]), plots[2]]

    @property
    def _current(self) -> FittedPicture | None:
        chosen = self._picture.value
        return self._pictures[int(chosen)] if chosen.isdigit() and int(chosen) < len(self._pictures) else None

    def _choose(self) -> None:
        one = self._current
        if one is None:
            return
        rows, columns = one.windows[WINDOWS[0]].shape
        left, top = one.corner
        position = {"x": [left - 0.5], "y": [top - 0.5], "dw": [columns], "dh": [rows]}
        self._values.data = {name: [np.ascontiguousarray(values)] for name, values in one.windows.items()} | position
        self._ranges["x_range"].update(start=left - 0.5, end=left - 0.5 + columns)
        self._ranges["y_range"].update(start=top - 0.5 + rows, end=top - 0.5)
        peak = float(np.nanmax([np.nanmax(one.windows[name], initial=0.0) for name in WINDOWS[:2]]))
        self._light.update(low=max(peak, 1e-30) * _DECADES, high=max(peak, 1e-30))
        column_, row_, radius = one.outline
        self._outline.data = {"x": [column_], "y": [row_], "radius": [radius]}
        self._highlight.data = {"x": [one.highlight[0]], "y": [one.highlight[1]]}
        middle = {"x": [left - 0.5 + columns / 2], "y": [top - 0.5 + rows / 2]}
        self._box.data = middle | {"width": [columns], "height": [rows]}
        reach = 1.12 * radius
        self._plot.x_range.update(start=column_ - reach, end=column_ + reach)
        self._plot.y_range.update(start=row_ + reach, end=row_ - reach)
        self._image.data = {name: [] for name in self._image.data}
        self._about.text = (
            f"outline: column {column_:.2f}, row {row_:.2f}, radius {radius:.2f} px; brightest fitted pixel: column "
            f"{one.highlight[0]:g}, row {one.highlight[1]:g}; window: logarithm of recorded and fitted light"
        )
        try:
            self._shots = shots_of(one, self._captures)
        except MatcamError as error:
            self._shots = []
            self._complain(str(error))
        else:
            self._complain("")
        self._shot.options = [(str(k), shot.label) for k, shot in enumerate(self._shots)]
        if self._shot.value == "0":
            self._look()
        elif self._shots:
            self._shot.value = "0"

    def _look(self) -> None:
        one, chosen = self._current, self._shot.value
        if one is None or not chosen.isdigit() or int(chosen) >= len(self._shots):
            return
        shot = self._shots[int(chosen)]

        def draw(read: tuple[np.ndarray, tuple[float, float, float, float]]) -> None:
            if self._current is one:
                values, (left, top, width, height) = read
                self._image.data = {"image": [values], "x": [left], "y": [top], "dw": [width], "dh": [height]}
                self._plot.title.text = f"{escape(shot.capture.folder.resolve().name)}: {shot.label}"

        self._work.ask(lambda: shot.about(one.outline), draw)
