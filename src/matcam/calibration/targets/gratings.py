"""Where a grating lies in a picture: its pixels, and the phase of each of them.

Gratings: the MTF at a line frequency and its harmonics, from sines, square waves (bars) and narrow lines (MODEL 7).

A bar pattern is a square wave: its contrast is not the MTF until it is freed of harmonics. Here the harmonics are fitted one by
one, with the phase that they share; `coltman` does the same for contrasts that were measured elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from matcam.calibration.chart.chart import PROFILES, Grating
from matcam.calibration.chart.registration import Projection, check_projection_given
from matcam.calibration.photograph import region
from matcam.calibration.photograph.light import smoothed
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, region_of
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.calibration.targets.wave_fit import Modulation, WaveFit, enough, fit_wave, local_wave
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import FloatArray
from matcam.files.photographs import Photograph

MARGIN = 4.0
"""px: pixels nearer than this to a grating's border see what is outside."""
_WIDE = 50.0  # px: beyond, perspective and distortion need third order
_CLEAR_IN_SPECTRUM = 30.0  # power of the wave over the median of the spectrum
_ENVELOPE = 0.75
_NEAR = 0.1  # of a stated frequency: how far the true one is looked for
_LONGEST = 2.0  # periods that a region must hold at least


class FoundGrating(NamedTuple):
    """A grating in a picture."""

    parameters: FloatArray
    """(6,) or (10,) of `phase_of`."""
    inside: np.ndarray
    """(height, width) pixels that see nothing else."""
    middle: tuple[float, float]
    """px of the place that the phase is expanded about."""


def phase_of(parameters: FloatArray, x: FloatArray, y: FloatArray, middle: tuple[float, float]) -> FloatArray:
    """Phase, rad, at px: a polynomial of second or third order; in units of 100 px."""
    u, v = (x - middle[0]) / 100, (y - middle[1]) / 100
    p = parameters
    phase = p[0] + p[1] * u + p[2] * v + p[3] * u * u + p[4] * u * v + p[5] * v * v
    if len(p) == 10:
        phase = phase + p[6] * u * u * u + p[7] * u * u * v + p[8] * u * v * v + p[9] * v * v * v
    return np.asarray(phase)


def scales(found: FoundGrating) -> FloatArray:
    """Changes of the parameters that turn the phase by about 1 rad."""
    reach = np.sqrt(found.inside.sum()) / 200
    return np.concatenate([[1.0], [1 / reach] * 2, [1 / reach**2] * 3, [1 / reach**3] * (len(found.parameters) - 6)])


def from_points(x: FloatArray, y: FloatArray, phase: FloatArray, inside: np.ndarray) -> FoundGrating:
    """The grating whose (unwrapped) phase is known at some points."""
    middle = (float(x.mean()), float(y.mean()))
    u, v = (x - middle[0]) / 100, (y - middle[1]) / 100
    powers = [np.ones_like(u), u, v, u * u, u * v, v * v]
    if np.sqrt(inside.sum()) > _WIDE:
        powers += [u * u * u, u * u * v, u * v * v, v * v * v]
    parameters = np.asarray(np.linalg.lstsq(np.stack(powers, axis=-1), phase, rcond=None)[0], dtype=np.float64)
    return FoundGrating(parameters, inside, middle)


def inside_of(corners: FloatArray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels deeper than the margin inside a convex polygon (n, 2) px."""
    y, x = np.indices(shape).astype(float)
    middle, inside = corners.mean(0), np.ones(shape, bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*(b - a))
        normal *= np.sign(normal @ (middle - a))
        inside &= (x - a[0]) * normal[0] + (y - a[1]) * normal[1] > MARGIN
    return inside


def find_grating(values: FloatArray, near: tuple[float, float] | None = None) -> FoundGrating:
    """The grating in a region (height, width), NaN where there are no data. near: its frequency (fx, fy), cycles/px, if it may
    lie beyond Nyquist; roughly: the nearest that looks the same is taken. FitError where there is none."""
    filled = values if np.isfinite(values).all() else smoothed(values, 0.9)
    frequency = _strongest(filled, near)
    if near is not None:
        shifts = np.stack(np.meshgrid([-2, -1, 0, 1, 2], [-2, -1, 0, 1, 2]), axis=-1).reshape(-1, 2)
        alike = np.concatenate([shifts + frequency, shifts - frequency])
        frequency = alike[np.argmin(np.hypot(*(alike - np.array(near)).T))]
    y, x = np.indices(values.shape).astype(float)
    wave = np.exp(-2j * np.pi * (frequency[0] * x + frequency[1] * y))
    smooth = max(3.0, 0.8 / np.hypot(*_folded(frequency)))
    turned = (filled - filled.mean()) * wave
    envelope = ndimage.gaussian_filter(turned.real, smooth) + 1j * ndimage.gaussian_filter(turned.imag, smooth)
    size = np.abs(envelope)
    label, count = ndimage.label(size > _ENVELOPE * np.quantile(size, 0.98))
    if not count:
        raise FitError("region holds no grating")
    largest = 1 + int(np.argmax(ndimage.sum_labels(np.ones_like(size), label, np.arange(1, count + 1))))
    inside = ndimage.binary_erosion(
        ndimage.binary_fill_holes(label == largest), iterations=round(MARGIN), border_value=1
    )
    if inside.sum() < 256:
        raise FitError("region holds no grating: nowhere 16 x 16 px of one regular wave")
    start = float(np.angle(envelope[inside].mean()))
    phase = start + 2 * np.pi * (frequency[0] * x + frequency[1] * y)
    return from_points(x[inside], y[inside], phase[inside], inside)


def _folded(frequency: FloatArray) -> FloatArray:
    return np.asarray(frequency - np.round(frequency))


def _strongest(filled: FloatArray, near: tuple[float, float] | None) -> FloatArray:
    """(fx, fy) cycles/px of the strongest wave below Nyquist; of those that may be `near` in truth, if that is given."""
    height, width = filled.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
    mean = (window * filled).sum() / window.sum()
    # four times as many frequencies as samples: the peak is then known to a small part of a period over the region
    power = np.abs(np.fft.rfft2(window * (filled - mean), (4 * height, 4 * width))) ** 2
    fy, fx = np.fft.fftfreq(4 * height)[:, None], np.fft.rfftfreq(4 * width)[None]
    # borders of what is in the region have power at low frequencies, more than harmonics have at high ones
    power *= np.hypot(fx, fy)
    power[(np.abs(fx) * width < _LONGEST) & (np.abs(fy) * height < _LONGEST)] = 0
    everywhere = np.median(power)
    if near is not None:
        alias = _folded(np.array(near))
        off = [np.hypot(_folded(fx - sign * alias[0]), _folded(fy - sign * alias[1])) for sign in (-1, 1)]
        power[np.minimum(*off) > max(_NEAR * float(np.hypot(*near)), 2 * _LONGEST / min(height, width))] = 0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    if not power[row, column] > _CLEAR_IN_SPECTRUM * everywhere:
        raise FitError("region holds no grating: no frequency stands out")
    return np.array([fx[0, column], fy[row, 0]])


_HIGHEST = 1.1  # cycles/px: harmonics beyond are taken for gone
_USEFUL = 0.1  # standard deviation of an MTF value beyond which it says nothing
_CLEAR = 6.0  # standard deviations of the whole wave
_LEFT = 0.05  # share of the variance that a grating may leave if it is not noise
_WHITE = 40.0  # largest power of a residual over the median: white noise stays below 20


@dataclass(frozen=True, eq=False)
class GratingMTF:
    """What a grating says."""

    samples: MTFSamples
    """The MTF at the harmonics that tell something."""
    frequency: tuple[float, float]
    """(fx, fy) cycles/px of the grating in the middle of its picture."""
    orders: tuple[int, ...]
    modulation: FloatArray
    """Amplitude of the harmonic of each order, relative to the mean, signed as the print's phase has it."""
    modulation_std: FloatArray
    gain: float
    """Noise as found: a pixel's variance is gain * value + read_variance."""
    read_variance: float

    @property
    def contrast(self) -> float:
        """(brightest - darkest) / (brightest + darkest) that pixels on the middles of lines would read."""
        at_bright, at_dark = self.modulation.sum(), (self.modulation * (-1.0) ** np.array(self.orders)).sum()
        return float((at_bright - at_dark) / (2 + at_bright + at_dark))


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
    aperture: float | None = None,
    source: str = "",
) -> GratingMTF:
    """MTF of lens and pixel at a grating's frequency, and at the harmonics that it holds.

    image, roi, cfa, channel, tone: as for `edge_mtf`; the region holds one grating, and may hold what is around it. grating,
    projection: a chart's grating and where the page's points lie in the picture, both or neither: they replace roi,
    profile, contrast, duty and near. profile: "bars", "sine" or "lines"; duty: bright share of a period of lines.
    contrast: (bright - dark) / (bright + dark) of the print, linear. near: the frequency (fx, fy), cycles/px, roughly: only
    needed if it is beyond Nyquist; without it the frequency is taken to be below.

    Phases are fitted, so no error is made by where pixels lie on the bars; harmonics that look alike on the grid, or like the
    mean, get the errors that they deserve, and those that say nothing are left out. Raises ArgumentError, and FitError where
    there is no grating.
    """
    check_projection_given("grating", grating, projection)
    if grating is not None and projection is not None:
        whole = LinearImage.of(image, channel, cfa, tone)
        found, box = _as_printed(grating, projection, whole.shape)
        picture = region_of(whole, box)
    else:
        if contrast is None:
            raise ArgumentError("contrast of the print must be given: (bright - dark) / (bright + dark), linear")
        checks.within("contrast", contrast, 0, 1, open_low=True)
        checks.within("duty", duty, 0, 1, open_low=True, open_high=True)
        checks.choice("profile", profile, PROFILES)
        # bright + dark = 2: only ratios matter
        print_ = Grating(
            profile, (0, 0), (1, 1), 0.0, 1.0, 0.0, 1 - contrast, 1 + contrast, duty if profile == "lines" else 0.5
        )
        picture = region_of(image, roi, channel=channel, cfa=cfa, tone=tone)
        if problem := region.flaw(picture.values):
            raise FitError(problem)
        found = find_grating(picture.values, near)
    known = grating is not None
    printed = grating if grating is not None else print_
    fit, orders, waves = _fitted(picture.values, found, printed)
    signs = np.ones(len(orders))
    if not known and fit.coefficients[0] < 0:
        # nobody said where the bright lines are: the camera does not turn the first harmonic round
        signs = (-1.0) ** np.array(orders)
    return _result(
        fit,
        signs,
        orders,
        waves,
        printed,
        picture.corner,
        found,
        picture.channel,
        picture.f_number if aperture is None else aperture,
        source or picture.source,
    )


def coltman(frequency: ArrayLike, contrast: ArrayLike) -> FloatArray:
    """Sine-wave MTF from contrasts of square waves (Coltman, JOSA 44, 1954, 468).

    frequency: (n,) rising, cycles/px. contrast: (n,) of bars on the middles of their lines, relative to the print's; the last
    one should be near 0: beyond it the contrast is taken to be 0, and between them it is interpolated from 1 at frequency 0.
    Returns the MTF at `frequency`. Raises ArgumentError.
    """
    f, c = (np.asarray(a, dtype=np.float64) for a in (frequency, contrast))
    if (
        f.ndim != 1
        or f.shape != c.shape
        or f.size < 2
        or not (np.diff(f) > 0).all()
        or not f[0] > 0
        or not np.isfinite(c).all()
    ):
        raise ArgumentError(
            f"frequency must rise from above 0, with one finite contrast each, got {f.shape} and {c.shape}"
        )
    from scipy.interpolate import PchipInterpolator

    between = PchipInterpolator(np.concatenate([[0.0], f]), np.concatenate([[1.0], c]), extrapolate=False)
    total = np.zeros_like(f)
    for k in range(1, int(f[-1] / f[0]) + 1, 2):
        # C(f) = (4 / pi) sum chi(k) M(k f) / k, chi(k) = +-1 for k = 1, 3 mod 4, inverted after Moebius
        total += _moebius(k) * (1 if k % 4 == 1 else -1) / k * np.nan_to_num(between(k * f))
    return np.asarray(np.pi / 4 * total)


def _moebius(k: int) -> int:
    sign, p = 1, 2
    while k > 1:
        if k % p == 0:
            k //= p
            if k % p == 0:
                return 0
            sign = -sign
        p += 1
    return sign


def _as_printed(
    grating: Grating, projection: Projection, shape: tuple[int, ...]
) -> tuple[FoundGrating, tuple[int, int, int, int]]:
    """The grating where the registration expects it, in px of the region that holds it."""
    corners = projection(grating.corners)
    low = np.maximum(np.floor(corners.min(0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(0)).astype(int) + 1, [shape[1], shape[0]])
    if (high - low < SMALLEST).any():
        raise FitError("the grating lies outside the picture, or covers less than 16 x 16 px of it")
    inside = inside_of(corners - low, (int(high[1] - low[1]), int(high[0] - low[0])))
    if inside.sum() < 64:
        raise FitError("the grating covers too few pixels of the picture")
    across = np.array([np.cos(grating.angle), np.sin(grating.angle)])
    along = np.array([-np.sin(grating.angle), np.cos(grating.angle)])
    u, v = (a.ravel() for a in np.meshgrid(*(np.linspace(-0.5, 0.5, 9) * side for side in grating.size)))
    points = projection(np.array(grating.centre) + u[:, None] * across + v[:, None] * along) - low
    found = from_points(
        points[:, 0], points[:, 1], 2 * np.pi * u / grating.period + grating.phase, inside
    )  # fmt: skip
    return found, (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def _fitted(
    values: FloatArray, found: FoundGrating, printed: Grating
) -> tuple[WaveFit, tuple[int, ...], tuple[FloatArray, FloatArray]]:
    """The wave's fit, its orders, and the mean frequency and direction."""
    rows, columns = np.nonzero(found.inside & np.isfinite(values))
    some = enough(np.ones(len(rows), bool))
    rows, columns = rows[some], columns[some]
    x, y, value = columns.astype(float), rows.astype(float), values[rows, columns]
    phase = partial(phase_of, middle=found.middle)
    _, frequency, _ = local_wave(phase, found.parameters, x, y)
    highest = max(1, int(_HIGHEST / max(float(frequency.mean()), 1e-6)))
    if printed.profile == "sine":
        orders: tuple[int, ...] = (1,)
    else:
        orders = tuple(n for n in range(1, highest + 1) if abs(printed.harmonic(n)) > 1e-9)
    sizes = scales(found)
    # first the fundamental alone, which knows the phase but for what its harmonics leave
    first = (
        fit_wave(value, x, y, phase, found.parameters, sizes, Modulation(_constant), steps=4, rough=True)
        if len(value)
        else None
    )
    fit = first and fit_wave(value, x, y, phase, first.parameters, sizes, Modulation(_constant, orders), steps=8)
    if not fit:
        raise FitError("the grating's pixels do not determine its contrast: too few of them in this picture")
    if not fit.signal > _CLEAR:
        raise FitError(
            f"region holds no grating that can be measured: its wave is {fit.signal:.1f} standard deviations strong"
        )
    if other := _other_wave(value - fit.values, value, rows, columns, values.shape):
        raise FitError(f"region holds no grating that can be measured: {other}")
    _, frequency, direction = local_wave(phase, fit.parameters, x, y)
    fx, fy = (frequency * np.cos(direction)).mean(), (frequency * np.sin(direction)).mean()
    return fit, orders, (np.array([fx, fy]), np.array([x.mean(), y.mean()]))


def _other_wave(
    residual: FloatArray, value: FloatArray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, ...]
) -> str:
    """What else there is than one wave and noise; empty if nothing."""
    left = residual.var() / value.var()
    if left < _LEFT:
        return ""
    image = np.zeros(shape)
    image[rows, columns] = residual
    power = np.abs(np.fft.rfft2(image)) ** 2
    if power.max() < _WHITE * np.median(power):
        return ""
    return f"what varies in it is not one wave, which leaves {left:.0%} of it"


def _constant(frequency: FloatArray, direction: FloatArray) -> FloatArray:
    return np.ones((len(frequency), 1))


def _result(
    fit: WaveFit, signs: FloatArray, orders: tuple[int, ...], waves: tuple[FloatArray, FloatArray], printed: Grating,
    corner: tuple[int, int], found: FoundGrating, channel: str, aperture: float | None, source: str,
) -> GratingMTF:  # fmt: skip
    (fx, fy), place = waves
    f, direction = float(np.hypot(fx, fy)), float(np.arctan2(fy, fx))
    modulation = signs * fit.coefficients
    std = np.sqrt(np.diag(fit.covariance))
    size = np.array([printed.harmonic(n) for n in orders])
    telling = np.flatnonzero(std / np.abs(size) < _USEFUL)
    if not telling.size:
        raise FitError(
            f"the grating of {f:.3f} cycles/px tells nothing: standard deviation {std[0] / abs(size[0]):.2g} of its MTF"
        )
    scale = (signs / size)[telling]
    samples = MTFSamples(
        "grating",
        (float(place[0] + corner[0]), float(place[1] + corner[1])),
        f * np.array(orders)[telling],
        np.full(telling.size, direction),
        modulation[telling] / size[telling],
        fit.covariance[np.ix_(telling, telling)] * np.outer(scale, scale),
        channel,
        aperture,
        source,
    )
    return GratingMTF(samples, (float(fx), float(fy)), orders, modulation, std, fit.gain, fit.read_variance)
