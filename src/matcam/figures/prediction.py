"""What to expect of a rig: loss at the peak against angle for several roughnesses."""

from __future__ import annotations

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.figures.style import BLACK, GREY, degrees_axis, styled


def prediction_figure(data: xr.Dataset, title: str) -> Figure:
    """Relative response over theta, one line per roughness, loss angles marked. data: `forward.peak.predict`."""
    with styled():
        figure = Figure(figsize=(7.4, 4.4), layout="constrained")
        axes = figure.subplots()
        theta = np.degrees(data["theta"].values)
        roughness = data["roughness"].values
        colours = matplotlib.colormaps["cividis"](np.linspace(0.0, 0.88, roughness.size))
        limit = 1 - data.attrs["loss"]
        for value, colour in zip(roughness, colours, strict=True):
            one = data.sel(roughness=value)
            axes.plot(theta, one["relative_response"], color=colour, label=f"{value:g}")
            angle = np.degrees(float(one["loss_angle"]))
            if angle < 90:
                axes.plot([angle], [limit], "o", color=colour, ms=4.5, mec=BLACK, mew=0.5)
        axes.axhline(limit, color=GREY, lw=0.8)
        axes.annotate(
            _name_of_limit(data), (1, limit), xytext=(0, 3), textcoords="offset points", fontsize=8, color=GREY
        )
        axes.plot(theta, np.cos(np.radians(theta)), color=GREY, ls="--", lw=1.2, label=r"$\cos\,\theta_o$")
        degrees_axis(axes, r"viewing angle $\theta_o$")
        axes.set_ylim(0, 1.04)
        axes.set_ylabel(r"recorded / true peak, relative to $\theta_o$ = 0 [-]")
        axes.set_title(title, loc="left", fontsize=9.5)
        axes.legend(
            title=f"roughness\n({data.attrs['ndf']})", loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5
        )
    return figure


def plane_figure(data: xr.Dataset, title: str) -> Figure:
    """Map of the (angle, roughness) plane: relative response, its loss angle drawn. data: `forward.peak.predict`."""
    with styled():
        figure = Figure(figsize=(7.4, 4.6), layout="constrained")
        axes = figure.subplots()
        axes.grid(False)
        theta, roughness = np.degrees(data["theta"].values), data["roughness"].values
        relative = data["relative_response"].values
        steps = np.linspace(0, 1.0, 11)
        filled = axes.contourf(theta, roughness, np.clip(relative, 0, 1), levels=steps, cmap="cividis")
        limit = 1 - data.attrs["loss"]
        if relative.min() < limit < relative.max():
            lines = axes.contour(theta, roughness, relative, levels=[limit], colors=[BLACK], linewidths=1.6)
            axes.clabel(lines, fmt={limit: _name_of_limit(data)}, fontsize=8.5)
        axes.set_yscale("log")
        degrees_axis(axes, r"viewing angle $\theta_o$")
        axes.set_ylabel(f"roughness ({data.attrs['ndf']}) [{'rad' if data.attrs['ndf'] == 'gaussian' else 'slope'}]")
        axes.set_title(title, loc="left", fontsize=9.5)
        figure.colorbar(filled, ax=axes, label=r"recorded / true peak, relative to $\theta_o$ = 0 [-]")
    return figure


def _name_of_limit(data: xr.Dataset) -> str:
    return f"{100 * data.attrs['loss']:g} % loss"
