"""Linear colour plane of a photograph: the input of every estimator of this package.

A mosaic is not demosaiced: the sites of a colour keep their positions, with NaN between them. A colour image provides one
channel or its luminance. All estimators convert their argument `image` to such a plane with `LinearImage.of`, and `flaw` tests
whether a region can be measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from matcam.calibration.photograph.tone import Tone, assumed_tone, is_named, linear_values
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.errors import ArgumentError, FitError
from matcam.core.registry import CFAS
from matcam.core.remark import Remark
from matcam.files.photographs import Photograph
from matcam.files.picture_header import Exif
from matcam.numerics.normal import robust_std

CHANNELS = ("R", "G", "B", "Y", "grey")
"""Names of colour planes; "Y" is the luminance of a colour image."""
SMALLEST = 16
"""Smallest side of a region that is measured, px."""
SATURATED = 0.02
"""Share of saturated pixels above which a region is rejected."""


@dataclass(frozen=True, eq=False)
class LinearImage:
    """Linear colour plane of a photograph.

    Every estimator accepts a `LinearImage`, or an array that it converts with `LinearImage.of`. Create a `LinearImage`
    explicitly to apply several estimators to the same image, or to store the f-number and the file name of the image.

    Attributes:
        values: linear pixel values (height, width), any unit. NaN marks missing pixels and the sites of other colours of a
            mosaic.
        channel: "R", "G", "B", "Y" (luminance) or "grey" (no unit). Default: "grey".
        cfa: colours of the first 2 x 2 px of `values`, row by row: "RGGB", "BGGR", "GRBG" or "GBRG" (no unit). Default:
            None, no mosaic.
        tone: tone curve that was inverted: "linear", "srgb", a gamma or a table (no unit). Default: "linear".
        f_number: f-number of the photograph (no unit). Default: None, the f-number is unknown.
        source: file name, for messages and provenance (no unit). Default: "".
        corner: (x, y) of the first pixel in the whole photograph, px. Default: (0, 0).
        saturated: mask of the saturated pixels (height, width). Default: None, the mask is unknown.
        saturation: code of a saturated pixel, in the units of the photograph. Default: infinity, the code is unknown.
        remarks: assumptions about the photograph (no unit). Default: ().

    Raises:
        ArgumentError: `values` are not numbers of shape (height, width), `saturated` has another shape, or `channel` or
            `cfa` is not one of the values above. With `cfa`, `channel` must be "R", "G" or "B".

    Example:
        >>> mosaic = np.arange(16.0).reshape(4, 4)
        >>> red = matcam.LinearImage(mosaic, channel="R", cfa="RGGB")
        >>> red.values[0]
        array([ 0., nan,  2., nan])
        >>> red.cut((1, 0, 3, 2)).cfa
        'GRBG'
    """

    values: np.ndarray = field(repr=False)
    channel: str = "grey"
    cfa: str | None = None
    tone: Tone = "linear"
    f_number: float | None = None
    source: str = ""
    corner: tuple[int, int] = (0, 0)
    saturated: np.ndarray | None = field(default=None, repr=False)
    saturation: float = np.inf
    remarks: tuple[Remark, ...] = ()

    def __post_init__(self) -> None:
        checks.not_masked("values", self.values)
        try:
            values = np.asarray(self.values)
        except ValueError:
            raise ArgumentError(
                f"values must be numbers of shape (height, width), got a {type(self.values).__name__} of rows of "
                "different lengths"
            ) from None
        if values.ndim != 2 or values.dtype.kind not in "uif":
            raise ArgumentError(f"values must be numbers of shape (height, width), got {values.dtype} {values.shape}")
        checks.choice("channel", self.channel, CHANNELS)
        if self.saturated is not None and np.shape(self.saturated) != values.shape:
            raise ArgumentError(
                f"saturated must have the shape of values, {values.shape}, got {np.shape(self.saturated)}"
            )
        if self.cfa is not None:
            (height, width), cell = values.shape, sites_of(self.cfa, self.channel)
            sites = np.tile(cell, (height // 2 + 1, width // 2 + 1))[:height, :width]
            values = np.where(sites, values, np.nan)
            if self.saturated is not None:
                object.__setattr__(self, "saturated", self.saturated & sites)
        object.__setattr__(self, "values", np.asarray(values, dtype=np.float64))

    @classmethod
    def of(
        cls,
        image: ArrayLike | Photograph | LinearImage,
        channel: str | None = None,
        cfa: str | None = None,
        tone: Tone = "linear",
        roi: Sequence[int] | None = None,
        f_number: float | None = None,
        source: str = "",
    ) -> LinearImage:
        """Convert an array or a photograph to a linear colour plane.

        The tone curve is inverted. A `LinearImage` is returned unchanged, or cropped to `roi`.

        Args:
            image: array of codes (height, width), or (height, width, 3) for R, G, B, in which NaN marks missing pixels;
                a `Photograph` of `matcam.files.photographs.open_photograph`; or a `LinearImage`.
            channel: "R", "G", "B" or "Y" (luminance) of a colour image; "R", "G" or "B" of a mosaic, which requires this
                argument (no unit). Default: None, the luminance of a colour image, or a grey image itself.
            cfa: colours of the first 2 x 2 px of the whole image, row by row, if the image is a mosaic: "RGGB", "BGGR",
                "GRBG" or "GBRG" (no unit). Default: None, the colours in the photograph, or no mosaic.
            tone: tone curve of the codes (no unit): "linear"; "srgb" (IEC 61966-2-1); a gamma, light = (code / full) **
                gamma, where full is the largest value of an integer data type, or 1 for floats; a table of linear
                values by code, (codes,) or (codes, 3); or "auto": 8-bit photographs are assumed to be sRGB unless their
                format is linear, and all others are assumed to be linear. Default: "linear".
            roi: region (x, y, width, height), px. Default: None, the whole image.
            f_number: f-number of the image (no unit). Default: None, that of the photograph.
            source: name of the file, for messages (no unit). Default: "".

        Returns:
            The plane; `remarks` lists the assumptions of "auto".

        Raises:
            ArgumentError: an argument is invalid, the image does not have this channel, or the region is not inside the
                image.

        Source:
            Luminance: IEC 61966-2-1.

        Example:
            >>> codes = np.full((20, 30, 3), 188, np.uint8)
            >>> plane = matcam.LinearImage.of(codes, channel="G", tone="srgb", roi=(4, 2, 16, 18))
            >>> plane.values.shape, plane.corner, round(float(plane.values[0, 0]), 3)
            ((18, 16), (4, 2), 0.503)
        """
        if channel is not None:
            checks.choice("channel", channel, CHANNELS)
        if cfa is not None:
            checks.choice("cfa", cfa, CFAS)
        if isinstance(image, LinearImage):
            if channel is not None or cfa is not None or not is_named(tone, "linear", "auto"):
                raise ArgumentError("channel, cfa and tone are already specified by the LinearImage: omit them")
            return image.cut(roi)
        photograph = image if isinstance(image, Photograph) else as_photograph(image, "image must be numbers", (3, 4))
        x, y, width, height = _checked_roi(roi, photograph.values.shape)
        codes = photograph.values[y : y + height, x : x + width]
        mosaic = cfa or photograph.cfa
        remarks: tuple[Remark, ...] = ()
        if is_named(tone, "auto"):
            tone, remarks = assumed_tone(photograph, mosaic=mosaic is not None)
        if photograph.cfa is not None and not is_named(tone, "linear"):
            raise ArgumentError("camera raw is linear and has no tone curve: omit tone")
        if codes.ndim == 3:
            if mosaic is not None:
                shape = photograph.values.shape
                raise ArgumentError(
                    f"cfa is for a mosaic of shape (height, width), got an image of shape {shape}: omit cfa"
                )
            channel = checks.choice("channel", channel or "Y", ("R", "G", "B", "Y"))
        elif mosaic is None:
            if channel not in (None, "grey"):
                raise ArgumentError(
                    f"channel must not be {channel!r} for a grey image: omit the channel, or give cfa if the image is a mosaic"
                )
            channel = "grey"
        else:
            sites_of(mosaic, channel)  # raises an error for an invalid channel before the image is linearised
            mosaic = _shifted(mosaic, x, y)
        values, full = _plane(codes, str(channel), tone, photograph.saturation)
        return cls(
            values, str(channel), mosaic, tone, photograph.exif.f_number if f_number is None else f_number, source, (x, y),
            full, photograph.saturation, remarks,
        )  # fmt: skip

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (height, width), px."""
        height, width = self.values.shape
        return height, width

    @property
    def sites(self) -> np.ndarray:
        """Mask (2, 2) of the sites of this colour.

        The mask covers the first 2 x 2 px. Without a mosaic, it is true everywhere.
        """
        return np.ones((2, 2), bool) if self.cfa is None else sites_of(self.cfa, self.channel)

    def cut(self, roi: Sequence[int] | None) -> LinearImage:
        """Crop the plane to a region.

        Args:
            roi: region (x, y, width, height) of this plane, px. None selects the whole plane.

        Returns:
            The region; `corner` is its position in the photograph.

        Raises:
            ArgumentError: the region is not four whole numbers, or is not inside the plane.

        Example:
            >>> plane = matcam.LinearImage(np.zeros((40, 50)))
            >>> plane.cut((10, 5, 20, 30)).shape
            (30, 20)
        """
        if roi is None:
            return self
        x, y, width, height = _checked_roi(roi, self.values.shape)
        part = np.s_[y : y + height, x : x + width]
        return replace(
            self,
            values=self.values[part],
            cfa=None if self.cfa is None else _shifted(self.cfa, x, y),
            corner=(self.corner[0] + x, self.corner[1] + y),
            saturated=None if self.saturated is None else self.saturated[part],
        )


def usable_region(region: LinearImage) -> LinearImage:
    """Check the size and the exposure of a region, and return the region.

    Raises:
        ArgumentError: the region is smaller than 16 x 16 px.
        FitError: more than 2 % of the samples of the region are saturated.
    """
    height, width = region.shape
    if min(height, width) < SMALLEST:
        raise ArgumentError(
            f"the region must be at least {SMALLEST} x {SMALLEST} px, got {width} x {height}: choose a larger region"
        )
    if region.saturated is not None:
        share = region.saturated.sum() / max(np.isfinite(region.values).sum(), 1)
        if share > SATURATED:
            raise FitError(
                f"the region is saturated: {share:.0%} of its samples are at {region.saturation:g}, the end of their range; "
                "reduce the exposure"
            )
    return region


def measurable_region(region: LinearImage) -> LinearImage:
    if problem := flaw(usable_region(region).values):
        raise FitError(problem.text)
    return region


def flaw(values: np.ndarray) -> Remark | None:
    """Create a remark if a region cannot be measured, else return None. `values`: (height, width)."""
    used = values[np.isfinite(values)]
    if used.size < SMALLEST**2 / 4:
        return Remark("too-few-samples", f"the region contains only {used.size} usable samples: choose a larger region")
    low, high = used.min(), used.max()
    if not low < high:
        return Remark("flat", f"the region has only one value, {low:g}: choose a region that contains the target")
    if (used == high).mean() > 0.05:
        # Noisy pixels have equal values only at the end of a range. Without noise, the dark side is equally flat.
        middle = (low + high) / 2
        flat = (used == high).sum() / (used > middle).sum()
        levels, index, count = np.unique(used, return_inverse=True, return_counts=True)
        dark = levels <= middle
        below = index[used <= middle]
        spread = robust_std(below - np.median(below))
        # Many pixels have the largest value either at the end of a range, or if the noise is below half a level. The
        # sRGB curve is at most six times as steep in dark parts as in bright parts. A noise of 3 levels on the dark
        # side therefore excludes a noise below half a level on the bright side.
        if count[dark].max() / count[dark].sum() < flat / 2 and spread > 3.0:
            text = f"the region is saturated: {flat:.0%} of its bright samples have the value {high:g}; reduce the exposure"
            return Remark("saturated", text)
    return None


def local_mean(values: FloatArray, width: float) -> FloatArray:
    """Compute local means of an image (height, width), weighted by a Gaussian of `width` px. NaN is ignored."""
    known = np.isfinite(values)
    if known.all():
        return ndimage.gaussian_filter(values, width)
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width)
    # With less weight of known pixels than 1e-6, the mean tends to 0.
    return total / np.maximum(ndimage.gaussian_filter(known.astype(float), width), 1e-6)


def smoothed(values: FloatArray) -> FloatArray:
    """Smooth an image (height, width) for the search of targets, and fill its missing pixels."""
    # In one colour of a mosaic, 2 or 3 of 4 pixels are missing.
    return local_mean(values, 0.7 if np.isfinite(values).mean() > 0.9 else 1.2)


def planes_of(
    photograph: Photograph, channels: Sequence[str] | None = None, tone: Tone = "auto", f_number: float | None = None,
    source: str = "", cfa: str | None = None,
) -> Iterator[LinearImage]:  # fmt: skip
    """Generate the colour planes of a photograph.

    `cfa`: colours of the first 2 x 2 px of a mosaic whose file does not specify them.

    Raises:
        ArgumentError: the photograph lacks one of the channels.
    """
    there: tuple[str, ...] = ("R", "G", "B")
    if (cfa or photograph.cfa) is None and photograph.values.ndim == 2:
        there = ("grey",)
    for channel in channels or ():
        if channel not in there and not (channel == "Y" and photograph.values.ndim == 3):
            allowed = (*there, "Y") if photograph.values.ndim == 3 else there
            raise ArgumentError(f"channel must be one of {', '.join(allowed)} for this image, got {channel!r}")
    names = there if channels is None else channels
    return (LinearImage.of(photograph, name, cfa, tone, f_number=f_number, source=source) for name in names)


def as_photograph(
    image: ArrayLike, what: str = "an image must be numbers", colours: tuple[int, ...] = (3,)
) -> Photograph:
    """Convert an array of linear values to a photograph without a file.

    An ArgumentError is raised if the array is not an image. `what`: beginning of the error message. `colours`: allowed
    numbers of colour channels; only the first three are used.
    """
    values = checks.plain_array("image", image)
    if (
        values.dtype.kind not in "uif"
        or values.ndim not in (2, 3)
        or (values.ndim == 3 and values.shape[2] not in colours)
    ):
        raise ArgumentError(f"{what} of shape (height, width) or (height, width, 3), got {values.dtype} {values.shape}")
    full = float(np.iinfo(values.dtype).max) if values.dtype.kind in "ui" else np.inf
    return Photograph(values[..., :3] if values.ndim == 3 else values, None, full, True, Exif())


def sites_of(cfa: str, channel: str | None) -> np.ndarray:
    """Compute the mask (2, 2) of the sites of a colour in the first 2 x 2 px of a mosaic."""
    checks.choice("cfa", cfa, CFAS)
    if channel not in ("R", "G", "B"):
        given = "none is given" if channel is None else f"got {channel!r}"
        raise ArgumentError(f"channel must be one of 'R', 'G', 'B' with a mosaic, {given}")
    return np.array(list(cfa)).reshape(2, 2) == channel


def _plane(codes: np.ndarray, channel: str, tone: Tone, saturation: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Compute the linear values of one channel, and the mask of its saturated pixels.

    The mask is None if the saturation is unknown.
    """
    known = np.isfinite(saturation)
    if channel == "Y":
        # Weights of linear R, G and B in the luminance (IEC 61966-2-1).
        light = linear_values(codes, tone) @ np.array((0.2126, 0.7152, 0.0722))
        return light, np.asarray((codes >= saturation).any(-1)) if known else None
    column = "RGB".index(channel) if channel in "RGB" else None
    if codes.ndim == 3:
        codes = codes[..., column]
    return linear_values(codes, tone, column), (codes >= saturation) if known else None


def _shifted(cfa: str, x: int, y: int) -> str:
    return "".join(np.roll(np.array(list(cfa)).reshape(2, 2), (-y, -x), (0, 1)).ravel())


def _checked_roi(roi: Sequence[int] | None, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    height, width = shape[:2]
    if roi is None:
        return 0, 0, width, height
    try:
        x, y, w, h = (int(v) for v in roi)
        whole = all(float(v) == int(v) for v in roi)
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise ArgumentError(f"roi must be four whole numbers (x, y, width, height), got {roi!r:.60}")
    if x < 0 or y < 0 or w < 0 or h < 0 or x + w > width or y + h > height:
        raise ArgumentError(f"roi must lie inside the image of {width} x {height} px, got {(x, y, w, h)}")
    return x, y, w, h
