"""The figure of one edge: region, ESF, LSF, MTF with its error band, and residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.figures.style import BLACK, BLUE, GREY, VERMILION, nyquist_line, styled


def edge_figure(result: EdgeMTF, image: np.ndarray, roi: Sequence[int] | None, name: str) -> Figure:
    """Draw a result of `edge_mtf`.

    Args:
        result: the result.
        image: the picture in which it was measured, in any codes.
        roi: region (x, y, width, height) px; None for the whole picture.
        name: title.
    """
    with styled():
        figure = Figure(figsize=(10.2, 6.2), layout="constrained")
        axes = figure.subplot_mosaic([["region", "esf", "lsf"], ["mtf", "mtf", "residual"]], width_ratios=(1, 1.2, 1.2))
        _draw_region(axes["region"], result, image, roi)
        reach = _reach(result)
        _draw_esf(axes["esf"], result, reach)
        _draw_lsf(axes["lsf"], result, reach)
        _draw_mtf(axes["mtf"], result)
        _draw_residuals(axes["residual"], result)
        figure.suptitle(
            f"{name}: edge with its normal at {np.degrees(result.angle):.2f}°", x=0.01, ha="left", fontsize=11
        )
    return figure


def _reach(result: EdgeMTF) -> float:
    """Return the distance at which the edge is over, and a little more, px."""
    distance = np.linspace(0.5, 30, 60)
    line = result.lsf(distance).value
    return float(np.clip(2.2 * distance[line > 0.01 * line[0]].max(initial=2.0), 4, 30))


def _draw_region(axes: Axes, result: EdgeMTF, image: np.ndarray, roi: Sequence[int] | None) -> None:
    height, width = image.shape[:2]
    x, y, w, h = (0, 0, width, height) if roi is None else (int(v) for v in roi)
    part = np.asarray(image[y : y + h, x : x + w], dtype=float)
    axes.imshow(
        part if part.ndim == 2 else part[..., :3].mean(-1),
        cmap="gray",
        extent=(x - 0.5, x + w - 0.5, y + h - 0.5, y - 0.5),
    )
    along, out = (
        np.array([-np.sin(result.angle), np.cos(result.angle)]),
        np.array([np.cos(result.angle), np.sin(result.angle)]),
    )
    t = np.linspace(-1, 1, 65)[:, None] * np.hypot(w, h) / 2
    length = w if abs(np.sin(result.angle)) > np.sqrt(0.5) else h
    # the middle bulges towards the bright side by the bow
    points = np.array(result.place) + t * along - result.bow * (2 * t / length) ** 2 * out
    axes.plot(points[:, 0], points[:, 1], color=VERMILION, lw=0.9)
    axes.set(xlim=(x - 0.5, x + w - 0.5), ylim=(y + h - 0.5, y - 0.5), xlabel="x [px]", ylabel="y [px]")
    axes.grid(False)
    axes.set_title("Region and edge", loc="left")


def _draw_esf(axes: Axes, result: EdgeMTF, reach: float) -> None:
    samples = result.samples
    near = np.abs(samples.distance) <= reach
    distance = np.linspace(-reach, reach, 400)
    found = result.esf(distance)
    axes.plot(samples.distance[near], samples.value[near], ".", ms=2.5, color=GREY, label="pixels")
    axes.plot(distance, found.value, color=BLUE, label="free")
    axes.fill_between(distance, found.value - found.std, found.value + found.std, color=BLUE, alpha=0.25, lw=0)
    axes.set(xlabel="distance [px]", ylabel="edge response [-]", xlim=(-reach, reach))
    axes.legend(loc="upper left", fontsize=8.5)
    axes.set_title("ESF", loc="left")


def _draw_lsf(axes: Axes, result: EdgeMTF, reach: float) -> None:
    distance = np.linspace(-reach, reach, 400)
    found = result.lsf(distance)
    axes.plot(distance, found.value, color=BLUE)
    axes.fill_between(distance, found.value - found.std, found.value + found.std, color=BLUE, alpha=0.25, lw=0)
    axes.set(xlabel="distance [px]", ylabel="line response [1/px]", xlim=(-reach, reach))
    axes.set_title("LSF", loc="left")


def _draw_mtf(axes: Axes, result: EdgeMTF) -> None:
    fit, f = result.parametric, result.frequency
    axes.axhline(0, color=BLACK, lw=0.6)
    nyquist_line(axes)
    label = f"{fit.model} lens: {fit.mtf50:.4f} ± {fit.mtf50_std:.4f}"
    axes.plot(
        f,
        np.abs(fit.mtf),
        color=VERMILION,
        ls="--",
        lw=1.2,
        label=label if fit.consistent else f"{label} (wrong model)",
    )
    axes.plot(f, result.mtf, color=BLUE, label=f"free: {result.mtf50:.4f} ± {result.mtf50_std:.4f}")
    axes.fill_between(f, result.mtf - result.mtf_std, result.mtf + result.mtf_std, color=BLUE, alpha=0.25, lw=0)
    axes.errorbar(result.mtf50, 0.5, xerr=result.mtf50_std, fmt="o", color=BLUE, ms=4, capsize=2)
    if result.glare_found:
        label = f"free, without {result.glare_fraction:.1%} of glare: {result.core_mtf50:.4f}"
        axes.plot(f, result.core_mtf, color=BLUE, lw=1, ls=":", label=label)
    axes.set(xlim=(0, 1), ylim=(-0.03, max(1.05, 1.05 * float(np.max(result.mtf)))))
    axes.set(xlabel="frequency along the normal [cycles/px]", ylabel="MTF of lens and pixel [-]")
    axes.legend(title="MTF50 [cycles/px]", loc="upper right", fontsize=8.5)
    axes.set_title("MTF", loc="left")


def _draw_residuals(axes: Axes, result: EdgeMTF) -> None:
    samples = result.samples
    free = result.esf(samples.distance).value
    for expected, colour, mark, label in (
        (samples.parametric, VERMILION, "x", f"{result.parametric.model} lens"), (free, BLUE, ".", "free"),
    ):  # fmt: skip
        axes.plot(
            samples.distance, (samples.value - expected) / samples.std, mark, ms=3, mew=0.7, color=colour, label=label
        )
    axes.axhline(0, color=BLACK, lw=0.6)
    axes.set(xlabel="distance [px]", ylabel="residual / noise [-]")
    axes.legend(loc="lower left", fontsize=8.5, ncols=2, frameon=True, framealpha=0.85, edgecolor="none")
    axes.set_title("Residuals", loc="left")
