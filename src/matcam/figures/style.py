"""Style and writing of all figures and pages.

pyplot is not used, because it has global state and is slow to import. The colours are those of Okabe & Ito,
which colour-blind readers can distinguish. Pages are Jinja2 templates (templates/*.html), which escape all values.
"""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from matcam.core.io import check_picture, replacing, write_text
from matcam.core.results.summary import Quantity
from matcam.numerics.budget import UncertaintyBudget

BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, YELLOW, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#F0E442", "#000000",
)  # fmt: skip
CHANNELS = {"R": VERMILION, "G": GREEN, "B": BLUE, "Y": BLACK, "grey": BLACK}
"""Colours of channels."""
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
GREY = "#6E6E6E"


def channel_colour(name: str, index: int) -> str:
    return CHANNELS.get(name[:1] if name[1:].isdigit() else name, CYCLE[index % len(CYCLE)])


_GAP = 10.0
"""Distance between titles of neighbouring panels, and tolerance of the height of panels of one row, dots."""

_RC: Any = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titley": 1.0,  # otherwise Matplotlib computes all labels to find the height of a title
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "matcam",  # the same data give the same file
    "pdf.fonttype": 42,
}


def styled() -> AbstractContextManager[None]:
    return matplotlib.rc_context(_RC)


@contextmanager
def drawing(width: float, height: float, layout: Any = "constrained", **options: Any) -> Iterator[Figure]:
    """Create a figure in the style of the package.

    The style applies during the block. `width` and `height` are the size of the figure, inches. For `layout` and
    `options`, see `Figure`.
    """
    with styled():
        yield Figure(figsize=(width, height), layout=layout, **options)


def save(figure: Figure, path: str | Path, *, force: bool = False, dpi: float = 144) -> None:
    """Write a figure to a file, without a date, so that the same data give the same file.

    `dpi` is the resolution of a PNG, dots per inch.
    """
    path = check_picture(path, force=force)
    if path.suffix.lower() == ".png":
        drawn = _png(figure, dpi)
    else:
        metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}[path.suffix.lower()]
        stream = io.BytesIO()  # Matplotlib raises arbitrary errors on a full disk
        with styled():
            figure.draw_without_rendering()
            layout = figure.get_layout_engine()
            if not fit_titles(figure):
                figure.set_layout_engine("none")  # `savefig` would compute the layout again
            figure.savefig(stream, format=path.suffix.lower()[1:], dpi=dpi, metadata=metadata)
            figure.set_layout_engine(layout)
        drawn = stream.getvalue()  # an open view of it, kept by an error, crashes Python 3.12
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(drawn)


def fit_titles(figure: Figure) -> bool:
    """Shrink the titles that do not fit into a drawn figure.

    A title must not extend beyond the figure or overlap the panel to the right. Titles contain names of files and
    parameters of rigs, which may be long; Matplotlib clips them. A title that would be smaller than 7 points is also
    broken into lines.

    Returns:
        True if a title was changed, so that the figure must be drawn again.
    """
    changed = False
    for axes in figure.axes:
        titles = [one for one in axes.get_children() if isinstance(one, Text) and one not in axes.texts]
        for title in titles:
            changed |= bool(title.get_text()) and _fit(title, _end(figure, axes) - title.get_window_extent().x0)
    for title in figure.texts:
        changed |= bool(title.get_text()) and _fit(title, figure.bbox.width - title.get_window_extent().x0)
    return changed


def _end(figure: Figure, axes: Axes) -> float:
    """Compute the right limit of a panel's title, dots.

    It is the left edge of the next panel in the row, minus a gap, or the right edge of the figure.
    """
    here = axes.get_window_extent()
    # colour bars, which Matplotlib labels so, lie beside the panel and below its title
    panels = [one.get_window_extent() for one in figure.axes if one.get_label() != "<colorbar>"]
    right = [box.x0 - _GAP for box in panels if box.x0 >= here.x1 and box.y0 < here.y1 < box.y1 + _GAP]
    return min([*right, figure.bbox.width])


def _fit(title: Text, room: float) -> bool:
    width = title.get_window_extent().width
    if width <= room:
        return False
    size = float(title.get_fontsize())
    # a title is not smaller than the smallest labels, 7 points
    smaller = max(size * 0.98 * room / width, min(size, 7.0))
    title.set_fontsize(smaller)
    if (needed := width * smaller / size) > room and title.get_text().count("$") < 2:  # a formula cannot be broken
        longest = max(map(len, title.get_text().splitlines()))
        title.set_text(textwrap.fill(title.get_text(), max(int(longest * room / needed) - 1, 10)))
    return True


def degrees_axis(axes: Axes, label: str) -> None:
    axes.set_xlabel(f"{label} [degrees]")
    axes.set_xlim(0, 90)
    axes.set_xticks(range(0, 91, 15))


def draw_with_std(axes: Axes, x: Any, value: Any, std: Any, colour: Any, **line: Any) -> None:
    axes.fill_between(x, value - std, value + std, color=colour, alpha=0.25, lw=0)
    axes.plot(x, value, color=colour, **line)


def mtf_lines(axes: Axes) -> None:
    """Draw lines at an MTF of 0, and at the Nyquist frequency, 0.5 cycles/px.

    The label of the Nyquist frequency is below the position of the legend.
    """
    axes.axhline(0, color=BLACK, lw=0.6)
    axes.axvline(0.5, color=GREY, lw=0.8)
    axes.annotate("Nyquist", (0.5, 0.5), xytext=(3, -9), textcoords="offset points", fontsize=8, color=GREY)


def legend_above(axes: Axes, columns: int) -> None:
    low, high = axes.get_ylim()
    share = 0.04 + 0.08 * -(-len(axes.get_legend_handles_labels()[0]) // columns)
    axes.set_ylim(low, high + (high - low) * share / (1 - share))
    axes.legend(loc="upper right", fontsize=8.5, ncols=columns)


def inline_png(figure: Figure) -> str:
    return data_url(_png(figure, 110))


def data_url(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _png(figure: Figure, dpi: float) -> bytes:
    """Encode a figure as a PNG file.

    `savefig` is not used, because it would compute the layout twice.
    """
    stream, drawn_for = io.BytesIO(), figure.dpi
    with styled():
        figure.dpi = dpi
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        if fit_titles(figure):
            canvas.draw()
        figure.dpi = drawn_for
    Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).save(stream, format="png", dpi=(dpi, dpi))
    return stream.getvalue()


def budget_tables(budgets: Iterable[UncertaintyBudget]) -> list[tuple[str, list[list[Any]]]]:
    return [(f"{one.name}: {Quantity(one.name, one.value, one.combined).text}", one.rows()) for one in budgets]


def write_page(path: str | Path, template: str, content: Mapping[str, Any], *, force: bool = False) -> None:
    """Write an HTML page from a template of the package.

    All values in `content` are escaped.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("matcam.figures", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template(template).render(content)
    write_text(path, text, force=force, errors="xmlcharrefreplace")  # names of folders may be invalid text
