"""Where a Siemens star lies in a picture: its centre, the number of its cycles, and the phase of every pixel.

Lines through a star's centre stay lines in any pinhole's picture, so brightness changes across them only: the centre is where
the pixels' gradients are all at right angles to the way there. The number of cycles is how often the phase turns along a
ring, whatever perspective does to its speed. Perspective changes the azimuth by a linear map exactly; what a lens's
distortion adds is a smooth displacement, of which second and third order are kept.

The Siemens star: MTF at all frequencies and in all directions from one target, which was printed as a sine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from matcam.calibration.chart.chart import Star
from matcam.calibration.chart.registration import Projection, check_projection_given
from matcam.calibration.photograph import region
from matcam.calibration.photograph.light import smoothed
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, region_of
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.wave_fit import Modulation, WaveFit, enough, fit_wave, local_wave
from matcam.core import checks
from matcam.core.errors import FitError
from matcam.core.jax import FloatArray
from matcam.files.photographs import Photograph

PARAMETERS = 14
_ROUNDS = 12
_CLEAR_IN_RING = 0.5  # share of a ring's power that its wave must have
_KEPT = 0.8  # of the outer rings' usual amplitude
_BAND = 0.35  # of the cycles: how far perspective may spread a ring's wave
_FINE = 4  # samples of a ring per px
_LOW = (0.03, 0.3)  # cycles/px: rings on which the phase is looked at


class FoundStar(NamedTuple):
    """A star in a picture, px."""

    parameters: FloatArray
    """(14,) of `phase_of`."""
    cycles: int
    inner: float
    outer: float
    """Radii between which there is nothing but star."""


def phase_of(parameters: FloatArray, x: FloatArray, y: FloatArray, cycles: int, outer: float) -> FloatArray:
    """Phase, rad, at px: parameters are centre (2), phase at azimuth 0, linear map (2), displacements of second (4) and
    third (5) order across the rays, rad at the outer radius."""
    x0, y0, turn, e1, e2 = parameters[:5]
    u, v = (x - x0) / outer, (y - y0) / outer
    azimuth = np.arctan2((1 - e1) * v + e2 * u, (1 + e1) * u + e2 * v)
    c, q = parameters[5:9], parameters[9:]
    uu, uv, vv = u * u, u * v, v * v  # powers as such are slow
    square = np.maximum(uu + vv, 1e-12)
    bent = uu * (c[0] * u + c[1] * v + q[0] * uu + q[1] * uv) + q[2] * uv * uv
    bent += vv * (c[2] * u + c[3] * v + q[3] * uv + q[4] * vv)
    return cycles * azimuth + turn + bent / square


def scales(cycles: int, outer: float) -> FloatArray:
    """Changes of the parameters that turn the phase by about 1 rad."""
    return np.array([outer / cycles / 2] * 2 + [1.0] + [1 / cycles] * 2 + [1.0] * 9)


def from_points(
    x: FloatArray, y: FloatArray, phase: FloatArray, cycles: int, centre: tuple[float, float], outer: float
) -> FloatArray:
    """The parameters that give px their known phases, mod 2 pi."""
    size = scales(cycles, outer)

    def residual(p: FloatArray) -> FloatArray:
        return np.mod(phase_of(p * size, x, y, cycles, outer) - phase + np.pi, 2 * np.pi) - np.pi

    start = np.zeros(PARAMETERS)
    start[:2] = np.array(centre) / size[:2]
    turn = np.angle(np.exp(1j * (phase - phase_of(start * size, x, y, cycles, outer))).mean())
    start[2] = turn
    return np.asarray(least_squares(residual, start, x_scale=1.0).x * size)


def find_star(values: FloatArray, cycles: int | None = None) -> FoundStar:
    """The star in a region (height, width), NaN where there are no data. FitError where there is none."""
    # what is missing is filled by its neighbours
    filled = smoothed(values, 0.7 if np.isfinite(values).mean() > 0.9 else 1.2)
    centre = _centre(filled)
    rings = _rings(filled, centre)
    if not rings:
        raise FitError("region holds no Siemens star: no ring shows a regular wave")
    votes: dict[int, float] = {}
    for ring in rings:
        votes[ring.cycles] = votes.get(ring.cycles, 0.0) + ring.share
    winner = max(votes, key=lambda m: votes[m]) if cycles is None else cycles
    agreeing = [ring for ring in rings if ring.cycles == winner]
    if len(agreeing) < 4 or winner < 8:
        raise FitError(
            f"region holds no Siemens star{f' of {cycles} cycles' if cycles else ''}: "
            f"of {len(rings)} rings with a wave {len(agreeing)} agree on {winner} cycles"
        )
    # beyond the rim a ring's wave is weak, though nothing else may be there
    strong = _KEPT * float(np.median([ring.amplitude for ring in agreeing[len(agreeing) // 2 :]]))
    outer = max(ring.radius for ring in agreeing if ring.amplitude > strong)
    agreeing = [ring for ring in agreeing if ring.radius <= outer]
    x, y, phase = (np.concatenate([np.asarray(getattr(ring, n)) for ring in agreeing]) for n in ("x", "y", "phase"))
    parameters = from_points(x, y, phase, winner, centre, outer)
    return FoundStar(parameters, winner, agreeing[0].radius, outer)


class _Ring(NamedTuple):
    radius: float
    cycles: int
    share: float
    amplitude: float
    """Of its wave, relative to its mean."""
    x: FloatArray
    y: FloatArray
    phase: FloatArray


def _centre(filled: FloatArray) -> tuple[float, float]:
    gy, gx = np.gradient(filled)
    y, x = np.indices(filled.shape).astype(float)
    length = np.hypot(gx, gy)
    nx, ny = gx / np.maximum(length, 1e-300), gy / np.maximum(length, 1e-300)
    strength = np.minimum(length, np.quantile(length, 0.9)) ** 2
    at = np.array([(filled.shape[1] - 1) / 2, (filled.shape[0] - 1) / 2])
    reach = max(filled.shape) / 3
    for _ in range(_ROUNDS):
        off = nx * (x - at[0]) + ny * (y - at[1])
        # gradients that point elsewhere (a rim, another target) lose their say
        weight = strength / (1 + (off / reach) ** 2) ** 2
        normal = np.array([[(weight * nx * nx).sum(), (weight * nx * ny).sum()], [0, (weight * ny * ny).sum()]])
        normal[1, 0] = normal[0, 1]
        if np.linalg.det(normal) <= 1e-12 * np.trace(normal) ** 2:
            raise FitError("region holds no Siemens star: its brightness changes in one direction only")
        found = nx * x + ny * y
        at = np.linalg.solve(normal, np.array([(weight * nx * found).sum(), (weight * ny * found).sum()]))
        reach = max(reach * 0.7, 3.0)
    if not (0 <= at[0] < filled.shape[1] and 0 <= at[1] < filled.shape[0]):
        raise FitError("region holds no Siemens star: its rays do not meet inside it")
    return float(at[0]), float(at[1])


def _rings(filled: FloatArray, centre: tuple[float, float]) -> list[_Ring]:
    height, width = filled.shape
    most = min(centre[0], centre[1], width - 1 - centre[0], height - 1 - centre[1])
    found = []
    for radius in np.arange(6.0, most, max(1.0, most / 80)):
        count = 2 * int(np.pi * radius * _FINE / 2)
        turn = 2 * np.pi * np.arange(count) / count
        x, y = centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn)
        spectrum = np.fft.rfft(ndimage.map_coordinates(filled, [y, x], order=1))
        power = np.abs(spectrum) ** 2
        low, high = max(6, int(_LOW[0] * 2 * np.pi * radius)), int(_LOW[1] * 2 * np.pi * radius) + 1
        if high - low < 3:
            continue
        peak = low + int(np.argmax(power[low:high]))
        spread = int(max(2, _BAND * peak))
        band = np.zeros(count, complex)
        band[peak - spread : peak + spread + 1] = spectrum[peak - spread : peak + spread + 1]
        share = power[peak - spread : peak + spread + 1].sum() / power[3:].sum()
        phase = np.unwrap(np.angle(np.fft.ifft(band)))
        turns = (phase[-1] - phase[0] + np.angle(np.exp(1j * (phase[0] - phase[-1])))) / (2 * np.pi)
        if share > _CLEAR_IN_RING:
            inside = power[peak - spread : peak + spread + 1].sum()
            amplitude = 2 * float(np.sqrt(inside) / max(abs(spectrum[0]), 1e-300))
            some = slice(None, None, max(1, count // (4 * peak)))
            found.append(_Ring(float(radius), round(turns), float(share), amplitude, x[some], y[some], phase[some]))
    return found


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
    def frequency(self) -> FloatArray:
        """(n,) distinct frequencies of `samples`, cycles/px."""
        return self.samples.frequency[:: len(_DIRECTIONS)]


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
    check_projection_given("star", star, projection)
    if contrast is not None:
        checks.within("contrast", contrast, 0, 1, open_low=True)
    if star is not None and projection is not None:
        whole = LinearImage.of(image, channel, cfa, tone)
        found, box = _as_printed(star, projection, whole.shape)
        picture = region_of(whole, box)
        contrast = star.contrast if contrast is None else contrast
    else:
        picture = region_of(image, roi, channel=channel, cfa=cfa, tone=tone)
        found = find_star(picture.values, cycles)
    if problem := region.flaw(picture.values):
        raise FitError(problem)
    fit, edges = _fitted(picture.values, found)
    aperture = picture.f_number if aperture is None else aperture
    return _result(fit, edges, found, contrast, picture.corner, picture.channel, aperture, source or picture.source)


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
        (high - low < SMALLEST).any()
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
    parameters = from_points(points[:, 0], points[:, 1], phase, star.cycles, tuple(centre), reach)
    box = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    return FoundStar(parameters, star.cycles, float(np.hypot(*(inner - centre).T).max()), reach), box


def _fitted(values: FloatArray, found: FoundStar) -> tuple[WaveFit, tuple[float, float]]:
    """The wave's fit and the range of its frequencies: first where the phase is sure, then all of it."""
    phase = partial(phase_of, cycles=found.cycles, outer=found.outer)
    sizes = scales(found.cycles, found.outer)
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


def _inner_rim(radius: FloatArray, value: FloatArray, found: FoundStar) -> float:
    """px: inside which rings are brighter or darker than the star, as far as it is known."""
    ring = np.round(radius).astype(int)
    count = np.maximum(np.bincount(ring), 1)
    mean = np.bincount(ring, value) / count
    inside = np.arange(len(mean)) <= found.inner
    known = mean[(np.arange(len(mean)) > found.inner) & (np.arange(len(mean)) < found.outer - _RIM)].mean()
    other = inside & (np.abs(mean / known - 1) > _OTHER)
    return float(np.flatnonzero(other).max(initial=0))


def _knots(edges: tuple[float, float]) -> FloatArray:
    inner = np.linspace(*edges, max(2, int(np.ceil((edges[1] - edges[0]) / _INTERVAL)) + 1))
    return np.concatenate([[edges[0]] * 3, inner, [edges[1]] * 3])


def _basis(frequency: FloatArray, direction: FloatArray, edges: tuple[float, float]) -> FloatArray:
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


def _as_plane_waves(mtf: FloatArray, cycles: int) -> FloatArray:
    """The MTF from the contrast on a ring of so many cycles, which is not quite a plane wave.

    exp(i m phi) holds the frequencies z / (2 pi r) with weights m J_m(z) / z, whose even moments are
    m^2j prod(1 - 4 i^2 / m^2), i < j: to 1 / m^2 the contrast is K - (2 s^2 K'' + (4/3) s^3 K''') / m^2, s = f^2. With
    K = exp(-x), x proportional to s, that is K [1 - (2 x^2 - (4/3) x^3) / m^2].
    """
    x = -np.log(np.clip(mtf, 1e-3, 1.0))
    return np.asarray(mtf * (1 + (2 * x**2 - 4 / 3 * x**3) / cycles**2))


def _extrapolated(frequency: FloatArray, amplitude: FloatArray, covariance: FloatArray) -> tuple[float, float]:
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
