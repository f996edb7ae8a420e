"""Slanted edges (ISO 12233): the MTF of a camera from one edge or from many edges, with standard deviations.

Up to about 500 edges are measured one by one. Larger numbers of edges are measured by a compiled program, ten at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge.edge_result import EdgeMTF, EdgeStack, stack_result
from matcam.calibration.edge.free_curve import GHOSTS, GLARE, line_width
from matcam.calibration.edge.geometry import Rows, aligned_rows
from matcam.calibration.edge.maximum_likelihood import Noise
from matcam.calibration.edge.measurement import EdgeFits, edge_fits, fits_program, lens_fit
from matcam.calibration.edge.processing import with_traces
from matcam.calibration.edge.profiles import Gaussian, LensModel, check_light, lens_model
from matcam.calibration.edge.rows import (
    EdgeRegions,
    RegionFrame,
    clearance,
    describe_content,
    edge_region,
    edge_regions,
    refusals,
)
from matcam.calibration.edge.start import in_even_rows
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, flaw
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.photograph.uneven_light import EXCLUDED_WIDTHS, LightField, light_field
from matcam.core import checks
from matcam.core.arrays import changed, tuple_map
from matcam.core.errors import ArgumentError, FitError, RegionError
from matcam.core.registry import PARAMETRIC_LENSES
from matcam.core.remark import Remark
from matcam.files.photographs import Photograph

AT_ONCE = 10
"""Number of edges that are processed together. The data of ten edges fit into the cache of the processor."""


@dataclass(frozen=True)
class EdgeSettings:
    """Settings for the measurement of edges.

    Attributes:
        lens: lens model of the parametric estimate.
        noise: noise of the pixels; its parameters are NaN if they are estimated from the image.
        half_width: half the side of the sensitive area of a pixel, px.
        accept_sharpened: whether sharpened images are measured.
    """

    lens: LensModel = field(default_factory=Gaussian)
    noise: Noise = field(default_factory=Noise)
    half_width: float = 0.5
    accept_sharpened: bool = False


def edge_mtf(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    model: str = "gaussian",
    wavelength: float | None = None,
    pixel_pitch: float | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "auto",
    gain: float | None = None,
    read_noise: float | None = None,
    accept_sharpened: bool = False,
) -> EdgeMTF:
    """Measure the MTF of lens and pixel across one slanted edge.

    The MTF applies to the direction of the edge normal. It is estimated without a model and with a lens model. The edge
    may deviate from a straight line by a few px, and the light may vary over the region. The edge must not be parallel
    to the pixel grid or to its diagonals, because the pixels must sample it at different phases. `docs/edge.md`
    describes the method, its accuracy and the tests.

    Args:
        image: `LinearImage`, `Photograph`, or array (height, width) or (height, width, 3) for R, G, B; NaN marks missing
            pixels.
        roi: region (x, y, width, height) that contains one edge, px. It must have at least 16 x 16 px and at most 2^22
            pixels; 80 px across the edge and 160 px along the edge are recommended. Default: None, the whole image.
        model: lens model of the parametric estimate (no unit): "gaussian"; "diffraction"; "defocus" (with diffraction);
            or "halo" (a Gaussian with veiling glare). Choose another model if the result reports that the model does
            not explain the edge. Default: "gaussian".
        wavelength: wavelength of the light, m; required by "diffraction" and "defocus". Default: None.
        pixel_pitch: pixel pitch, m; required by "diffraction" and "defocus". Default: None.
        half_width: half the side of the sensitive area of a pixel, (0, 0.5] px. It hardly affects the model-free
            estimate. Default: 0.5.
        cfa: colours of the first 2 x 2 px of a mosaic, row by row: "RGGB", "BGGR", "GRBG" or "GBRG" (no unit). The
            sites of `channel` are used without demosaicing. Default: None, the colours in the photograph, or no mosaic.
        channel: "R", "G" or "B" of a mosaic or of a colour image; "Y" for the luminance of a colour image (no unit).
            This argument is required for a mosaic. Default: None, the luminance of a colour image, or a grey image
            itself.
        tone: tone curve of the codes, as in `LinearImage.of` (no unit). Default: "auto", as in `calibrate`: photographs of
            8 bits are assumed to be sRGB, which `remarks` reports; arrays, 16-bit files and camera raw are assumed to be
            linear.
        gain: system gain: the variance of a pixel is gain * value + read_noise^2, in the units of the linear image (counts of
            photo-electrons have gain 1). Default: None, gain and read_noise are estimated.
        read_noise: standard deviation of the read noise, in the units of the linear image. Default: None, gain and
            read_noise are estimated.
        accept_sharpened: measure a sharpened image instead of raising an error; the result is the MTF of lens, pixel
            and sharpening (no unit). Default: False.

    Returns:
        The model-free and the parametric estimate, with their standard deviations.

    Raises:
        ArgumentError: an argument is invalid.
        RegionError: the region does not contain exactly one edge.
        FitError: the edge cannot be measured; the message gives the reason.

    Source:
        ISO 12233; docs/model.md 7.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> result = matcam.edge_mtf(image)
        >>> print(f"{result.mtf50:.2f} cycles/px, normal at {np.degrees(result.angle):.1f} degrees")
        0.22 cycles/px, normal at -5.7 degrees
    """
    settings = _settings(model, wavelength, pixel_pitch, half_width, gain, read_noise, accept_sharpened)
    region, rows = edge_region(image, roi, channel, cfa, tone)
    rows = _placed(rows, *region.corner)
    stack = edge_stack([(rows, [None])], settings, even_light=True)
    if problem := stack.problems[0]:
        # These problems may be absent in another region of the image.
        raise (RegionError if problem.code in ("no-edge", "unexplained") else FitError)(problem.text)
    result = stack[0]
    return replace(result, given=region.remarks + result.given)


def edge_mtf_stack(
    images: ArrayLike | Sequence[LinearImage],
    *,
    model: str = "gaussian",
    wavelength: float | None = None,
    pixel_pitch: float | None = None,
    half_width: float = 0.5,
    gain: float | None = None,
    read_noise: float | None = None,
    accept_sharpened: bool = False,
) -> EdgeStack:
    """Measure the MTF across one edge in each of many regions.

    For 500 edges or more, a compiled program is used, which is several times faster than calls of `edge_mtf`. Either
    all edges must be closer to vertical than to horizontal, or all edges must be closer to horizontal.

    Args:
        images: regions of equal shape, each with one edge: array (n, height, width) of linear values, or a sequence of
            `LinearImage` objects that are not mosaics. Height and width must be at least 16 px.
        model: lens model of the parametric estimate, as in `edge_mtf` (no unit). Default: "gaussian".
        wavelength: wavelength of the light, m; required by "diffraction" and "defocus". Default: None.
        pixel_pitch: pixel pitch, m; required by "diffraction" and "defocus". Default: None.
        half_width: half the side of the sensitive area of a pixel, (0, 0.5] px. Default: 0.5.
        gain: system gain, as in `edge_mtf`. Default: None, estimated for each edge.
        read_noise: standard deviation of the read noise, in the units of the images. Default: None, estimated for each edge.
        accept_sharpened: measure sharpened images, as in `edge_mtf` (no unit). Default: False.

    Returns:
        The results. The values of an edge that cannot be measured are NaN, and `problems` gives the reason.

    Raises:
        ArgumentError: an argument is invalid, or some edges are closer to vertical and others closer to horizontal.

    Source:
        ISO 12233; docs/model.md 7.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> images = [100 + 800 / (1 + np.exp(-2 * (x - slope * y))) for slope in (0.1, 0.15)]
        >>> stack = matcam.edge_mtf_stack(images)
        >>> np.round(np.degrees(stack.angle), 1)
        array([-5.7, -8.5])
    """
    settings = _settings(model, wavelength, pixel_pitch, half_width, gain, read_noise, accept_sharpened)
    values, corners = _stacked(images)
    regions = []
    for i in range(0, len(values), AT_ONCE):
        some = values[i : i + AT_ONCE].astype(np.float64)
        rows = _placed(edge_regions(some), *corners[i : i + AT_ONCE].T)
        regions.append((rows, [flaw(one) for one in some]))
        if rows.frame.transposed != regions[0][0].frame.transposed:
            raise ArgumentError(
                f"images must have edges that are all closer to vertical, or all closer to horizontal, but the edges with the "
                f"indices {i} to {i + len(some) - 1} differ from the first edges: measure them separately"
            )
    return edge_stack(regions, settings, even_light=True)


def edge_stack(
    regions: Sequence[tuple[EdgeRegions, list[Remark | None]]], settings: EdgeSettings, *, even_light: bool = False
) -> EdgeStack:
    """Measure the edges in regions of one shape.

    Args:
        regions: pairs of a group of at most `AT_ONCE` regions and a list, which contains the known problem of each
            region or None.
        settings: settings of the measurement.
        even_light: correct the regions for uneven light, and search for traces of image processing. Default: False.
    """
    # For fewer than 500 edges, compiling takes longer than it saves.
    fit = _compiled_fits if len(regions) * AT_ONCE >= 500 else _fits
    chunks: list[tuple[EdgeFits, RegionFrame, np.ndarray]] = []
    problems: list[Remark | None] = []
    even: list[EdgeRegions] = []
    lights: list[LightField | None] = []
    for given, known in regions:
        rows, fits = given, fit(given, settings)
        if even_light:
            rows, found = _in_even_light(given, fits)
            again = np.flatnonzero([light is not None and light.amplitude > 0 for light in found])
            if again.size:
                some = {name: getattr(rows, name)[again] for name in ("value", "y", "start")}
                anew = fit(rows._replace(**some), settings)
                fits = tuple_map(lambda a, new: changed(a, again, new), fits, anew)  # noqa: B023
            even.append(rows)
            lights += found
        if settings.lens.name != "gaussian":
            of_lens = lambda edge: lens_fit(edge, np.float64(settings.half_width), settings.lens)  # noqa: E731
            fits = fits._replace(parametric=_of_each(len(fits.outliers), of_lens, fits))
        clear = clearance(fits, given)
        refused = refusals(fits, given, clear, accept_sharpened=settings.accept_sharpened)
        problems += [before or refusal for before, refusal in zip(known, refused, strict=True)]
        frame = RegionFrame(*(np.broadcast_to(column, len(rows.value)) for column in rows.frame))
        chunks.append((fits, frame, clear))
    fits, frame, clear = tuple_map(lambda *a: np.concatenate(a), *chunks)
    stack = stack_result(fits, frame, settings.lens, settings.half_width, tuple(problems))
    return with_traces(stack, even, lights, clear) if even_light else stack


def _placed(rows: EdgeRegions, x: ArrayLike, y: ArrayLike) -> EdgeRegions:
    """Shift the frames of regions by the positions of their first pixels in the photograph, px."""
    return rows._replace(frame=rows.frame._replace(x=rows.frame.x + np.asarray(x), y=rows.frame.y + np.asarray(y)))


def _of_each(count: int, function: Callable[..., Any], *edges: Any) -> Any:
    found = [function(*tuple_map(lambda a: a[i], edges)) for i in range(count)]  # noqa: B023
    return tuple_map(lambda *a: np.array(a), *found)


def _fits(rows: EdgeRegions, settings: EdgeSettings) -> EdgeFits:
    """Fit the edges of n regions one by one. The arrays of the result have a leading axis of length n."""
    half = np.float64(settings.half_width)
    fit = partial(edge_fits, noise=settings.noise, half_width=half, step=rows.step, turns=rows.turns)
    return _of_each(len(rows.value), fit, rows.value, rows.y, rows.start)


def _compiled_fits(rows: EdgeRegions, settings: EdgeSettings) -> EdgeFits:
    count, half = len(rows.value), np.float64(settings.half_width)
    # A constant number of edges requires only one compiled program. Repeated edges are discarded.
    value, y, start = (
        np.concatenate([a, np.repeat(a[:1], AT_ONCE - count, axis=0)]) for a in (rows.value, rows.y, rows.start)
    )
    fits = fits_program()(value, y, start, settings.noise, half, rows.step, rows.turns)
    # The programs run one after the other, because queued programs compete for the threads of the processor.
    return tuple_map(lambda a: np.array(a)[:count], fits)


def _in_even_light(rows: EdgeRegions, fits: EdgeFits) -> tuple[EdgeRegions, list[LightField | None]]:
    """Correct regions for uneven light.

    Args:
        rows: n regions.
        fits: fits of their edges, NumPy arrays with a leading axis of length n.

    Returns:
        The corrected regions, and the light of each region. The light is None if a polynomial of third order explains
        it, or if it cannot be estimated.
    """
    value, fields = np.array(rows.value), list[LightField | None]()
    widths = line_width(fits.free.shape)
    for i, (region, x, y) in enumerate(zip(rows.value, *rows.coordinates(), strict=True)):
        shape, curve = fits.free.shape, fits.curve[i]
        blur = float(widths[i])
        field: LightField | None = None
        # With a wider blur, too little of the two flat sides remains.
        if np.isfinite([*curve, blur]).all() and blur < 0.1 * np.isfinite(region).sum(1).max() * rows.step:
            distance = rows.distances(i, curve, fits.length[i])
            gain, read = (float(np.asarray(part)[i]) for part in fits.noise)
            glare = bool(fits.free.coefficients[i, GLARE] != 0)
            if (fits.free.coefficients[i, GHOSTS] != 0).any():  # a ghost is not uneven light
                blur = max(blur, float(shape.apart[i]) / EXCLUDED_WIDTHS + blur)
            # The light along the edge is divided out of the rows in all cases.
            own = Rows.of(region, rows.y[i], rows.start[i], rows.step)
            by_row = in_even_rows(aligned_rows(own, curve)).light[:, None]
            field = light_field(region / by_row, x, y, distance, (gain, read), blur=blur, glare=glare)
            # A variation of the light above 20 % is attributed to a pattern of the scene.
            if field is not None and field.amplitude and (field.amplitude > 0.2 or describe_content(region)):
                field = None
            if field is not None and field.amplitude:
                value[i] = (region / by_row - field.addend) / field.factor
        fields.append(field)
    return rows._replace(value=value), fields


def _stacked(images: ArrayLike | Sequence[LinearImage]) -> tuple[np.ndarray, np.ndarray]:
    """Stack images as regions (n, height, width).

    The second result contains the positions (x, y) of the first pixels of the regions in the photograph, (n, 2) px.
    """
    planes = list(images) if isinstance(images, list | tuple) else []
    if planes and all(isinstance(plane, LinearImage) for plane in planes):
        if len({plane.shape for plane in planes}) > 1 or any(plane.cfa is not None for plane in planes):
            shapes = ", ".join(f"{plane.shape}{' of a mosaic' if plane.cfa else ''}" for plane in planes)
            raise ArgumentError(f"images must be regions of one shape without a mosaic, got shapes {shapes:.100}")
        values, corners = np.stack([plane.values for plane in planes]), np.array([plane.corner for plane in planes])
    else:
        values = checks.plain_array("images", images)
        corners = np.zeros((len(values) if values.ndim else 0, 2), int)
    if values.dtype.kind not in "uif" or values.ndim != 3 or min(values.shape[1:]) < SMALLEST or not len(values):
        raise ArgumentError(
            f"images must be an array of numbers of shape (n, height, width) with n >= 1 and sides of at least {SMALLEST} px, "
            f"got {values.dtype} {values.shape}"
        )
    return values, corners


def _settings(
    model: str, wavelength: float | None, pixel_pitch: float | None, half_width: float, gain: float | None,
    read_noise: float | None, accept_sharpened: bool,
) -> EdgeSettings:  # fmt: skip
    checks.choice("model", model, tuple(PARAMETRIC_LENSES))
    checks.flag("accept_sharpened", accept_sharpened)
    if model in ("diffraction", "defocus"):
        for name, value in (("wavelength", wavelength), ("pixel_pitch", pixel_pitch)):
            if value is None:
                raise ArgumentError(f"{name} must be given in m for the {model} model")
        check_light(wavelength, pixel_pitch)
    checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
    if (gain is None) != (read_noise is None):
        raise ArgumentError("gain and read_noise must be given together: give both, or omit both to estimate them")
    noise = Noise()
    if gain is not None and read_noise is not None:
        for name, number in (("gain", gain), ("read_noise", read_noise)):
            checks.scalar(name, checks.within(name, number, 0, np.inf, open_high=True))
        if not (gain > 0 or read_noise > 0):
            raise ArgumentError(
                "gain and read_noise must not both be 0, because every image has noise: omit both to estimate them"
            )
        noise = Noise(np.float64(gain), np.float64(read_noise))
    return EdgeSettings(lens_model(model, wavelength, pixel_pitch), noise, float(half_width), accept_sharpened)
