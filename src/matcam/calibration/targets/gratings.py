"""Gratings: the MTF at a fundamental frequency and its harmonics, from sines, square waves (bars) and narrow lines.

A bar pattern is a square wave, whose contrast contains harmonics and therefore is not the MTF. Here all harmonics are
fitted with a common phase. `coltman` converts square-wave contrasts that were measured elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from matcam.calibration.chart.chart import PROFILES, Grating
from matcam.calibration.chart.registration import Projection, check_projection_given, pixel_box
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, measurable_region, usable_region
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples, with_units
from matcam.calibration.targets.wave_fit import WaveFit, WavePixels, fit_wave, local_wave
from matcam.calibration.targets.wave_search import MARGIN, FoundGrating, find_grating
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.errors import ArgumentError, FitError
from matcam.files.photographs import Photograph
from matcam.numerics.normal import SIGNIFICANT

_USEFUL = 0.1
"""Standard deviation above which an MTF value is discarded."""


@dataclass(frozen=True, eq=False)
class GratingMTF:
    """MTF from a grating, and the other fitted parameters.

    Attributes:
        samples: MTF at the harmonics that the image determines.
        frequency: mean frequency (fx, fy) of the grating, cycles/px.
        orders: orders of the fitted harmonics.
        modulation: amplitude of each harmonic relative to the mean; the sign is relative to the phase of the print
            (no unit).
        modulation_std: standard deviations of `modulation` (no unit).
        gain: gain estimated from the residuals, in the units of the values; the variance of a pixel is gain * value +
            read_variance.
        read_variance: variance of a dark pixel, in squared units of the values.

    Example:
        >>> x = np.arange(120) + 0.1 * np.arange(100)[:, None]
        >>> result = matcam.targets.grating_mtf(1000 * (1 + 0.25 * np.cos(x)), profile="sine", contrast=0.5)
        >>> round(result.contrast, 3)
        0.25
    """

    samples: MTFSamples
    frequency: tuple[float, float]
    orders: tuple[int, ...]
    modulation: FloatArray
    modulation_std: FloatArray
    gain: float
    read_variance: float

    @property
    def contrast(self) -> float:
        """Contrast at the centres of the lines.

        It is (bright - dark) / (bright + dark) of pixels at the centres of bright and of dark lines.
        """
        at_bright, at_dark = self.modulation.sum(), (self.modulation * (-1.0) ** np.array(self.orders)).sum()
        return float((at_bright - at_dark) / (2 + at_bright + at_dark))

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a JSON object.

        Returns:
            All attributes, with units in the names of those that have one, and the contrast.
        """
        return with_units(self, frequency="cycles_per_px", contrast=None)


def grating_mtf(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    grating: Grating | None = None,
    projection: Projection | None = None,
    profile: str = "bars",
    contrast: float | None = None,
    duty: float = 0.5,
    near: tuple[float, float] | None = None,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
) -> GratingMTF:
    """Measure the MTF of lens and pixel with a grating.

    The MTF is determined at the frequency of the grating and at its harmonics. The phase is fitted, so that the position of
    the pixels relative to the bars causes no error. Harmonics that cannot be distinguished from each other or from the mean
    on the pixel grid have large standard deviations. Harmonics that the image does not determine are omitted.

    Args:
        image: `LinearImage`, `Photograph`, or array as in `LinearImage.of`.
        roi: region (x, y, width, height) that contains one grating, px. It may contain the surroundings of the grating.
            Default: None, the whole image.
        grating: description of the grating from a chart, to be given with `projection`. Both replace roi, profile, contrast,
            duty and near. Default: None, the grating is detected in the region.
        projection: map from the page of the chart, mm, to the image, px: a `Registration`. Default: None.
        profile: "bars", "sine" or "lines" (no unit). Default: "bars".
        contrast: (bright - dark) / (bright + dark) of the print, linear (no unit); required without `grating`. Default: None.
        duty: bright share of a period of lines (no unit). Default: 0.5.
        near: approximate frequency (fx, fy), cycles/px; required for a grating beyond the Nyquist frequency. Default:
            None, the frequency is below the Nyquist frequency of 0.5 cycles/px.
        cfa: colours of the first 2 x 2 px of a mosaic, as in `LinearImage.of` (no unit). Default: None.
        channel: colour, as in `LinearImage.of` (no unit). Default: None.
        tone: tone curve, as in `LinearImage.of` (no unit). Default: "linear".

    Returns:
        The MTF at the harmonics that the image determines, with its covariance.

    Raises:
        ArgumentError: if an argument is missing or out of range, or only one of `grating` and `projection` is given.
        FitError: if there is no grating, or the grating cannot be measured.

    Source:
        J. W. Coltman, JOSA 44, 468 (1954), for square waves; docs/model.md 7; docs/targets.md.

    Example:
        >>> x = np.arange(120) + 0.1 * np.arange(100)[:, None]
        >>> sine = 1000 * (1 + 0.25 * np.cos(2 * np.pi * 0.16 * x))
        >>> result = matcam.targets.grating_mtf(sine, profile="sine", contrast=0.5)
        >>> np.round(result.samples.frequency, 3), np.round(result.samples.mtf, 3)
        (array([0.161]), array([0.5]))
    """
    check_projection_given("grating", grating, projection)
    if grating is not None and projection is not None:
        whole = LinearImage.of(image, channel, cfa, tone)
        found, box = _expected_grating(grating, projection, whole.shape)
        picture, printed = usable_region(whole.cut(box)), grating
    else:
        if contrast is None:
            raise ArgumentError(
                "contrast of the print must be given: (bright - dark) / (bright + dark) of linear values"
            )
        checks.within("contrast", contrast, 0, 1, open_low=True)
        checks.within("duty", duty, 0, 1, open_low=True, open_high=True)
        checks.choice("profile", profile, PROFILES)
        # The sum of bright and dark level is arbitrary, because only ratios are used.
        duty = duty if profile == "lines" else 0.5
        printed = Grating(profile, (0, 0), (1, 1), 0.0, 1.0, 0.0, 1 - contrast, 1 + contrast, duty)
        picture = measurable_region(LinearImage.of(image, channel, cfa, tone, roi))
        found = find_grating(picture.values, near)
    fit, orders, *wave = _fit_grating(picture.values, found, printed)
    # The positions of the bright lines may be unknown. The MTF is then assumed to be positive at the first harmonic.
    inverted = grating is None and fit.coefficients[0] < 0
    signs = (-1.0) ** np.array(orders) if inverted else np.ones(len(orders))
    return _grating_result(picture, fit, printed, orders, signs, *wave)


def coltman(frequency: ArrayLike, contrast: ArrayLike) -> FloatArray:
    """Convert square-wave contrasts to the sine-wave MTF.

    The contrast is interpolated between the frequencies, starting from 1 at frequency 0. Beyond the last frequency, the
    contrast is assumed to be 0.

    Args:
        frequency: (n,) ascending frequencies, cycles/px.
        contrast: (n,) contrast between the centres of bright and dark bars, relative to the contrast of the print (no
            unit). The last value should be close to 0.

    Returns:
        The MTF (n,) at `frequency` (no unit).

    Raises:
        ArgumentError: if there are fewer than two frequencies, the frequencies are not positive and ascending, or the
            contrasts are not n finite values.

    Source:
        J. W. Coltman, JOSA 44, 468 (1954).

    Example:
        >>> f = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
        >>> np.round(matcam.targets.coltman(f, [0.95, 0.7, 0.4, 0.15, 0.0]), 3)
        array([0.851, 0.55 , 0.314, 0.118, 0.   ])
    """
    f, c = np.asarray(checks.number("frequency", frequency)), np.asarray(checks.number("contrast", contrast))
    if f.ndim != 1 or f.shape != c.shape or f.size < 2 or not (np.diff(f) > 0).all() or not f[0] > 0:
        raise ArgumentError(
            f"frequency must be a list of at least 2 positive values in ascending order, and contrast must have one value for "
            f"each, got shapes {f.shape} and {c.shape}"
        )
    from scipy.interpolate import PchipInterpolator

    between = PchipInterpolator(np.concatenate([[0.0], f]), np.concatenate([[1.0], c]), extrapolate=False)

    def sine(at: float) -> float:
        # C(f) = (4 / pi) sum of chi(k) M(k f) / k, with chi(k) = +-1 for k = 1, 3 mod 4.
        beyond = sum((2 - k % 4) * sine(k * at) / k for k in range(3, int(f[-1] / at) + 1, 2))
        return float(np.pi / 4 * np.nan_to_num(between(at))) - beyond

    return np.array([sine(at) for at in f.tolist()])


def _inside_polygon(corners: FloatArray, shape: tuple[int, int]) -> np.ndarray:
    outwards = ConvexHull(corners).equations
    y, x = np.indices(shape)
    return np.all([a * x + b * y + c < -MARGIN for a, b, c in outwards], axis=0)


def _expected_grating(
    grating: Grating, projection: Projection, shape: tuple[int, int]
) -> tuple[FoundGrating, tuple[int, int, int, int]]:
    corners = projection(checks.instance("grating", grating, Grating).corners)
    box = pixel_box(corners, shape, 0)
    if min(box[2:]) < SMALLEST:
        raise FitError(
            "the grating lies outside the image, or covers less than 16 x 16 px: photograph the whole grating at a larger scale"
        )
    inside = _inside_polygon(corners - box[:2], (box[3], box[2]))
    if inside.sum() < 64:
        raise FitError("the grating covers too few pixels of the image: photograph the chart at a larger scale")
    across = np.array([np.cos(grating.angle), np.sin(grating.angle)])
    along = np.array([-np.sin(grating.angle), np.cos(grating.angle)])
    u, v = (a.ravel() for a in np.meshgrid(*(np.linspace(-0.5, 0.5, 9) * side for side in grating.size)))
    x, y = (projection(np.array(grating.centre) + u[:, None] * across + v[:, None] * along) - box[:2]).T
    return FoundGrating.through(x, y, 2 * np.pi * u / grating.period + grating.phase, inside), box


def _fit_grating(
    values: FloatArray, found: FoundGrating, printed: Grating
) -> tuple[WaveFit, tuple[int, ...], FloatArray, FloatArray]:
    """Fit the wave of a grating.

    The result contains the fit, the orders of the harmonics, the mean frequency (2,), cycles/px, and the mean position (2,)
    of the pixels, px.
    """
    pixels = WavePixels.where(values, found.inside)
    frequency, _ = local_wave(found.phase, found.parameters, pixels.x, pixels.y)
    # Higher harmonics are neglected: the MTF of a square pixel has its first zero at 1 cycle/px.
    highest = max(1, int(1.1 / max(float(frequency.mean()), 1e-6)))
    orders: tuple[int, ...] = (1,)
    if printed.profile != "sine":
        orders = tuple(n for n in range(1, highest + 1) if abs(printed.harmonic(n)) > 1e-9)

    def uniform(frequency: FloatArray, direction: FloatArray) -> FloatArray:
        return np.ones((len(frequency), 1))  # the modulation of a grating is uniform

    # The fundamental is fitted first. It determines the phase approximately.
    fit = None
    if pixels.value.size:
        fit = fit_wave(pixels, found.phase, found.parameters, uniform, steps=4)
    fit = fit and fit_wave(pixels, found.phase, fit.parameters, uniform, orders)
    if not fit:
        raise FitError(
            "the pixels of the grating do not determine its contrast: photograph the grating at a larger scale"
        )
    if not fit.signal > SIGNIFICANT:
        raise FitError(
            f"the region contains no grating that can be measured: the wave exceeds the noise by only {fit.signal:.1f} "
            f"standard deviations, but must exceed it by {SIGNIFICANT:g}; give a region with more contrast"
        )
    if other := _other_wave(pixels, fit, values.shape):
        raise FitError(f"the region contains no grating that can be measured: {other}")
    frequency, direction = local_wave(found.phase, fit.parameters, pixels.x, pixels.y)
    mean = (frequency * np.exp(1j * direction)).mean()
    return fit, orders, np.array([mean.real, mean.imag]), np.array([pixels.x.mean(), pixels.y.mean()])


def _other_wave(pixels: WavePixels, fit: WaveFit, shape: tuple[int, ...]) -> str:
    residual = pixels.value - fit.values
    left = residual.var() / pixels.value.var()
    image = np.zeros(shape)
    image[pixels.y.astype(int), pixels.x.astype(int)] = residual
    power = np.abs(np.fft.rfft2(image)) ** 2
    # For white noise, the largest power is below 20 times its median.
    if left < 0.05 or power.max() < 40 * np.median(power):
        return ""
    return f"a single wave leaves {left:.0%} of the variance unexplained; give a region of one grating"


def _grating_result(
    picture: LinearImage, fit: WaveFit, printed: Grating, orders: tuple[int, ...], signs: FloatArray,
    frequency: FloatArray, position: FloatArray,
) -> GratingMTF:  # fmt: skip
    """Compute the MTF of a grating from its harmonics and those of the print.

    `signs`: signs of the harmonics, which correct for an unknown phase.
    """
    f, direction = float(np.hypot(*frequency)), float(np.arctan2(*frequency[::-1]))
    modulation = signs * fit.coefficients
    std = np.sqrt(np.diag(fit.covariance))
    size = np.array([printed.harmonic(n) for n in orders])
    useful = np.flatnonzero(std / np.abs(size) < _USEFUL)
    if not useful.size:
        raise FitError(
            f"the grating of {f:.3f} cycles/px does not determine the MTF: the standard deviation of the MTF is "
            f"{std[0] / abs(size[0]):.2g}, but must be below {_USEFUL:g}; give a coarser grating, or a grating with more "
            "contrast"
        )
    scale = (signs / size)[useful]
    samples = MTFSamples.of_region(
        "grating", picture, position, f * np.array(orders)[useful], np.full(useful.size, direction),
        modulation[useful] / size[useful], fit.covariance[np.ix_(useful, useful)] * np.outer(scale, scale),
    )  # fmt: skip
    return GratingMTF(
        samples, (float(frequency[0]), float(frequency[1])), orders, modulation, std, fit.gain, fit.read_variance
    )
