"""What is measured in one photograph: its edges, and a described chart's other targets, colour by colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from matcam.calibration.chart import Chart, Patch, Square
from matcam.calibration.edge_result import EdgeMTF
from matcam.calibration.edge_search import find_edges
from matcam.calibration.mtf_samples import MTFSamples
from matcam.calibration.photograph_edges import measured_edges, remarks_on
from matcam.calibration.planes import Plane, assumed_tone, planes_of
from matcam.calibration.targets import measure_targets
from matcam.calibration.tone import Tone
from matcam.errors import FitError
from matcam.files.photographs import Photograph


@dataclass
class Measured:
    """What a photograph says, by channel."""

    edges: dict[str, EdgeMTF] = field(default_factory=dict)
    samples: dict[str, tuple[MTFSamples, ...]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Plan:
    """How every photograph is measured; fields as in `calibrate`."""

    tone: Tone
    channels: Sequence[str] | None
    half_width: float
    accept_sharpened: bool
    chart: Chart | None

    def measured(self, photograph: Photograph, name: str, f_number: float | None) -> Measured:
        """Everything in it. FitError where there is nothing, or the chart is not in it."""
        known = self.tone is not None or photograph.linear
        tone, assumed = (self.tone, "") if known else assumed_tone(photograph)
        found = Measured(remarks=[assumed] if assumed else [])
        planes = planes_of(photograph, self.channels, tone)
        if self.chart is not None:
            self._measure_targets(self.chart, planes, name, f_number, found)
        if self.chart is not None and not any(isinstance(e, Square | Patch) for e in self.chart.elements):
            return found
        # around gratings and stars there are edges by the hundred; those of a described chart are its squares'
        edges = find_edges(photograph.values, mosaic=photograph.cfa is not None)
        for plane in planes:
            try:
                result = measured_edges(plane, edges, self.half_width, accept_sharpened=self.accept_sharpened)
            except FitError:
                if not found.samples.get(plane.channel):
                    raise
                continue
            found.edges[plane.channel] = result
            found.remarks += remarks_on(result, plane.channel)
        return found

    def _measure_targets(
        self, chart: Chart, planes: Sequence[Plane], name: str, f_number: float | None, found: Measured
    ) -> None:
        place = None
        for plane in planes:
            photograph = plane.photograph
            targets = measure_targets(
                photograph.values, chart, registration=place, half_width=self.half_width, cfa=photograph.cfa,
                channel=None if plane.channel == "grey" else plane.channel, tone=plane.tone, aperture=f_number, source=name,
            )  # fmt: skip
            place = targets.registration
            found.samples[plane.channel] = targets.samples
            found.remarks += [f"{plane.channel}: {problem}" for problem in targets.problems]
