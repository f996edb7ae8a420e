"""The index of a run over many materials: one HTML file, sortable without a network, that leads to each material's page."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from matcam.figures.style import write_page
from matcam.inverse.operator.rig_axes import LAMP, LENS

INLINE = 1000
"""Materials up to which thumbnails (16 kB each) should stand in the page itself."""


class _Cell(NamedTuple):
    """Hold one cell of the index.

    Attributes:
        value: what the column is sorted by; "" sorts last.
        text: what is shown.
        link: address that the text leads to; "" for none.
        details: lines that a click on the text opens.
    """

    value: str
    text: str
    link: str = ""
    details: tuple[str, ...] = ()


class _Column(NamedTuple):
    """Describe one column of the index: lines of its head, "text" or "number", and its cell of a record."""

    head: tuple[str, ...]
    kind: str
    cell: Callable[[dict[str, Any]], _Cell]


def write_run_index(
    path: str | Path,
    records: Iterable[tuple[str, dict[str, Any]]],
    failures: Sequence[str],
    *,
    summary: str = "",
    inline: bool = True,
    force: bool = False,
) -> None:
    """Write the index of a run beside its files.

    Args:
        path: HTML file to write.
        records: (name, what NAME.json holds) of the finished materials, read one after the other. NAME.png and, if the
            record lists it, NAME.html lie beside the index.
        failures: one line for each material that failed.
        summary: what all materials of the run have in common, in words. Default: "".
        inline: whether thumbnails stand in the page itself; otherwise it names their files. Default: True.
        force: whether to replace the file. Default: False.
    """
    folder = Path(path).parent
    rows = [
        (name, _thumbnail(folder, name, inline), [column.cell({**record, "name": name}) for column in _COLUMNS])
        for name, record in records
    ]
    content = {"columns": _COLUMNS, "rows": rows, "failures": failures, "summary": summary}
    write_page(path, "run_index.html", content, force=force)


def _thumbnail(folder: Path, name: str, inline: bool) -> str:
    """Return the address of a material's thumbnail; "" if it is not there."""
    if not inline:
        return quote(f"{name}.png")
    try:
        return "data:image/png;base64," + base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
    except OSError:
        return ""


def _material(record: dict[str, Any]) -> _Cell:
    """Return the material's name, with a link to its page."""
    name = record["name"]
    listed = record.get("run", {}).get("files", {})
    return _Cell(name, name, f"{quote(name)}.html" if f"{name}.html" in listed else "")


def _verdict(record: dict[str, Any]) -> _Cell:
    """Return the verdict in two words, which open the whole of it and the remarks."""
    short = record.get("determination") or "not determined"
    verdict = record.get("verdict") or ""
    return _Cell(short, short, details=(verdict, *(remark["text"] for remark in record.get("remarks") or ())))


def _number(value: Any, text: Callable[[float], str]) -> _Cell:
    """Return a value that may be missing."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return _Cell("", "-")
    return _Cell(repr(float(value)), text(float(value)))


def _with_std(value: Any, std: Any, scale: float = 1.0) -> _Cell:
    """Return a value with its standard deviation, both times `scale`."""

    def text(x: float) -> str:
        error = f" ± {std * scale:.1g}" if isinstance(std, int | float) and math.isfinite(std) else ""
        return f"{x * scale:.4g}{error}"

    return _number(value, text)


def _roughness(record: dict[str, Any]) -> _Cell:
    """Return the first parameter of the fit, which is its lobe's."""
    params, std = record["fit"]["params"], record["fit"]["std"]
    name = next(iter(params), None)
    return _Cell("", "-") if name is None else _with_std(params[name], std.get(name))


def _free_parameter(name: str, scale: float = 1.0) -> Callable[[dict[str, Any]], _Cell]:
    """Return the column of a rig's parameter as the data would have it."""

    def cell(record: dict[str, Any]) -> _Cell:
        fit = (record.get("doubts") or {}).get(name)
        return _with_std(fit["params"].get(name), fit["std"].get(name), scale) if fit else _Cell("", "-")

    return cell


def _peak_loss(degrees: str) -> Callable[[dict[str, Any]], _Cell]:
    """Return the column of the peak's loss at an angle."""
    return lambda record: _number((record.get("peak_lost") or {}).get(degrees), lambda x: f"{x:.0%}")


_COLUMNS = (
    _Column(("material",), "text", _material),
    _Column(("verdict",), "text", _verdict),
    _Column(("lobe",), "text", lambda r: _Cell(str(r["fit"]["ndf"]), str(r["fit"]["ndf"]))),
    _Column(("roughness", "(slope)"), "number", _roughness),
    _Column(
        ("half width at half", "maximum (degrees)"),
        "number",
        lambda r: _with_std(r["fit"]["hwhm_rad"], r["fit"]["hwhm_std_rad"], 180 / math.pi),
    ),
    _Column(("peak lost", "at 5°"), "number", _peak_loss("5")),
    _Column(("at 45°",), "number", _peak_loss("45")),
    _Column(("at 75°",), "number", _peak_loss("75")),
    _Column(("entries", "supported"), "number", lambda r: _number(r.get("supported_share"), lambda x: f"{x:.0%}")),
    _Column(
        ("noise of", "a pixel"),
        "number",
        lambda r: _number((r["fit"].get("noise") or {}).get("relative"), lambda x: f"{x:.1%}"),
    ),
    _Column(("lens left", "free (px)"), "number", _free_parameter(LENS)),
    _Column(("lamp left free", "(degrees)"), "number", _free_parameter(LAMP, 180 / math.pi)),
    _Column(("time", "(s)"), "number", lambda r: _number((r.get("run") or {}).get("seconds"), lambda x: f"{x:.1f}")),
)
