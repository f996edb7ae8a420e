"""The paper's Figures 3, 4 and 5, redrawn (Figure 6: figures/fresnel_term.py)."""

from __future__ import annotations

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.figures.style import BLUE, GREY, VERMILION, degrees_axis, styled


def highlight_figure(data: xr.Dataset) -> Figure:
    """Figures 3 and 4: a highlight on the sensor, after the optics, and in the pixels. data: `paper.figure_3_4`."""
    with styled():
        figure = Figure(figsize=(10, 3.3), layout="constrained")
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
    """Figure 5: relative loss at the peak against angle, for narrow to wide lobes. data: `paper.figure_5`."""
    with styled():
        figure = Figure(figsize=(7.4, 4.4), layout="constrained")
        axes = figure.subplots()
        theta = np.degrees(data["theta"].values)
        ratios = data["ratio"].values
        # cividis: made to look the same to readers with and without red-green blindness
        colours = matplotlib.colormaps["cividis"](np.linspace(0.0, 0.88, ratios.size))
        for ratio, colour in zip(ratios, colours, strict=True):
            one = data.sel(ratio=ratio)
            axes.plot(theta, one["loss"], color=colour, label=f"{ratio:g}")
            axes.plot(theta, one["loss_printed"], color=colour, lw=0.9, ls=":")
        axes.plot(theta, data["cosine"], color=GREY, ls="--", lw=1.2)
        degrees_axis(axes, r"viewing angle $\theta_o$")
        axes.set_ylim(0, 1.04)
        axes.set_ylabel(r"recorded / true peak, relative to $\theta_o$ = 0 [-]")
        axes.set_title(
            "Loss at the specular peak. Solid: tangent plane; dotted: eq. (11) as printed;\n"
            r"dashed: $\cos\,\theta_o$",
            loc="left",
            fontsize=9.5,
        )
        axes.legend(
            title="lobe width /\n" r"($\sigma_{mtf} / r_s$)", loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5
        )
    return figure
