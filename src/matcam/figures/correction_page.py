"""The page that `correct` writes: one HTML file that can be read offline and kept with the data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.core.grid import merl_grid, sampling_of
from matcam.core.remark import texts
from matcam.figures.spheres import body_white, encoded_for_screen, table_sphere
from matcam.figures.style import BLUE, GREEN, GREY, VERMILION, degrees_axis, inline_png, styled, write_page
from matcam.inverse.correction.correction import Correction

_SLICES = (5, 45, 65, 75)
_SPHERE = 180  # px


def write_correction_page(
    path: str | Path, raw: xr.DataArray, done: Correction, name: str, *, force: bool = False
) -> None:
    """Write the page of a correction: verdict, parameters, F, lobes and spheres before and after.

    Args:
        path: HTML file to write; it needs no network and no other file.
        raw: the table that was corrected.
        done: its correction.
        name: title of the page.
        force: whether to replace the file. Default: False.
    """
    found = done.fit
    figures = [
        ("Fresnel term: from the recorded peak, and through the camera", reflectance_figure(raw, done)),
        ("The lobe, as recorded and as a perfect camera would have measured it", lobe_figure(raw, done)),
        ("A sphere in the light of one lamp, before and after", sphere_figure(raw, done)),
    ]
    content = {
        "name": name,
        "verdict": done.verdict,
        "remarks": texts(done.remarks),
        "family": found.family,
        "parameters": [
            *((key, value, found.std[key]) for key, value in found.params.items()),
            ("half width at half maximum, rad", found.hwhm, found.hwhm_std),
        ],
        "figures": [(title, inline_png(figure)) for title, figure in figures],
    }
    write_page(path, "correction_page.html", content, force=force)


def reflectance_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw F over theta_d, free in every slice, beside the recorded peak times cos^2, in the middle channel.

    Both are divided by their mean from 10 to 45 degrees.
    """
    curves = done.fit.curves
    channel = curves.sizes["channel"] // 2
    theta = np.degrees(curves["theta_d"].values)
    fitted, std = curves["fresnel"].values[:, channel], curves["fresnel_std"].values[:, channel]
    angle = raw["theta_d"].values
    top = raw.values[0, ..., channel]
    there = np.isfinite(top)
    peak = np.where(there.any(1), np.where(there, top, 0).sum(1) / np.maximum(there.sum(1), 1), np.nan)
    peak = peak * np.cos(angle) ** 2
    middle = (angle > np.radians(10)) & (angle < np.radians(45))
    used = (theta > 10) & (theta < 45)
    scale = np.nanmean(fitted[used])  # below 0 where noise is all that there is of a lobe
    with styled():
        figure = Figure(figsize=(7.5, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot(
            np.degrees(angle),
            peak / np.nanmean(peak[middle]),
            color=VERMILION,
            label="recorded peak × cos², no masking",
        )
        axes.errorbar(
            theta, fitted / scale, std / abs(scale), color=BLUE, fmt="o", ms=4, label="through the camera, ± 1 std"
        )
        degrees_axis(axes, r"difference angle $\theta_d$")
        axes.set_ylabel("F / mean of F over 10 to 45° [-]")
        axes.set_ylim(0, None)
        axes.legend(loc="lower left")
    return figure


def lobe_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw the BRDF over theta_h at several theta_d, phi_d = 90 degrees, in the middle channel."""
    channel, grid = raw.sizes["channel"] // 2, merl_grid(sampling_of(raw))
    theta_h = np.degrees(raw["theta_h"].values)
    with styled():
        figure = Figure(figsize=(9.6, 6.4), layout="constrained")
        for axes, theta_d in zip(figure.subplots(2, 2).flat, np.radians(_SLICES), strict=True):
            at = (*grid.index(theta_d=theta_d, phi_d=np.pi / 2), channel)
            before = raw.values[at]
            after, std = (done.table[v].values[at] for v in ("brdf", "brdf_std"))
            good = done.table["supported"].values[at]
            seen = np.isfinite(before) & (before > 0)
            if not seen.any():
                axes.text(0.5, 0.5, "missing in this table", transform=axes.transAxes, ha="center", color=GREY)
                continue
            axes.plot(theta_h[seen], before[seen], color=VERMILION, label="recorded")
            axes.plot(theta_h[seen], after[seen], color=BLUE, label="corrected")
            low = np.maximum(after - std, after * 1e-2)
            axes.fill_between(theta_h[seen], low[seen], (after + std)[seen], color=BLUE, alpha=0.25, lw=0)
            axes.plot(theta_h[good], after[good], ".", color=GREEN, ms=5, label="supported")
            axes.set_xscale("log")
            axes.set_yscale("log")
            top = np.nanmax(after[seen])
            axes.set_ylim(max(top * 1e-7, np.nanmin(before[seen]) / 2), top * 2)
            axes.set_title(rf"$\theta_d$ = {np.degrees(grid.theta_d[at[1]]):.1f}°", loc="left")
            axes.set_xlabel(r"half angle $\theta_h$ [degrees]")
            axes.set_ylabel("BRDF [1/sr]")
        drawn = [axes for axes in figure.axes if axes.lines]
        if drawn:
            drawn[0].legend(loc="lower left")
    return figure


def sphere_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """Draw a sphere under one lamp 50 degrees from the camera, before and after, and its highlight 20 times closer."""
    with styled():
        figure = Figure(figsize=(8.6, 8.6), layout="constrained")
        panels = figure.subplots(2, 2)
        for row, (zoom, exposed) in zip(panels, ((1.0, "for the body"), (20.0, "for the highlight")), strict=True):
            before, after = (table_sphere(values, _SPHERE, zoom) for values in (raw.values, done.table["brdf"].values))
            white = body_white(after) if zoom == 1 else after.max(initial=0)
            for axes, picture, title in zip(row, (before, after), ("as recorded", "corrected"), strict=True):
                display = encoded_for_screen(picture, white)
                axes.imshow(
                    display if display.shape[-1] == 3 else display[..., 0], cmap="gray", interpolation="nearest"
                )
                axes.set_title(f"{title}, exposed {exposed}", loc="left")
                axes.axis("off")
        figure.supxlabel(
            "display-encoded, one exposure a row; below, the highlight 20 times closer", fontsize=8, color=GREY
        )
    return figure
