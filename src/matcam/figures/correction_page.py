"""The page that `correct` writes: one HTML file that can be read offline and kept with the data."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from matcam.core.io import replacing
from matcam.figures.spheres import ball, body_white, shown
from matcam.figures.style import BLUE, GREEN, GREY, VERMILION, degrees_axis, styled
from matcam.inverse.correction.correction import Correction

_SLICES = (5, 45, 65, 75)
_BALL = 180
_STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse}td,th{padding:.2rem .9rem;text-align:right;border-bottom:1px solid #ddd}
td:first-child,th:first-child{text-align:left}img{max-width:100%}.verdict{background:#f2f2f2;padding:.6rem 1rem}"""


def write_correction_page(
    path: str | Path, raw: xr.DataArray, done: Correction, name: str, *, force: bool = False
) -> None:
    """Write the page of a correction: verdict, numbers with errors, F, lobes and spheres before and after, no network
    needed. raw: the table that was corrected."""
    found = done.fit
    rows = "".join(
        f"<tr><td>{html.escape(key)}</td><td>{value:.6g}</td><td>{found.std[key]:.2g}</td></tr>"
        for key, value in found.params.items()
    )
    notes = "".join(f"<li>{html.escape(remark.text)}</li>" for remark in done.remarks)
    pictures = [
        ("Fresnel term: from the recorded peak, and through the camera", reflectance_figure(raw, done)),
        ("The lobe, as recorded and as a perfect camera would have measured it", lobe_figure(raw, done)),
        ("A sphere in the light of one lamp, before and after", ball_figure(raw, done)),
    ]
    drawn = "".join(
        f"<h2>{html.escape(text)}</h2><img alt='{html.escape(text)}' src='{_inline(f)}'>" for text, f in pictures
    )
    document = (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{html.escape(name)}: corrected</title>"
        f"<style>{_STYLE}</style><h1>{html.escape(name)}</h1><p class='verdict'>{html.escape(done.verdict)}</p>"
        f"<ul>{notes}</ul><h2>Parameters of the lobe ({html.escape(found.family)})</h2>"
        f"<table><tr><th>parameter</th><th>value</th><th>std</th></tr>{rows}"
        f"<tr><td>half width at half maximum, rad</td><td>{found.hwhm:.6g}</td><td>{found.hwhm_std:.2g}</td></tr>"
        f"</table>{drawn}</html>\n"
    )
    with replacing(path, force=force) as temporary:
        temporary.write_text(document, encoding="utf-8")


def reflectance_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """F over theta_d, free in every picture, beside the recorded peak over cos^2, both over their mean at 10 to 45 degrees;
    middle channel."""
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
    """BRDF against theta_h at several theta_d, phi_d = 90 degrees, middle channel."""
    channel, phi = raw.sizes["channel"] // 2, 90
    theta_h = np.degrees(raw["theta_h"].values)
    with styled():
        figure = Figure(figsize=(9.6, 6.4), layout="constrained")
        for axes, j in zip(figure.subplots(2, 2).flat, _SLICES, strict=True):
            before = raw.values[:, j, phi, channel]
            after, std = (done.table[v].values[:, j, phi, channel] for v in ("brdf", "brdf_std"))
            good = done.table["supported"].values[:, j, phi, channel]
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
            axes.set_title(rf"$\theta_d$ = {np.degrees(raw['theta_d'].values[j]):.1f}°", loc="left")
            axes.set_xlabel(r"half angle $\theta_h$ [degrees]")
            axes.set_ylabel("BRDF [1/sr]")
        drawn = [axes for axes in figure.axes if axes.lines]
        if drawn:
            drawn[0].legend(loc="lower left")
    return figure


def ball_figure(raw: xr.DataArray, done: Correction) -> Figure:
    """A sphere under one distant lamp 50 degrees from the camera, from the table before and after, and its highlight 20
    times closer and as bright as it is."""
    with styled():
        figure = Figure(figsize=(8.6, 8.6), layout="constrained")
        panels = figure.subplots(2, 2)
        for row, (zoom, exposed) in zip(panels, ((1.0, "for the body"), (20.0, "for the highlight")), strict=True):
            before, after = (ball(values, _BALL, zoom) for values in (raw.values, done.table["brdf"].values))
            white = body_white(after) if zoom == 1 else after.max(initial=0)
            for axes, picture, title in zip(row, (before, after), ("as recorded", "corrected"), strict=True):
                seen = shown(picture, white)
                axes.imshow(seen if seen.shape[-1] == 3 else seen[..., 0], cmap="gray", interpolation="nearest")
                axes.set_title(f"{title}, exposed {exposed}", loc="left")
                axes.axis("off")
        figure.supxlabel(
            "display-encoded, one exposure a row; below, the highlight 20 times closer", fontsize=8, color=GREY
        )
    return figure


def _inline(figure: Figure) -> str:
    stream = io.BytesIO()
    with styled():
        figure.savefig(stream, format="png", dpi=110)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
