"""The calibration of a camera: every measurement of every photograph, in one fit per colour, judged and with its errors."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.camera.camera_fit import CameraFit, CameraRequest, fit_camera
from matcam.calibration.camera.evidence import EdgeTable, Evidence, Finding, PicturePlan
from matcam.calibration.camera.lateral_colour import LateralColour, lateral_colour, lateral_remark
from matcam.calibration.camera.processed_pictures import processing_std
from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.chart_file import read_chart
from matcam.calibration.photograph.linear_image import CHANNELS, LinearImage, as_photograph
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.camera.camera import Camera
from matcam.camera.parameters import Provenance
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError, MatcamError
from matcam.core.io import plain
from matcam.core.registry import CFAS, FITTED_LENSES
from matcam.core.remark import Remark, texts
from matcam.core.results.summary import Quantity, Summarised, Summary
from matcam.files.photographs import Photograph, open_photograph

if TYPE_CHECKING:
    import xarray as xr

_REFERENCE = "G"  # the colour with the most sites
Picture = str | Path | ArrayLike | Photograph | LinearImage


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarised):
    """Camera for every colour, and how it was found.

    Attributes:
        channels: fits by channel: "R", "G", "B", "Y" or "grey".
        failed: images that could not be used, and why.
        remarks: what was assumed, and what a photographer should know.
        pictures: names of the images that were used.
        lateral_colour: by how much red and blue are larger than green, by channel. Default: {}, not known.
        shape: height and width of the images, px. Default: None, they differ, or there are none.

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
        """Return the channel that represents the camera.

        It is green, luminance or grey, whichever there is, or else the first.
        """
        return next((c for c in ("G", "Y", "grey") if c in self.channels), next(iter(self.channels)))

    @property
    def camera(self) -> Camera:
        """Return the camera of `channel`."""
        return self.channels[self.channel].camera

    @property
    def cameras(self) -> dict[str, Camera]:
        """Return the cameras by channel."""
        return {name: found.camera for name, found in self.channels.items()}

    def edges_dataset(self) -> xr.Dataset:
        """Return the measured edges of all channels in one data set.

        Returns:
            Place, direction, blur and MTF50 of each, with units. For images of one shape also the image height, its distance
            from their middle, and the plane: an edge whose normal lies within 45 degrees of the radius shows the "meridional"
            MTF, any other the "sagittal" one.
        """
        import xarray as xr

        from matcam.core.results.labelled import named

        tables = {name: fit.edges for name, fit in self.channels.items() if fit.edges is not None}
        names = {
            "x": "position of the middle of the edge [px]",
            "y": "position of the middle of the edge, downwards [px]",
            "angle": "direction of the normal towards the bright side [rad]",
            "sigma": "standard deviation of the Gaussian lens of the edge [px]",
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
        """Return the result as `matcam calibrate --json` prints it.

        Returns:
            The fit of every channel, images, failures, and the remarks' texts.
        """
        return plain(
            {
                "channel": self.channel,
                "channels": {name: fit.to_dict() for name, fit in self.channels.items()},
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
    """Find a camera from images of slanted edges and other targets.

    An image that cannot be used is left out, and listed in `failed`.

    Args:
        pictures: files (8 or 16 bit TIFF, PNG, JPEG; OpenEXR; camera raw), arrays (height, width[, 3]) of linear values, or
            `Photograph`s, or `LinearImage`s, each of one colour. All by one camera.
        samples: measurements of gratings, stars, dots. Default: none.
        chart: what the images show, or its file, which `matcam chart` writes. Default: None, slanted edges only. With it
            gratings, stars and dots are measured, too.
        model: lens (no unit): "gaussian" (the paper's sigma_mtf), "halo" (Gaussian core and veiling glare), "diffraction",
            "defocus" (diffraction and defocus), "measured" (the edges' own mean curve, divided by the pixel).
            Default: "gaussian".
        half_width: half the side of a pixel's sensitive area, in (0, 0.5] px. Default: 0.5. None fits it together with a
            Gaussian core, which takes many edges, and is refused where either is not known to 10 %.
        wavelength: of the light, m, one or by channel. Default: None. "diffraction" and "defocus" need it; with
            `half_width=None` it takes diffraction into account.
        pixel_pitch: distance between pixels, m. Default: None. Needed with `wavelength`.
        f_numbers: f-number of each image, or one for all (no unit). Default: None, the files' own.
        tone: tone curve of images that are not linear by nature (no unit): "linear", "srgb", a gamma, or a table of linear
            values by code. Default: "auto", 8-bit files are taken for sRGB, others for linear, and `remarks` says so.
        channels: of "R", "G", "B", "Y" (luminance), "grey" (no unit). Default: None, all there are.
        cfa: colours of the first 2 x 2 px, row by row, of mosaics whose files do not say so: "RGGB", "BGGR", "GRBG" or "GBRG".
            The sites of each colour are samples as they are. Default: None, the files' own, or no mosaic (no unit).
        accept_sharpened: measure edges that overshoot as sharpened ones do, and images that were denoised or compressed: lens
            and software together (no unit). Default: False.

    Returns:
        A camera for every colour with its uncertainty, how well it explains the edges, and remarks.

    Raises:
        ArgumentError: if an argument is out of range, or the images are of different cameras.
        FitError: if measurements contradict one another, or do not determine what was asked; if there are edges only, fewer
            than 8 or all in one direction, or more than 30 % of them sharpened or saturated.
        MatcamError: the error of the first bad image, if there is no good one.

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
        raise ArgumentError(f"half_width can be fitted with the gaussian model only, not with {model}")
    for name in () if channels is None else channels:
        checks.choice("channel", name, CHANNELS)
    if cfa is not None:
        checks.choice("cfa", cfa, CFAS)
    checks.flag("accept_sharpened", accept_sharpened)
    samples = checks.instances("samples", samples, MTFSamples)
    if not len(pictures) and not len(samples):
        raise ArgumentError("neither pictures nor samples were given: give at least one of them")
    described = read_chart(chart) if isinstance(chart, str | Path) else chart
    plan = PicturePlan(tone, channels, half_width or 0.5, accept_sharpened, described, cfa)
    measured = _Pictures()
    for number, (picture, f_number) in enumerate(
        zip(pictures, _checked_f_numbers(f_numbers, len(pictures)), strict=True)
    ):
        measured.add(picture, f"image {number + 1}", f_number, plan)
    measured.check()
    findings = measured.findings + [Finding(s.channel, s.source, s.f_number, None, (s,)) for s in samples]
    request = CameraRequest(model, half_width, wavelength, pixel_pitch)
    fits = {}
    for channel in dict.fromkeys(f.channel for f in findings):
        evidence = Evidence(f for f in findings if f.channel == channel)
        measured.remarks += evidence.check(channel, accept_sharpened=accept_sharpened)
        fit = fit_camera(evidence, channel, request)
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
    """Compare the size of the other colours with green in images of one shape that have enough edges."""
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
        findings: one for each colour of each image.
        remarks: on all images.
        used: names of the images that were used.
        failed: why others were not, by name.
        errors: the same, as errors.
        cameras: first image of every camera, by the camera's name.
    """

    findings: list[Finding] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    used: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    errors: list[MatcamError] = field(default_factory=list)
    cameras: dict[str, str] = field(default_factory=dict)

    def add(self, picture: Any, name: str, f_number: float | None, plan: PicturePlan) -> None:
        """Measure an image, or record its error.

        `name` is used for an image that is not a file.
        """
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
            findings, remarks = plan.measure(picture, short, own if f_number is None else f_number)
        except ArgumentError:
            raise
        except MatcamError as error:
            self.errors.append(FitError(f"{short}: {error}") if isinstance(error, FitError) else error)
            self.failed[name] = str(error).removeprefix(f"{name}: ")
        else:
            self.used.append(short)
            self.findings += findings
            self.remarks += [Remark(remark.code, f"{short}: {remark.text}") for remark in remarks]

    def check(self) -> None:
        """Raise an error if the images cannot give one camera.

        ArgumentError: they are of different cameras. If none could be used, the error of the first image is raised.
        """
        if len(self.cameras) > 1:
            listed = ", ".join(f"{camera} ({file})" for camera, file in self.cameras.items())
            raise ArgumentError(f"pictures are of different cameras: {listed}: calibrate one at a time")
        if self.errors and not self.used:
            count, first = len(self.errors), self.errors[0]
            raise first if count == 1 else FitError(f"none of {count} images can be used; the first: {first}")

    def provenance(self, summary: str) -> Provenance:
        """Return the provenance of a profile that is made from these images."""
        return Provenance(
            source=f"{len(self.used)} images ({', '.join(self.used)}), {summary}",
            created=datetime.datetime.now(datetime.UTC).date().isoformat(),
            software=f"matcam {metadata.version('matcam')}",
            notes="; ".join(texts(self.remarks)),
        )


def _checked_f_numbers(f_numbers: Any, count: int) -> list[float | None]:
    """Return one f-number for each image.

    None selects the f-number in the file.
    """
    if f_numbers is None:
        return [None] * count
    numbers = np.asarray(checks.within("f_numbers", f_numbers, 0.3, 200.0), dtype=float)
    if numbers.shape not in ((), (count,)):
        raise ArgumentError(f"f_numbers must be one, or one for each of the {count} images, got {numbers.size}")
    return list(np.broadcast_to(numbers, count).tolist())
