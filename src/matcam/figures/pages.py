"""HTML pages of `correct`: page of a corrected table, and index of a run over many tables.

The page of a table is one file that works offline and can be stored with the data. The index can be sorted, and links
to the page of each material. It shows thumbnails, which are embedded or separate files. Figures have fixed margins,
because the computation of margins is slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.core.grid import merl_grid, sampling_of
from matcam.core.remark import texts
from matcam.core.results.summary import Quantity, half_width, with_std
from matcam.figures.curves import RAW_LABEL, draw_corrected_lobe
from matcam.figures.spheres import (
    encoded_for_screen,
    highlight_zoom,
    logarithmic,
    logarithmic_range,
    table_sphere,
    whole_sphere,
)
from matcam.figures.style import (
    BLUE,
    GREY,
    VERMILION,
    budget_tables,
    data_url,
    degrees_axis,
    drawing,
    inline_png,
    write_page,
)
from matcam.inverse.correction.correction import Correction
from matcam.inverse.fresnel_term import fresnel_of_peaks
from matcam.inverse.peak_curve import NORMALISED_OVER
from matcam.inverse.rig.rig_axes import LAMP, LENS

_SPHERE = 180  # height and width of the image of a sphere, px
_READ_AS = {
    "hwhm_rad": "half width at half maximum, rad",
    "tail_exponent": "tail exponent",
    "haze_share": "haze share",
}


def write_correction_page(
    path: str | Path, raw: xr.DataArray, done: Correction, name: str, *, force: bool = False
) -> None:
    """Write the page of a correction: verdict, parameters, Fresnel term, lobes and spheres.

    Args:
        path: HTML file to write; it needs no network and no other file.
        raw: the table that was corrected.
        done: correction of this table.
        name: title of the page.
        force: True to replace the file. Default: False.
    """
    found = done.fit
    figures = [
        ("Fresnel term: from the recorded peak, and fitted through the camera", reflectance_figure(raw, done)),
        ("Lobe, as recorded and as a perfect camera would have measured it", lobe_figure(raw, done)),
        ("Sphere under one lamp, before and after the correction", sphere_figure(raw, done)),
    ]
    content = {
        "name": name,
        "verdict": done.verdict,
        "remarks": texts(done.remarks),
        "family": found.lobe_name,
        "parameters": [
            *(Quantity(_READ_AS.get(key, key), value, found.std[key]) for key, value in found.params.items()),
            *([] if "hwhm_rad" in found.params else [half_width(found.hwhm, found.hwhm_std)]),
        ],
        "figures": [(title, inline_png(figure)) for title, figure in figures],
        "uncertainty": budget_tables(done.uncertainty_budgets()),
    }
    write_page(path, "correction_page.html", content, force=force)


def reflectance_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw the Fresnel term F over theta_d, from the fit and from the recorded peak.

    In the fit, F of every slice is a free parameter. F from the peak is computed as in `fresnel`. The channel is the
    middle one.
    """
    curves = done.fit.curves
    channel = curves.sizes["channel"] // 2
    theta = curves["theta_d"].values
    fitted, std = curves["fresnel"].values[:, channel], curves["fresnel_std"].values[:, channel]
    low, high = NORMALISED_OVER
    scale = np.nanmean(fitted[(theta > low) & (theta < high)])  # negative where a lobe is only noise
    angle, response = raw["theta_d"].values, done.table["response"].values[0, :, raw.sizes["phi_d"] // 2].T
    masking = None if done.table.attrs["masking"] == "none" else done.table.attrs["masking"]
    used = (angle > low) & (angle < high)
    of_peaks = fresnel_of_peaks(raw, angle, done.fit.ndf, masking, response / response[:, :1], used)
    with drawing(7.5, 4.2, layout=None) as figure:
        axes = figure.subplots(gridspec_kw={"left": 0.1, "right": 0.98, "bottom": 0.13, "top": 0.97})
        axes.plot(np.degrees(angle), of_peaks.raw[channel], color=VERMILION, label=RAW_LABEL)
        axes.errorbar(
            np.degrees(theta), fitted / scale, std / abs(scale), color=BLUE, fmt="o", ms=4,
            label="corrected: lobe fitted through the camera, ± 1 std",
        )  # fmt: skip
        degrees_axis(axes, r"difference angle $\theta_d$")
        axes.set_ylabel(f"F / mean of F over {np.degrees(low):.0f} to {np.degrees(high):.0f}° [-]")
        axes.set_ylim(0, None)
        axes.legend(loc="lower left")
    return figure


def lobe_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw the recorded and the corrected BRDF over theta_h at several theta_d.

    The azimuth phi_d is 90 degrees, and the channel is the middle one.
    """
    channel, grid = raw.sizes["channel"] // 2, merl_grid(sampling_of(raw))
    with drawing(9.6, 6.4, layout=None) as figure:
        margins = {"left": 0.08, "right": 0.985, "bottom": 0.085, "top": 0.955}
        panels = figure.subplots(2, 2, gridspec_kw={**margins, "wspace": 0.22, "hspace": 0.36})
        for axes, theta_d in zip(panels.flat, np.radians((5, 45, 65, 75)), strict=True):
            at = (*grid.index(theta_d=theta_d, phi_d=np.pi / 2), channel)
            draw_corrected_lobe(axes, done.table, raw, at)
            if axes.lines:
                axes.set_title(rf"$\theta_d$ = {np.degrees(grid.theta_d[at[1]]):.1f}°", loc="left")
        drawn = [axes for axes in figure.axes if axes.lines]
        if drawn:
            drawn[0].legend(loc="lower left")
    return figure


def sphere_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw a sphere and its magnified highlight before and after the correction.

    The lamp is 50 degrees from the camera. The sphere has a logarithmic scale. The highlight has a linear scale,
    encoded as sRGB. Both images of a row have the same scale.
    """
    tables = raw.values, done.table["brdf"].values
    # 20 times, if an image cannot contain the highlight completely
    zoom = highlight_zoom(*tables) or 20.0
    before, after = (whole_sphere(values, _SPHERE) for values in tables)
    black, white = logarithmic_range(before, after)
    closer = [table_sphere(values, _SPHERE, zoom) for values in tables]
    brightest = max(float(one.max(initial=0)) for one in closer)
    rows = (
        ("whole sphere", [logarithmic(one, black, white) for one in (before, after)]),
        (f"highlight, {zoom:g} times larger", [encoded_for_screen(one, brightest) for one in closer]),
    )
    with drawing(8.6, 8.6, layout=None) as figure:
        margins = {"left": 0.01, "right": 0.99, "bottom": 0.035, "top": 0.965}
        panels = figure.subplots(2, 2, gridspec_kw={**margins, "wspace": 0.02, "hspace": 0.08})
        for row, (part, pictures) in zip(panels, rows, strict=True):
            for axes, picture, title in zip(row, pictures, ("as recorded", "corrected"), strict=True):
                shown = picture if picture.shape[-1] == 3 else picture[..., 0]
                axes.imshow(shown, cmap="gray", interpolation="nearest", vmin=0, vmax=1)
                axes.set_title(f"{title}: {part}", loc="left")
                axes.axis("off")
        figure.supxlabel(
            f"one scale per row; above: logarithmic, from {black:.1g} to {white:.1g} 1/sr; below: encoded for the screen",
            fontsize=8,
            color=GREY,
        )
    return figure


INLINE = 1000
"""Number of materials up to which thumbnails (16 kB each) are embedded in the page."""


class _Cell(NamedTuple):
    """Cell of the index.

    Attributes:
        value: sort key of the cell; "" is last.
        text: displayed text.
        link: address of the link; "": no link.
        details: lines that are shown after a click on the text.
    """

    value: str
    text: str
    link: str = ""
    details: tuple[str, ...] = ()


def write_run_index(
    path: str | Path,
    records: Iterable[tuple[str, dict[str, Any]]],
    failures: Sequence[str],
    *,
    summary: str = "",
    inline: bool = True,
    force: bool = False,
) -> None:
    """Write the index of a run into the folder of the run.

    Args:
        path: HTML file to write.
        records: (NAME, content of NAME.json) of each finished material. The folder also contains NAME.png and, if the
            record lists it, NAME.html.
        failures: one line for each material that failed.
        summary: description of the common settings of all materials of the run. Default: "".
        inline: True to embed thumbnails in the page, False to link to their files. Default: True.
        force: True to replace the file. Default: False.
    """
    folder, records = Path(path).parent, list(records)
    rows = [
        (name, _thumbnail(folder, name, inline), [cell({**record, "name": name}) for _, _, cell in _COLUMNS])
        for name, record in records
    ]
    withheld = sum(bool(record.get("withheld")) for _, record in records)
    content = {"columns": _COLUMNS, "rows": rows, "failures": failures, "summary": summary, "withheld": withheld}
    write_page(path, "run_index.html", content, force=force)


def _thumbnail(folder: Path, name: str, inline: bool) -> str:
    if not inline:
        return quote(f"{name}.png")
    try:
        return data_url((folder / f"{name}.png").read_bytes())
    except OSError:
        return ""


def _material(record: dict[str, Any]) -> _Cell:
    name = record["name"]
    listed = record.get("run", {}).get("files", {})
    return _Cell(name, name, f"{quote(name)}.html" if f"{name}.html" in listed else "")


def _verdict(record: dict[str, Any]) -> _Cell:
    short = record.get("determination") or "not determined"
    verdict = record.get("verdict") or ""
    return _Cell(short, short, details=(verdict, *(remark["text"] for remark in record.get("remarks") or ())))


def _number(value: Any, text: Callable[[float], str]) -> _Cell:
    if not isinstance(value, int | float) or not math.isfinite(value):
        return _Cell("", "-")
    return _Cell(repr(float(value)), text(float(value)))


def _with_std(value: Any, std: Any, scale: float = 1.0) -> _Cell:
    def text(x: float) -> str:
        known = isinstance(std, int | float) and 0 < std < math.inf
        return with_std(x * scale, std * scale) if known else f"{x * scale:.4g}"

    return _number(value, text)


def _lobe(record: dict[str, Any]) -> _Cell:
    words = (
        f"spline-modified {record['fit']['ndf']}" if record["fit"].get("spline_modified") else str(record["fit"]["ndf"])
    )
    return _Cell(words, words)


def _roughness(record: dict[str, Any]) -> _Cell:
    params, std = record["fit"]["params"], record["fit"]["std"]
    name = None if record["fit"].get("spline_modified") else next(iter(params), None)
    return _Cell("", "-") if name is None else _with_std(params[name], std.get(name))


def _free_parameter(name: str, scale: float = 1.0) -> Callable[[dict[str, Any]], _Cell]:
    def cell(record: dict[str, Any]) -> _Cell:
        fit = (record.get("refits") or {}).get(name)
        return _with_std(fit["params"].get(name), fit["std"].get(name), scale) if fit else _Cell("", "-")

    return cell


def _peak_loss(degrees: str) -> Callable[[dict[str, Any]], _Cell]:
    return lambda record: _number((record.get("peak_lost") or {}).get(degrees), lambda x: f"{x:.0%}")


def _relative_std_75(record: dict[str, Any]) -> _Cell:
    std, gain = record.get("correction_std_75"), record.get("peak_gain_75")
    return _number(None if std is None or not gain else std / gain, lambda x: f"{x:.1%}")


_COLUMNS: tuple[tuple[tuple[str, ...], str, Callable[[dict[str, Any]], _Cell]], ...] = (
    (("material",), "text", _material),
    (("verdict",), "text", _verdict),
    (("lobe",), "text", _lobe),
    (("roughness", "(slope)"), "number", _roughness),
    (
        ("half width at half", "maximum (degrees)"),
        "number",
        lambda r: _with_std(r["fit"]["hwhm_rad"], r["fit"]["hwhm_std_rad"], 180 / math.pi),
    ),
    (("peak lost", "at 5°"), "number", _peak_loss("5")),
    (("at 45°",), "number", _peak_loss("45")),
    (("at 75°",), "number", _peak_loss("75")),
    (("std of the correction", "at 75°, relative"), "number", _relative_std_75),
    (
        ("supported, of entries", "with known uncertainty"),
        "number",
        lambda r: _number(r.get("supported_share"), lambda x: f"{x:.0%}"),
    ),
    (
        ("noise of", "a pixel"),
        "number",
        lambda r: _number((r["fit"].get("noise") or {}).get("relative"), lambda x: f"{x:.1%}"),
    ),
    (("free lens", "(px)"), "number", _free_parameter(LENS)),
    (("free lamp radius", "(degrees)"), "number", _free_parameter(LAMP, 180 / math.pi)),
    (("time", "(s)"), "number", lambda r: _number((r.get("run") or {}).get("seconds"), lambda x: f"{x:.1f}")),
)
"""Columns of the index: lines of the header, "text" or "number", and a function from a record to its cell."""
