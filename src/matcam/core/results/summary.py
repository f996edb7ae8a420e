"""Summaries of results: quantities with standard deviations as plain text, as HTML for notebooks, and as a figure.

A result derives from `Summarised` and defines its content once (`_summary`). Datasets have the same methods through an
accessor (`matcam.core.results.labelled`).
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from matcam.core.registry import imported
from matcam.core.remark import Remark

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_ROWS = 12
"""Largest number of quantities of a section that are shown. A measured MTF has hundreds of parameters, which are too
many to read.
"""
_WIDTH = 100
"""Number of characters of a line of text, as in the reports of lmfit and statsmodels."""


class Quantity(NamedTuple):
    """Named value of a result.

    Attributes:
        name: name of the quantity.
        value: the value, a number or a string.
        std: standard deviation, in the unit of the value. 0: the value is exact; infinity: the data do not determine the
            value. Default: NaN, the standard deviation is unknown.
        unit: unit of the value. Default: "", the quantity has no unit, or its name includes the unit.
        relative: True if the text also contains the standard deviation in percent of the value. Such a percentage is
            meaningless for a coordinate. Default: True.
    """

    name: str
    value: float | str
    std: float = math.nan
    unit: str = ""
    relative: bool = True

    @property
    def text(self) -> str:
        """Value, standard deviation and unit as text.

        If the standard deviation is known, it determines the number of digits of the value.
        """
        if isinstance(self.value, str):
            return self.value
        unit = self.unit if self.unit in ("", "°") else f" {self.unit}"
        if math.isnan(self.std):
            return f"{self.value:.6g}{unit}"
        if math.isinf(self.std):
            return f"{self.value:.6g}{unit} (not determined)"
        if self.std == 0:
            return f"{self.value:.6g}{unit} (exact)"
        return f"{with_std(self.value, self.std)}{unit}{self._share}"

    @property
    def _share(self) -> str:
        """Text of the standard deviation in percent of the value; "" if `relative` is False or the percentage is too large."""
        assert not isinstance(self.value, str)
        share = 100 * self.std / abs(self.value) if self.value and self.relative else math.inf
        return f" ({share:.2g} %)" if share < 99.5 else f" ({share:.0f} %)" if share < 1000 else ""


def with_std(value: float, std: float) -> str:
    """Format a value and its standard deviation.

    The standard deviation has two significant digits.

    Args:
        value: the value.
        std: standard deviation of `value`, positive.

    Example:
        >>> with_std(0.0051234, 0.000012)
        '0.005123 ± 0.000012'
        >>> with_std(6.54321e-7, 1e-9)
        '(6.543 ± 0.010)e-07'
    """
    size = max(abs(value), std)
    power = math.floor(math.log10(size))
    scale = power if not -4 <= power < 6 else 0
    digits = min(max(0, 1 - math.floor(math.log10(std)) + scale), 12)
    text = f"{value / 10.0**scale:.{digits}f} ± {std / 10.0**scale:.{digits}f}"
    return f"({text})e{scale:+03d}" if scale else text


def half_width(angle: float, std: float) -> Quantity:
    """Build the quantity "half width at half maximum" of a lobe, in degrees.

    Args:
        angle: the half width, rad.
        std: standard deviation of `angle`, rad.

    Example:
        >>> half_width(0.0023501, 7e-06).text
        '0.13465 ± 0.00040° (0.3 %)'
    """
    return Quantity("half width at half maximum", math.degrees(angle), math.degrees(std), "°")


class Summary(NamedTuple):
    """Content of a summary.

    Attributes:
        title: noun phrase that names the result.
        verdict: findings in complete sentences. Default: "".
        sections: quantities by the title of their section. Default: none.
        remarks: limitations and warnings. Default: none.
    """

    title: str
    verdict: str = ""
    sections: Mapping[str, Sequence[Quantity]] = {}
    remarks: Sequence[Remark] = ()

    @property
    def text(self) -> str:
        """Summary as plain text in the format of `fit_report` of lmfit. Long sections are shortened."""
        lines = [f"[[{self.title}]]"]
        if self.verdict:
            lines += textwrap.wrap(self.verdict, _WIDTH, initial_indent="    ", subsequent_indent="    ")
        for title, quantities in self.sections.items():
            shown, more = quantities[:_MOST_ROWS], len(quantities) - _MOST_ROWS
            width = max((len(one.name) for one in shown), default=0)
            lines += [f"[[{title}]]"] if shown else []
            lines += [f"    {one.name + ':':<{width + 1}} {one.text}" for one in shown]
            lines += [f"    and {more} more"] if more > 0 else []
        lines += ["[[Remarks]]"] if self.remarks else []
        for remark in self.remarks:
            lines += textwrap.wrap(remark.text, _WIDTH, initial_indent="    - ", subsequent_indent="      ")
        return "\n".join(lines)

    @property
    def html(self) -> str:
        """Summary as HTML. It has no styles, so that the theme of the notebook applies. Long sections are shortened."""
        parts = [f"<strong>{escape(self.title)}</strong>"]
        parts += [f"<p>{escape(self.verdict)}</p>"] if self.verdict else []
        for title, quantities in self.sections.items():
            rows = [
                f"<tr><th scope='row'>{escape(one.name)}</th><td>{escape(one.text)}</td></tr>"
                for one in quantities[:_MOST_ROWS]
            ]
            more = len(quantities) - _MOST_ROWS
            rows += [f"<tr><td colspan='2'>and {more} more</td></tr>"] if more > 0 else []
            parts += [f"<table><caption>{escape(title)}</caption>{''.join(rows)}</table>"] if rows else []
        items = "".join(f"<li>{escape(remark.text)}</li>" for remark in self.remarks)
        parts += [f"<ul>{items}</ul>"] if items else []
        return f"<div>{''.join(parts)}</div>"


def parameters(values: Mapping[str, Any], std: Mapping[str, Any]) -> list[Quantity]:
    """List parameters with their standard deviations.

    Args:
        values: value of each parameter by its name, which includes the unit.
        std: standard deviation of each parameter by its name, in the unit of the parameter. An unknown standard deviation is
            NaN or missing.
    """
    return [Quantity(name, float(value), float(std.get(name, math.nan))) for name, value in values.items()]


def correlations(names: Iterable[str], covariance: np.ndarray) -> list[Quantity]:
    """List the correlations with a modulus of at least 0.1, in the order of decreasing modulus.

    Args:
        names: names of the parameters.
        covariance: covariance of the parameters, (parameters, parameters).

    Example:
        >>> [one.name for one in correlations(["a", "b", "c"], np.array([[4.0, 1.0, 0], [1.0, 1.0, 0], [0, 0, 1]]))]
        ['C(a, b)']
    """
    names = list(names)
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.maximum(np.outer(scale, scale), 1e-300)
    # as in lmfit, smaller correlations are not listed: they change a standard deviation by less than 1 %
    pairs = [(i, j) for i in range(len(names)) for j in range(i) if abs(correlation[i, j]) >= 0.1]
    pairs.sort(key=lambda pair: -abs(correlation[pair]))
    return [Quantity(f"C({names[j]}, {names[i]})", f"{correlation[i, j]:+.3f}") for i, j in pairs]


class Summarised:
    """Base class of results that have a summary and a figure."""

    def _summary(self) -> Summary:
        raise NotImplementedError

    def summary(self) -> str:
        """Summarise the result in plain text.

        Returns:
            Text with sections of quantities, standard deviations and units, with the correlations of fitted parameters, and
            with remarks. A notebook shows the same content as a table if a cell ends with the result.
        """
        return self._summary().text

    def plot(self, ax: Axes | None = None, **options: Any) -> Axes:
        """Draw the result.

        Args:
            ax: Matplotlib Axes to draw on. Default: None, the Axes of a new figure.
            **options: options of the figure, which depend on the kind of result. `channel` is the index of a channel. For
                a correction, `theta_d` is the difference angle, rad. For a Fresnel term, `metal` is a name as in
                `matcam.material.metals`.

        Returns:
            The Axes.

        Raises:
            ArgumentError: an option is invalid, or this kind of result has no figure that consists of one panel.
        """
        return draw(type(self).__name__, self, ax, options)

    def _repr_html_(self) -> str:
        return self._summary().html

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._summary().title}>"


def draw(kind: str, result: Any, ax: Axes | None, options: Mapping[str, Any]) -> Axes:
    """Draw a result.

    Args:
        kind: name of the class of the result, or for a Dataset the kind of result, such as "Fresnel term".
        result: the result.
        ax: Axes to draw on. None: the Axes of a new figure.
        options: options of the figure.
    """
    # imported with the first figure, so that no layer below depends on figures
    return imported("matcam.figures.artists:draw")(kind, result, ax, options)
