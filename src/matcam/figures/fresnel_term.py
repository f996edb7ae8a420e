"""Figure 6: the Fresnel term of a measured material, with and without the camera."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, degrees_axis, styled

_TABLE_COLOURS = (GREEN, ORANGE, PURPLE, BLACK)
_MOST_TABLES = 4


def fresnel_figure(
    result: xr.Dataset, tables: xr.Dataset | None = None, title: str = "", channel: int | None = None
) -> Figure:
    """Raw and corrected F over theta_d beside tabulated metals (left), and the loss at the peak (right).

    result: from `fresnel`; tables: from `tabulated_fresnel`. channel: index; default the middle one (green).
    """
    channel = result.sizes["channel"] // 2 if channel is None else channel
    with styled():
        figure = Figure(figsize=(9.6, 5.0), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(2.1, 1))
        draw_fresnel(left, result, tables, channel)
        name = str(result["channel"].values[channel])
        left.set_title(title or f"{result.attrs['source']}: Fresnel term, channel {name}", loc="left")
        # under the axes: measured curves go everywhere
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=2, fontsize=8.2)
        _draw_loss(right, result)
    return figure


def draw_fresnel(axes: Axes, result: xr.Dataset, tables: xr.Dataset | None, channel: int) -> None:
    """The curves of one channel on one pair of axes."""
    one = result.isel(channel=channel)
    theta = np.degrees(one["theta_d"].values)
    supported = np.degrees(float(one["supported_angle"]))
    corrected, std = one["corrected"].values, one["corrected_std"].values
    low, high = np.degrees(result.attrs["normalised_over"])
    axes.axvspan(low, high, color="#F2F2F2", lw=0, zorder=0)
    axes.plot(theta, one["raw"], color=VERMILION, label="raw: from the recorded peak, camera ignored")
    axes.plot(
        theta, one["corrected_peak"], color=BLUE, lw=1, ls=(0, (1, 1.2)), label="peak over its loss (the paper's)"
    )
    axes.fill_between(theta, corrected - std, corrected + std, color=BLUE, alpha=0.25, lw=0)
    axes.plot(theta, corrected, color=BLUE, lw=2, label="corrected: lobe fitted through the camera, ± 1 std")
    if tables is not None:
        best = np.argsort(tables["rms_corrected"].isel(channel=channel).values, kind="stable")[:_MOST_TABLES]
        for index, colour in zip(sorted(best), _TABLE_COLOURS, strict=False):
            table = tables.isel(table=index, channel=channel)
            axes.plot(theta, table["tabulated"], color=colour, lw=1.2, ls="--", label=str(table["table"].values))
    if supported < theta[-1]:
        axes.axvline(supported, color=GREY, lw=0.8)
        axes.annotate(
            f"supported to {supported:.0f}°", (supported, 0), xycoords=("data", "axes fraction"), xytext=(-3, 4),
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
    axes.plot(theta, np.cos(np.radians(theta)), color=GREY, ls="--", lw=1, label=r"$\cos\,\theta_d$: narrowest")
    degrees_axis(axes, r"difference angle $\theta_d$")
    axes.set_xticks(range(0, 91, 30))
    axes.set_ylim(0, 1.05)
    axes.set_ylabel(r"recorded / true peak, relative to $\theta_d$ = 0 [-]")
    half = float(np.degrees(result["half_width"]))
    axes.set_title(f"Loss of this lobe,\nhalf width {half:.3f}°", loc="left")
    axes.legend(loc="lower left", fontsize=8.2)
