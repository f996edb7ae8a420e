"""All gratings, stars and dots of a described chart in one photograph: what each says of the MTF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.chart.chart import Chart, Dots, Grating, Patch, Square, Star
from matcam.calibration.chart.registration import Registration, register_chart
from matcam.calibration.photograph import region
from matcam.calibration.targets.gratings import grating_mtf
from matcam.calibration.targets.grid import DotGrid, dot_grid
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.star import star_mtf
from matcam.core.errors import FitError


@dataclass(frozen=True, eq=False)
class Targets:
    """What a chart's targets say in one photograph and one channel."""

    samples: tuple[MTFSamples, ...]
    grids: tuple[DotGrid, ...]
    """The lens's blur over the field, of every grid of dots."""
    problems: tuple[str, ...]
    """Which targets cannot be measured, and why."""
    registration: Registration


def measure_targets(
    image: ArrayLike,
    chart: Chart,
    *,
    registration: Registration | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: str | ArrayLike | None = None,
    aperture: float | None = None,
    source: str = "",
) -> Targets:
    """Find a chart in a photograph and measure its gratings, stars and dots; squares are the edges' business.

    image, cfa, channel, tone: as for `edge_mtf`. registration: where the chart lies, if that is known from another channel.
    half_width: of the pixel's sensitive area, px, (0, 0.5]: only the grids' sigma depends on it. aperture: f-number, source:
    file; handed on to the samples, to which source adds the target. A target that cannot be measured becomes a line of
    `problems`. Raises ArgumentError for bad arguments, FitError where the chart is not found.
    """
    picture = np.asarray(image)
    if registration is None:
        # colours only matter for blur: all of a mosaic's pixels know where the chart lies
        linear = region.cut(picture, None, None, (channel or "Y") if picture.ndim == 3 else None, tone)
        registration = register_chart(linear, chart, mosaic=cfa is not None)
    samples: list[MTFSamples] = []
    grids: list[DotGrid] = []
    problems: list[str] = []
    for number, element in enumerate(chart.elements):
        if isinstance(element, Square | Patch):
            continue
        name = f"{source}{': ' if source else ''}{type(element).__name__.lower()} {number}"
        try:
            if isinstance(element, Grating):
                name += f" ({element.profile})"
                grating = grating_mtf(
                    picture, grating=element, projection=registration, cfa=cfa, channel=channel, tone=tone,
                    aperture=aperture, source=name,
                )  # fmt: skip
                samples.append(grating.samples)
            elif isinstance(element, Star):
                star = star_mtf(
                    picture, star=element, projection=registration, cfa=cfa, channel=channel, tone=tone, aperture=aperture,
                    source=name,
                )  # fmt: skip
                samples.append(star.samples)
            elif isinstance(element, Dots):
                grid = dot_grid(
                    picture, dots=element, projection=registration, half_width=half_width, cfa=cfa, channel=channel,
                    tone=tone, aperture=aperture, source=name,
                )  # fmt: skip
                grids.append(grid)
                samples += grid.samples
        except FitError as error:
            problems.append(f"{name}: {error}")
    return Targets(tuple(samples), tuple(grids), tuple(problems), registration)
