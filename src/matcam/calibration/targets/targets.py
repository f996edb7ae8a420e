"""All gratings, stars and dots of a described chart in one photograph: what each says of the MTF."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from matcam.calibration.chart.chart import Chart, Dots, Grating, Patch, Square, Star
from matcam.calibration.chart.registration import Registration, register_chart
from matcam.calibration.photograph.linear_image import LinearImage, region_of
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.gratings import grating_mtf
from matcam.calibration.targets.grid import DotGrid, dot_grid
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.star import star_mtf
from matcam.core.errors import FitError
from matcam.files.photographs import Photograph


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
    image: ArrayLike | Photograph | LinearImage,
    chart: Chart,
    *,
    registration: Registration | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
    aperture: float | None = None,
    source: str = "",
) -> Targets:
    """Find a chart in a photograph and measure its gratings, stars and dots; squares are the edges' business.

    image, cfa, channel, tone: as for `edge_mtf`. registration: where the chart lies, if that is known from another channel.
    half_width: of the pixel's sensitive area, px, (0, 0.5]: only the grids' sigma depends on it. aperture: f-number, source:
    file; handed on to the samples, to which source adds the target. A target that cannot be measured becomes a line of
    `problems`. Raises ArgumentError for bad arguments, FitError where the chart is not found.
    """
    picture = LinearImage.of(image, channel, cfa, tone)
    if registration is None:
        # colours only matter for blur: all of a mosaic's pixels know where the chart lies
        mosaic = cfa is not None
        registration = register_chart(
            region_of(image, tone=tone) if mosaic else region_of(picture), chart, mosaic=mosaic
        )
    samples: list[MTFSamples] = []
    grids: list[DotGrid] = []
    problems: list[str] = []
    for number, element in enumerate(chart.elements):
        if isinstance(element, Square | Patch):
            continue
        source = source or picture.source
        name = f"{source}{': ' if source else ''}{type(element).__name__.lower()} {number}"
        try:
            if isinstance(element, Grating):
                name += f" ({element.profile})"
                grating = grating_mtf(picture, grating=element, projection=registration, aperture=aperture, source=name)
                samples.append(grating.samples)
            elif isinstance(element, Star):
                star = star_mtf(picture, star=element, projection=registration, aperture=aperture, source=name)
                samples.append(star.samples)
            elif isinstance(element, Dots):
                grid = dot_grid(
                    picture,
                    dots=element,
                    projection=registration,
                    half_width=half_width,
                    aperture=aperture,
                    source=name,
                )
                grids.append(grid)
                samples += grid.samples
        except FitError as error:
            problems.append(f"{name}: {error}")
    return Targets(tuple(samples), tuple(grids), tuple(problems), registration)
