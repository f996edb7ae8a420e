"""Figures of calibrations: one edge, a camera fitted to many edges, and the MTFs of the targets of a chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.figures.field_maps import draw_blur_map, draw_lateral_colour
from matcam.figures.style import (
    BLACK,
    BLUE,
    CHANNELS,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    draw_with_std,
    drawing,
    legend_above,
    mtf_lines,
)

if TYPE_CHECKING:
    from matcam.calibration.camera.calibration import Calibration
    from matcam.calibration.camera.camera_fit import CameraFit
    from matcam.calibration.edge.edge_result import EdgeMTF
    from matcam.calibration.targets.mtf_samples import MTFSamples
    from matcam.camera.camera import Camera

_MARKS = {"R": "s", "G": "o", "B": "^", "Y": "o", "grey": "o"}


def edge_figure(result: EdgeMTF, image: np.ndarray, roi: Sequence[int] | None, name: str) -> Figure:
    """Draw a result of `edge_mtf`.

    Args:
        result: the result.
        image: image in which the edge was measured, in any unit.
        roi: region (x, y, width, height), px; None: the entire image.
        name: title.
    """
    with drawing(10.2, 6.2) as figure:
        axes = figure.subplot_mosaic([["region", "esf", "lsf"], ["mtf", "mtf", "residual"]], width_ratios=(1, 1.2, 1.2))
        _draw_region(axes["region"], result, image, roi)
        reach = _reach(result)
        _draw_esf(axes["esf"], result, reach)
        _draw_lsf(axes["lsf"], result, reach)
        draw_edge_mtf(axes["mtf"], result)
        _draw_edge_residuals(axes["residual"], result)
        figure.suptitle(
            f"{name}: edge with its normal at {np.degrees(result.angle):.2f}°",
            x=0.01,
            ha="left",
            fontsize=11,
            parse_math=False,  # file names may contain dollar signs
        )
    return figure


def _reach(result: EdgeMTF) -> float:
    """Compute the range of drawn distances from the edge, px.

    It is 2.2 times the largest distance at which the line spread function exceeds 1 % of its central value, and at
    least 4 and at most 30 px.
    """
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
    # the middle is displaced towards the bright side by the bow
    points = np.array(result.position) + t * along - result.bow * (2 * t / length) ** 2 * out
    axes.plot(points[:, 0], points[:, 1], color=VERMILION, lw=0.9)
    axes.set(xlim=(x - 0.5, x + w - 0.5), ylim=(y + h - 0.5, y - 0.5), xlabel="x [px]", ylabel="y [px]")
    axes.grid(False)
    axes.set_title("Region and edge", loc="left")


def _draw_esf(axes: Axes, result: EdgeMTF, reach: float) -> None:
    samples = result.samples
    near = np.abs(samples.distance) <= reach
    distance = np.linspace(-reach, reach, 400)
    axes.plot(samples.distance[near], samples.value[near], ".", ms=2.5, color=GREY, label="pixels")
    draw_with_std(axes, distance, *result.esf(distance), BLUE, label="model-free")
    axes.set(xlabel="distance [px]", ylabel="edge response [-]", xlim=(-reach, reach))
    axes.legend(loc="upper left", fontsize=8.5)
    axes.set_title("ESF", loc="left")


def _draw_lsf(axes: Axes, result: EdgeMTF, reach: float) -> None:
    distance = np.linspace(-reach, reach, 400)
    draw_with_std(axes, distance, *result.lsf(distance), BLUE)
    axes.set(xlabel="distance [px]", ylabel="line response [1/px]", xlim=(-reach, reach))
    axes.set_title("LSF", loc="left")


def draw_edge_mtf(axes: Axes, result: EdgeMTF) -> None:
    fit, f = result.parametric, result.frequency
    mtf_lines(axes)
    label = f"{fit.model} lens: {fit.mtf50:.4f} ± {fit.mtf50_std:.4f}"
    axes.plot(
        f,
        np.abs(fit.mtf),
        color=VERMILION,
        ls="--",
        lw=1.2,
        label=label if fit.consistent else f"{label} (wrong model)",
    )
    label = f"model-free: {result.mtf50:.4f} ± {result.mtf50_std:.4f}"
    draw_with_std(axes, f, result.mtf, result.mtf_std, BLUE, label=label)
    axes.errorbar(result.mtf50, 0.5, xerr=result.mtf50_std, fmt="o", color=BLUE, ms=4, capsize=2)
    if result.glare_found:
        label = f"model-free, without {result.glare_fraction:.1%} of glare: {result.core_mtf50:.4f}"
        axes.plot(f, result.core_mtf, color=BLUE, lw=1, ls=":", label=label)
    axes.set(xlim=(0, 1), ylim=(-0.03, max(1.05, 1.05 * float(np.max(result.mtf)))))
    axes.set(xlabel="frequency along the normal [cycles/px]", ylabel="MTF of lens and pixel [-]")
    axes.legend(
        title="MTF50 [cycles/px]", loc="upper right", fontsize=8.5, frameon=True, framealpha=1, edgecolor="none"
    )
    axes.set_title("MTF", loc="left")


def _draw_edge_residuals(axes: Axes, result: EdgeMTF) -> None:
    samples = result.samples
    free = result.esf(samples.distance).value
    for expected, colour, mark, label in (
        (samples.parametric, VERMILION, "x", f"{result.parametric.model} lens"), (free, BLUE, ".", "model-free"),
    ):  # fmt: skip
        axes.plot(
            samples.distance, (samples.value - expected) / samples.std, mark, ms=3, mew=0.7, color=colour, label=label
        )
    axes.axhline(0, color=BLACK, lw=0.6)
    axes.set(xlabel="distance [px]", ylabel="residual / noise [-]")
    legend_above(axes, 2)
    axes.set_title("Residuals", loc="left")


def calibration_figure(found: Calibration, picture: np.ndarray | None, lines: Sequence[str]) -> Figure:
    """Draw a result of `calibrate`.

    The panels show the edges in the image, MTFs, residuals, blur over the field, and lateral colour.

    Args:
        found: the result.
        picture: the first image, in any unit; None: no image is drawn.
        lines: lines of the verdict, which are printed below the panels.
    """
    channel = found.channels[found.channel]
    edges = channel.edges if picture is not None else None
    maps = [["map", "lateral" if found.lateral_colour else "."]] if edges is not None else []
    of_edges = [["residuals", "field"], *maps] if any(fit.edges is not None for fit in found.channels.values()) else []
    with drawing(10.5, 4.4 + 3.3 * len(of_edges)) as figure:
        rows: list[Any] = [["picture", "mtf"], *of_edges, ["words", "words"]]
        axes = figure.subplot_mosaic(
            rows,
            height_ratios=(1.15, *([1.05] * len(of_edges)), 0.12 + 0.075 * len(lines)),
        )
        _draw_picture(axes["picture"], channel, picture, found.channel)
        draw_calibration(axes["mtf"], found)
        if of_edges:
            _draw_residuals(axes["residuals"], found)
            _draw_field(axes["field"], found, picture)
        if picture is not None and edges is not None:
            draw_blur_map(axes["map"], edges, picture.shape[:2], found.channel)
            if found.lateral_colour:
                draw_lateral_colour(axes["lateral"], found, picture.shape[:2])
        axes["words"].axis("off")
        axes["words"].text(
            0,
            1,
            "\n".join(lines),
            va="top",
            fontsize=8.5,
            family="monospace",
            transform=axes["words"].transAxes,
            parse_math=False,
        )
    return figure


def _draw_picture(axes: Axes, fit: CameraFit, picture: np.ndarray | None, channel: str) -> None:
    source = f"Edges of {fit.edges.source[0]}" if fit.edges is not None else "No edges were measured"
    axes.set_title(f"{source}, {channel}", loc="left", parse_math=False)
    axes.grid(False)
    if picture is None:
        axes.axis("off")
        return
    height, width = picture.shape[:2]
    # the drawn image has at most 900 px along a side
    step = max(1, int(np.ceil(max(height, width) / 900)))
    shown = picture[::step, ::step].astype(float)
    shown = shown if shown.ndim == 2 else shown.mean(-1)
    low, high = np.quantile(shown, (0.005, 0.995))
    axes.imshow(
        shown, cmap="gray", vmin=low, vmax=max(high, low + 1e-12), extent=(-0.5, width - 0.5, height - 0.5, -0.5)
    )
    axes.set(xlabel="x [px]", ylabel="y [px]")
    edges = fit.edges
    if edges is None:
        return
    here = edges.source == edges.source[0]
    dots = axes.scatter(
        edges.x[here], edges.y[here], c=edges.mtf50[here], s=18, cmap="cividis", lw=0.4, edgecolor="white"
    )
    axes.figure.colorbar(dots, ax=axes, label="MTF50 [cycles/px]", shrink=0.85)


def draw_calibration(axes: Axes, found: Calibration) -> None:
    _draw_mtf(axes, found.channels)


def draw_camera_fit(axes: Axes, fit: CameraFit) -> None:
    _draw_mtf(axes, {"grey": fit})


def _draw_mtf(axes: Axes, channels: Mapping[str, CameraFit]) -> None:
    mtf_lines(axes)
    # from wide to narrow, because equal curves lie on each other
    widths = 1.6 + 1.8 * np.arange(len(channels))[::-1]
    for (name, fit), width in zip(channels.items(), widths, strict=True):
        curve = fit.curve
        if np.isfinite(curve.mtf).all():
            label = f"{name}: edges, model-free"
            draw_with_std(axes, curve.frequency, curve.mtf, 2 * curve.mtf_std, CHANNELS[name], lw=width, label=label)
    for order, fit in enumerate(channels.values()):
        entry = None if order else "fitted camera"  # one entry for all channels
        axes.plot(fit.curve.frequency, fit.curve.camera_mtf, color=BLACK, lw=0.9, ls=(0, (4, 4)), label=entry)
    axes.set(xlim=(0, 1), ylim=(-0.03, 1.05), xlabel="frequency [cycles/px]", ylabel="MTF of lens and pixel [-]")
    axes.legend(loc="upper right", fontsize=8.5, frameon=True, framealpha=1, edgecolor="none")
    axes.set_title("MTF, and 2 standard deviations", loc="left")


def _draw_residuals(axes: Axes, found: Calibration) -> None:
    axes.axhline(0, color=BLACK, lw=0.6)
    for name, fit in found.channels.items():
        curve, colour = fit.curve, CHANNELS[name]
        draw_with_std(
            axes, curve.frequency, curve.mtf - curve.camera_mtf, 2 * curve.mtf_std, colour, lw=1.2, label=name
        )
    axes.set(xlim=(0, 0.75), xlabel="frequency [cycles/px]", ylabel="edges - camera [-]")
    if len(found.channels) > 1:
        legend_above(axes, 3)
    axes.set_title("Residuals of the camera", loc="left")


def _draw_field(axes: Axes, found: Calibration, picture: np.ndarray | None) -> None:
    for name, fit in found.channels.items():
        edges = fit.edges
        if edges is None:
            continue
        if picture is None:
            middle = (edges.x.mean(), edges.y.mean())
        else:
            middle = ((picture.shape[1] - 1) / 2, (picture.shape[0] - 1) / 2)
        radius, meridional = edges.over_field(middle)
        for plane, fill in (("meridional", CHANNELS[name]), ("sagittal", "white")):
            which = meridional == (plane == "meridional")
            axes.errorbar(
                radius[which], edges.sigma[which], edges.sigma_std[which], fmt=_MARKS[name], ms=3.5, lw=0.7,
                color=CHANNELS[name], mfc=fill, label=f"{name}, {plane}",
            )  # fmt: skip
    axes.set(xlabel="distance from the centre of the image [px]", ylabel="blur as Gaussian sigma [px]")
    legend_above(axes, 2)
    axes.set_title("Blur over the field", loc="left")


_LOOKS = {
    "star": (BLUE, "o", "Siemens star"), "grating": (VERMILION, "s", "gratings"), "dots": (GREEN, "^", "dots"),
    "edge": (ORANGE, "D", "edges"),
}  # fmt: skip


def targets_figure(samples: Sequence[MTFSamples], camera: Camera | None = None, title: str = "") -> Figure:
    """Draw the MTF of lens and pixel from each kind of target.

    Args:
        samples: samples of all targets.
        camera: camera to compare with; a second panel then shows the differences between targets and camera, in units of the
            standard deviations of the targets. Default: None, no comparison.
        title: title of the figure. Default: "", the title is "MTF".
    """
    with drawing(9.2, 4.2) as figure:
        axes, left = figure.subplots(1, 2, width_ratios=(1.5, 1)) if camera is not None else (figure.subplots(), None)
        mtf_lines(axes)
        highest = max(float(s.frequency.max()) for s in samples)
        if camera is not None:
            f = np.linspace(0, highest, 200)
            along, diagonal = np.asarray(camera.mtf(f, 0.0)), np.asarray(camera.mtf(f, np.pi / 4))
            axes.fill_between(f, along, diagonal, color=GREY, alpha=0.4, lw=0.8, label="camera, all directions")
        for kind, (colour, mark, name) in _LOOKS.items():
            some = [s for s in samples if s.kind == kind]
            if not some:
                continue
            f, mtf, std, direction = (
                np.concatenate([getattr(s, n) for s in some]) for n in ("frequency", "mtf", "mtf_std", "direction")
            )
            axes.errorbar(f, mtf, yerr=std, fmt=mark, ms=3.5, lw=0.9, color=colour, label=name)
            if camera is not None and left is not None:
                left.plot(f, (mtf - np.asarray(camera.mtf(f, direction))) / std, mark, ms=3.5, color=colour)
        axes.set(
            xlabel="frequency [cycles/px]",
            ylabel="MTF of lens and pixel [-]",
            xlim=(0, highest * 1.02),
            ylim=(-0.1, 1.05),
        )
        axes.legend(loc="upper right", frameon=True, framealpha=1, edgecolor="none")
        axes.set_title(title or "MTF", loc="left")
        if left is not None:
            left.axhline(0, color=BLACK, lw=0.6)
            left.axhspan(-1, 1, color=GREY, alpha=0.2, lw=0)
            left.set(xlabel="frequency [cycles/px]", ylabel="(target - camera) / standard deviation [-]")
            left.set_title("Differences", loc="left")
    return figure
