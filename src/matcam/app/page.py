"""Page of the app. It shows one of three views, and a line for errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models.widgets import Div, RadioButtonGroup

from matcam.app.calibrate_view import CalibrateView, is_picture
from matcam.app.calibrated import is_chart
from matcam.app.controls import watch
from matcam.app.exploring.explore import ExploreView
from matcam.app.plan import PlanView
from matcam.app.plots import THEME
from matcam.app.transfers import Downloads, worded


class Page:
    """Views of one browser tab.

    Args:
        document: the tab's document.
        files: files and folders that the user opened on the command line.
        downloads: registry of files to save.
    """

    def __init__(self, document: Document, files: Sequence[Path], downloads: Downloads):
        self._message = Div(
            text="", name="message", height=18, sizing_mode="stretch_width", styles={"color": "#B00000"}
        )
        self._make: dict[str, Callable[[], Any]] = {
            "Plan": lambda: PlanView(document, downloads, self.complain),
            "Calibrate": lambda: CalibrateView(document, downloads, self.complain, files),
            "Explore": lambda: ExploreView(
                document,
                downloads,
                self.complain,
                [path for path in files if not is_picture(path) and not is_chart(path)],
            ),
        }
        self._views: dict[str, Any] = {}
        start = "Plan" if not files else "Calibrate" if is_picture(files[0]) else "Explore"
        self._chosen = RadioButtonGroup(
            labels=list(self._make), active=list(self._make).index(start), name="views", width=300
        )
        watch(self._chosen, self._choose, "active")
        head = row(self._chosen, self._message, sizing_mode="stretch_width", spacing=12)
        document.title, document.theme = "matcam", THEME
        self._body = column(sizing_mode="stretch_width", name="page")
        document.add_root(column(head, self._body, sizing_mode="stretch_width"))
        self._started: set[str] = set()
        self._ready = False
        self._choose()
        document.on_event("document_ready", lambda event: self._begin())

    def complain(self, line: str) -> None:
        self._message.text = escape(worded(" ".join(line.split())))

    def close(self) -> None:
        for view in self._views.values():
            view.close()

    def _begin(self) -> None:
        self._ready = True
        self._choose()

    def _choose(self) -> None:
        chosen = self._chosen.labels[self._chosen.active]
        if chosen not in self._views:  # views are built when they are first visible
            self._views[chosen] = self._make[chosen]()
            self._body.children = [*self._body.children, self._views[chosen].layout]
        for name, view in self._views.items():
            view.layout.visible = name == chosen
        if self._ready and chosen not in self._started:
            self._started.add(chosen)
            self._views[chosen].start()
