"""View for the calibration of a camera: images with their edges, one selected region, MTF curves, and the profile to save."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import SelectionGeometry
from bokeh.layouts import column, row
from bokeh.models import BoxSelectTool, ColorBar, ColumnDataSource, LinearColorMapper, Range1d
from bokeh.models.widgets import Button, Div, NumericInput, Select
from bokeh.palettes import Viridis256

from matcam.app.calibrated import (
    OpenedPicture,
    calibrated,
    edges_in,
    is_chart,
    measured_edge,
    opened_or_why,
    profiles,
    target_columns,
    targets_in,
)
from matcam.app.controls import note, watch
from matcam.app.plots import WIDTH, curve_figure, empty_source, follow_data, hover, picture_figure
from matcam.app.transfers import Downloads, Upload, worded
from matcam.app.worker import Newest
from matcam.core.errors import MatcamError
from matcam.core.readers.names import is_file
from matcam.figures.style import BLUE, GREY, VERMILION
from matcam.files.photographs import PICTURES

_SIDE = 430  # width and height of the displayed image, px of the screen
_REGION = ("x", "y", "width", "height")
_TONES = {"auto": "auto: 8 bits are sRGB, others linear", "linear": "linear", "srgb": "sRGB"}


class CalibrateView:
    """View for the calibration of a camera from photographs of edges and charts.

    Args:
        document: the page's document.
        downloads: registry of files to save.
        complain: function that shows a message of one line.
        files: files that the user opened on the command line.
    """

    def __init__(self, document: Document, downloads: Downloads, complain: Any, files: Sequence[Path]):
        self._downloads, self._complain = downloads, complain
        self._files = [path for path in files if is_picture(path) or is_chart(path)]
        self._work = Newest(document, self._failed)
        self._pictures: list[OpenedPicture] = []
        self._found: Any = None
        self._chart: Path | None = None
        self._samples: dict[Path, list[Any]] = {}
        self._upload = Upload(
            "to open a file, drop an image or the .json of a chart here", self._dropped, complain, name="upload-picture"
        )
        self._picture = Select(title="image", options=[], value="", name="picture")
        self._tone = Select(title="tone curve", options=list(_TONES.items()), value="auto")
        self._model = Select(title="lens", options=["gaussian", "halo", "measured"], value="gaussian", width=138)
        self._half = NumericInput(
            title="pixel half width [px]", value=0.5, low=0.05, high=0.5, mode="float", width=138, margin=(2, 4, 2, 4)
        )
        self._region = [
            NumericInput(
                title=f"{name} [px]", value=None, mode="int", width=64, margin=(2, 2, 2, 6), name=f"region-{name}"
            )
            for name in _REGION
        ]
        self._edge = Button(label="measure the region's edge", name="measure")
        self._all = Button(label="find and measure all edges", name="calibrate")
        self._edge.on_click(self._measure)
        self._all.on_click(self._calibrate)
        watch(self._picture, self._draw)
        for setting in (self._tone, self._model, self._half):
            watch(setting, self._forget)
        self._targets_of = Div(
            text="no chart is open; edges are measured", name="chart", width=WIDTH - 16, margin=(2, 8, 2, 8)
        )
        self._status = Div(
            text="Nothing is open: drop photographs of slanted edges or a chart.",
            name="calibrate-status",
            height=18,
            sizing_mode="stretch_width",
        )
        self._about = note("about")
        self._result = note("result")
        self._saved = Div(text="", name="profiles", width=WIDTH - 16)
        self.layout = row(self._knobs(), self._plots(), sizing_mode="stretch_width", spacing=8, name="calibrate-view")

    def start(self) -> None:
        for path in self._files[:1]:  # the others are read with it
            self._dropped(path)

    def close(self) -> None:
        self._work.close()
        self._upload.close()

    def _knobs(self) -> Any:
        return column(
            self._upload.layout, self._picture, self._tone, row(self._model, self._half),
            Div(text="one region: draw a rectangle, or enter", margin=(4, 8, 0, 8)), row(*self._region), self._edge,
            Div(text="all images:", margin=(4, 8, 0, 8)), self._targets_of, self._all, self._saved, width=WIDTH,
        )  # fmt: skip

    def _plots(self) -> Any:
        self._image = empty_source("photograph", "image", "dw", "dh")
        self._edges = empty_source("edges", "x", "y", "x0", "y0", "x1", "y1", "mtf50", "mtf50_std")
        self._box = empty_source("region", *_REGION)
        self._plot = picture_figure(
            "picture", _SIDE, "x [px]", "y [px]", toolbar_location="above", match_aspect=True,
            x_range=Range1d(-0.5, 1), y_range=Range1d(1, -0.5),
            tools="pan,wheel_zoom,box_zoom,reset", active_scroll="wheel_zoom",
        )  # fmt: skip
        self._plot.image(
            "image",
            x=-0.5,
            y=-0.5,
            dw="dw",
            dh="dh",
            source=self._image,
            color_mapper=LinearColorMapper(palette=[f"#{v:02x}{v:02x}{v:02x}" for v in range(256)], low=0, high=1),
        )
        self._colours = LinearColorMapper(palette=Viridis256, low=0, high=0.5)
        colour = {"field": "mtf50", "transform": self._colours}
        self._plot.segment("x0", "y0", "x1", "y1", source=self._edges, line_color=colour, line_width=4)
        dots = self._plot.scatter("x", "y", source=self._edges, fill_color=colour, line_color="white", size=8)
        hover(
            self._plot,
            [dots],
            [("MTF50", "@mtf50{0.0000} ± @mtf50_std{0.0000} cycles/px"), ("x, y", "@x{0}, @y{0} px")],
        )
        self._targets = ColumnDataSource(target_columns([]), name="targets")
        marks = self._plot.scatter(
            "x",
            "y",
            source=self._targets,
            marker="diamond_cross",
            size=16,
            fill_alpha=0,
            line_color=VERMILION,
            line_width=2,
        )
        hover(
            self._plot,
            [marks],
            [("target", "@kind"), ("MTF", "@mtf{0.000} ± @mtf_std{0.000} at @frequency{0.000} cycles/px")],
        )
        self._plot.rect(
            "x",
            "y",
            "width",
            "height",
            source=self._box,
            fill_alpha=0.1,
            fill_color=VERMILION,
            line_color=VERMILION,
            line_width=2,
        )
        self._plot.add_layout(
            ColorBar(color_mapper=self._colours, width=10, title="MTF50 [cycles/px]", title_text_font_size="10px"),
            "right",
        )
        self._plot.add_tools(BoxSelectTool(renderers=[dots], description="draw a region"))
        self._plot.on_event(SelectionGeometry, self._drawn)
        self._curve = curve_figure(
            "MTF of lens and pixel",
            "spatial frequency [cycles/px]",
            "MTF [-]",
            height=380,
            x_range=(0, 1.0),
            y_range=(-0.1, 1.1),
        )
        self._mtf = empty_source("mtf", "frequency", "mtf", "low", "high", "lens")
        self._curve.varea(
            "frequency", "low", "high", fill_color=BLUE, fill_alpha=0.25, source=self._mtf, legend_label="± 1 std"
        )
        lines = self._curve.line(
            "frequency", "mtf", color=BLUE, line_width=2, source=self._mtf, legend_label="without a model"
        )
        self._curve.line(
            "frequency",
            "lens",
            color=VERMILION,
            line_width=2,
            line_dash="dashed",
            source=self._mtf,
            legend_label="lens model",
        )
        self._points = empty_source("target-samples", "frequency", "mtf")
        self._curve.scatter(
            "frequency",
            "mtf",
            source=self._points,
            color=VERMILION,
            size=4,
            legend_label="other targets",
        )
        self._curve.line([0.5, 0.5], [-0.1, 1.1], color=GREY, line_width=1, legend_label="Nyquist")
        follow_data(self._curve)
        hover(self._curve, [lines], [("frequency", "@frequency{0.000} cycles/px"), ("MTF", "@mtf{0.0000}")])
        return column(
            self._status,
            row(
                column(self._plot, width=_SIDE + 150),
                column(self._curve, self._about, self._result, sizing_mode="stretch_width"),
                sizing_mode="stretch_width",
            ),
            sizing_mode="stretch_width",
        )

    def _dropped(self, path: Path) -> None:
        self._status.text = f"reading {escape(path.name)} ..."
        waiting = [path, *(one for one in self._files if one not in {picture.path for picture in self._pictures})]
        todo = list(dict.fromkeys(waiting))
        self._work.ask(lambda: [opened_or_why(one) for one in todo], self._add)

    def _add(self, opened: list[OpenedPicture | tuple[Path, str] | MatcamError]) -> None:
        self._status.text = ""
        for one in opened:
            if isinstance(one, MatcamError):
                self._complain(str(one))
            elif isinstance(one, tuple):
                self._chart, words = one
                self._targets_of.text = escape(f"chart: {self._chart.name}: {words}")
            else:
                self._pictures.append(one)
        if any(not isinstance(one, MatcamError) for one in opened):
            self._forget()
        self._files = []
        self._picture.options = [(str(index), one.path.name) for index, one in enumerate(self._pictures)]
        if self._pictures:
            self._picture.value = str(len(self._pictures) - 1)
            self._draw()

    @property
    def _settings(self) -> tuple[Any, ...]:
        """Everything on which results depend: images, chart, tone curve, lens and pixel."""
        paths = tuple(picture.path for picture in self._pictures)
        return paths, self._chart, self._tone.value, self._model.value, float(self._half.value or 0.5)

    def _forget(self) -> None:
        """Remove the results, because they belong to other images or settings."""
        self._found, self._samples = None, {}
        self._saved.text = ""
        self._show_found()

    def _clear_curves(self) -> None:
        self._mtf.data = {key: [] for key in self._mtf.data}
        self._result.text = ""

    def _ask(self, work: Callable[[], Any], show: Callable[[Any], None]) -> None:
        """Start work, and show its result unless the settings have changed meanwhile."""
        settings = self._settings

        def show_if_current(result: Any) -> None:
            self._status.text = ""
            if settings == self._settings:
                show(result)

        self._work.ask(work, show_if_current)

    @property
    def _current(self) -> OpenedPicture | None:
        return self._pictures[int(self._picture.value)] if self._picture.value.isdigit() else None

    def _draw(self) -> None:
        picture = self._current
        if picture is None:
            return
        height, width = picture.size
        self._image.data = {"image": [picture.shown], "dw": [width], "dh": [height]}
        self._plot.title.text = picture.path.name
        side = max(height, width)
        self._plot.x_range.update(start=-0.5, end=side - 0.5, reset_start=-0.5, reset_end=side - 0.5)
        self._plot.y_range.update(start=side - 0.5, end=-0.5, reset_start=side - 0.5, reset_end=-0.5)
        self._show_found()  # results of a region belong to the image that was shown before

    def _say_about(self, picture: OpenedPicture, remarks: Sequence[Any]) -> None:
        lines = [
            picture.about,
            f"tone curve: {_TONES[self._tone.value]}",
            *(worded(str(getattr(one, "text", one))) for one in remarks),
        ]
        self._about.text = "<br>".join(escape(line) for line in lines)

    def _drawn(self, event: Any) -> None:
        geometry = event.geometry
        if event.final and geometry.get("type") == "rect" and self._current is not None:
            height, width = self._current.size
            x0, x1 = (int(np.clip(round(v), 0, width)) for v in sorted((geometry["x0"], geometry["x1"])))
            y0, y1 = (int(np.clip(round(v), 0, height)) for v in sorted((geometry["y0"], geometry["y1"])))
            for field, value in zip(self._region, (x0, y0, x1 - x0, y1 - y0), strict=True):
                field.value = value
            self._measure()

    def _measure(self) -> None:
        picture = self._current
        if picture is None:
            self._complain("nothing is open: drop an image first")
            return
        given = [field.value for field in self._region]
        x, y, width, height = (int(value or 0) for value in given)
        region = None if all(value is None for value in given) else (x, y, width, height)
        if region:
            self._box.data = {"x": [x + width / 2], "y": [y + height / 2], "width": [width], "height": [height]}
        tone, half = self._tone.value, float(self._half.value or 0.5)
        self._clear_curves()
        self._begin("measuring the edge ... (slow the first time after an installation)")
        self._ask(lambda: measured_edge(picture, region, tone, half), lambda result: self._show_edge(picture, result))

    def _show_edge(self, picture: OpenedPicture, result: Any) -> None:
        if picture is not self._current:
            return
        self._curves(result.frequency, result.mtf, result.mtf_std, result.parametric.mtf)
        fit = result.parametric
        self._result.text = (
            f"<b>MTF50 {result.mtf50:.4f} ± {result.mtf50_std:.4f} cycles/px</b>, without a model<br>"
            f"{escape(fit.model)} lens {fit.mtf50:.4f} ± {fit.mtf50_std:.4f} cycles/px: "
            f"{'explains the edge' if fit.consistent else 'does NOT explain the edge'}"
        )
        self._say_about(picture, result.remarks)

    def _calibrate(self) -> None:
        if not self._pictures:
            self._complain("nothing is open: drop an image first")
            return
        pictures, chart = list(self._pictures), self._chart
        paths = [picture.path for picture in pictures]
        model, tone, half = self._model.value, self._tone.value, float(self._half.value or 0.5)
        self._forget()
        self._begin(f"finding and measuring all {'edges' if chart is None else 'targets'} of {len(paths)} image(s) ...")

        def measure() -> tuple[Any, dict[Path, list[Any]]]:
            found = calibrated(paths, model, tone, half, chart)
            if chart is None:
                return found, {}
            return found, {one.path: targets_in(one, chart, tone, half, found.channel) for one in pictures}

        self._ask(measure, lambda result: self._show_camera(*result))

    def _begin(self, words: str) -> None:
        self._complain("")
        self._status.text = escape(words)

    def _failed(self, line: str) -> None:
        self._status.text = ""
        self._complain(line)

    def _show_camera(self, found: Any, samples: dict[Path, list[Any]]) -> None:
        self._found, self._samples = found, samples
        links = " · ".join(self._downloads.offer(name, content) for name, content in profiles(found).items())
        self._saved.text = f"save the profile: {links}"
        self._show_found()

    def _show_found(self) -> None:
        """Show the calibration of all images, or nothing if there is none."""
        found = self._found
        if self._current is not None:
            self._say_about(self._current, () if found is None else found.remarks)
        self._overlay()
        if found is None:
            self._clear_curves()
            return
        fit = found.channels[found.channel]
        curve = fit.curve
        self._curves(curve.frequency, curve.mtf, curve.mtf_std, curve.camera_mtf)
        lines = []
        for name, one in found.channels.items():
            numbers = ", ".join(
                f"{label} = {value:.4g} ± {std:.2g}"
                for label, value, std in zip(one.names, one.values, one.std, strict=True)
            )
            lines.append(
                f"{name}: {numbers} ({_counted(one.measurements)}), "
                f"{'the model explains the data' if one.consistent else 'the model does NOT explain the data'}"
            )
        lines += [f"left out: {name}: {why}" for name, why in found.failed.items()]
        self._result.text = "<br>".join(escape(line) for line in lines)

    def _overlay(self) -> None:
        samples = [] if self._current is None else self._samples.get(self._current.path, [])
        self._targets.data = target_columns(samples)
        self._points.data = {
            name: [float(v) for one in samples for v in getattr(one, name)] for name in ("frequency", "mtf")
        }
        columns: dict[str, Any] = {key: [] for key in self._edges.data}
        if self._found is not None and self._current is not None:
            columns = edges_in(self._found, self._current)
            if len(columns["x"]):
                self._colours.update(low=float(np.nanmin(columns["mtf50"])), high=float(np.nanmax(columns["mtf50"])))
        self._edges.data = columns

    def _curves(self, frequency: Any, mtf: Any, std: Any, lens: Any) -> None:
        self._mtf.data = {"frequency": frequency, "mtf": mtf, "low": mtf - std, "high": mtf + std, "lens": lens}


def _counted(measurements: dict[str, int]) -> str:
    counts: dict[str, int] = {}
    for name, count in measurements.items():
        kind = name[name.rfind("(") + 1 :].rstrip(")")
        counts[kind] = counts.get(kind, 0) + count
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def is_picture(path: Path) -> bool:
    from matcam.files.formats import suffixes_for

    return is_file(path) and path.suffix.lower() in {*PICTURES, *suffixes_for("picture")}
