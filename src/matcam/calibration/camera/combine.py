"""What is measured in one photograph: its edges, and a described chart's other targets, colour by colour.

From photographs to a camera: every measurement of every picture in one fit per colour, judged and with its errors.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.camera.camera_fit import CameraFit, CameraRequest, fit_camera
from matcam.calibration.camera.evidence import Evidence
from matcam.calibration.chart.chart import Chart, Patch, Square
from matcam.calibration.chart.chart_file import read_chart
from matcam.calibration.chart.registration import register_chart
from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.photograph.linear_image import CHANNELS, as_photograph, planes_of
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.search.edge_search import find_edges
from matcam.calibration.search.photograph_edges import measured_edges, remarks_on
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.targets import measure_targets
from matcam.camera.camera import Camera
from matcam.camera.uncertainty import Provenance
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError, MatcamError
from matcam.files.photographs import Photograph, open_photograph


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
        found = Measured()
        planes = planes_of(photograph, self.channels, self.tone, f_number, name)
        # around gratings and stars there are edges by the hundred; those of a described chart are its squares'
        squares = self.chart is None or any(isinstance(e, Square | Patch) for e in self.chart.elements)
        edges = find_edges(photograph.values, mosaic=photograph.cfa is not None) if squares else None
        registration = None
        if self.chart is not None and photograph.cfa is not None:
            # colours only matter for blur: all of a mosaic's pixels know where the chart lies
            registration = register_chart(photograph.values, self.chart, mosaic=True)
        for plane in planes:
            found.remarks = found.remarks or [str(remark) for remark in plane.remarks]
            if self.chart is not None:
                targets = measure_targets(plane, self.chart, registration=registration, half_width=self.half_width)
                registration = targets.registration
                found.samples[plane.channel] = targets.samples
                found.remarks += [f"{plane.channel}: {problem}" for problem in targets.problems]
            if edges is None:
                continue
            try:
                result = measured_edges(plane, edges, self.half_width, accept_sharpened=self.accept_sharpened)
            except FitError:
                if not found.samples.get(plane.channel):
                    raise
                continue
            found.edges[plane.channel] = result
            found.remarks += remarks_on(result, plane.channel)
        return found


if TYPE_CHECKING:
    import xarray as xr

MODELS = ("gaussian", "halo", "diffraction", "defocus", "measured")
Picture = str | Path | ArrayLike | Photograph


@dataclass(frozen=True, eq=False)
class Calibration:
    """What `calibrate` found: a camera for every colour, and how it was found."""

    channels: dict[str, CameraFit]
    """By channel: "R", "G", "B", "Y" or "grey"."""
    failed: dict[str, str]
    """Pictures that could not be used, and why."""
    remarks: tuple[str, ...]
    """What was assumed, and what a photographer should know."""
    pictures: tuple[str, ...]
    """Those that were used."""

    @property
    def channel(self) -> str:
        """The one that stands for all: green, luminance or grey, whichever there is; else the first."""
        return next((c for c in ("G", "Y", "grey") if c in self.channels), next(iter(self.channels)))

    @property
    def camera(self) -> Camera:
        """The camera of `channel`."""
        return self.channels[self.channel].camera

    def edges_dataset(self) -> xr.Dataset:
        """Every measured edge of every channel, one after the other: place, direction, blur, MTF50, with units."""
        import xarray as xr

        tables = {name: fit.edges for name, fit in self.channels.items() if fit.edges is not None}
        units = {"x": "px", "y": "px", "angle": "rad", "sigma": "px", "mtf50": "cycles/px"}
        units |= {"sigma_std": "px", "mtf50_std": "cycles/px"}
        columns: dict[str, Any] = {
            name: (
                "edge",
                np.concatenate([getattr(t, name) for t in tables.values()] or [np.zeros(0)]),
                {"units": unit},
            )
            for name, unit in units.items()
        }
        columns["channel"] = ("edge", [name for name, t in tables.items() for _ in range(t.x.size)])
        columns["picture"] = ("edge", [str(s) for t in tables.values() for s in t.source])
        return xr.Dataset(columns)

    @property
    def cameras(self) -> dict[str, Camera]:
        """By channel."""
        return {name: found.camera for name, found in self.channels.items()}


def calibrate(
    pictures: Sequence[Picture],
    *,
    samples: Sequence[MTFSamples] = (),
    chart: Chart | str | Path | None = None,
    model: str = "gaussian",
    half_width: float | None = 0.5,
    wavelength: float | Mapping[str, float] | None = None,
    pixel_pitch: float | None = None,
    f_numbers: Sequence[float] | float | None = None,
    tone: Tone = "auto",
    channels: Sequence[str] | None = None,
    accept_sharpened: bool = False,
) -> Calibration:
    """A camera from pictures of slanted edges, and from any other measurements of its MTF (MODEL 7).

    pictures: files (8 or 16 bit TIFF, PNG, JPEG; OpenEXR; camera raw), arrays (height, width[, 3]) of linear values, or
    `Photograph`s. samples: measurements of gratings, stars, dots. chart: what the pictures show, or its file (`matcam chart`
    writes it): its gratings, stars and dots are then measured, too.
    model: of the lens: "gaussian" (the paper's sigma_mtf), "halo" (Gaussian core and veiling glare), "diffraction", "defocus"
    (diffraction and defocus), "measured" (the edges' own mean curve, divided by the pixel).
    half_width: of the pixel's sensitive area, px; None: fitted together with a Gaussian core, and refused with the reason when
    either is not known to 10 %. That takes many edges; with wavelength, pixel_pitch (m) and f-numbers diffraction is taken into
    account. wavelength: m, one or by channel. f_numbers: one for each picture, or one for all; None: the files' own.
    tone: of pictures that are not linear by nature: "linear", "srgb", a gamma or a table; "auto": 8-bit files are taken for
    sRGB, others for linear, and `remarks` says so.
    channels: of "R", "G", "B", "Y", "grey"; None: all there are.

    One bad picture among many is left out, and listed in `failed`. Raises ArgumentError for bad arguments and for pictures of
    different cameras, FitError where measurements contradict one another or do not determine what was asked, and the error of
    the first bad picture if there is no good one.
    """
    checks.choice("model", model, MODELS)
    if half_width is not None:
        checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
    elif model != "gaussian":
        raise ArgumentError(f"half_width can be fitted with the gaussian model only, not with {model}")
    for name in channels or ():
        checks.choice("channel", name, CHANNELS)
    if not len(pictures) and not len(samples):
        raise ArgumentError("there is nothing to calibrate from: no pictures, no samples")
    request = CameraRequest(model, half_width, wavelength, pixel_pitch)
    described = read_chart(chart) if isinstance(chart, str | Path) else chart
    plan = Plan(tone, channels, half_width or 0.5, accept_sharpened, described)
    evidence, failed, remarks, used = _gathered(pictures, f_numbers, plan)
    for one in samples:
        evidence.setdefault(one.channel, Evidence()).add_samples(one)
    found = {}
    for channel, of_channel in evidence.items():
        fitted = fit_camera(of_channel, channel, request)
        source = f"{len(used)} pictures ({', '.join(used)}), channel {channel}: {fitted.summary}"
        created = datetime.datetime.now(datetime.UTC).date().isoformat()
        software = f"matcam {metadata.version('matcam')}"
        provenance = Provenance(source=source, created=created, software=software, notes="; ".join(remarks))
        found[channel] = fitted.with_provenance(provenance)
    return Calibration(found, failed, tuple(remarks), tuple(used))


def _gathered(
    pictures: Sequence[Picture], f_numbers: Any, plan: Plan
) -> tuple[dict[str, Evidence], dict[str, str], list[str], list[str]]:
    """Evidence by channel, failures, remarks, names of the pictures used."""
    apertures = _f_numbers(f_numbers, len(pictures))
    evidence: dict[str, Evidence] = {}
    failed: dict[str, str] = {}
    remarks: list[str] = []
    cameras: dict[str, str] = {}
    errors: list[MatcamError] = []
    used = []
    for number, picture in enumerate(pictures):
        name = str(picture) if isinstance(picture, str | Path) else f"picture {number + 1}"
        short = Path(name).name
        try:
            photograph = _opened(picture)
            if photograph.exif.camera:
                cameras.setdefault(photograph.exif.camera, short)
            aperture = apertures[number] if apertures[number] is not None else photograph.exif.f_number
            measured = plan.measured(photograph, short, aperture)
        except FitError as error:
            errors.append(FitError(f"{short}: {error}"))
            failed[name] = str(error)
        except ArgumentError:
            raise
        except MatcamError as error:
            errors.append(error)
            failed[name] = str(error).removeprefix(f"{name}: ")
        else:
            used.append(short)
            remarks += [f"{short}: {remark}" for remark in measured.remarks]
            for channel, result in measured.edges.items():
                evidence.setdefault(channel, Evidence()).add_edges(result, short, aperture)
            for channel, samples in measured.samples.items():
                evidence.setdefault(channel, Evidence()).add_samples(*samples)
    if len(cameras) > 1:
        listed = ", ".join(f"{camera} ({file})" for camera, file in cameras.items())
        raise ArgumentError(f"pictures are of different cameras: {listed}: calibrate one at a time")
    if errors and not used:
        raise (
            errors[0]
            if len(errors) == 1
            else FitError(f"none of {len(errors)} pictures can be used; the first: {errors[0]}")
        )
    return evidence, failed, remarks, used


def _opened(picture: Any) -> Photograph:
    if isinstance(picture, Photograph):
        return picture
    if isinstance(picture, str | Path):
        return open_photograph(picture)
    return as_photograph(picture)


def _f_numbers(given: Any, count: int) -> list[float | None]:
    if given is None:
        return [None] * count
    numbers = np.asarray(checks.within("f_numbers", given, 0.3, 200.0), dtype=float)
    if numbers.ndim == 0:
        return [float(numbers)] * count
    if numbers.shape != (count,):
        raise ArgumentError(f"f_numbers must be one, or one for each of the {count} pictures, got {numbers.size}")
    return [float(n) for n in numbers]
