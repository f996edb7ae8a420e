"""The index of a run over many materials: one HTML file, sortable without a network, that leads to each material's page."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from matcam.core.io import replacing
from matcam.inverse.operator.rig_axes import LAMP, LENS

INLINE = 1000
"""Materials up to which thumbnails (16 kB each) should stand in the page itself."""

_STYLE = """body{font:15px/1.45 system-ui,sans-serif;margin:1.5rem;color:#222}
table{border-collapse:collapse}td,th{padding:.25rem .7rem;text-align:right;border-bottom:1px solid #ddd;vertical-align:middle}
td.text,th.text{text-align:left}th{position:sticky;top:0;background:#f2f2f2;vertical-align:bottom}
th button{all:unset;cursor:pointer;font-weight:600}th button:focus-visible{outline:2px solid #0072B2}
th[aria-sort=ascending] button::after{content:" \\25B2"}th[aria-sort=descending] button::after{content:" \\25BC"}
img{display:block}summary{cursor:pointer}details{max-width:26rem}small{color:#555}
.failed{border-left:4px solid #D55E00;padding-left:1rem}"""
_SCRIPT = """for (const head of document.querySelectorAll('th[data-kind]')) head.firstChild.onclick = () => {
  const row = head.parentNode, place = [...row.children].indexOf(head), body = row.closest('table').tBodies[0];
  const sign = head.getAttribute('aria-sort') === 'ascending' ? -1 : 1;
  for (const other of row.children) other.removeAttribute('aria-sort');
  head.setAttribute('aria-sort', sign === 1 ? 'ascending' : 'descending');
  const value = r => r.children[place].dataset.v, number = head.dataset.kind === 'number';
  const compare = (a, b) => {
    const [x, y] = [value(a), value(b)];
    if (x === '' || y === '') return (x === '') - (y === '');
    return sign * (number ? x - y : x.localeCompare(y));
  };
  body.append(...[...body.rows].sort(compare));
};
document.querySelector('#find').oninput = e => {
  const words = e.target.value.toLowerCase();
  for (const r of document.querySelector('tbody').rows) r.hidden = !r.children[1].dataset.v.toLowerCase().includes(words);
};"""


class _Column(NamedTuple):
    head: str
    kind: str
    cell: Callable[[dict[str, Any]], tuple[Any, str]]
    """Of a record: what is sorted by ("" sorts last), and what is shown, as HTML."""


def write_run_index(
    path: str | Path,
    records: Iterable[tuple[str, dict[str, Any]]],
    failures: Sequence[tuple[str, str]],
    *,
    said: str = "",
    inline: bool = True,
    force: bool = False,
) -> None:
    """Write the index of a run beside its files.

    records: (name, what NAME.json holds) of finished materials, looked at one after the other; NAME.png and, where the record
    lists it, NAME.html lie beside the index. failures: (file, reason). said: what the whole run has in common, in words.
    inline: thumbnails stand in the page itself; else it names their files.
    """
    folder = Path(path).parent
    heads = "".join(
        f"<th class='{'text' if column.kind == 'text' else ''}' data-kind={column.kind}><button>{column.head}</button></th>"
        for column in _COLUMNS
    )
    rows = [_row(folder, name, record, inline) for name, record in records]
    body = "".join(rows)
    failed = "".join(f"<li>{html.escape(reason)}</li>" for _, reason in failures)
    document = (
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>matcam: corrected materials</title>"
        f"<style>{_STYLE}</style><h1>{len(rows)} corrected materials</h1><p>{html.escape(said)}</p>"
        + (f"<h2>{len(failures)} failed</h2><ul class='failed'>{failed}</ul>" if failures else "")
        + "<p><label>Find <input id='find' type='search'></label> <small>A head sorts its column; a verdict opens. "
        "Sphere: as recorded (left), corrected (right), one lamp 50° from the camera, one exposure.</small></p>"
        f"<table><thead><tr><th class='text'>sphere</th>{heads}</tr></thead><tbody>{body}</tbody></table>"
        f"<script>{_SCRIPT}</script></html>\n"
    )
    with replacing(path, force=force) as temporary:
        temporary.write_text(document, encoding="utf-8")


def _row(folder: Path, name: str, record: dict[str, Any], inline: bool) -> str:
    cells = "".join(
        f"<td class='{'text' if column.kind == 'text' else ''}' data-v='{html.escape(str(value))}'>{shown}</td>"
        for column, (value, shown) in ((column, column.cell({**record, "name": name})) for column in _COLUMNS)
    )
    return f"<tr><td class='text'>{_thumbnail(folder, name, inline)}</td>{cells}</tr>\n"


def _thumbnail(folder: Path, name: str, inline: bool) -> str:
    source = quote(f"{name}.png")
    if inline:
        try:
            source = "data:image/png;base64," + base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        except OSError:
            return ""
    return f"<img loading=lazy width=128 height=64 alt='{html.escape(name)}, before and after' src='{source}'>"


def _name(record: dict[str, Any]) -> tuple[str, str]:
    name = record["name"]
    shown = html.escape(name)
    listed = record.get("run", {}).get("files", {})
    return name, f"<a href='{quote(name)}.html'>{shown}</a>" if f"{name}.html" in listed else shown


def _verdict(record: dict[str, Any]) -> tuple[str, str]:
    short = record.get("determination") or "not determined"
    more = "".join(f"<br>{html.escape(remark['text'])}" for remark in record.get("remarks") or ())
    return short, f"<details><summary>{short}</summary>{html.escape(record.get('verdict') or '')}{more}</details>"


def _number(value: Any, shown: Callable[[float], str]) -> tuple[Any, str]:
    """A number that may be missing."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "", "-"
    return repr(float(value)), shown(float(value))


def _with_std(value: Any, std: Any, scale: float = 1.0) -> tuple[Any, str]:
    def shown(x: float) -> str:
        error = f" ± {std * scale:.1g}" if isinstance(std, int | float) and math.isfinite(std) else ""
        return f"{x * scale:.4g}{error}"

    return _number(value, shown)


def _roughness(record: dict[str, Any]) -> tuple[Any, str]:
    """The first number of a fit is its lobe's."""
    params, std = record["fit"]["params"], record["fit"]["std"]
    name = next(iter(params), None)
    return ("", "-") if name is None else _with_std(params[name], std.get(name))


def _freed(name: str, scale: float = 1.0) -> Callable[[dict[str, Any]], tuple[Any, str]]:
    """A number of the rig as the data would have it."""

    def cell(record: dict[str, Any]) -> tuple[Any, str]:
        fit = (record.get("doubts") or {}).get(name)
        return _with_std(fit["params"].get(name), fit["std"].get(name), scale) if fit else ("", "-")

    return cell


def _lost(degrees: str) -> Callable[[dict[str, Any]], tuple[Any, str]]:
    return lambda record: _number((record.get("peak_lost") or {}).get(degrees), lambda x: f"{x:.0%}")


_COLUMNS = (
    _Column("material", "text", _name),
    _Column("verdict", "text", _verdict),
    _Column("lobe", "text", lambda r: (r["fit"]["ndf"], html.escape(str(r["fit"]["ndf"])))),
    _Column("roughness<br>(slope)", "number", _roughness),
    _Column(
        "half width at half<br>maximum (degrees)",
        "number",
        lambda r: _with_std(r["fit"]["hwhm_rad"], r["fit"]["hwhm_std_rad"], 180 / math.pi),
    ),
    _Column("peak lost<br>at 5°", "number", _lost("5")),
    _Column("at 45°", "number", _lost("45")),
    _Column("at 75°", "number", _lost("75")),
    _Column("entries<br>supported", "number", lambda r: _number(r.get("supported_share"), lambda x: f"{x:.0%}")),
    _Column(
        "noise of<br>a pixel",
        "number",
        lambda r: _number((r["fit"].get("noise") or {}).get("relative"), lambda x: f"{x:.1%}"),
    ),
    _Column("lens left<br>free (px)", "number", _freed(LENS)),
    _Column("lamp left free<br>(degrees)", "number", _freed(LAMP, 180 / math.pi)),
    _Column("time<br>(s)", "number", lambda r: _number((r.get("run") or {}).get("seconds"), lambda x: f"{x:.1f}")),
)
