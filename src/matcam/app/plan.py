"""View for planning a rig: previews of the loss and of images while a slider moves, and exact values after it stops."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Span
from bokeh.models.widgets import Button, Div, RadioButtonGroup, Select

from matcam.app.controls import ConductorControl, NumberControl, note, watch
from matcam.app.plan_settings import PRESETS, SETTINGS, Planned, green_indices
from matcam.app.plots import (
    COLOURS,
    WIDTH,
    PictureColours,
    PictureFigure,
    curve_figure,
    empty_source,
    hover,
    no_pictures,
    picture_columns,
)
from matcam.app.transfers import Downloads
from matcam.app.worker import DRAINED, Newest
from matcam.figures.style import GREY

_SIDE = 156  # side of the frame of an image, px of the screen
_PICTURES = {
    "sphere true": "sphere: true",
    "sphere recorded": "sphere: recorded",
    "close true": "highlight: true",
    "close recorded": "highlight: recorded",
}
_DIFFERENCES = {
    "sphere difference": "sphere: recorded - true",
    "close difference": "highlight: recorded - true",
}


class PlanView:
    """View for planning a rig, with the predicted loss and images.

    Args:
        document: the page's document.
        downloads: registry of files to save.
        complain: function that shows a message of one line.
    """

    def __init__(self, document: Document, downloads: Downloads, complain: Any):
        self._document, self._downloads = document, downloads
        self._fast, self._exact = Newest(document, complain), Newest(document, complain)
        self._warm = False
        self._last: dict[str, Any] = {}
        self._controls = {one.name: NumberControl(one, self.refresh, self._rest) for one in SETTINGS}
        self._metal = ConductorControl("metal, n and k (green)", self.refresh, green_indices)
        self._family = Select(
            title="lobe",
            value="ggx",
            options=["ggx", "beckmann", "gaussian"],
            width=128,
            name="lobe",
        )
        self._shown = RadioButtonGroup(labels=["log exposure", "difference", "row profile"], active=0, name="shown")
        watch(self._family, self.refresh)
        watch(self._shown, self._choose, "active")
        self._status = Div(text="", name="plan-status", height=18, sizing_mode="stretch_width")
        self._numbers = note("plan-numbers")
        self._limits = note("plan-limits")
        self._copy = note("plan-copy")
        self.layout = row(self._knobs(), self._pictures(), sizing_mode="stretch_width", spacing=8, name="plan")

    def start(self) -> None:
        self._fast.ask(self._warmed, self._started)

    def close(self) -> None:
        self._fast.close()
        self._exact.close()

    @property
    def planned(self) -> Planned:
        numbers = {name: control.value for name, control in self._controls.items()}
        return Planned(**numbers, metal=self._metal.name.value, family=self._family.value, n_and_k=self._metal.n_and_k)

    def refresh(self) -> None:
        planned = self.planned
        self._copy.text = ""  # until the values rest: commands of the previous rig would be wrong
        if self._warm:
            self._fast.ask(lambda: _fast(planned), self._show, **DRAINED)
            self._rest()

    def _rest(self) -> None:
        if self._warm:
            planned = self.planned
            # the exact values are computed after 0.5 s without a change
            self._exact.ask(lambda: self._at_rest(planned), lambda _: None, after=0.5)

    def _knobs(self) -> Any:
        presets = []
        for name in PRESETS:
            button = Button(label=name, width=88, margin=(2, 4, 2, 4), name=f"preset-{name}")
            button.on_click(lambda name=name: self._preset(name))
            presets.append(button)
        return column(
            row(*presets),
            *(control.layout for control in self._controls.values()),
            self._metal.layout,
            self._family,
            width=WIDTH,
        )

    def _pictures(self) -> Any:
        self._curves = curve_figure(
            "Peak kept, relative to θ = 0",
            "viewing angle θ [degrees]",
            "recorded / true peak, relative [-]",
            height=270,
            x_range=(0, 90),
            y_range=(0, 1.05),
        )
        self._curves.xaxis.ticker = list(range(0, 91, 15))
        self._curve = empty_source("curve", "theta", "relative", "roughness", "chosen", "words", "colour", "width")
        lines = self._curves.multi_line(
            "theta", "relative", color="colour", line_width="width", legend_field="words", source=self._curve
        )
        hover(self._curves, [lines], [("roughness", "@roughness"), ("θ", "$x°"), ("relative", "$y")])
        degrees = np.linspace(0, 90, 91)
        self._cos = self._curves.line(
            degrees, np.cos(np.radians(degrees)), color=GREY, line_dash="dashed", legend_label="cos θ: largest loss"
        )
        self._curves.add_layout(Span(location=0.95, dimension="width", line_color=GREY, line_width=1))
        self._curves.legend.location = "bottom_left"
        self._drawn = ColumnDataSource(no_pictures(*_PICTURES), name="pictures")
        self._changes = ColumnDataSource(no_pictures(*_DIFFERENCES), name="differences")
        self._colours = {
            "sphere": PictureColours(decades=8), "close": PictureColours(),
            "sphere difference": PictureColours(difference=True), "close difference": PictureColours(difference=True),
        }  # fmt: skip
        pair: dict[str, PictureFigure] = {}
        for name, title in _PICTURES.items():
            part, what = name.split()
            true = pair.get(f"{part} true")
            pair[name] = PictureFigure(
                title, _SIDE, self._drawn, name, self._colours[part], bar=what == "recorded", beside=true
            )
        changes = {
            name: PictureFigure(title, _SIDE, self._changes, name, self._colours[name], bar=True)
            for name, title in _DIFFERENCES.items()
        }
        self._drawings = pair | changes
        self._recorded = pair["sphere recorded"].plot
        self._profile = curve_figure(
            "Row through the highlight", "x from the highlight [px]", "radiance [1/sr]", height=260, y_axis_type="log"
        )
        self._rows = empty_source("profile", "x", "true", "recorded")
        for name, colour, words in (("true", COLOURS[0], "true"), ("recorded", COLOURS[1], "recorded")):
            self._profile.line("x", name, color=colour, line_width=2, legend_label=words, source=self._rows)
        pictures = row(*(one.plot for one in pair.values()), spacing=2)
        differences = row(*(one.plot for one in changes.values()), spacing=12)
        self._panels = (pictures, differences, column(self._profile, sizing_mode="stretch_width"))
        self._choose()
        about = column(self._numbers, self._limits, width=290)
        return column(
            self._status,
            row(self._curves, about, sizing_mode="stretch_width", spacing=8),
            row(
                self._shown,
                Div(text="green light; logarithmic colours, with one scale for a pair", styles={"font-size": "11px"}),
            ),
            *self._panels,
            self._copy,
            sizing_mode="stretch_width",
        )

    def _choose(self) -> None:
        for index, panel in enumerate(self._panels):
            panel.visible = index == self._shown.active
        self._show_pictures(self._last)

    def _preset(self, name: str) -> None:
        for one, control in self._controls.items():
            kept = one in ("roughness", "theta_d")
            control.set(PRESETS[name].get(one, control.value if kept else math.inf if control.setting.infinite else 0))
        self.refresh()

    def _warmed(self) -> Any:
        from matcam.core.jax import use_compilation_cache
        from matcam.material.optical_constants import metals

        use_compilation_cache()
        planned = self.planned
        parts: dict[str, Any] = {}
        for count, (name, part) in enumerate(_PARTS.items()):
            words = f"compiling: {count + 1} of {len(_PARTS)}, {name} (slow the first time after an installation)"
            self._fast.show(partial(self._say, words))
            parts |= part(planned)
            so_far = dict(parts)
            self._fast.show(partial(self._show, so_far))
        return list(metals())

    def _started(self, names: list[str]) -> None:
        self._metal.offer(names)
        self._warm = True
        self._say("")
        self.refresh()

    def _say(self, words: str) -> None:
        self._status.text = escape(words)

    def _show(self, found: dict[str, Any]) -> None:
        self._last = found
        if "curves" in found:
            self._show_curves(found["planned"], found["curves"])
        self._show_pictures(found)

    def _show_curves(self, planned: Planned, data: Any) -> None:
        count = data.roughness.size
        theta = np.degrees(data.theta).tolist()
        rows = list(zip(data.roughness, data.response[:, 0], data.loss_angle, strict=True))
        chosen, others = [r == planned.roughness for r, _, _ in rows], iter(COLOURS[1:])
        self._curve.data = {  # lists: arrays would be two messages each
            "theta": [theta] * count,
            "relative": [np.round(one, 5).tolist() for one in data.relative_response],
            "roughness": [f"{r:g}" for r, _, _ in rows],
            "words": [f"{r:g}: response {kept:.1%} at 0°, 5 % lost at {_angle(angle)}" for r, kept, angle in rows],
            "chosen": [f"{planned.roughness:g}"] * count,
            "colour": [COLOURS[0] if one else next(others) for one in chosen],
            "width": [3.5 if one else 1.5 for one in chosen],
        }
        self._cos.visible = planned.loses_at_most_cos
        if len(theta) > 100:  # exact
            lines = "".join(
                f"<tr><td>{r:g}</td><td>{kept:.1%}</td><td>{_angle(angle)}</td></tr>" for r, kept, angle in rows
            )
            self._numbers.text = (
                "<table><tr><th>roughness</th><th>response at 0°</th><th>5 % lost at</th></tr>"
                f"{lines}</table>computed as by <code>matcam predict</code>"
            )
        else:  # constant while a slider moves, because a changed text triggers a new layout
            self._numbers.text = "preview: the numbers are shown beside the curves"
            self._limits.text = ""

    def _show_pictures(self, found: dict[str, Any]) -> None:
        parts = {name: found[name] for name in ("sphere", "close") if name in found}
        if not parts:
            return
        if self._shown.active == 2:
            if "close" in parts:
                rows = parts["close"].isel(y=parts["close"].sizes["y"] // 2)
                self._rows.data = {name: rows[name].values for name in ("x", "true", "recorded")}
            return
        columns: dict[str, list[Any]] = {}
        differ = self._shown.active == 1
        for part, data in parts.items():
            names = (
                {"difference": f"{part} difference"}
                if differ
                else {"true": f"{part} true", "recorded": f"{part} recorded"}
            )
            for key, name in names.items():
                columns |= picture_columns(name, data[key].values, data["x"].values, data["y"].values)
            largest = data.attrs["largest_difference" if differ else "largest"]
            self._colours[f"{part} difference" if differ else part].scale(largest)
        exact = found.get("exact")
        if exact is not None and not differ:
            columns |= picture_columns(
                "sphere recorded", exact.values[::-1, :, 0], exact["x"].values, exact["y"].values[::-1]
            )
        self._recorded.title.text = (
            "sphere: recorded, within 1 %" if exact is not None else _PICTURES["sphere recorded"]
        )
        source = self._changes if differ else self._drawn
        source.data = {**source.data, **columns}
        for name, one in self._drawings.items():
            if name in columns:
                one.arrived()

    def _at_rest(self, planned: Planned) -> None:
        from matcam.forward.prediction import predicted

        def show(change: Callable[[], None]) -> None:
            self._exact.show(lambda: change() if planned == self.planned else None)

        copies = self._copies(planned)
        show(lambda: self._copy.update(text=copies))
        rig = planned.rig()
        curves = predicted(rig, planned.lobes())
        show(lambda: self._show_curves(planned, curves))
        if self._exact.overtaken():
            return
        bounds = _limits(planned)
        show(lambda: self._limits.update(text=bounds))
        if self._exact.overtaken():
            return
        from matcam.forward.image import picture

        angle = float(rig.sample.lamp_angle(math.radians(planned.theta_d), rig.lamp.nearness))  # type: ignore[attr-defined]
        # the error is a share of the peak of the image
        exact = picture(planned.material(), rig, angle, error=0.01)
        show(lambda: self._show_exact(planned, exact))

    def _show_exact(self, planned: Planned, exact: Any) -> None:
        if self._last.get("planned") == planned:
            self._last = {**self._last, "exact": exact}
            self._show_pictures(self._last)

    def _copies(self, planned: Planned) -> str:
        links = " · ".join(
            self._downloads.offer(name, text.encode())
            for name, text in (("camera.json", planned.camera_profile()), ("rig.toml", planned.rig_file()))
        )
        return (
            f"<b>The same rig</b> as a command and as Python; files: {links}<br><code>{escape(planned.command())}</code>"
            f"<pre style='margin:4px 0'>{escape(planned.python())}</pre>"
        )


def _angle(radians: float) -> str:
    degrees = math.degrees(radians)
    return f"{degrees:.1f}°" if degrees < 90 else "-"


def _curves(planned: Planned) -> dict[str, Any]:
    from matcam.forward.prediction import predicted

    return {"planned": planned, "curves": predicted(planned.rig(), planned.lobes(), fast=True)}


def _close(planned: Planned) -> dict[str, Any]:
    from matcam.forward.previews import highlight_preview

    return {"close": highlight_preview(planned.material(), planned.rig(), math.radians(planned.theta_d))}


def _sphere(planned: Planned) -> dict[str, Any]:
    from matcam.forward.previews import sphere_preview

    # 128 values along a side of the preview
    return {"sphere": sphere_preview(planned.material(), planned.rig(), math.radians(planned.theta_d), side=128)}


_PARTS = {"curves": _curves, "the highlight": _close, "the sphere": _sphere}


def _fast(planned: Planned) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in _PARTS.values():
        found |= part(planned)
    return found


def _limits(planned: Planned) -> str:
    from matcam.core.errors import MatcamError
    from matcam.core.workspace import Workspace
    from matcam.inverse.recoverability import limits

    try:
        found = limits(planned.rig(), planned.family, roughness=[planned.roughness], workspace=Workspace.user())
    except MatcamError as error:
        return f"bounds: {escape(str(error))}"
    one = found.isel(roughness=0)
    rows = (("camera exact", one["width_std"]), ("lens free", one["width_std_free"]))
    lines = "".join(f"<tr><td>{name}</td><td>{float(value):.2%}</td></tr>" for name, value in rows)
    return f"<b>Bounds</b> of the std of ln roughness (<code>matcam limits</code>), 1 % noise:<table>{lines}</table>"
