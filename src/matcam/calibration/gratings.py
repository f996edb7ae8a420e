"""Gratings: the MTF at a line frequency and its harmonics, from sines, square waves (bars) and narrow lines (MODEL 7).

A bar pattern is a square wave: its contrast is not the MTF until it is freed of harmonics. Here the harmonics are fitted one by
one, with the phase that they share; `coltman` does the same for contrasts that were measured elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from matcam import checks
from matcam.calibration import grating_geometry, region
from matcam.calibration.chart import PROFILES, Grating, harmonic
from matcam.calibration.grating_geometry import FoundGrating
from matcam.calibration.mtf_samples import MTFSamples
from matcam.calibration.projection import Projection, check_given
from matcam.calibration.wave_fit import Array, Modulation, WaveFit, enough, fit_wave, local_wave
from matcam.errors import ArgumentError, FitError

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
    modulation: Array
    """Amplitude of the harmonic of each order, relative to the mean, signed as the print's phase has it."""
    modulation_std: Array
    gain: float
    """Noise as found: a pixel's variance is gain * value + read_variance."""
    read_variance: float

    @property
    def contrast(self) -> float:
        """(brightest - darkest) / (brightest + darkest) that pixels on the middles of lines would read."""
        at_bright, at_dark = self.modulation.sum(), (self.modulation * (-1.0) ** np.array(self.orders)).sum()
        return float((at_bright - at_dark) / (2 + at_bright + at_dark))


def grating_mtf(
    image: ArrayLike,
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
    tone: str | ArrayLike | None = None,
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
    picture = np.asarray(image)
    check_given("grating", grating, projection)
    if grating is not None and projection is not None:
        found, box = _as_printed(grating, projection, picture.shape)
        values, (x0, y0) = region.cut(image, box, cfa, channel, tone), box[:2]
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
        values = region.cut(image, roi, cfa, channel, tone)
        if problem := region.flaw(values):
            raise FitError(problem)
        found = grating_geometry.find_grating(values, near)
        x0, y0 = region.corner_of(roi)
    known = grating is not None
    printed = grating if grating is not None else print_
    fit, orders, waves = _fitted(values, found, printed)
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
        (x0, y0),
        found,
        region.measured_channel(picture, channel),
        aperture,
        source,
    )


def coltman(frequency: ArrayLike, contrast: ArrayLike) -> Array:
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
    if (high - low < region.SMALLEST).any():
        raise FitError("the grating lies outside the picture, or covers less than 16 x 16 px of it")
    inside = grating_geometry.inside_of(corners - low, (int(high[1] - low[1]), int(high[0] - low[0])))
    if inside.sum() < 64:
        raise FitError("the grating covers too few pixels of the picture")
    across = np.array([np.cos(grating.angle), np.sin(grating.angle)])
    along = np.array([-np.sin(grating.angle), np.cos(grating.angle)])
    u, v = (a.ravel() for a in np.meshgrid(*(np.linspace(-0.5, 0.5, 9) * side for side in grating.size)))
    points = projection(np.array(grating.centre) + u[:, None] * across + v[:, None] * along) - low
    found = grating_geometry.from_points(
        points[:, 0], points[:, 1], 2 * np.pi * u / grating.period + grating.phase, inside
    )  # fmt: skip
    return found, (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def _fitted(
    values: Array, found: FoundGrating, printed: Grating
) -> tuple[WaveFit, tuple[int, ...], tuple[Array, Array]]:
    """The wave's fit, its orders, and the mean frequency and direction."""
    rows, columns = np.nonzero(found.inside & np.isfinite(values))
    some = enough(np.ones(len(rows), bool))
    rows, columns = rows[some], columns[some]
    x, y, value = columns.astype(float), rows.astype(float), values[rows, columns]
    phase = partial(grating_geometry.phase_of, middle=found.middle)
    _, frequency, _ = local_wave(phase, found.parameters, x, y)
    highest = max(1, int(_HIGHEST / max(float(frequency.mean()), 1e-6)))
    if printed.profile == "sine":
        orders: tuple[int, ...] = (1,)
    else:
        orders = tuple(n for n in range(1, highest + 1) if abs(harmonic(printed, n)) > 1e-9)
    sizes = grating_geometry.scales(found)
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


def _other_wave(residual: Array, value: Array, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, ...]) -> str:
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


def _constant(frequency: Array, direction: Array) -> Array:
    return np.ones((len(frequency), 1))


def _result(
    fit: WaveFit, signs: Array, orders: tuple[int, ...], waves: tuple[Array, Array], printed: Grating, corner: tuple[int, int],
    found: FoundGrating, channel: str, aperture: float | None, source: str,
) -> GratingMTF:  # fmt: skip
    (fx, fy), place = waves
    f, direction = float(np.hypot(fx, fy)), float(np.arctan2(fy, fx))
    modulation = signs * fit.coefficients
    std = np.sqrt(np.diag(fit.covariance))
    size = np.array([harmonic(printed, n) for n in orders])
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
