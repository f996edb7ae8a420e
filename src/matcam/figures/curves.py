"""Curves over an angle or a position: Figures 3 to 6 of Holzschuch & Pacanowski (2017), and the predicted loss of a rig."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    degrees_axis,
    draw_with_std,
    drawing,
)
from matcam.forward.prediction import LOSS, Prediction

_LIMIT = f"{100 * LOSS:g} % loss"
"""Label of the loss limit in a figure."""
RAW_LABEL = "raw: from the recorded peak, camera ignored"
"""Label of the raw curve of a result of `fresnel`."""


def fresnel_figure(result: xr.Dataset, tables: xr.Dataset | None = None, channel: int | None = None) -> Figure:
    """Draw the raw and the corrected Fresnel term F, and the recorded share of the peak.

    The left panel shows F and tabulated metals over the difference angle theta_d. The right panel shows the recorded
    share of the peak, relative to that at theta_d = 0.

    Args:
        result: result of `fresnel`.
        tables: result of `tabulated_fresnel`; None: no tables. Default: None.
        channel: index of the channel. Default: None, the middle one (green).
    """
    channel = result.sizes["channel"] // 2 if channel is None else channel
    with drawing(9.6, 5.0, layout=None) as figure:  # fixed margins, because the computation of margins is slow
        left, right = figure.subplots(1, 2, width_ratios=(2.1, 1))
        draw_fresnel(left, result, tables, channel)
        handles, labels = left.get_legend_handles_labels()
        rows = -(-len(labels) // 2)
        figure.subplots_adjust(left=0.065, right=0.988, top=0.91, bottom=0.135 + 0.037 * rows, wspace=0.2)
        name = str(result["channel"].values[channel])
        left.set_title(f"{result.attrs['source']}: Fresnel term, channel {name}", loc="left")
        # legend under the axes, because measured curves may cover any part of them
        figure.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.05, 0.0), ncols=2, fontsize=8.2)
        _draw_loss(right, result.isel(channel=channel))
    return figure


def draw_fresnel(axes: Axes, result: xr.Dataset, tables: xr.Dataset | None, channel: int) -> None:
    one = result.isel(channel=channel)
    theta = np.degrees(one["theta_d"].values)
    supported = np.degrees(float(one["supported_angle"]))
    corrected, std = one["corrected"].values, one["corrected_std"].values
    low, high = np.degrees(result.attrs["normalised_over"])
    axes.axvspan(low, high, color="#F2F2F2", lw=0, zorder=0)
    axes.plot(theta, one["raw"], color=VERMILION, label=RAW_LABEL)
    axes.plot(
        theta,
        one["corrected_peak"],
        color=BLUE,
        lw=1,
        ls=(0, (1, 1.2)),
        label="peak over its response (as in the paper)",
    )
    label = "corrected: lobe fitted through the camera, ± 1 std"
    draw_with_std(axes, theta, corrected, std, BLUE, lw=2, label=label)
    if tables is not None:
        best = np.argsort(tables["rms_corrected"].isel(channel=channel).values, kind="stable")[:4]
        among = "closest: " if tables.sizes["table"] > len(best) else ""
        for index, colour in zip(sorted(best), (GREEN, ORANGE, PURPLE, BLACK), strict=False):
            table = tables.isel(table=index, channel=channel)
            label = f"{among}{table['table'].values}"
            axes.plot(theta, table["tabulated"], color=colour, lw=1.2, ls="--", label=label)
    if supported < theta[-1]:
        axes.axvline(supported, color=GREY, lw=0.8)
        axes.annotate(
            f"supported to {supported:.1f}°", (supported, 0), xycoords=("data", "axes fraction"), xytext=(-3, 4),
            textcoords="offset points", ha="right", va="bottom", fontsize=8, color=GREY, rotation=90,
            bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1},
        )  # fmt: skip
    degrees_axis(axes, r"difference angle $\theta_d$")
    axes.set_ylabel(f"F / mean of F over {low:.0f} to {high:.0f}° [-]")
    used = np.concatenate([corrected[theta < 87], one["raw"].values[theta < 87]])
    axes.set_ylim(0, 1.25 * np.nanquantile(used, 0.98))


def _draw_loss(axes: Axes, result: xr.Dataset) -> None:
    theta = np.degrees(result["theta_d"].values)
    response = result["response"].values
    axes.plot(theta, response / response[0], color=BLUE, label="this lobe")
    axes.plot(theta, np.cos(np.radians(theta)), color=GREY, ls="--", lw=1, label=r"$\cos\,\theta_d$: narrowest lobe")
    degrees_axis(axes, r"difference angle $\theta_d$")
    axes.set_xticks(range(0, 91, 30))
    axes.set_ylim(0, 1.05)
    axes.set_ylabel(r"recorded / true peak, relative to $\theta_d$ = 0 [-]")
    half = float(np.degrees(result["hwhm"]))
    axes.set_title(f"Recorded share of the peak,\nhalf width {half:.3f}°", loc="left")
    axes.legend(loc="lower left", fontsize=8.2)


def prediction_figure(data: Prediction, title: str) -> Figure:
    """Draw the relative response over the viewing angle for each roughness.

    The response is the ratio of the recorded to the true peak, relative to normal view. Loss angles are marked. `data`
    is the result of `predicted`.
    """
    with drawing(7.4, 4.4) as figure:
        axes = figure.subplots()
        draw_prediction(axes, data.dataset())
        axes.set_title(title, loc="left", fontsize=9.5)
    return figure


def draw_prediction(axes: Axes, data: xr.Dataset) -> None:
    """Draw the relative response over the viewing angle for each roughness.

    The response is the ratio of the recorded to the true peak, relative to normal view. Loss angles are marked. `data`
    is the result of `predict`.
    """
    colours = _shades(data.sizes["roughness"])
    limit, theta = 1 - LOSS, np.degrees(data["theta"].values)
    angles = np.degrees(data["loss_angle"].values)
    rows = zip(data["roughness"].values, data["relative_response"].values, angles, colours, strict=True)
    for value, relative, angle, colour in rows:
        axes.plot(theta, relative, color=colour, label=f"{value:g}")
        if angle < 90:
            axes.plot([angle], [limit], "o", color=colour, ms=4.5, mec=BLACK, mew=0.5)
    axes.axhline(limit, color=GREY, lw=0.8)
    axes.annotate(_LIMIT, (1, limit), xytext=(0, 3), textcoords="offset points", fontsize=8, color=GREY)
    axes.plot(theta, np.cos(np.radians(theta)), color=GREY, ls="--", lw=1.2, label=r"$\cos\,\theta_o$")
    _finish_loss(axes, f"roughness\n({data.attrs['family']})")


def _shades(count: int) -> np.ndarray:
    # cividis: similar appearance for readers with and without red-green blindness
    return matplotlib.colormaps["cividis"](np.linspace(0.0, 0.88, count))


def _finish_loss(axes: Axes, title: str) -> None:
    """Label the axes of a relative response over the viewing angle. `title` is the title of the legend."""
    degrees_axis(axes, r"viewing angle $\theta_o$")
    axes.set_ylim(0, 1.04)
    axes.set_ylabel(r"recorded / true peak, relative to $\theta_o$ = 0 [-]")
    axes.legend(title=title, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5)


def plane_figure(data: Prediction, title: str) -> Figure:
    """Draw the relative response over viewing angle and roughness.

    The response is the ratio of the recorded to the true peak, relative to normal view. A line marks the loss angle of
    each roughness. `data` is the result of `predicted`.
    """
    with drawing(7.4, 4.6) as figure:
        axes = figure.subplots()
        axes.grid(False)
        theta, roughness, relative = np.degrees(data.theta), data.roughness, data.relative_response
        steps = np.linspace(0, 1.0, 11)
        filled = axes.contourf(theta, roughness, np.clip(relative, 0, 1), levels=steps, cmap="cividis")
        limit = 1 - LOSS
        if relative.min() < limit < relative.max():
            lines = axes.contour(theta, roughness, relative, levels=[limit], colors=[BLACK], linewidths=1.6)
            axes.clabel(lines, fmt={limit: _LIMIT}, fontsize=8.5)
        axes.set_yscale("log")
        degrees_axis(axes, r"viewing angle $\theta_o$")
        axes.set_ylabel(f"roughness ({data.family}) [{'rad' if data.family == 'gaussian' else 'slope'}]")
        axes.set_title(title, loc="left", fontsize=9.5)
        figure.colorbar(filled, ax=axes, label=r"recorded / true peak, relative to $\theta_o$ = 0 [-]")
    return figure


def highlight_figure(data: xr.Dataset) -> Figure:
    """Draw a highlight on the sensor: the signal, the signal after the optics, and the values of the pixels.

    These are Figures 3 and 4 of Holzschuch & Pacanowski (2017). `data` is the result of `paper.figure_3_4`.
    """
    with drawing(10, 3.3) as figure:
        panels = figure.subplots(1, data.sizes["theta_o"], sharey=True)
        for axes, theta in zip(panels, data["theta_o"].values, strict=True):
            one = data.sel(theta_o=theta)
            axes.fill_between(data["x"], one["recorded"], step="mid", color="#C8C8C8", lw=0, label="pixels")
            pixels = np.unique(np.rint(data["x"].values))
            heights = one["recorded"].sel(x=pixels, method="nearest")
            borders = pixels[1:] - 0.5
            taller = np.maximum(heights.values[1:], heights.values[:-1])
            axes.vlines(borders, 0, taller, color="#9A9A9A", lw=0.5)
            axes.plot(data["x"], one["signal"], color=BLUE, label="signal")
            axes.plot(data["x"], one["after_optics"], color=VERMILION, ls="--", label="after the optics")
            axes.set_title(rf"$\theta_o$ = {np.degrees(theta):.0f}°", loc="left")
            axes.set_xlabel("position on the sensor [px]")
            axes.set_xlim(float(data["x"][0]), float(data["x"][-1]))
            axes.grid(axis="x", visible=False)
        panels[0].set_ylabel("signal / true peak [-]")
        panels[0].set_ylim(0, 1.08)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8.5)
        ratio = data.attrs["ratio"]
        figure.suptitle(
            rf"Highlight of standard deviation {ratio:g} $\sigma_{{mtf}} / r_s$, across the limb of a sphere",
            fontsize=10.5,
            x=0.01,
            ha="left",
        )
    return figure


def loss_figure(data: xr.Dataset) -> Figure:
    """Draw the ratio of the recorded to the true peak over the viewing angle, relative to normal view.

    This is Figure 5 of Holzschuch & Pacanowski (2017), with one curve for each width of the lobe. `data` is the result
    of `paper.figure_5`.
    """
    with drawing(7.4, 4.4) as figure:
        axes = figure.subplots()
        theta = np.degrees(data["theta"].values)
        ratios = data["ratio"].values
        for ratio, colour in zip(ratios, _shades(ratios.size), strict=True):
            one = data.sel(ratio=ratio)
            axes.plot(theta, one["loss"], color=colour, label=f"{ratio:g}")
            axes.plot(theta, one["loss_printed"], color=colour, lw=0.9, ls=":")
        axes.plot(theta, data["cosine"], color=GREY, ls="--", lw=1.2)
        _finish_loss(axes, "lobe width /\n" r"($\sigma_{mtf} / r_s$)")
        axes.set_title(
            "Recorded over true peak. Solid: tangent plane; dotted: eq. (11) as printed;\n"
            r"dashed: $\cos\,\theta_o$",
            loc="left",
            fontsize=9.5,
        )
    return figure


def draw_corrected_lobe(axes: Axes, table: xr.Dataset, recorded: xr.DataArray, at: tuple[Any, ...]) -> None:
    """Draw the recorded and the corrected BRDF over theta_h.

    Args:
        axes: axes to draw on.
        table: result of `correct`.
        recorded: the table that was corrected, 1/sr.
        at: index into the tables that selects all theta_h.
    """
    theta_h = np.degrees(recorded["theta_h"].values)
    before = recorded.values[at]
    after, std = (table[v].values[at] for v in ("brdf", "brdf_std"))
    good = table["supported"].values[at]
    seen = np.isfinite(before) & (before > 0)
    if not seen.any():
        axes.text(0.5, 0.5, "missing in this table", transform=axes.transAxes, ha="center", color=GREY)
        return
    axes.plot(theta_h[seen], before[seen], color=VERMILION, label="recorded")
    draw_lobe(axes, theta_h, after, std, seen, good, "corrected")
    top = np.nanmax(after[seen])
    axes.set_ylim(max(top * 1e-7, np.nanmin(before[seen]) / 2), top * 2)


def draw_lobe(
    axes: Axes, theta_h: np.ndarray, value: np.ndarray, std: np.ndarray, seen: Any, good: Any, label: str
) -> None:
    """Draw a BRDF over theta_h, degrees, on logarithmic axes.

    `value` and `std` are the BRDF and its standard deviation, 1/sr. `seen` is the mask of the drawn angles, and `good`
    is the mask of the supported angles. `label` is the label of the curve.
    """
    axes.plot(theta_h[seen], value[seen], color=BLUE, label=label)
    low = np.maximum(value - std, value * 1e-2)
    axes.fill_between(theta_h[seen], low[seen], (value + std)[seen], color=BLUE, alpha=0.25, lw=0, label="± 1 std")
    axes.plot(theta_h[good], value[good], ".", color=GREEN, ms=5, label="supported")
    axes.set(xscale="log", yscale="log", xlabel=r"half angle $\theta_h$ [degrees]", ylabel="BRDF [1/sr]")
    axes.minorticks_off()  # a hundred artists for each panel would take most of the time of a page
