"""Collection of the measurements for a camera: all colours of one photograph, and one colour of all photographs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from matcam.calibration.camera.consensus import in_consensus, refuse_too_few
from matcam.calibration.camera.joint_fit import Measurements, edge_measurements, value_measurements
from matcam.calibration.camera.lens_over_field import BlurSamples, lens_over_field
from matcam.calibration.camera.processed_pictures import Processed, processed
from matcam.calibration.chart.chart import Chart, Grating, Star
from matcam.calibration.chart.marks import balanced
from matcam.calibration.chart.registration import Projection, pixel_box, register_chart
from matcam.calibration.edge.edge_result import EdgeStack
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.photograph.linear_image import LinearImage, planes_of, smoothed
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.photograph.unnamed_mosaic import refuse_unnamed_mosaic
from matcam.calibration.search.edge_search import described_edges, find_edges
from matcam.calibration.search.photograph_edges import edge_remarks, plane_edge_stack, strips_along
from matcam.calibration.targets.grid import DotGrid
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.targets import measure_targets
from matcam.camera.lens_field import LensField
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark
from matcam.files.photographs import Photograph

LensAt = Callable[[float | None], LensModel]
"""Lens model of an image as a function of its f-number; None if the f-number is unknown."""


class EdgeTable(NamedTuple):
    """Results of n edges over the field.

    Attributes:
        x: (n,) x of the middle of the edge, px.
        y: (n,) y of the middle of the edge, downwards, px.
        angle: (n,) direction of the normal towards the bright side, rad.
        sigma: (n,) lens width from the Gaussian fit of each edge, px.
        sigma_std: (n,) standard deviation of `sigma`, px.
        mtf50: (n,) model-free MTF50, cycles/px.
        mtf50_std: (n,) standard deviation of `mtf50`, cycles/px.
        mtf: (n, 81) model-free MTF at 81 frequencies from 0 to 1.25 cycles/px (no unit).
        mtf_std: (n, 81) standard deviation of `mtf` (no unit).
        source: (n,) names of the images.

    Example:
        >>> one, mtf = np.ones(4), np.full((4, 81), 0.5)
        >>> columns = (one, one, one, 0.5 * one, 0.01 * one, one, one, mtf, mtf / 10, np.array(["a.png"] * 4))
        >>> table = matcam.calibration.EdgeTable(*columns)
        >>> float(table.weights[0, 0]), table.spread
        (0.25, 0.0)
    """

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    sigma: np.ndarray
    sigma_std: np.ndarray
    mtf50: np.ndarray
    mtf50_std: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    source: np.ndarray

    @classmethod
    def joined(cls, tables: Iterable[EdgeTable]) -> EdgeTable:
        """Join the edges of several tables.

        Args:
            tables: one or more tables.
        """
        return cls(*(np.concatenate(columns) for columns in zip(*tables, strict=True)))

    def over_field(self, middle: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Compute distances from the middle of the image, and find meridional edges.

        An edge is meridional if its normal is within 45 degrees of the line from the middle of the image to the edge. All
        other edges are sagittal.

        Args:
            middle: (x, y) of the middle of the image, px.

        Returns:
            Distances of the edges (n,), px, and a mask of the meridional edges (n,).
        """
        x, y = self.x - middle[0], self.y - middle[1]
        return np.hypot(x, y), np.abs(np.cos(self.angle - np.arctan2(y, x))) > np.sqrt(0.5)

    def of_source(self, source: str) -> EdgeTable:
        """Select the edges of one image.

        Args:
            source: name of the image.
        """
        return EdgeTable(*(column[self.source == source] for column in self))

    @property
    def weights(self) -> np.ndarray:
        """Weights (n, 81) of the edges in their mean MTF.

        The weights are inverse variances. At each frequency, their sum is 1.
        """
        # The smallest standard deviation, 1e-4, limits the weight of a single edge.
        weight = 1 / np.maximum(self.mtf_std, 1e-4) ** 2
        return weight / weight.sum(0)

    @property
    def spread(self) -> float:
        """Relative standard deviation of `sigma` among the edges, beyond noise (no unit).

        The value is 0 if noise explains the scatter of the edges, or if there are fewer than 3 edges.
        """
        if self.x.size < 3:
            return 0.0
        relative = self.sigma_std / self.sigma
        mean = np.average(np.log(self.sigma), weights=relative**-2)
        variance = np.var(np.log(self.sigma), ddof=1, mean=mean)
        return float(np.sqrt(max(variance - np.mean(relative**2), 0.0)))


@dataclass(frozen=True, eq=False)
class MeanCurve:
    """Mean MTF of all edges, and the MTF of a camera.

    Attributes:
        frequency: (81,) frequencies, cycles/px.
        mtf: (81,) model-free mean MTF of the edges (no unit); NaN without edges.
        mtf_std: (81,) standard deviation of `mtf` (no unit); NaN without edges.
        camera_mtf: (81,) mean MTF of the camera in the directions of the edges (no unit). Without edges, MTF along the rows.

    Example:
        >>> f = np.linspace(0, 1, 5)
        >>> curve = matcam.calibration.MeanCurve(f, 1 - f, np.full(5, 0.01), 1 - 1.1 * f)
        >>> [round(value, 3) for value in curve.misfit]
        [0.05, 0.01]
    """

    frequency: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    camera_mtf: np.ndarray

    @property
    def misfit(self) -> tuple[float, float]:
        """Largest difference between `mtf` and `camera_mtf`, and its standard deviation.

        Both have no unit, and are NaN without edges. Only frequencies up to 0.5 cycles/px are compared.
        """
        off = np.abs(self.mtf - self.camera_mtf)
        below = (self.frequency > 0) & (self.frequency <= 0.5)
        worst = int(np.argmax(np.where(below, off, -1)))
        return float(off[worst]), float(self.mtf_std[worst])

    @property
    def consistent(self) -> bool:
        """True if the camera explains the curve; see `CameraFit.consistent`."""
        misfit, std = self.misfit
        return not misfit > max(0.005, 4 * std)


class Finding(NamedTuple):
    """Measurements of one colour, from one image or provided by the caller.

    Attributes:
        channel: "R", "G", "B", "Y" or "grey".
        source: name of the image, or of the source of `samples` that the caller provided.
        f_number: f-number of the image; None if it is unknown.
        edges: measured edges; None if no edges were measured.
        samples: MTF values of other targets.
        dots: positions of dots on the page and in the image.
        shape: height and width of the image, px; None if there is no image.
        software: processing of the image; None if there is no image.
    """

    channel: str
    source: str
    f_number: float | None
    edges: EdgeStack | None
    samples: tuple[MTFSamples, ...]
    dots: tuple[BlurSamples, ...] = ()
    shape: tuple[int, int] | None = None
    software: Processed | None = None


def measure_picture(
    picture: Photograph | LinearImage,
    name: str,
    f_number: float | None,
    *,
    tone: Tone,
    channels: Sequence[str] | None,
    half_width: float,
    accept_sharpened: bool,
    chart: Chart | None,
    cfa: str | None,
) -> tuple[list[Finding], list[Remark]]:
    """Measure each colour of an image, and collect remarks.

    The keywords are arguments of `calibrate`. A FitError is raised if nothing can be measured, if the chart is not found, or
    if the image was denoised or compressed and `accept_sharpened` is False.
    """
    mosaic = (cfa or picture.cfa) is not None
    if isinstance(picture, LinearImage):
        if cfa is not None:
            raise ArgumentError("cfa is already specified by the LinearImage: omit it")
        planes: Iterable[LinearImage] = [replace(picture, source=name, f_number=f_number)]
        values, mosaic = (smoothed(picture.values) if mosaic else picture.values), False
    else:
        planes = planes_of(picture, channels, tone, f_number, name, cfa)
        values = picture.values
    edges = find_edges(values, mosaic=mosaic) if chart is None else None
    registration: Projection | None = None
    findings: list[Finding] = []
    remarks: list[Remark] = []
    for plane in planes:
        refuse_unnamed_mosaic(plane)
        remarks = remarks or list(plane.remarks)
        if chart is not None and registration is None:
            # All pixels of a mosaic are used to find the chart, because its position hardly depends on the colour.
            seen = balanced(values) if mosaic else plane.values
            registration = register_chart(seen, chart)
            edges = described_edges(seen, chart, registration)
        even = plane if chart is None or registration is None else _without_waves(plane, chart, registration)
        software = processed(even, accept=accept_sharpened)
        remarks += [r.about(plane.channel) for r in software.remarks]
        result: EdgeStack | None = None
        samples: tuple[MTFSamples, ...] = ()
        dots: tuple[BlurSamples, ...] = ()
        if chart is not None:
            targets = measure_targets(plane, chart, registration=registration, half_width=half_width)
            samples = targets.samples
            dots = dot_positions(targets.grids)
            assumed = any(remark.code == "tone-assumed" for remark in plane.remarks)
            printed_remarks = [targets.printed.remark(assumed=assumed)] if targets.printed is not None else []
            remarks += [r.about(plane.channel) for r in (*targets.problems, *printed_remarks) if r]
        if edges is not None:
            try:
                result = plane_edge_stack(plane, edges, half_width, accept_sharpened=accept_sharpened)
            except FitError as error:
                if not samples and chart is not None and registration is not None:
                    reason = str(error) if strips_along(edges, plane.shape).u.size else ""
                    raise _nothing_measured(chart, registration, reason) from error
                if not samples:
                    raise
                remarks.append(Remark("edges-not-measured", f"no edge was measured: {error}").about(plane.channel))
            else:
                remarks += edge_remarks(result, plane.channel)
        findings.append(Finding(plane.channel, name, f_number, result, samples, dots, plane.shape, software))
    return findings, remarks


def _without_waves(plane: LinearImage, chart: Chart, registration: Projection) -> LinearImage:
    """Mask gratings and stars in a plane, because their finest waves would increase the noise estimate."""
    values, turn = plane.values.copy(), np.linspace(0, 2 * np.pi, 33)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    for element in chart.elements:
        if isinstance(element, Star | Grating):
            round_it = element.corners if isinstance(element, Grating) else element.centre + element.outer * rim
            # The margin of 6 px includes the blur of a grating or star.
            x, y, width, height = pixel_box(registration(np.asarray(round_it)), plane.shape, 6)
            values[y : y + max(height, 0), x : x + max(width, 0)] = np.nan
    return replace(plane, values=values)


def _nothing_measured(chart: Chart, registration: Projection, reason: str) -> FitError:
    """Explain why no target of a chart was measured. `reason`: why the edges were not measured; empty: not known."""
    width, height = chart.page
    ends = registration(np.array([[0.0, height / 2], [width, height / 2]]))
    across = float(np.hypot(*(ends[1] - ends[0])))
    cause = reason or "its targets cannot be measured: they are covered, or their edges are along rows or columns"
    return FitError(
        f"the chart was found, but {cause}; or its targets are too fine for a page of {across:.0f} px width; uncover them, "
        "level the page, photograph the chart at a larger scale, print a chart for this width (matcam chart --pixels), or give "
        "the description of this chart"
    )


def dot_positions(grids: Sequence[DotGrid]) -> tuple[BlurSamples, ...]:
    columns = [(np.column_stack([grid.x, grid.y]), grid.sigma, grid.sigma_std, grid.printed) for grid in grids]
    return (BlurSamples(*map(np.concatenate, zip(*columns, strict=True))),) if columns else ()


def _group(samples: MTFSamples) -> str:
    return f"{samples.source} ({samples.kind})" if samples.source else samples.kind


class Evidence:
    """All measurements of one colour. Edges are listed first, as in the joint fit."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        self._findings = findings = tuple(findings)
        found = [f for f in findings if f.edges is not None]
        stacks = in_consensus([f.edges for f in found if f.edges is not None])
        self._stacks = [(edges, f.source, f.f_number) for edges, f in zip(stacks, found, strict=True)]
        self._samples = [samples for f in findings for samples in f.samples]

    @property
    def f_numbers(self) -> list[float | None]:
        return [f_number for _, _, f_number in self._stacks] + [s.f_number for s in self._samples]

    def check(self, channel: str, failed: Iterable[str], *, accept_sharpened: bool) -> list[Remark]:
        """List remarks on edges that were excluded.

        A FitError is raised if edges are the only measurements and are insufficient for a camera. `failed` contains the names
        of the images in which nothing was measured.
        """
        edges = [stack for stack, _, _ in self._stacks]
        if edges and not self._samples:
            empty = (source for stack, source, _ in self._stacks if not stack.good.size)
            refuse_too_few(edges, channel, (*failed, *empty), accept_sharpened=accept_sharpened)
        lost = sum(problem is not None and problem.code == "no-consensus" for e in edges for problem in e.problems)
        text = f"{channel}: edges that disagree with the others were excluded ({lost})"
        return [Remark("no-consensus", text)] if lost else []

    def measurements(self, lens_at: LensAt) -> Measurements:
        groups = [f"{source} (edges)" for edges, source, _ in self._stacks for _ in edges.good]
        groups += [_group(samples) for samples in self._samples]
        # Targets in images that also have edges may be excluded, because edges are more reliable.
        seen = {source for edges, source, _ in self._stacks if edges.good.size}
        own = [s for f in self._findings if f.shape is not None and f.source in seen for s in f.samples]
        return Measurements(
            edge_measurements([(edges, lens_at(f_number)) for edges, _, f_number in self._stacks]),
            value_measurements([(s, lens_at(s.f_number)) for s in self._samples]),
            tuple(groups),
            frozenset(map(_group, own)),
        )

    @property
    def software(self) -> list[Processed]:
        return [f.software for f in self._findings if f.software is not None]

    def field(self) -> LensField | None:
        shapes = {f.shape for f in self._findings if f.shape is not None}
        if len(shapes) != 1:
            return None
        positions, edges = [one for f in self._findings for one in f.dots], self.table()
        # Each image is a group of its own, because the blur depends on the aperture.
        if edges is not None:
            pictures = map(edges.of_source, dict.fromkeys(edges.source.tolist()))
            positions += [BlurSamples(np.column_stack([of.x, of.y]), of.sigma, of.sigma_std) for of in pictures]
        return lens_over_field(positions, *shapes)

    def table(self) -> EdgeTable | None:
        tables = []
        for edges, source, _ in self._stacks:
            fit, good = edges.parametric, edges.good
            sigma, std = fit.values[:, 0], np.sqrt(fit.covariance[:, 0, 0])
            own = (edges.mtf50, edges.mtf50_std, edges.mtf, edges.mtf_std, np.full(len(edges), source))
            tables.append(EdgeTable(*(column[good] for column in (*edges.position, edges.angle, sigma, std, *own))))
        return EdgeTable.joined(tables) if tables else None
