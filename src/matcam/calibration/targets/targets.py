"""Measurement of the gratings, stars and dots of a described chart in one photograph."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.chart.chart import Chart, Dots, Grating, Star
from matcam.calibration.chart.printed_levels import PrintedLevels, printed_levels
from matcam.calibration.chart.registration import Projection, register_chart
from matcam.calibration.photograph.linear_image import LinearImage, usable_region
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.gratings import grating_mtf
from matcam.calibration.targets.grid import DotGrid, dot_grid
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.star import star_mtf
from matcam.core import checks
from matcam.core.errors import FitError
from matcam.core.io import plain
from matcam.core.remark import Remark, texts
from matcam.files.photographs import Photograph


@dataclass(frozen=True, eq=False)
class Targets:
    """Results of the targets of a chart in one photograph and channel.

    Attributes:
        samples: MTF of every target that could be measured.
        grids: blur over the field from every grid of dots.
        problems: remarks on the targets that could not be measured, with the reasons.
        registration: map from the page, mm, to the image, px.
        printed: printed levels of the chart, measured with its tone patches. Default: None, too few patches can be
            measured.

    Example:
        >>> chart = matcam.targets.design_chart(["dots"], pixels_across=300)
        >>> noise = np.random.default_rng(0).normal(9, 1, (213, 300))
        >>> found = matcam.targets.measure_targets(noise, chart, registration=lambda mm: mm)
        >>> print(found.problems[0])
        dots 11: ...
    """

    samples: tuple[MTFSamples, ...]
    grids: tuple[DotGrid, ...]
    problems: tuple[Remark, ...]
    registration: Projection
    printed: PrintedLevels | None = None

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a JSON object.

        Returns:
            Samples, grids and problems.
        """
        return plain({"samples": self.samples, "grids": self.grids, "problems": texts(self.problems)})


def measure_targets(
    image: ArrayLike | Photograph | LinearImage,
    chart: Chart,
    *,
    registration: Projection | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
    f_number: float | None = None,
    source: str = "",
) -> Targets:
    """Find a chart, and measure its gratings, stars and dots.

    Squares are measured by `edge_mtf` and `calibrate`. Targets that cannot be measured are listed in `problems`. The
    contrast of stars and gratings is that of the print, which is measured with the tone patches of the chart. If too
    few patches can be measured, the contrast of the description is used.

    Args:
        image: `LinearImage`, `Photograph`, or array as in `LinearImage.of`.
        chart: description of the chart.
        registration: map from the page of the chart, mm, to the image, px, for example from another channel. Default: None,
            the chart is detected in the image.
        half_width: half the side of the sensitive area of a pixel, in (0, 0.5] px. Only grids depend on it. Default: 0.5.
        cfa: colours of the first 2 x 2 px of a mosaic, as in `LinearImage.of` (no unit). Default: None.
        channel: colour, as in `LinearImage.of` (no unit). Default: None.
        tone: tone curve, as in `LinearImage.of` (no unit). Default: "linear".
        f_number: f-number of the image (no unit). Default: None, the f-number in `image`.
        source: name of the file; the source of a sample is this name and the target (no unit). Default: "", the source
            in `image`.

    Returns:
        The MTF of every target, the blur over the field of every grid, and the targets that could not be measured.

    Raises:
        ArgumentError: if an argument is out of range.
        FitError: if the chart is not found, or the image in which it is searched for is saturated.

    Source:
        docs/targets.md.

    Example:
        >>> chart = matcam.targets.design_chart(["dots"], pixels_across=300)
        >>> y, x = np.mgrid[:213, :300]
        >>> page = np.full(y.shape, 1000.0)
        >>> for column, row in chart.elements[-1].centres:
        ...     page -= 900 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 2.5)
        >>> found = matcam.targets.measure_targets(page, chart, registration=lambda mm: mm, source="a.png")  # 1 px is 1 mm
        >>> found.samples[0].source, found.problems
        ('a.png: dots 11', ())
    """
    checks.instance("chart", chart, Chart)
    checks.instance("source", source, str)
    picture = LinearImage.of(image, channel, cfa, tone)
    f_number = picture.f_number if f_number is None else f_number
    source = source or picture.source
    if registration is None:
        # All pixels of a mosaic are used to find the chart, because its position hardly depends on the colour.
        mosaic = cfa is not None
        whole = usable_region(LinearImage.of(image, tone=tone) if mosaic else picture)
        registration = register_chart(whole, chart, mosaic=mosaic)
    samples: list[MTFSamples] = []
    grids: list[DotGrid] = []
    unmeasured: dict[str, dict[int, str]] = {}
    printed = printed_levels(picture.values, chart, registration)
    for number, described in enumerate(chart.elements):
        element = described if printed is None else printed.of(described)
        kind = type(element).__name__.lower()
        name = f"{source}{': ' if source else ''}{kind} {number}"
        try:
            if isinstance(element, Grating):
                name += f" ({element.profile})"
                kind += f"s ({element.profile})"
                found = [grating_mtf(picture, grating=element, projection=registration).samples]
            elif isinstance(element, Star):
                found = [star_mtf(picture, star=element, projection=registration).samples]
            elif isinstance(element, Dots):
                grid = dot_grid(picture, dots=element, projection=registration, half_width=half_width)
                found = [replace(one, source=name, f_number=f_number) for one in grid.samples]
                grids.append(replace(grid, samples=tuple(found)))
            else:  # squares are measured by `edge_mtf`, patches by `printed_levels`
                continue
        except FitError as error:
            unmeasured.setdefault(kind, {})[number] = f"{kind} {number}: {error}"
        else:
            found = [replace(one, source=name, f_number=f_number) for one in found]
            if printed is not None and not isinstance(element, Dots):
                # All samples have the relative error of the contrast of the print in common.
                common = [printed.contrast_std**2 * np.outer(one.mtf, one.mtf) for one in found]
                found = [replace(f, covariance=f.covariance + more) for f, more in zip(found, common, strict=True)]
            samples += found
    problems = tuple(_not_measured(kind, of) for kind, of in unmeasured.items())
    return Targets(tuple(samples), tuple(grids), problems, registration, printed)


def _not_measured(kind: str, problems: dict[int, str]) -> Remark:
    text = next(iter(problems.values()))
    if len(problems) > 1:
        text += f"; likewise {kind} {', '.join(map(str, list(problems)[1:]))}"
    return Remark("target-not-measured", text)
