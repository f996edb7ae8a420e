"""Controls: a slider with a number field for one parameter, and the choice of a metal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bokeh.layouts import column, row
from bokeh.models.layouts import LayoutDOM
from bokeh.models.widgets import Checkbox, Div, NumericInput, Select, Slider

from matcam.app.plots import WIDTH

_BOX = 72  # width of a box with its label, px of the screen


def watch(widget: Any, action: Callable[[], None], attribute: str = "value") -> None:
    widget.on_change(attribute, lambda attr, old, new: action())


def note(name: str) -> Div:
    return Div(text="", name=name, sizing_mode="stretch_width", styles={"font-size": "12px"})


@dataclass(frozen=True)
class Setting:
    """Parameter that a user can set.

    Attributes:
        name: name of the parameter in the program.
        title: label with unit.
        low: smallest value, in the unit of the title.
        high: largest finite value, in the same unit.
        value: initial value, in the same unit.
        log: True if the slider is logarithmic.
        infinite: True if the value may be infinite. A box beside the title then sets the value to infinite.
    """

    name: str
    title: str
    low: float
    high: float
    value: float
    log: bool = False
    infinite: bool = False

    def to_slider(self, value: float) -> float:
        """Convert a value to the position of the slider: the value, or its logarithm to base 10 if `log` is True.

        The position of an infinite value is the right end of the slider.
        """
        value = min(value, self.high)
        return math.log10(value) if self.log else value

    def from_slider(self, position: float) -> float:
        return float(f"{min(max(10**position if self.log else position, self.low), self.high):.3g}")


class NumberControl:
    """Slider and number field for one parameter.

    Args:
        setting: the parameter.
        changed: called after a change by the user.
        released: called after the user has released the slider, or left the number field.
    """

    def __init__(self, setting: Setting, changed: Callable[[], None], released: Callable[[], None]):
        self.setting = setting
        self._changed, self._released, self._own = changed, released, False
        start, end = setting.to_slider(setting.low), setting.to_slider(setting.high)
        self.slider = Slider(
            start=start,
            end=end,
            step=(end - start) / 200,
            value=setting.to_slider(setting.value),
            show_value=False,
            title=None,
            name=f"slider-{setting.name}",
            width=WIDTH - 100,
            height=18,
            margin=(0, 8, 4, 8),
        )
        self.field = NumericInput(
            value=None if math.isinf(setting.value) else setting.value,
            placeholder="infinite" if setting.infinite else "",
            low=setting.low,
            high=setting.high,
            mode="float",
            name=f"field-{setting.name}",
            width=76,
            height=26,
            margin=(0, 0, 0, 0),
        )
        self.infinite = Checkbox(
            label="infinite",
            active=math.isinf(setting.value),
            visible=setting.infinite,
            name=f"infinite-{setting.name}",
            width=_BOX - 8,
            height=16,
            margin=(0, 0, 0, 0),
        )
        wide = WIDTH - 100 - (_BOX if setting.infinite else 0)
        self.label = Div(text=setting.title, width=wide, height=16, margin=(0, 8, 0, 8))
        head = row(self.label, self.infinite) if setting.infinite else self.label
        self.slider.on_change("value", self._slid)
        watch(self.slider, self._end, "value_throttled")
        self.field.on_change("value", self._typed)
        watch(self.infinite, self._ticked, "active")
        self.layout: LayoutDOM = row(column(head, self.slider), self.field, margin=(0, 0, 2, 0))

    @property
    def value(self) -> float:
        if self.infinite.active:
            return math.inf
        return min(self.setting.value, self.setting.high) if self.field.value is None else float(self.field.value)

    def set(self, value: float) -> None:
        """Show a value without calling `changed` and `released`."""
        self._own = True
        self.infinite.active = math.isinf(value)
        self.field.value = None if math.isinf(value) else value
        self.slider.value = self.setting.to_slider(value)
        self._own = False
        self._say_limit()

    def _ticked(self) -> None:
        if not self._own:
            self._own = True
            self.field.value = None if self.infinite.active else self.setting.from_slider(self.slider.value)
            self._own = False
            self._changed()
            self._released()

    def _slid(self, attribute: str, old: float, new: float) -> None:
        if not self._own:
            self._own = True
            self.infinite.active = False  # moving the slider implies a finite number
            self.field.value = self.setting.from_slider(new)
            self._own = False
            self._say_limit()
            self._changed()

    def _typed(self, attribute: str, old: float, new: float | None) -> None:
        if not self._own and new is not None:
            self._own = True
            self.infinite.active = False
            self.slider.value = self.setting.to_slider(new)
            self._own = False
            self._say_limit()
            self._changed()
            self._released()

    def _say_limit(self) -> None:
        """Show in the label that the value is a limit, because the browser replaces values beyond it."""
        limits = {self.setting.low: "smallest", self.setting.high: "largest"}
        which = limits.get(self.value)
        self.label.text = self.setting.title + (f": {which} value" if which else "")

    def _end(self) -> None:
        if not self._own:
            self._released()


CUSTOM = "custom"
"""Entry in the list of metals that stands for custom n and k."""


class ConductorControl:
    """Control for the choice of a metal, or of custom values of refractive index n and extinction coefficient k.

    Args:
        title: label of the control.
        changed: called after the user has changed the choice.
        indices: function that returns n and k of the metal with a given name, no unit.
    """

    def __init__(self, title: str, changed: Callable[[], None], indices: Callable[[str], tuple[float, float]]):
        self._changed, self._indices, self._own = changed, indices, False
        self.name = Select(title=title, value="Cr", options=["Cr"], width=128, margin=(2, 4, 2, 8), name="metal")
        self.numbers = [
            NumericInput(
                title=label, value=None, low=low, high=20, mode="float", width=66, margin=(2, 4, 2, 4), name=label
            )
            for label, low in (("n", 0.01), ("k", 0))
        ]
        watch(self.name, self._named)
        for field in self.numbers:
            watch(field, self._typed)
        self.layout: LayoutDOM = row(self.name, *self.numbers)

    @property
    def n_and_k(self) -> tuple[float, float] | None:
        """Custom n and k, no unit; None if a metal is chosen."""
        if self.name.value != CUSTOM:
            return None
        n, k = (float(field.value or 0.0) for field in self.numbers)
        return max(n, 0.01), k

    def offer(self, names: list[str]) -> None:
        self.name.options = [*names, CUSTOM]
        self.fill()

    def fill(self) -> None:
        if self.name.value != CUSTOM:
            self._own = True
            for field, value in zip(self.numbers, self._indices(self.name.value), strict=True):
                field.value = float(f"{value:.4g}")
            self._own = False

    def _named(self) -> None:
        if not self._own:
            self.fill()
            self._changed()

    def _typed(self) -> None:
        if not self._own:
            self._own = True
            self.name.value = CUSTOM
            self._own = False
            self._changed()
