"""Calibration of a camera: one fit per colour to the measurements of all photographs."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from matcam.calibration.camera.camera_fit import CameraFit, fit_camera
from matcam.calibration.camera.evidence import EdgeTable, Evidence, Finding, measure_picture
from matcam.calibration.camera.lateral_colour import LateralColour, lateral_colour, lateral_remark
from matcam.calibration.camera.processed_pictures import processing_std
from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.chart_file import read_chart
from matcam.calibration.photograph.linear_image import CHANNELS, LinearImage, as_photograph
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.camera.camera import Camera
from matcam.camera.optics.colour import ColourOptics
from matcam.camera.parameters import Provenance, Uncertainty
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError, MatcamError
from matcam.core.io import plain
from matcam.core.registry import CFAS, FITTED_LENSES
from matcam.core.remark import Remark, texts
from matcam.core.results.summary import Quantity, Summarised, Summary
from matcam.files.photographs import Photograph, open_photograph

if TYPE_CHECKING:
    import xarray as xr

_REFERENCE = "G"
"""Colour with which the image size of the other colours is compared. It has the most sites in a mosaic."""
Picture = str | Path | ArrayLike | Photograph | LinearImage
"""Image as an argument of `calibrate`: file, array, `Photograph` or `LinearImage`."""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarised):
    """Calibrated camera for every colour, with the fits and remarks.

    Attributes:
        channels: fits by channel: "R", "G", "B", "Y" or "grey".
        failed: images that could not be used: reason by name of the image.
        remarks: assumptions, and advice to the photographer.
        pictures: names of the images that were used.
        lateral_colour: size of the red and of the blue image relative to green, by channel. Default: {}, it is unknown.
        shape: height and width of the images, px. Default: None, the images differ in shape, or there are no images.

    Example:
        >>> f = np.linspace(0.05, 0.5, 10)
        >>> mtf = np.exp(-2 * (np.pi * 0.6 * f) ** 2) * np.sinc(f)
        >>> star = matcam.targets.MTFSamples("star", (9.0, 9.0), f, np.zeros(10), mtf, 1e-6 * np.eye(10))
        >>> found = matcam.calibrate([], samples=[star])
        >>> found.channel, list(found.to_dict()["channels"]["grey"]["parameters"])
        ('grey', ['optics.sigma_px'])
    """

    channels: dict[str, CameraFit]
    failed: dict[str, str]
    remarks: tuple[Remark, ...]
    pictures: tuple[str, ...]
    lateral_colour: dict[str, LateralColour] = field(default_factory=dict)
    shape: tuple[int, int] | None = None

    @property
    def channel(self) -> str:
        """Channel that represents the camera.

        It is green, luminance or grey if available, otherwise the first channel.
        """
        return next((c for c in ("G", "Y", "grey") if c in self.channels), next(iter(self.channels)))

    @property
    def camera(self) -> Camera:
        """Camera of `channel`."""
        return self.channels[self.channel].camera

    @property
    def cameras(self) -> dict[str, Camera]:
        """Cameras by channel."""
        return {name: found.camera for name, found in self.channels.items()}

    @property
    def colour_camera(self) -> Camera | None:
        """Camera with a lens for each colour.

        None if the channels are not R, G and B, or if their pixels differ. The errors of the colours are treated as
        independent.
        """
        if set(self.channels) != set("RGB"):
            return None
        red, green, blue = cameras = [self.cameras[name] for name in "RGB"]
        if not red.pixel == green.pixel == blue.pixel:
            return None
        names: list[str] = []
        covariances = []
        for colour, one in zip(("red", "green", "blue"), cameras, strict=True):
            known = one.uncertainty or Uncertainty.of({})
            own = [n for n, name in enumerate(known.names) if name.startswith("optics.")]
            names += [f"optics.{colour}.{known.names[n].removeprefix('optics.')}" for n in own]
            covariances.append(np.asarray(known.covariance)[np.ix_(own, own)])
        return Camera(
            ColourOptics(red.optics, green.optics, blue.optics),
            green.pixel,
            green.sensor,
            uncertainty=Uncertainty(names, block_diag(*covariances)) if names else None,
            provenance=green.provenance,
            field=green.field,
        )

    def edges_dataset(self) -> xr.Dataset:
        """Convert the measured edges of all channels to one data set.

        Returns:
            Position, direction, blur and MTF50 of each edge, with units. If all images have the same shape, the data set also
            contains the image height (distance from the middle) and the plane of each edge. The plane is "meridional" if the
            normal of the edge is within 45 degrees of the radius, otherwise "sagittal".
        """
        import xarray as xr

        from matcam.core.results.labelled import named

        tables = {name: fit.edges for name, fit in self.channels.items() if fit.edges is not None}
        names = {
            "x": "position of the middle of the edge [px]",
            "y": "position of the middle of the edge, downwards [px]",
            "angle": "direction of the normal towards the bright side [rad]",
            "sigma": "standard deviation of the Gaussian blur of the lens [px]",
            "mtf50": "frequency at which the MTF is one half [cycles/px]",
            "sigma_std": "standard deviation of sigma [px]",
            "mtf50_std": "standard deviation of mtf50 [cycles/px]",
        }
        edges = EdgeTable.joined(tables.values()) if tables else EdgeTable(*[np.zeros(0)] * len(EdgeTable._fields))
        columns: dict[str, Any] = {name: ("edge", getattr(edges, name)) for name in names}
        if self.shape is not None:
            height, meridional = edges.over_field(((self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2))
            columns["image_height"] = ("edge", height)
            columns["plane"] = ("edge", np.where(meridional, "meridional", "sagittal"))
            names |= {"image_height": "distance from the middle of the image [px]"}
        channels = np.repeat(list(tables), [table.x.size for table in tables.values()])
        columns |= {"channel": ("edge", channels.astype(str)), "picture": ("edge", edges.source.astype(str))}
        return named(xr.Dataset(columns), names)

    def _summary(self) -> Summary:
        sections = {f"Channel {name}": fit.quantities() for name, fit in self.channels.items()}
        sections["Images that failed"] = [Quantity(name, why) for name, why in self.failed.items()]
        lines = [f"{name}: {fit.headline}." for name, fit in self.channels.items() if not fit.consistent]
        remarks = (*self.remarks, *(r for fit in self.channels.values() for r in fit.remarks if r not in self.remarks))
        return Summary(
            f"Camera calibrated from {len(self.pictures)} image{'' if len(self.pictures) == 1 else 's'}",
            " ".join(lines),
            sections,
            remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to the JSON object of `matcam calibrate --json`.

        Returns:
            The fit and the lateral colour of each channel, names of used and failed images, and the text of each remark.
        """
        return plain(
            {
                "channel": self.channel,
                "channels": self.channels,
                "pictures": self.pictures,
                "failed": self.failed,
                "remarks": texts(self.remarks),
                "lateral_colour": {name: found._asdict() for name, found in self.lateral_colour.items()},
            }
        )


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
    cfa: str | None = None,
    accept_sharpened: bool = False,
) -> Calibration:
    """Calibrate a camera with images of slanted edges and other targets.

    Images that cannot be used are skipped, and listed in `failed`.

    Args:
        pictures: files (8- or 16-bit TIFF, PNG, JPEG; OpenEXR; camera raw), arrays (height, width[, 3]) of linear values,
            `Photograph`s, or `LinearImage`s of one colour each. All must be taken with one camera.
        samples: measurements of gratings, stars and dots. Default: none.
        chart: description of the chart in the images, or its file, which `matcam chart` writes. With a chart, gratings, stars
            and dots are also measured. Default: None, slanted edges only.
        model: lens model (no unit): "gaussian" (sigma_mtf of Holzschuch & Pacanowski 2017), "halo" (Gaussian core and
            veiling glare), "diffraction", "defocus" (diffraction and defocus), "measured" (mean MTF of the edges,
            divided by that of the pixel). Default: "gaussian".
        half_width: half the side of the sensitive area of a pixel, in (0, 0.5] px. None: it is fitted together with a
            Gaussian core. This fit requires many edges, and fails if the width of the core or the half width of the pixel is
            not determined to 10 %. Default: 0.5.
        wavelength: wavelength of the light, m, one value or a mapping by channel. It is required by "diffraction" and
            "defocus". With `half_width=None`, diffraction is included if a wavelength is given. Default: None.
        pixel_pitch: pixel pitch, m; required with `wavelength`. Default: None.
        f_numbers: f-number of each image, or one for all (no unit). Default: None, those of the files.
        tone: tone curve of images whose format is not linear (no unit): "linear", "srgb", a gamma, or a table of linear values
            by code. Default: "auto": 8-bit files are assumed to be sRGB, and others linear. `remarks` lists the assumptions.
        channels: channels out of "R", "G", "B", "Y" (luminance), "grey" (no unit). Default: None, all available ones.
        cfa: colours of the first 2 x 2 px, row by row, of mosaics whose files do not specify them: "RGGB", "BGGR", "GRBG" or
            "GBRG" (no unit). Mosaics are not demosaiced. Default: None, those of the files, or no mosaic.
        accept_sharpened: True to accept sharpened edges, and images that were denoised or compressed (no unit). The result is
            then the MTF of lens and processing. Default: False.

    Returns:
        A camera for every colour with its uncertainty, the agreement with the edges, and remarks.

    Raises:
        ArgumentError: if an argument is out of range, if the model requires a missing argument, or if the images are of
            different cameras.
        FitError: if measurements contradict one another, or do not determine the requested parameters. If edges are the only
            measurements, at least 8 edges in two directions are required, and at most 30 % may be sharpened or saturated.
        MatcamError: if no image can be used; the message contains the error of the first image.

    Source:
        docs/model.md 7; docs/calibrate.md.

    Example:
        >>> f = np.linspace(0.05, 0.5, 10)
        >>> mtf = np.exp(-2 * (np.pi * 0.6 * f) ** 2) * np.sinc(f)
        >>> star = matcam.targets.MTFSamples("star", (9.0, 9.0), f, np.zeros(10), mtf, 1e-6 * np.eye(10))
        >>> found = matcam.calibrate([], samples=[star])
        >>> round(float(found.camera.optics.sigma), 3)
        0.6
    """
    checks.choice("model", model, tuple(FITTED_LENSES))
    if half_width is not None:
        checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
    elif model != "gaussian":
        raise ArgumentError(f"half_width can be fitted with the gaussian model only, not with {model}: give half_width")
    for name in () if channels is None else channels:
        checks.choice("channel", name, CHANNELS)
    if cfa is not None:
        checks.choice("cfa", cfa, CFAS)
    checks.flag("accept_sharpened", accept_sharpened)
    samples = checks.instances("samples", samples, MTFSamples)
    if not len(pictures) and not len(samples):
        raise ArgumentError("neither pictures nor samples were given: give at least one of them")
    described = read_chart(chart) if isinstance(chart, str | Path) else chart
    measure = partial(
        measure_picture, tone=tone, channels=channels, half_width=half_width or 0.5, accept_sharpened=accept_sharpened,
        chart=described, cfa=cfa,
    )  # fmt: skip
    measured = _Pictures()
    for number, (picture, f_number) in enumerate(
        zip(pictures, _checked_f_numbers(f_numbers, len(pictures)), strict=True)
    ):
        measured.add(picture, f"image {number + 1}", f_number, measure)
    measured.check()
    findings = measured.findings + [Finding(s.channel, s.source, s.f_number, None, (s,)) for s in samples]
    fits, names = {}, [Path(name).name for name in measured.failed]
    for channel in dict.fromkeys(f.channel for f in findings):
        evidence = Evidence(f for f in findings if f.channel == channel)
        measured.remarks += evidence.check(channel, names, accept_sharpened=accept_sharpened)
        colour = wavelength.get(channel) if isinstance(wavelength, Mapping) else wavelength
        fit = fit_camera(evidence, channel, model, half_width, colour, pixel_pitch)
        if fit.names[0].endswith("sigma_px"):
            fit = fit.with_wider_errors(processing_std(evidence.software, float(fit.values[0])))
        fit = replace(fit, camera=fit.camera.with_field(evidence.field()))
        measured.remarks += fit.remarks
        fits[channel] = fit.with_provenance(measured.provenance(f"channel {channel}: {fit.headline}"))
    shapes = {f.shape for f in findings if f.shape is not None}
    shape = shapes.pop() if len(shapes) == 1 else None
    lateral = {} if shape is None else _lateral_colours(fits, shape)
    measured.remarks += [r for name, found in lateral.items() if (r := lateral_remark(found, name, _REFERENCE))]
    return Calibration(fits, measured.failed, tuple(measured.remarks), tuple(measured.used), lateral, shape)


def _lateral_colours(fits: Mapping[str, CameraFit], shape: tuple[int, int]) -> dict[str, LateralColour]:
    green = fits[_REFERENCE].edges if _REFERENCE in fits else None
    if green is None:
        return {}
    others = {name: fit.edges for name, fit in fits.items() if name in ("R", "B")}
    found = {name: lateral_colour(edges, green, shape) for name, edges in others.items() if edges is not None}
    return {name: one for name, one in found.items() if one is not None}


@dataclass
class _Pictures:
    """Measurements of all images, and the images that failed.

    Attributes:
        findings: measurements of each colour of each image.
        remarks: remarks on all images.
        used: names of the images that were used.
        failed: images that were not used: reason by name of the image.
        errors: errors of the images that were not used.
        cameras: first image of every camera, by the name of the camera.
    """

    findings: list[Finding] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    used: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    errors: list[MatcamError] = field(default_factory=list)
    cameras: dict[str, str] = field(default_factory=dict)

    def add(self, picture: Any, name: str, f_number: float | None, measure: Callable[..., Any]) -> None:
        """Measure an image, or record its error. `name` is the name for an image without a file name."""
        if isinstance(picture, str | Path):
            name = str(picture)
        elif isinstance(picture, LinearImage):
            name = picture.source or name
        short = Path(name).name
        try:
            if isinstance(picture, str | Path):
                picture = open_photograph(picture)
            elif not isinstance(picture, Photograph | LinearImage):
                picture = as_photograph(picture)
            if isinstance(picture, LinearImage):
                own = picture.f_number
            else:
                own = picture.exif.f_number
                if picture.exif.camera:
                    self.cameras.setdefault(picture.exif.camera, short)
            findings, remarks = measure(picture, short, own if f_number is None else f_number)
        except ArgumentError:
            raise
        except MatcamError as error:
            self.errors.append(FitError(f"{short}: {error}") if isinstance(error, FitError) else error)
            self.failed[name] = str(error).removeprefix(f"{name}: ")
        else:
            self.used.append(short)
            self.findings += findings
            self.remarks += [remark.about(short) for remark in remarks]

    def check(self) -> None:
        """Check that the images determine one camera.

        An ArgumentError is raised if the images are of different cameras. If the only image cannot be used, its error is
        raised. If none of several images can be used, a FitError with the error of the first image is raised.
        """
        if len(self.cameras) > 1:
            listed = ", ".join(f"{camera} ({file})" for camera, file in self.cameras.items())
            raise ArgumentError(f"the images are of different cameras: {listed}; calibrate one camera at a time")
        if self.errors and not self.used:
            count, first = len(self.errors), self.errors[0]
            raise (
                first if count == 1 else FitError(f"all {count} images are unusable; error of the first image: {first}")
            )

    def provenance(self, summary: str) -> Provenance:
        return Provenance(
            source=f"{len(self.used)} image{'s' * (len(self.used) > 1)} ({', '.join(self.used)}), {summary}",
            created=datetime.datetime.now(datetime.UTC).date().isoformat(),
            software=f"matcam {metadata.version('matcam')}",
            notes="; ".join(texts(self.remarks)),
        )


def _checked_f_numbers(f_numbers: Any, count: int) -> list[float | None]:
    if f_numbers is None:
        return [None] * count
    numbers = np.asarray(checks.within("f_numbers", f_numbers, 0.3, 200.0), dtype=float)
    if numbers.shape not in ((), (count,)):
        raise ArgumentError(
            f"f_numbers must be one value, or one for each image (images: {count}, values: {numbers.size})"
        )
    return list(np.broadcast_to(numbers, count).tolist())
