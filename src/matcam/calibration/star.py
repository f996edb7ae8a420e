"""The Siemens star: MTF at all frequencies and in all directions from one target, which was printed as a sine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from matcam import checks
from matcam.calibration import chart, region, star_geometry
from matcam.calibration.chart import Star
from matcam.calibration.mtf_samples import MTFSamples
from matcam.calibration.projection import Projection, check_given
from matcam.calibration.star_geometry import FoundStar
from matcam.calibration.wave_fit import Array, Modulation, WaveFit, enough, fit_wave, local_wave
from matcam.errors import FitError

_HIGHEST = 0.75  # cycles/px: beyond, cameras leave nothing to fit
_SOME = 20_000  # pixels that know the phase
_FIRST = 0.2  # cycles/px: up to here before the phase is known well
_INTERVAL = 0.09  # cycles/px between knots
_RIM = 4.0  # px at both rims, where the blur sees the paper
_OTHER = 0.05  # change of the mean level that is not the star's
_DIRECTIONS = np.radians([0.0, 45.0, 90.0, 135.0])
_EXTRAPOLATED = 0.35  # cycles/px: from below this the contrast is extrapolated if nobody states it
_LEFT = 0.5  # share of the variance at low frequencies that a star may leave
_CLEAR = 20.0  # standard deviations of the whole wave


@dataclass(frozen=True, eq=False)
class StarMTF:
    """What a star says."""

    samples: MTFSamples
    """The MTF in four directions, up to 0.75 cycles/px, as far as the star goes."""
    centre: tuple[float, float]
    centre_std: tuple[float, float]
    """px, in the picture."""
    cycles: int
    contrast: float
    """Of the print: stated, or extrapolated to frequency 0."""
    contrast_std: float
    chi2: float
    """Per degree of freedom; 1 by construction up to the part that gain and read noise cannot explain."""
    gain: float
    """Noise as found: a pixel's variance is gain * value + read_variance."""
    read_variance: float

    @property
    def frequency(self) -> Array:
        """(n,) distinct frequencies of `samples`, cycles/px."""
        return self.samples.frequency[:: len(_DIRECTIONS)]


def star_mtf(
    image: ArrayLike,
    roi: Sequence[int] | None = None,
    *,
    star: Star | None = None,
    projection: Projection | None = None,
    cycles: int | None = None,
    contrast: float | None = None,
    cfa: str | None = None,
    channel: str | None = None,
    tone: str | ArrayLike | None = None,
    aperture: float | None = None,
    source: str = "",
) -> StarMTF:
    """MTF of lens and pixel from a sinusoidal Siemens star (ISO 12233, s-SFR; MODEL 7).

    image, roi, cfa, channel, tone: as for `edge_mtf`; the region holds the star and little else, and its centre, cycles and
    perspective are found. star, projection: a chart's star and where the page's points lie in the picture, both or
    neither: then the region is the star's own. cycles: if known. contrast: (bright - dark) / (bright + dark) of the print,
    linear; the star's own if that is given; None without one: the MTF is extrapolated to 1 at frequency 0, which loses
    what a wide halo takes. aperture, source: handed on.

    Raises ArgumentError, and FitError where there is no star or none that can be measured.
    """
    picture = np.asarray(image)
    check_given("star", star, projection)
    if contrast is not None:
        checks.within("contrast", contrast, 0, 1, open_low=True)
    if star is not None and projection is not None:
        found, box = _as_printed(star, projection, picture.shape)
        values = region.cut(image, box, cfa, channel, tone)
        x0, y0 = box[:2]
        contrast = chart.contrast(star) if contrast is None else contrast
    else:
        values = region.cut(image, roi, cfa, channel, tone)
        x0, y0 = region.corner_of(roi)
        found = star_geometry.find_star(values, cycles)
    if problem := region.flaw(values):
        raise FitError(problem)
    fit, edges = _fitted(values, found)
    return _result(fit, edges, found, contrast, (x0, y0), region.measured_channel(picture, channel), aperture, source)


def _as_printed(
    star: Star, projection: Projection, shape: tuple[int, ...]
) -> tuple[FoundStar, tuple[int, int, int, int]]:
    """The star where the registration expects it, in px of the region that holds it."""
    turn = 2 * np.pi * np.arange(8 * star.cycles) / (8 * star.cycles)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    outer = projection(np.array(star.centre) + star.outer * rim)
    low = np.maximum(np.floor(outer.min(0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(outer.max(0)).astype(int) + 3, [shape[1], shape[0]])
    if (
        (high - low < region.SMALLEST).any()
        or (outer.min(0) < -0.5).any()
        or (outer.max(0) > np.array(shape[1::-1]) - 0.5).any()
    ):
        raise FitError("the star lies outside the picture")
    centre = projection(np.array([star.centre]))[0] - low
    radii = np.linspace(max(star.inner, 0.2 * star.outer), star.outer, 6)
    points = np.concatenate([projection(np.array(star.centre) + r * rim) for r in radii]) - low
    reach = float(np.hypot(*(outer - low - centre).T).min())
    inner = projection(np.array(star.centre) + star.inner * rim) - low
    phase = np.tile(star.cycles * turn + star.phase, len(radii))
    parameters = star_geometry.from_points(points[:, 0], points[:, 1], phase, star.cycles, tuple(centre), reach)
    box = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    return FoundStar(parameters, star.cycles, float(np.hypot(*(inner - centre).T).max()), reach), box


def _fitted(values: Array, found: FoundStar) -> tuple[WaveFit, tuple[float, float]]:
    """The wave's fit and the range of its frequencies: first where the phase is sure, then all of it."""
    phase = partial(star_geometry.phase_of, cycles=found.cycles, outer=found.outer)
    sizes = star_geometry.scales(found.cycles, found.outer)
    rows, columns = np.nonzero(np.isfinite(values))
    x, y, value = columns.astype(float), rows.astype(float), values[rows, columns]
    parameters = found.parameters
    inner = _inner_rim(np.hypot(x - parameters[0], y - parameters[1]), value, found)
    fit = None
    for highest in (_FIRST, 0.4, _HIGHEST):
        _, frequency, _ = local_wave(phase, parameters, x, y)
        radius = np.hypot(x - parameters[0], y - parameters[1])
        used = (radius < found.outer - _RIM) & (radius > inner + _RIM) & (frequency < highest)
        if used.sum() < 500:
            continue
        last = highest == _HIGHEST
        used = enough(used, None if last else _SOME)
        edges = float(frequency[used].min()), float(frequency[used].max())
        fit = fit_wave(
            value[used], x[used], y[used], phase, parameters, sizes, Modulation(partial(_basis, edges=edges)), steps=6
        )
        if fit is None:
            raise FitError("the star's pixels do not determine its MTF: it is too small in this picture")
        parameters = fit.parameters
        left = value[used] - fit.values
        # this part of a star is hardly blurred: nearly all that varies is the wave
        if highest == _FIRST and left.var() > _LEFT * value[used].var():
            raise FitError(
                f"region holds no Siemens star: a star leaves {left.var() / value[used].var():.0%} of what varies in it"
            )
    if fit is None or not fit.signal > _CLEAR or np.hypot(*(parameters[:2] - found.parameters[:2])) > found.outer / 4:
        raise FitError("region holds no Siemens star that can be measured: too small, or too little contrast")
    return fit, edges


def _inner_rim(radius: Array, value: Array, found: FoundStar) -> float:
    """px: inside which rings are brighter or darker than the star, as far as it is known."""
    ring = np.round(radius).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    mean = np.bincount(ring, value) / count
    inside = np.arange(len(mean)) <= found.inner
    known = mean[(np.arange(len(mean)) > found.inner) & (np.arange(len(mean)) < found.outer - _RIM)].mean()
    other = inside & (np.abs(mean / known - 1) > _OTHER)
    return float(np.flatnonzero(other).max(initial=0))


def _knots(edges: tuple[float, float]) -> Array:
    inner = np.linspace(*edges, max(2, int(np.ceil((edges[1] - edges[0]) / _INTERVAL)) + 1))
    return np.concatenate([[edges[0]] * 3, inner, [edges[1]] * 3])


def _basis(frequency: Array, direction: Array, edges: tuple[float, float]) -> Array:
    """Smooth functions of frequency times those of direction that a square pixel and an astigmatic lens need."""
    spline = BSpline.design_matrix(np.clip(frequency, *edges), _knots(edges), 3).toarray()
    a = 2 * direction
    angular = np.stack([np.ones_like(a), np.cos(a), np.sin(a), np.cos(2 * a)], axis=-1)
    return (spline[:, :, None] * angular[:, None, :]).reshape(len(spline), -1)


def _result(
    fit: WaveFit, edges: tuple[float, float], found: FoundStar, stated: float | None, corner: tuple[int, int], channel: str,
    aperture: float | None, source: str,
) -> StarMTF:  # fmt: skip
    knots = _knots(edges)
    places = np.array([knots[i + 1 : i + 4].mean() for i in range(len(knots) - 4)])
    frequency, direction = (a.ravel() for a in np.meshgrid(places, _DIRECTIONS, indexing="ij"))
    rows = _basis(frequency, direction, edges)
    amplitude, covariance = rows @ fit.coefficients, rows @ fit.covariance @ rows.T
    size, size_std = (stated, 0.0) if stated is not None else _extrapolated(frequency, amplitude, covariance)
    mtf = amplitude / size
    covariance = (covariance + np.outer(mtf, mtf) * size_std**2) / size**2
    x, y = fit.parameters[:2] + corner
    samples = MTFSamples(
        "star", (float(x), float(y)), frequency, direction, _as_plane_waves(mtf, found.cycles), covariance, channel, aperture,
        source,
    )  # fmt: skip
    std = fit.parameters_std
    return StarMTF(
        samples, samples.position, (float(std[0]), float(std[1])), found.cycles, size, size_std, fit.chi2, fit.gain,
        fit.read_variance,
    )  # fmt: skip


def _as_plane_waves(mtf: Array, cycles: int) -> Array:
    """The MTF from the contrast on a ring of so many cycles, which is not quite a plane wave.

    exp(i m phi) holds the frequencies z / (2 pi r) with weights m J_m(z) / z, whose even moments are
    m^2j prod(1 - 4 i^2 / m^2), i < j: to 1 / m^2 the contrast is K - (2 s^2 K'' + (4/3) s^3 K''') / m^2, s = f^2. With
    K = exp(-x), x proportional to s, that is K [1 - (2 x^2 - (4/3) x^3) / m^2].
    """
    x = -np.log(np.clip(mtf, 1e-3, 1.0))
    return np.asarray(mtf * (1 + (2 * x**2 - 4 / 3 * x**3) / cycles**2))


def _extrapolated(frequency: Array, amplitude: Array, covariance: Array) -> tuple[float, float]:
    """The contrast at frequency 0, and its standard deviation: its logarithm is even, and of order 4."""
    low = (frequency < _EXTRAPOLATED) & (amplitude > 5 * np.sqrt(np.diag(covariance)))
    if low.sum() < 3 * len(_DIRECTIONS) or frequency.min() > 0.15:
        raise FitError(
            f"the star begins at {frequency.min():.2f} cycles/px: too fine to know its contrast at frequency 0; give contrast"
        )
    design = frequency[low, None] ** np.array([0, 2, 4])
    weight = np.linalg.inv(covariance[np.ix_(low, low)] / np.outer(amplitude[low], amplitude[low]))
    inverse = np.linalg.inv(design.T @ weight @ design)
    found = float(np.exp((inverse @ design.T @ weight @ np.log(amplitude[low]))[0]))
    return found, found * float(np.sqrt(inverse[0, 0]))
