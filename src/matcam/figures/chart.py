"""Page of a chart for printing. Levels are encoded for a printer or screen that reproduces sRGB."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from matcam.calibration.chart.chart import Chart, Dots, Element, Fiducial, Grating, Star
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.figures.style import drawing
from matcam.files import tone_curve as srgb

_STEPS = 24  # polygons per cycle of a sine; the lowest harmonic that differs from a sine is the 23rd
_AROUND = 64  # corners of the polygon of a circle
_INCH = 25.4
_Polygon = tuple[np.ndarray, float]
"""Corners of a polygon, mm (n, 2), and its luminance relative to that of the paper, in [0, 1] (no unit)."""
_MOST = 2e8  # largest number of pixels of a raster, which takes 0.8 GB as RGBA


def chart_figure(chart: Chart) -> Figure:
    """Draw the page of a chart at true size, with a ruler.

    Vector formats are preferable for printing.
    """
    polygons = [polygon for fiducial in chart.fiducials for polygon in _fiducial(fiducial, chart.ink)]
    polygons += [polygon for element in chart.elements for polygon in element_polygons(element)]
    width, height = chart.page
    with drawing(width / _INCH, height / _INCH, layout=None, facecolor="white") as figure:
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, width), ylim=(height, 0))
        axes.axis("off")
        axes.add_collection(
            PolyCollection(
                [points for points, _ in polygons],
                facecolors=[(_nearest_code(level),) * 3 for _, level in polygons],
                edgecolors="none",
                linewidths=0,
            ),
            autolim=False,
        )
        # ruler and text are between the fiducials of the lower border
        y, x = height - 0.045 * min(width, height), 0.14 * width
        axes.plot([x, x, x, x + 50, x + 50, x + 50], [y - 1, y + 1, y, y, y - 1, y + 1], color="black", lw=0.5)
        axes.text(x + 52, y, "50 mm", va="center", fontsize=6.5)
        axes.text(0.66 * width, y, f"{width:g} x {height:g} mm: print in true size", va="center", fontsize=6.5)
    return figure


def check_raster(chart: Chart, dpi: float, pixels_across: float) -> list[str]:
    """Check the resolution of a raster of a chart.

    An ArgumentError is raised if the raster is too coarse for a chart, or too large for memory. The result is a remark if
    it is too coarse for the finest elements, whose size is one pixel of the camera. `pixels_across`: number of pixels of the
    camera across the page.
    """
    checks.within("dpi", dpi, 50, 10_000)
    pixels = chart.page[0] * chart.page[1] * (dpi / _INCH) ** 2
    if pixels > _MOST:
        raise ArgumentError(
            f"at {dpi:g} dpi this page has {pixels / 1e6:.0f} million pixels, but at most {_MOST / 1e6:.0f} can be drawn: "
            "reduce dpi"
        )
    least = math.ceil(2 * pixels_across * _INCH / chart.page[0])  # two dots in a pixel of the camera
    if dpi >= least:
        return []
    return [
        f"at {dpi:g} dpi the finest elements of a chart for {pixels_across:g} px are not drawn correctly: use at least "
        f"--dpi {least}, or a .pdf file"
    ]


def element_polygons(element: Element) -> Iterator[_Polygon]:
    """Yield the polygons of an element, in painting order."""
    if isinstance(element, Grating):
        yield from _grating(element)
    elif isinstance(element, Star):
        yield from _star(element)
    elif isinstance(element, Dots):
        for centre in element.centres:
            yield _circle(centre, element.radius), element.level
    else:
        yield np.array(element.corners), element.level


def _nearest_code(level: float) -> float:
    """Convert a level to the nearest 8-bit sRGB code, as a value in [0, 1].

    A quarter of a code is added, because file writers truncate the value to 8 bits.
    """
    return min((round(255 * float(srgb.encoded(level))) + 0.25) / 255, 1.0)


def _circle(centre: tuple[float, float], radius: float) -> np.ndarray:
    t = 2 * np.pi * np.arange(_AROUND) / _AROUND
    # corners slightly outside, so that the polygon has the area of the circle
    radius *= np.sqrt(2 * np.pi / (_AROUND * np.sin(2 * np.pi / _AROUND)))
    return np.array(centre) + radius * np.stack([np.cos(t), np.sin(t)], axis=-1)


def _fiducial(fiducial: Fiducial, ink: float) -> Iterator[_Polygon]:
    for ring in range(fiducial.rings, 0, -1):
        yield _circle(fiducial.centre, (2 * ring + 1) * fiducial.radius), ink
        yield _circle(fiducial.centre, 2 * ring * fiducial.radius), 1.0
    yield _circle(fiducial.centre, fiducial.radius), ink


def _grating(grating: Grating) -> Iterator[_Polygon]:
    across = np.array([np.cos(grating.angle), np.sin(grating.angle)])
    along = np.array([-np.sin(grating.angle), np.cos(grating.angle)]) * grating.size[1] / 2
    half = grating.size[0] / 2

    def strip(low: float, high: float) -> np.ndarray:
        a, b = (np.array(grating.centre) + np.clip(u, -half, half) * across for u in (low, high))
        return np.array([a - along, b - along, b + along, a + along])

    if grating.profile == "sine":
        for start, stop, level in _staircase(-half, half, grating, 2 * np.pi / grating.period):
            yield strip(start, stop), level
        return
    # dark bars on a bright background: if its level is that of the paper, its border is invisible
    yield strip(-half, half), grating.bright
    shift, reach = grating.phase / (2 * np.pi), half / grating.period
    for n in range(int(np.floor(shift - reach)) - 1, int(np.ceil(shift + reach)) + 2):
        low, high = ((n - shift + side) * grating.period for side in (grating.duty / 2, 1 - grating.duty / 2))
        if low < half and high > -half:
            yield strip(low, high), grating.dark


def _star(star: Star) -> Iterator[_Polygon]:
    for start, stop, level in _staircase(0.0, 2 * np.pi, star, star.cycles):
        t = np.array([start, stop])
        rim = np.stack([np.cos(t), np.sin(t)], axis=-1)
        yield np.array(star.centre) + np.concatenate([star.inner * rim, star.outer * rim[::-1]]), level


def _staircase(low: float, high: float, of: Grating | Star, per: float) -> Iterator[tuple[float, float, float]]:
    """Yield (start, stop, level) of equal steps whose first harmonic is exactly the required sine.

    `per` is the phase of the sine, rad, per unit of `low` and `high`.
    """
    mean, amplitude = (of.bright + of.dark) / 2, (of.bright - of.dark) / 2 / np.sinc(1 / _STEPS)
    step = 2 * np.pi / _STEPS / per
    count = round((high - low) / step)
    for i in range(count):
        start = low + i * step
        # the next step overlaps this one, so that no paper is visible between them
        stop = start + (2 if i + 1 < count else 1) * step
        yield start, stop, float(np.clip(mean + amplitude * np.cos(per * (start + step / 2) + of.phase), 0, 1))
