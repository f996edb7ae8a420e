"""Sinusoidal Siemens star: MTF over a range of frequencies and in all directions from one target.

The modulation is fitted to the pixels without resampling (`wave_fit`). The modulation is a spline in the local
frequency, times functions of the direction that describe a square pixel and an astigmatic lens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.linalg import polar

from matcam.calibration.chart.chart import Star
from matcam.calibration.chart.registration import Projection, check_projection_given, pixel_box
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, measurable_region
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples, with_units
from matcam.calibration.targets.wave_fit import WaveFit, WavePixels, fit_wave, local_wave
from matcam.calibration.targets.wave_search import MARGIN, FoundStar, StarPhase, find_star
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.errors import FitError
from matcam.files.photographs import Photograph
from matcam.numerics.normal import SIGNIFICANT

_HIGHEST = 0.75
"""Highest frequency of the fit, cycles/px. Above it, the MTF of cameras is too small to be measured."""
_DIRECTIONS = np.radians([0.0, 45.0, 90.0, 135.0])
"""Directions of the reported MTF, rad. They determine the four functions of direction."""


@dataclass(frozen=True, eq=False)
class StarMTF:
    """MTF from a star, and the other fitted parameters.

    Attributes:
        samples: MTF in four directions at the frequencies of the star, up to 0.75 cycles/px.
        centre: (x, y) of the centre in the image, px.
        centre_std: standard deviations of `centre`, px.
        cycles: number of cycles of the star.
        contrast: contrast of the print, given or extrapolated to frequency 0 (no unit).
        contrast_std: standard deviation of `contrast`; 0 if the contrast was given.
        chi2: chi-square per degree of freedom (no unit); 1 if gain and read noise explain the residuals.
        gain: gain estimated from the residuals, in the units of the values; the variance of a pixel is gain * value +
            read_variance.
        read_variance: variance of a dark pixel, in squared units of the values.

    Example:
        >>> y, x = np.mgrid[:110, :110] - 54.5
        >>> wave = np.cos(20 * np.arctan2(y, x)) * (np.hypot(x, y) < 52)
        >>> result = matcam.targets.star_mtf(1000 * (1 + 0.5 * wave), contrast=0.5)
        >>> [round(position, 2) for position in result.centre], result.to_dict()["cycles"]
        ([54.5, 54.5], 20)
    """

    samples: MTFSamples
    centre: tuple[float, float]
    centre_std: tuple[float, float]
    cycles: int
    contrast: float
    contrast_std: float
    chi2: float
    gain: float
    read_variance: float

    @property
    def frequency(self) -> FloatArray:
        """Distinct frequencies of `samples`, cycles/px."""
        return self.samples.frequency[:: len(_DIRECTIONS)]

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a JSON object.

        Returns:
            All attributes, with units in the names of those that have one.
        """
        return with_units(self, centre="px", centre_std="px")


def star_mtf(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    star: Star | None = None,
    projection: Projection | None = None,
    cycles: int | None = None,
    contrast: float | None = None,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
) -> StarMTF:
    """Measure the MTF of lens and pixel with a sinusoidal Siemens star.

    Centre, number of cycles and perspective are estimated. The pixels are not resampled, and a mosaic is
    not demosaiced.

    Args:
        image: `LinearImage`, `Photograph`, or array as in `LinearImage.of`.
        roi: region (x, y, width, height) that contains the star and little else, px. Default: None, the whole image.
        star: description of the star from a chart, to be given with `projection` instead of `roi`. Default: None, the star
            is detected in the region.
        projection: map from the page of the chart, mm, to the image, px: a `Registration`. Default: None.
        cycles: number of cycles of the star (no unit); to be given if the count fails, and not used with `star`.
            Default: None, the cycles are counted.
        contrast: (bright - dark) / (bright + dark) of the print, linear (no unit). Default: None, the contrast in
            `star`. Without `star`, the MTF is extrapolated to 1 at frequency 0, which ignores the loss of contrast by a
            wide halo.
        cfa: colours of the first 2 x 2 px of a mosaic, as in `LinearImage.of` (no unit). Default: None.
        channel: colour, as in `LinearImage.of` (no unit). Default: None.
        tone: tone curve, as in `LinearImage.of` (no unit). Default: "linear".

    Returns:
        The MTF in four directions with its covariance, and the position of the star.

    Raises:
        ArgumentError: if an argument is out of range, or only one of `star` and `projection` is given.
        FitError: if there is no star, or the star cannot be measured.

    Source:
        ISO 12233:2017, s-SFR; docs/model.md 7; docs/targets.md.

    Example:
        >>> y, x = np.mgrid[:110, :110] - 54.5
        >>> wave = np.cos(20 * np.arctan2(y, x)) * (np.hypot(x, y) < 52)  # pixels without size: the MTF is 1
        >>> result = matcam.targets.star_mtf(1000 * (1 + 0.5 * wave), contrast=0.5)
        >>> result.cycles, bool(np.abs(result.samples.mtf - 1).max() < 1e-6)
        (20, True)
    """
    check_projection_given("star", star, projection)
    if contrast is not None:
        checks.within("contrast", contrast, 0, 1, open_low=True)
    if star is not None and projection is not None:
        whole = LinearImage.of(image, channel, cfa, tone)
        found, box = _expected_star(star, projection, whole.shape)
        picture = measurable_region(whole.cut(box))
        contrast = star.contrast if contrast is None else contrast
    else:
        picture = measurable_region(LinearImage.of(image, channel, cfa, tone, roi))
        found = find_star(picture.values, cycles)
    fit, edges = _fit_star(picture.values, found)
    return _star_result(picture, found, fit, edges, contrast)


def _expected_star(
    star: Star, projection: Projection, shape: tuple[int, int]
) -> tuple[FoundStar, tuple[int, int, int, int]]:
    turn = 2 * np.pi * np.arange(8 * star.cycles) / (8 * star.cycles)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    outer = projection(np.array(star.centre) + star.outer * rim)
    box = pixel_box(outer, shape, 2)
    if min(box[2:]) < SMALLEST or (outer.min(0) < -0.5).any() or (outer.max(0) > np.array(shape[::-1]) - 0.5).any():
        raise FitError(
            f"the star lies partly outside the image, or is smaller than {SMALLEST} x {SMALLEST} px: give an image that "
            "contains the whole star at a larger scale"
        )
    low = np.array(box[:2])
    centre = projection(np.array([star.centre]))[0] - low
    radii = np.linspace(max(star.inner, 0.2 * star.outer), star.outer, 6)
    points = np.concatenate([projection(np.array(star.centre) + r * rim) for r in radii]) - low
    inner = projection(np.array(star.centre) + star.inner * rim) - low
    wave = StarPhase(star.cycles, float(np.hypot(*(outer - low - centre).T).min()))
    phases = np.tile(star.cycles * turn + star.phase, len(radii))
    parameters = wave.parameters_through(points[:, 0], points[:, 1], phases, tuple(centre), _stretch(star, projection))
    return FoundStar(wave, parameters, float(np.hypot(*(inner - centre).T).max())), box


def _stretch(star: Star, projection: Projection) -> tuple[float, float]:
    step = star.outer / 2 * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
    left, right, upper, lower = projection(np.array(star.centre) + step)
    # Polar decomposition: rotation and symmetric map. The trace of the latter is arbitrary.
    _, symmetric = polar(np.linalg.pinv(np.stack([right - left, lower - upper], axis=-1)))
    symmetric *= 2 / np.trace(symmetric)
    return float(symmetric[0, 0] - 1), float(symmetric[0, 1])


def _fit_star(values: FloatArray, found: FoundStar) -> tuple[WaveFit, tuple[float, float]]:
    """Fit the wave of a star.

    The result contains the fit and the range of its frequencies, cycles/px. The wave is fitted at low
    frequencies first, where the approximate phase is reliable, and then at all frequencies.
    """
    phase, parameters = found.phase, found.parameters
    y, x = np.indices(values.shape, float)
    known = np.isfinite(values)
    inner = _inner_rim(np.hypot(x - parameters[0], y - parameters[1])[known], values[known], found)
    fit = None
    for highest in (0.2, 0.4, _HIGHEST):
        frequency, _ = local_wave(phase, parameters, x, y)
        radius = np.hypot(x - parameters[0], y - parameters[1])
        mask = known & (radius < phase.outer - MARGIN) & (radius > inner + MARGIN) & (frequency < highest)
        if mask.sum() < 500:
            continue
        # The first estimates of the phase use 20,000 pixels.
        some = WavePixels.where(values, mask, None if highest == _HIGHEST else 20_000)
        edges = float(frequency[mask].min()), float(frequency[mask].max())
        fit = fit_wave(some, phase, parameters, partial(_basis, edges=edges), steps=4)
        if fit is None:
            raise FitError("the pixels of the star do not determine the MTF: photograph the star at a larger scale")
        parameters = fit.parameters
        left = (some.value - fit.values).var() / some.value.var()
        # At low frequencies the blur is small, and the wave of a star explains nearly all of the variance.
        if highest == 0.2 and left > 0.5:
            raise FitError(
                f"the region contains no Siemens star: the fitted star leaves {left:.0%} of the variance unexplained; "
                "give a region of one star"
            )
    # Noise reaches a significance of more than 5 standard deviations, because the centre is searched.
    if fit is None or not fit.signal > 20 or np.hypot(*(parameters[:2] - found.parameters[:2])) > phase.outer / 4:
        raise FitError(
            "the region contains no Siemens star that can be measured: photograph the star at a larger scale, or with more "
            "contrast"
        )
    return fit, edges


def _inner_rim(radius: FloatArray, value: FloatArray, found: FoundStar) -> float:
    """Find the largest radius, px, of an inner ring whose mean level differs from that of the star; 0 if there is none."""
    ring = np.round(radius).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    mean = np.bincount(ring, value) / count
    inside = np.arange(len(mean)) <= found.inner
    known = mean[(np.arange(len(mean)) > found.inner) & (np.arange(len(mean)) < found.phase.outer - MARGIN)].mean()
    # The mean level of the rings of a star changes by less than 5 %.
    other = inside & (np.abs(mean / known - 1) > 0.05)
    return float(np.flatnonzero(other).max(initial=0))


def _knots(edges: tuple[float, float]) -> FloatArray:
    # The knots of the spline are at most 0.09 cycles/px apart.
    inner = np.linspace(*edges, max(2, int(np.ceil((edges[1] - edges[0]) / 0.09)) + 1))
    return np.concatenate([[edges[0]] * 3, inner, [edges[1]] * 3])


def _basis(frequency: FloatArray, direction: FloatArray, edges: tuple[float, float]) -> FloatArray:
    """Evaluate the basis: splines in frequency times functions of direction for a square pixel and an astigmatic lens."""
    spline = BSpline.design_matrix(np.clip(frequency, *edges), _knots(edges), 3).toarray()
    a = 2 * direction
    angular = np.stack([np.ones_like(a), np.cos(a), np.sin(a), np.cos(2 * a)], axis=-1)
    return (spline[:, :, None] * angular[:, None, :]).reshape(len(spline), -1)


def _star_result(
    picture: LinearImage, found: FoundStar, fit: WaveFit, edges: tuple[float, float], stated: float | None
) -> StarMTF:
    """Compute the MTF of a star from its modulation.

    `stated`: contrast of the print; None if it is to be extrapolated.
    """
    knots = _knots(edges)
    positions = np.array([knots[i + 1 : i + 4].mean() for i in range(len(knots) - 4)])
    frequency, direction = (a.ravel() for a in np.meshgrid(positions, _DIRECTIONS, indexing="ij"))
    rows = _basis(frequency, direction, edges)
    amplitude, covariance = rows @ fit.coefficients, rows @ fit.covariance @ rows.T
    size, size_std = (stated, 0.0) if stated is not None else _extrapolated_contrast(frequency, amplitude, covariance)
    mtf = amplitude / size
    covariance = (covariance + np.outer(mtf, mtf) * size_std**2) / size**2
    position, std = fit.parameters[:2], fit.parameters_std
    cycles = found.phase.cycles
    samples = MTFSamples.of_region(
        "star", picture, (position[0], position[1]), frequency, direction, _as_plane_waves(mtf, cycles), covariance
    )
    return StarMTF(
        samples, samples.position, (float(std[0]), float(std[1])), cycles, size, size_std, fit.chi2, fit.gain,
        fit.read_variance,
    )  # fmt: skip


def _as_plane_waves(mtf: FloatArray, cycles: int) -> FloatArray:
    """Convert the contrast on rings of `cycles` cycles to the MTF.

    The wave on a ring is not exactly a plane wave. Let m be the number of cycles, phi the azimuth, r the radius of the
    ring, and J_m the Bessel function. The wave exp(i m phi) contains the frequencies z / (2 pi r) with weights
    m J_m(z) / z. The moment of order 2 j of these weights is m^(2 j) times the product of 1 - 4 i^2 / m^2 over
    i = 1, ..., j - 1. Let K(s) be the MTF as a function of s = f^2, where f is the frequency. To order 1 / m^2, the
    contrast is K - (2 s^2 K'' + (4/3) s^3 K''') / m^2. For K = exp(-x) with x proportional to s, the contrast is
    K [1 - (2 x^2 - (4/3) x^3) / m^2].
    """
    x = -np.log(np.clip(mtf, 1e-3, 1.0))
    return mtf * (1 + (2 * x**2 - 4 / 3 * x**3) / cycles**2)


def _extrapolated_contrast(frequency: FloatArray, amplitude: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Extrapolate the contrast to frequency 0, with its standard deviation.

    The logarithm of the contrast is modelled as an even polynomial of order 4 in the frequency.
    """
    # At frequencies up to 0.35 cycles/px, a polynomial of order 4 describes the MTF.
    low = (frequency < 0.35) & (amplitude > SIGNIFICANT * np.sqrt(np.diag(covariance)))
    if low.sum() < 3 * len(_DIRECTIONS) or frequency.min() > 0.15:
        raise FitError(
            "the star has too few significant values at low frequencies to extrapolate its contrast to frequency 0 "
            f"(the lowest frequency of the star is {frequency.min():.2f} cycles/px); give contrast"
        )
    design = frequency[low, None] ** np.array([0, 2, 4])
    weight = np.linalg.inv(covariance[np.ix_(low, low)] / np.outer(amplitude[low], amplitude[low]))
    inverse = np.linalg.inv(design.T @ weight @ design)
    found = float(np.exp((inverse @ design.T @ weight @ np.log(amplitude[low]))[0]))
    return found, found * float(np.sqrt(inverse[0, 0]))
