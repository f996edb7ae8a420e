"""Figure and page of a sensor's characteristics (EMVA Standard 1288)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from matcam.core.remark import texts
from matcam.figures.style import BLACK, BLUE, GREY, VERMILION, drawing, inline_png, write_page

if TYPE_CHECKING:
    from matcam.calibration.sensor.characteristics import SensorCharacteristics


def sensor_figure(result: SensorCharacteristics, name: str) -> Figure:
    """Draw photon transfer, signal-to-noise ratio, linearity, and fixed patterns of a sensor.

    Args:
        result: result of `characterise_sensor`.
        name: title.
    """
    with drawing(10.2, 6.4) as figure:
        axes = figure.subplot_mosaic([["transfer", "snr", "linearity"], ["response", "dark", "spread"]])
        draw_transfer(axes["transfer"], result)
        _draw_snr(axes["snr"], result)
        _draw_linearity(axes["linearity"], result)
        _draw_map(axes["response"], 100 * (result.prnu_map - 1), 100 * result.prnu.value, "response / mean - 1 [%]")
        _draw_map(axes["dark"], result.dsnu_map, result.dsnu.value, "dark signal - mean [e-]")
        _draw_spread(axes["spread"], result)
        figure.suptitle(name, x=0.01, ha="left", fontsize=11, parse_math=False)
    return figure


def write_sensor_page(path: str | Path, result: SensorCharacteristics, name: str, *, force: bool = False) -> None:
    """Write the page of a sensor: values, remarks, and the figure.

    Args:
        path: HTML file to write; it needs no network and no other file.
        result: result of `characterise_sensor`.
        name: title of the page.
        force: True to replace the file. Default: False.
    """
    content = {
        "name": name,
        "verdict": result.verdict,
        "remarks": texts(result.remarks),
        "parameters": result.quantities(),
        "figures": [
            (
                "Photon transfer, signal-to-noise ratio, linearity, and fixed patterns",
                inline_png(sensor_figure(result, name)),
            )
        ],
    }
    write_page(path, "sensor_page.html", content, force=force)


def draw_transfer(axes: Axes, result: SensorCharacteristics) -> None:
    top = 1.0
    for plane in result.transfers:
        own = plane.variance - plane.dark_variance
        axes.plot(plane.signal[~plane.used], own[~plane.used], "o", ms=3, mfc="none", color=GREY)
        axes.plot(plane.signal[plane.used], own[plane.used], "o", ms=3, color=BLUE)
        top = max(top, float(plane.signal.max()))
    line = np.array([0.0, top])
    axes.plot(line, result.gain.value * line, color=VERMILION, lw=1.1)
    axes.set_ylim(0, None)
    axes.set(title="Photon transfer", xlabel="signal [DN]", ylabel="temporal variance - dark variance [DN²]")


def _draw_snr(axes: Axes, result: SensorCharacteristics) -> None:
    for plane in result.transfers:
        there = (plane.signal > 0) & (plane.variance > 0)
        signal = plane.signal[there] / result.gain.value
        axes.loglog(signal, plane.signal[there] / np.sqrt(plane.variance[there]), "o", ms=3, color=BLUE)
    fine = np.geomspace(1, max(result.full_well.value, 2.0), 100)
    axes.loglog(fine, result.snr(fine * result.gain.value), color=VERMILION, lw=1.1, label="from gain and read noise")
    axes.loglog(fine, np.sqrt(fine), color=BLACK, lw=0.8, ls="--", label="ideal sensor")
    axes.legend(loc="lower right")
    axes.set(title="Signal-to-noise ratio", xlabel="signal [e-]", ylabel="signal / noise")


def _draw_linearity(axes: Axes, result: SensorCharacteristics) -> None:
    for plane in result.transfers:
        judged = plane.judged
        axes.plot(plane.signal[judged], 100 * plane.departure[judged], "o", ms=3, color=BLUE)
    axes.axhline(0, color=BLACK, lw=0.8)
    axes.set(title="Linearity", xlabel="signal [DN]", ylabel="deviation from a line [%]")


def _draw_map(axes: Axes, values: np.ndarray, std: float, title: str) -> None:
    # a drawn map has at most 400 px along a side
    step = max(1, -(-max(values.shape) // 400))
    height, width = (n - n % step for n in values.shape)
    coarse = values[:height, :width].reshape(height // step, step, width // step, step).mean((1, 3))
    # the grey levels extend to 3 standard deviations on each side of the mean
    limit = 3.0 * max(std, 1e-12)
    axes.grid(visible=False)
    drawn = axes.imshow(coarse, cmap="gray", vmin=-limit, vmax=limit, interpolation="nearest")
    axes.figure.colorbar(drawn, ax=axes, shrink=0.8)
    axes.set(title=title, xticks=[], yticks=[])


def _draw_spread(axes: Axes, result: SensorCharacteristics) -> None:
    departure = 100 * (result.prnu_map - 1).ravel()
    limit = 6 * max(100 * result.prnu.value, 1e-9)
    axes.hist(np.clip(departure, -limit, limit), bins=101, histtype="step", color=BLUE, log=True)
    axes.set(title="Responses of the pixels", xlabel="response / mean - 1 [%]", ylabel="pixels")
