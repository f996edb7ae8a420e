"""View of materials: slices, a sphere under a lamp, the Fresnel term, and the comparison of two materials."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource
from bokeh.models.widgets import Button, Div, RadioButtonGroup, Select

from matcam.app.controls import ConductorControl, NumberControl, Setting, watch
from matcam.app.exploring.explored import (
    SIDE,
    as_bsdf,
    as_csv,
    as_exr,
    as_pbrt,
    fresnel_of,
    on_screen,
    range_of,
    slice_of,
    sphere_of,
)
from matcam.app.exploring.fitted_pictures import opened_captures
from matcam.app.exploring.opened import Openable, OpenedTable, entries_of
from matcam.app.exploring.photographs_panel import PhotographsPanel
from matcam.app.plots import WIDTH, curve_figure, empty_source, follow_data, hover, on_black, picture_figure
from matcam.app.transfers import Downloads, Upload
from matcam.app.worker import DRAINED, Newest
from matcam.core.errors import ArgumentError, MatcamError
from matcam.figures.style import BLUE, GREY, ORANGE, VERMILION
from matcam.files.capture import Capture

SETTINGS = (
    Setting("theta_d", "slice: θ_d [degrees]", 0.5, 89, 30),
    Setting("lamp", "lamp from camera [degrees]", 0, 170, 50),
    Setting("azimuth", "lamp azimuth [degrees]", 0, 360, 0),
    Setting("exposure", "exposure [stops]", -4, 8, 0),
)
_Listed = tuple[list[Openable], list[Capture], list[str], list[str]]
_NONE = "(none)"


class ExploreView:
    """View of the opened materials.

    Args:
        document: the page's document.
        downloads: registry of files to save.
        complain: function that shows a message of one line.
        files: files that the user opened on the command line.
    """

    def __init__(self, document: Document, downloads: Downloads, complain: Any, files: Sequence[Path]):
        self._downloads, self._complain, self._files = downloads, complain, files
        self._fast, self._slow, self._shots = (Newest(document, self._failed) for _ in range(3))
        self._entries: list[Openable] = []
        self._read: dict[int, OpenedTable] = {}
        self._shown: dict[str, Any] = {}
        self._before = ["", _NONE]  # selection when tables were last shown
        self._controls = {one.name: NumberControl(one, self.refresh, lambda: None) for one in SETTINGS}
        self._chosen = [
            Select(title=title, value="", options=[], name=name)
            for title, name in (("material", "material"), ("second material", "beside"))
        ]
        for select in self._chosen:
            watch(select, self._look)
        self._which = RadioButtonGroup(labels=["recorded", "corrected"], active=1, name="which", width=WIDTH - 16)
        self._channel = RadioButtonGroup(labels=["R", "G", "B"], active=1, name="channel", width=WIDTH - 16)
        self._metal = ConductorControl("metal, n and k", self.refresh, self._indices)
        watch(self._which, self.refresh, "active")
        watch(self._channel, self._other_channel, "active")
        self._looked_at = RadioButtonGroup(
            labels=["table", "photographs"], active=0, name="looked-at", visible=False, width=200
        )
        watch(self._looked_at, self._turn, "active")
        self._photographs = PhotographsPanel(self._shots, complain)
        self._upload = Upload("to open a table, drop it here", self._dropped, complain)
        self._status = Div(text="", name="explore-status", height=18, sizing_mode="stretch_width")
        self._saved = Div(text="", name="explore-saved", width=WIDTH - 16)
        self.layout = row(self._knobs(), self._plots(), sizing_mode="stretch_width", spacing=8, name="explore")

    def start(self) -> None:
        self._slow.ask(self._listed, self._offer)

    def close(self) -> None:
        for work in (self._fast, self._slow, self._shots):
            work.close()
        self._upload.close()

    def _failed(self, line: str) -> None:
        self._status.text = ""
        self._complain(line)

    def refresh(self) -> None:
        tables = [self._read.get(self._index(select)) for select in self._chosen]
        if tables[0] is not None:
            angles = {name: control.value for name, control in self._controls.items()}
            channel, which, metal = (
                self._channel.active,
                self._which.active,
                (self._metal.name.value, self._metal.n_and_k),
            )
            self._fast.ask(lambda: _shown(tables, angles, channel, which, metal), self._show, **DRAINED)

    def _other_channel(self) -> None:
        self._metal.fill()
        self.refresh()

    def _knobs(self) -> Any:
        exports = []
        for name, words in (("csv", "CSV"), ("exr", "EXR"), ("bsdf", "Mitsuba"), ("pbrt", "pbrt")):
            button = Button(label=words, width=64, margin=(2, 4, 2, 4), name=f"save-{name}")
            button.on_click(lambda name=name: self._save(name))
            exports.append(button)
        return column(
            self._upload.layout, *self._chosen, self._which, self._channel,
            *(control.layout for control in self._controls.values()), self._metal.layout,
            Div(text="save the shown data:", margin=(4, 8, 0, 8)), row(*exports), self._saved, width=WIDTH,
        )  # fmt: skip

    def _plots(self) -> Any:
        self._slice = curve_figure(
            "Slice across the plane of light and view", "half angle θ_h [degrees]", "BRDF [1/sr]", height=310,
            x_axis_type="log", y_axis_type="log", y_range=(1e-3, 1e3),
        )  # fmt: skip
        names = ("theta_h", "recorded", "corrected", "low", "high", "supported", "unsupported")
        self._curves = empty_source("slice", *names)
        self._besides = empty_source("slice-beside", *names)
        self._slice.varea(
            "theta_h", "low", "high", fill_color=BLUE, fill_alpha=0.25, source=self._curves, legend_label="± 1 std"
        )
        lines = [
            self._slice.line(
                "theta_h", "recorded", color=VERMILION, line_width=2, source=self._curves, legend_label="recorded"
            )
        ]
        lines.append(
            self._slice.line(
                "theta_h", "corrected", color=BLUE, line_width=2, source=self._curves, legend_label="corrected"
            )
        )
        self._slice.scatter("theta_h", "recorded", color=VERMILION, size=3, source=self._curves)
        self._slice.scatter(
            "theta_h", "unsupported", color="#AAAAAA", size=6, source=self._curves, legend_label="not supported"
        )
        for name, dash in (("recorded", "dotted"), ("corrected", "dashed")):
            self._slice.line(
                "theta_h",
                name,
                color=ORANGE,
                line_width=2,
                line_dash=dash,
                source=self._besides,
                legend_label=f"second material: {name}",
            )
        hover(
            self._slice, lines, [("θ_h", "@theta_h°"), ("recorded", "@recorded 1/sr"), ("corrected", "@corrected 1/sr")]
        )
        self._fresnel = curve_figure(
            "Peak × cos²θ_d, and F of a metal", "difference angle θ_d [degrees]", "over the mean at 10 to 45° [-]",
            height=292, x_range=(0, 90), y_range=(0, 2),
        )  # fmt: skip
        self._terms = empty_source("fresnel", "theta_d", "recorded", "corrected", "low", "high", "metal")
        self._fresnel.varea("theta_d", "low", "high", fill_color=BLUE, fill_alpha=0.25, source=self._terms)
        for name, colour, dash in (
            ("recorded", VERMILION, "solid"),
            ("corrected", BLUE, "solid"),
            ("metal", GREY, "dashed"),
        ):
            self._fresnel.line(
                "theta_d", name, color=colour, line_width=2, line_dash=dash, source=self._terms, legend_label=name
            )
        for plot in (self._slice, self._fresnel):
            plot.legend.location = "bottom_left"
            follow_data(plot)
        self._spheres = [_SpherePlot(name) for name in ("material", "beside it")]
        self._table = column(
            self._slice,
            row(
                self._fresnel,
                *(column(sphere.plot, width=SIDE + 70) for sphere in self._spheres),
                sizing_mode="stretch_width",
            ),
            sizing_mode="stretch_width",
        )
        head = row(self._looked_at, self._status, sizing_mode="stretch_width")
        return column(head, self._table, self._photographs.layout, sizing_mode="stretch_width")

    def _turn(self) -> None:
        pictures = self._looked_at.visible and self._looked_at.active == 1
        self._table.visible, self._photographs.layout.visible = not pictures, pictures
        table = self._read.get(self._index(self._chosen[0]))
        if pictures and table is not None:
            self._photographs.show(table.pictures)

    def _listed(self) -> _Listed:
        from matcam.material.optical_constants import metals

        captures, failures = opened_captures(self._files)
        entries: list[Openable] = []
        for path in self._files:
            try:
                entries += entries_of(path)
            except MatcamError as error:
                failures.append(str(error))
        return entries, captures, failures, list(metals())

    def _offer(self, listed: _Listed) -> None:
        entries, captures, failures, metals = listed
        self._photographs.open(captures)
        self._metal.offer(metals)
        self._add(entries)
        for line in failures:
            self._complain(line)
        if not self._entries:
            self._status.text = (
                "Nothing is open: drop a table (MERL, NetCDF, CSV, RGL .bsdf), or start <code>matcam app FILE</code>."
            )

    def _add(self, entries: list[Openable]) -> None:
        first = len(self._entries)
        self._entries += entries
        options = [(str(index), entry.label) for index, entry in enumerate(self._entries)]
        self._chosen[0].options = list(options)
        self._chosen[1].options = [(_NONE, _NONE), *options]
        if not self._chosen[1].value:
            self._chosen[1].value = _NONE
        if entries:
            self._chosen[0].value = str(first)

    def _dropped(self, path: Path) -> None:
        """Add the materials of a file to the lists, after the first material has been read.

        If the file cannot be read, only a message is shown.
        """

        def read() -> tuple[list[Openable], OpenedTable | None]:
            entries = entries_of(path)
            return entries, entries[0].read() if entries else None

        def add(found: tuple[list[Openable], OpenedTable | None]) -> None:
            entries, first = found
            index = len(self._entries)
            if first is not None:
                self._read[index] = first
            self._add(entries)
            self._have_read({} if first is None else {index: first})

        self._status.text = f"reading {escape(path.name)} ..."
        self._slow.ask(read, add)

    def _index(self, select: Select) -> int:
        return int(select.value) if select.value.isdigit() else -1

    def _look(self) -> None:
        wanted = [index for index in (self._index(select) for select in self._chosen) if index >= 0]
        missing = [index for index in wanted if index not in self._read]
        if not missing:
            self.refresh()
            return
        self._status.text = f"reading {escape(self._entries[missing[0]].label)} ..."
        entries = {index: self._entries[index] for index in missing}

        def read() -> dict[int, OpenedTable | MatcamError]:
            found: dict[int, OpenedTable | MatcamError] = {}
            for index, entry in entries.items():
                try:
                    found[index] = entry.read()
                except MatcamError as error:
                    found[index] = error
            return found

        self._slow.ask(read, self._have_read)

    def _have_read(self, found: dict[int, OpenedTable | MatcamError]) -> None:
        self._status.text = ""
        self._complain("")
        for index, table in found.items():
            if isinstance(table, MatcamError):
                self._complain(str(table))
                self._go_back(index)
            else:
                self._read[index] = table
                if table.pictures and index == self._index(self._chosen[0]):  # elsewhere a pinhole table is empty
                    middle = table.pictures[len(table.pictures) // 2]
                    self._controls["theta_d"].set(float(f"{np.degrees(middle.theta_d):.3g}"))
        shown = {self._index(select) for select in self._chosen}
        # at most 8 tables stay in memory
        for index in [one for one in self._read if one not in shown][: max(0, len(self._read) - 8)]:
            del self._read[index]
        self.refresh()

    def _go_back(self, index: int) -> None:
        for select, before in zip(self._chosen, self._before, strict=True):
            if self._index(select) == index and before != select.value:
                select.value = before

    def _show(self, found: dict[str, Any]) -> None:
        self._shown = found
        self._before = [select.value for select in self._chosen]
        table = self._read.get(self._index(self._chosen[0]))
        self._looked_at.visible = table is not None and bool(table.pictures)
        self._turn()
        self._curves.data = found.get("slice") or {name: [] for name in self._curves.data}
        if "slice" in found:
            self._slice.y_range.update(start=found["range"][0], end=found["range"][1])
        self._besides.data = found.get("beside") or {name: [] for name in self._besides.data}
        self._terms.data = found["fresnel"]
        top = np.nanmax([np.nanquantile(found["fresnel"][name], 0.97) if np.isfinite(found["fresnel"][name]).any() else 1.0
                         for name in ("recorded", "corrected", "metal")])  # fmt: skip
        self._fresnel.y_range.end = float(1.2 * top)
        for sphere, light, name in zip(self._spheres, found["light"], found["names"], strict=True):
            sphere.show(light, name, found["exposure"])

    def _indices(self, name: str) -> tuple[float, float]:
        from matcam.core.grid import CHANNEL_WAVELENGTHS
        from matcam.material.optical_constants import metal

        n, k, _ = metal(name, [CHANNEL_WAVELENGTHS[self._channel.active]])
        return float(n[0]), float(k[0])

    def _save(self, kind: str) -> None:
        table = self._read.get(self._index(self._chosen[0]))
        if table is None or not self._shown:
            self._complain("nothing is shown yet: open a table first")
            return
        name, shown, which = Path(table.name).stem, self._shown, self._which.active
        self._saved.text = "writing ..."

        def write() -> str:
            if kind == "csv":
                if "slice" not in shown:
                    return self._downloads.offer(f"{name}-fresnel.csv", as_csv(shown["fresnel"], "theta_d"))
                return self._downloads.offer(f"{name}-slice.csv", as_csv(shown["slice"], "theta_h"))
            data = _chosen_table(table, which)
            if kind == "pbrt":
                return self._downloads.offer(f"{name}.pbrt", as_pbrt(table))
            if data is None or shown["light"][0] is None:
                raise ArgumentError(
                    f"{table.name}: the file contains only a Fresnel term, which can only be saved as CSV"
                )
            if kind == "exr":
                return self._downloads.offer(f"{name}-sphere.exr", as_exr(shown["light"][0]))
            return self._downloads.offer(f"{name}.bsdf", as_bsdf(data))

        def done(link: str) -> None:
            self._saved.text = f"save {link}"

        self._saved.text = ""
        self._slow.ask(write, done)


class _SpherePlot:
    def __init__(self, title: str):
        self._title = title
        self._source = ColumnDataSource({"image": [np.zeros((2, 2), np.uint32)]}, name=f"sphere {title}")
        self.plot = picture_figure(
            title, SIDE, "x [radii]", "y [radii]", x_range=(-1, 1), y_range=(-1, 1), tools="", toolbar_location=None
        )
        self._drawn = self.plot.image_rgba("image", x=-1, y=-1, dw=2, dh=2, source=self._source, visible=False)

    def show(self, light: np.ndarray | None, name: str, exposure: float) -> None:
        if light is not None:
            self._source.data = {"image": [on_screen(light, exposure)]}
        on_black(self.plot, self._drawn, shown=light is not None)
        self.plot.title.text = name if len(name) < 30 else f"{name[:27]}..."


def _chosen_table(table: OpenedTable, which: int) -> Any:
    """Select the recorded (which = 0) or the corrected table. If it is missing, select the other table."""
    return table.best if which or table.recorded is None else table.recorded


def _shown(
    tables: list[Any], angles: dict[str, float], channel: int, which: int, metal: tuple[str, tuple[float, float] | None]
) -> dict[str, Any]:
    from matcam.inverse.peak_curve import conductor_curve, metal_curve

    table, beside = tables
    theta_d = float(np.radians(angles["theta_d"]))
    found: dict[str, Any] = {"exposure": angles["exposure"]}
    if table.best is not None:
        found["slice"] = slice_of(table, theta_d, channel)
        found["range"] = range_of(found["slice"])
    if beside is not None and beside.best is not None:
        found["beside"] = slice_of(beside, theta_d, channel)
    term = fresnel_of(table, channel)
    at, (name, custom) = np.radians(term["theta_d"]), metal
    if custom is None:
        curve = metal_curve(name, at)[:, channel]
    else:
        curve = conductor_curve(np.array([custom[0]]), np.array([custom[1]]), at)[:, 0]
    found["fresnel"] = {**term, "metal": curve}
    lamp, azimuth = float(np.radians(angles["lamp"])), float(np.radians(angles["azimuth"]))
    found["light"], found["names"] = [], []
    for one in tables:
        data = None if one is None else _chosen_table(one, which)
        found["light"].append(None if data is None else sphere_of(data, lamp, azimuth))
        found["names"].append("no second material" if one is None else f"{one.name}: radiance, sRGB")
    return found
