"""HTML page of a reconstruction: verdict, error budget, and figures to check the result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.arrays import evenly
from matcam.core.grid import merl_grid
from matcam.core.results.summary import Quantity
from matcam.figures.curves import draw_lobe
from matcam.figures.fitted_windows import fitted_windows, pinhole_slice
from matcam.figures.strip_profiles import profile_figure
from matcam.figures.style import (
    BLUE,
    GREY,
    VERMILION,
    budget_tables,
    channel_colour,
    degrees_axis,
    drawing,
    inline_png,
    write_page,
)
from matcam.reconstruction.picture_rule import WINDOW
from matcam.reconstruction.stated.captured_scene import INCOMPLETE

if TYPE_CHECKING:
    from matcam.reconstruction.reconstruction import Reconstruction

_BUDGET = (
    ("ratio", "F at grazing angles over F at 10 to 45°, %", 100.0),
    ("level", "F at 10 to 45°, absolute, %", 100.0),
    ("roughness", "roughness, %", 100.0),
    ("radius_px", "radius of the outline, px", 1.0),
    ("lens", "lens, %", 100.0),
)


def write_reconstruction_page(
    path: str | Path,
    result: Reconstruction,
    name: str,
    *,
    overview: MergedPicture | None = None,
    exposures: Sequence[tuple[str, float, float]] = (),
    force: bool = False,
) -> None:
    """Write the page of a reconstruction.

    Args:
        path: HTML file to write; it needs no network and no other file.
        result: the reconstruction.
        name: title of the page.
        overview: image of a sphere, for a figure with the fitted outline and highlights. Default: None, no such figure.
        exposures: name, relative light and standard deviation of the light for each exposure. Default: (), exposures
            are not listed.
        force: True to replace the file. Default: False.
    """
    figures = _of_cylinder(result) if result.sample == "cylinder" else _of_sphere(result, overview)
    solution = result.fit.solution
    columns = [column for column in _BUDGET if column[0] in result.budget["total"]]
    content = {
        "name": name,
        "verdict": result.verdict,
        "remarks": [f"left out: {remark}" if remark.code in INCOMPLETE else str(remark) for remark in result.remarks],
        "parameters": [Quantity(name, *pair) for name, pair in result.parameters.items()],
        "budget_columns": [words for _, words, _ in columns],
        "budget": [
            (source, [scale * parts[key] for key, _, scale in columns]) for source, parts in result.budget.items()
        ],
        "lengths": result.length_quantities,
        "pictures": [
            (name, np.degrees(theta_d), chi2, left_out)
            for name, theta_d, chi2, left_out in zip(
                result.fit.names, solution.theta_d, solution.chi2, solution.left_out, strict=True
            )
        ],
        "explanations": result.tried,
        "not_determined": [(*one.names, one.correlation) for one in result.not_determined],
        "exposures": exposures,
        "uncertainty": budget_tables(result.uncertainty_budgets()),
        "figures": [(title, inline_png(figure)) for title, figure in figures],
    }
    write_page(path, "reconstruction_page.html", content, force=force)


def _of_cylinder(result: Reconstruction) -> list[tuple[str, Figure]]:
    return [
        ("Profiles of the strips about their highlights: recorded and fitted", profile_figure(result)),
        ("Fresnel term: strengths of the images, and the fitted curve", reflectance_figure(result)),
    ]


def _of_sphere(result: Reconstruction, overview: MergedPicture | None) -> list[tuple[str, Figure]]:
    figures = [
        ("Fresnel term: strengths of the images, and the fitted curve", reflectance_figure(result)),
        (
            "Lobe, as a perfect camera would have measured it, and from the same images by the pinhole model",
            lobe_figure(result),
        ),
        ("Highlights: recorded, fitted, and residual", highlight_figure(result)),
    ]
    if overview is not None:
        figures.insert(0, ("Fitted outline and highlights", overview_figure(result, overview)))
    return figures


def overview_figure(result: Reconstruction, picture: MergedPicture) -> Figure:
    geometry = result.geometry
    column, row = geometry["centre_px"][0]
    radius = geometry["radius_px"][0]
    values = np.where(np.isfinite(picture.values), picture.values, 0.0)
    low, high = np.percentile(values, [5, 99.5])
    floor = max(high * 1e-4, 1e-12)
    turn = np.linspace(0, 2 * np.pi, 361)
    first_row, first_column = picture.origin
    height, width = values.shape
    # 4.9 inches are left for the image beside its labels and the colour bar; a figure of its shape has no blank bands
    with drawing(6.8, float(np.clip(4.9 * height / width + 0.7, 2.5, 9.0))) as figure:
        axes = figure.subplots()
        shown = axes.imshow(
            np.log10(np.maximum(values - min(low, 0.0), floor)),
            cmap="gray",
            extent=(first_column - 0.5, first_column + width - 0.5, first_row + height - 0.5, first_row - 0.5),
            vmax=np.log10(max(values.max(), 2 * floor)),
            vmin=np.log10(floor),
        )
        axes.plot(column + radius * np.cos(turn), row + radius * np.sin(turn), color=BLUE, lw=1, label="fitted outline")
        windows = fitted_windows(result)
        axes.plot(
            windows["highlight_column"],
            windows["highlight_row"],
            "+",
            color=VERMILION,
            ms=8,
            mew=1.5,
            label="fitted highlights",
        )
        axes.grid(visible=False)
        axes.set_xlabel("column [px]")
        axes.set_ylabel("row [px]")
        axes.legend(loc="lower left", facecolor="white", framealpha=0.9, frameon=True)
        figure.colorbar(
            shown, ax=axes, label=r"$\log_{10}$ of the recorded radiance [unit of the merged images]", shrink=0.8
        )
    return figure


def reflectance_figure(result: Reconstruction) -> Figure:
    with drawing(7.5, 4.2) as figure:
        draw_reflectance(figure.subplots(), result)
    return figure


def draw_reflectance(axes: Axes, result: Reconstruction) -> None:
    fit = result.fit
    theta = fit.solution.theta_d
    units = np.array([one.value for one in result.units])
    strengths = fit.strengths / units
    std = fit.strengths_std / units
    fine = np.linspace(theta.min(), theta.max(), 200)
    for c, channel in enumerate(fit.channels):
        colour = channel_colour(channel, c)
        axes.errorbar(
            np.degrees(theta), strengths[:, c], std[:, c], color=colour, fmt="o", ms=4, label=f"{channel}, ± 1 std"
        )
        axes.plot(np.degrees(fine), result.curves[c].at(fine) / units[c], color=colour, lw=1.2)
    degrees_axis(axes, r"difference angle $\theta_d$")
    axes.set_ylabel("F [-]" if result.absolute else "F, relative [-]")
    axes.set_ylim(0, None)
    axes.legend(loc="lower left")


def lobe_figure(result: Reconstruction) -> Figure:
    """Draw the reconstructed BRDF and the pinhole table over theta_h.

    Each panel shows one of up to four theta_d, at phi_d = 90 degrees. The pinhole table is averaged over phi_d.
    """
    grid = merl_grid("centre")
    theta_d = np.sort(np.degrees(result.fit.solution.theta_d))  # the pinhole table has cells at these angles, too
    slices = [float(theta_d[k]) for k in evenly(len(theta_d), 4)]
    table = result.table
    channel = table["brdf"].sizes["channel"] // 2
    theta_h = np.degrees(grid.theta_h)
    with drawing(9.6, 6.4) as figure:
        panels = figure.subplots(2, 2).flat
        for axes, degrees in zip(panels, [*slices, *[None] * (4 - len(slices))], strict=True):
            if degrees is None:
                axes.axis("off")
                continue
            at = (*grid.index(theta_d=np.radians(degrees), phi_d=np.pi / 2), channel)
            value, std = (table[name].values[at] for name in ("brdf", "brdf_std"))
            good = table["supported"].values[at]
            seen = np.isfinite(value) & (value > 0)
            if result.pinhole is not None:
                binned = pinhole_slice(result.pinhole, at[1], channel)
                there = np.isfinite(binned)
                axes.plot(theta_h[there], binned[there], ".-", color=VERMILION, lw=0.8, ms=3, label="pinhole binning")
            draw_lobe(axes, theta_h, value, std, seen, good, "reconstructed")
            axes.set_title(rf"$\theta_d$ = {np.degrees(grid.theta_d[at[1]]):.1f}°", loc="left")
        next(iter(figure.axes)).legend(loc="lower left")
    return figure


def highlight_figure(result: Reconstruction) -> Figure:
    """Draw the windows of up to 18 highlights: recorded, fitted, and residual.

    The residual is in standard deviations of a pixel.
    """
    solution, windows = result.fit.solution, fitted_windows(result)
    shown = evenly(len(result.fit.names), 18)
    columns = 3
    rows = int(np.ceil(len(shown) / columns))
    with drawing(10.5, 1.5 * rows + 0.7) as figure:
        grid = figure.subplots(rows, 3 * columns, squeeze=False)
        for axes in grid.flat:
            axes.axis("off")
        last = None
        for position, k in enumerate(shown):
            one = windows.isel(picture=k)
            top = max(np.nanmax(one["window_fitted"].values), 1e-300)
            row, column = divmod(position, columns)
            for panel, name in enumerate(("window_recorded", "window_fitted", "window_residual")):
                axes, image = grid[row, 3 * column + panel], one[name].values
                if name == "window_residual":
                    last = axes.imshow(image, cmap="coolwarm", vmin=-5, vmax=5)
                else:
                    axes.imshow(np.log10(np.maximum(image / top, 1e-3)), cmap="gray", vmin=-3, vmax=0)
            title = rf"{result.fit.names[k]}, $\theta_d$ = {np.degrees(solution.theta_d[k]):.0f}°"
            grid[row, 3 * column].set_title(title, loc="left", fontsize=7)
        if last is not None:
            figure.colorbar(last, ax=grid, label="recorded - fitted [standard deviations]", shrink=0.6, aspect=30)
        figure.supxlabel(
            f"windows of {WINDOW} x {WINDOW} px: recorded and fitted (logarithmic, three decades), and residual",
            fontsize=8,
            color=GREY,
        )
    return figure
