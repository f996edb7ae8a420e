"""Gain, responsivity, saturation and linearity from means and variances of exposures (EMVA Standard 1288, release 4, 6 to 8).

The temporal variance of a pixel grows with its mean: s^2 - s_dark^2 = K (mean - dark), K the gain. The mean grows with the
light: mean - dark = R light, R the responsivity. Both lines go through the origin, by ordinary least squares up to 70 % of
saturation, as the standard says. An exposure that is clipped, or departs from the line of the others, is in neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.calibration.sensor.exposure_statistics import ExposureStatistics
from matcam.core.errors import FitError
from matcam.core.remark import Remark, some_of
from matcam.files.capture_settings import Stated
from matcam.numerics.frame_noise import line_of_least_relative_error, not_linear

_FITTED = 0.7
"""Share of saturation up to which gain and responsivity are fitted (EMVA 1288, 6.6)."""
_LINEAR = (0.05, 0.95)
"""Shares of saturation between which linearity is tested (EMVA 1288, 8.2.7)."""
_CLIPPED = 1e-3
"""Share of pixels at the largest code above which an exposure is clipped: hot pixels are fewer."""
_PILED = 0.05
"""Share of the pixels of an exposure with the largest code of all above which this code is the clip level."""
_NOT_LINEAR = 0.03
"""Departure from the line of the other exposures above which an exposure is not used: sensors stay below 1 %."""
_SIGNIFICANT = 5.0
"""Standard deviations by which the variance must be below its largest value if exposures are saturated."""
_HALF = 0.5
"""Smallest share of the largest signal at which a sensor saturates: after a tone curve bright frames have less noise."""
_FEWEST = 3
"""Smallest number of exposures below 70 % of saturation for a gain: with two a contradiction is not detected."""


class Transfer(NamedTuple):
    """Signals of the lit exposures of one plane of the mosaic, in ascending order, and what was fitted to them.

    Attributes:
        light: photons a pixel or exposure time, s, (n,).
        time: exposure time, s, (n,).
        signal: mean above dark, DN, (n,).
        dark: mean dark code, DN, (n,).
        variance: temporal variance, DN^2, (n,).
        dark_variance: of the dark frames, DN^2, (n,).
        variance_std: standard deviation of `variance`, DN^2, (n,).
        dark_variance_std: standard deviation of `dark_variance`, DN^2, (n,).
        linear: exposures that were not left out for their departure, bool, (n,).
        used: exposures that gain and responsivity were fitted to, bool, (n,).
        departure: relative departure from the straight line of 5 to 95 % of saturation, no unit, (n,).
        saturation: index of the exposure that saturates.
        saturated: whether an exposure beyond it was seen.
        responsivity: DN per unit of light.
    """

    light: np.ndarray
    time: np.ndarray
    signal: np.ndarray
    dark: np.ndarray
    variance: np.ndarray
    dark_variance: np.ndarray
    variance_std: np.ndarray
    dark_variance_std: np.ndarray
    linear: np.ndarray
    used: np.ndarray
    departure: np.ndarray
    saturation: int
    saturated: bool
    responsivity: Stated

    @property
    def judged(self) -> np.ndarray:
        """Return a mask (n,) of the exposures between 5 and 95 % of saturation that were not left out."""
        top = self.signal[self.saturation]
        inside = (self.signal >= _LINEAR[0] * top) & (self.signal <= _LINEAR[1] * top)
        return inside & np.isfinite(self.departure) & self.linear & (np.arange(len(self.light)) <= self.saturation)


def clip_level(lit: Sequence[ExposureStatistics]) -> float:
    """Find the code at which pixels clip, DN, or infinity."""
    top = max(one.largest for one in lit)
    piled = max(one.at_largest for one in lit if one.largest == top)
    return top if piled > _PILED else math.inf


def is_clipped(one: ExposureStatistics, lit: Sequence[ExposureStatistics]) -> bool:
    """Check whether pixels of an exposure clip, by the largest code of the others."""
    return one.largest >= clip_level(lit) and one.at_largest > _CLIPPED


def measure_transfer(
    lit: Sequence[ExposureStatistics], dark: Sequence[ExposureStatistics], plane: int
) -> tuple[Transfer, list[Remark]]:
    """Compute the transfer of one plane of the mosaic.

    Args:
        lit: exposures of an evenly lit field.
        dark: exposures of darkness.
        plane: index of the plane.

    Returns:
        The transfer, and remarks that name the exposures that were not used.

    Raises:
        FitError: fewer than three exposures can be used.
    """
    # sorted by signal: an exposure whose light is not as stated is moved to its correct position
    lit = sorted(lit, key=lambda one: (round(float(one.mean[plane])), one.light))
    own_dark = [
        min(dark, key=lambda d: (abs(d.exposure.time - one.exposure.time), -len(d.exposure.files))) for one in lit
    ]
    dark_level = np.array([d.mean[plane] for d in own_dark])
    dark_variance = np.array([d.variance[plane] for d in own_dark])
    dark_variance_std = dark_variance * np.array([d.variance_error for d in own_dark])
    light = np.array([one.light for one in lit])
    signal = np.array([one.mean[plane] for one in lit]) - dark_level
    variance = np.array([one.variance[plane] for one in lit])
    variance_std = variance * np.array([one.variance_error for one in lit])
    clipped = np.array([is_clipped(one, lit) for one in lit])
    saturation = _saturation(variance)
    falls = variance[saturation] - variance[-1] > _SIGNIFICANT * math.hypot(variance_std[saturation], variance_std[-1])
    saturation = saturation if falls or clipped.any() else len(lit) - 1
    beyond = np.arange(len(lit)) > saturation
    top = signal[saturation]
    if top < _HALF * signal.max():
        raise FitError(
            f"{lit[0].exposure.files[0].parent}: the temporal variance falls from {top:.0f} DN on, while the signal grows "
            f"up to {signal.max():.0f} DN: the frames went through a tone curve; give raw frames"
        )
    inside = (signal >= _LINEAR[0] * top) & (signal <= _LINEAR[1] * top) & ~beyond & ~clipped
    mean_std = np.sqrt(variance) / np.array([one.pixels for one in lit]) ** 0.5
    departure, outside = _departures(light, signal, mean_std, inside)
    used = (signal <= _FITTED * top) & ~beyond & ~clipped & ~outside
    remarks = _remarks(lit, beyond | clipped, outside, departure)
    if used.sum() < _FEWEST or (outside.sum() > 0.5 * inside.sum()):
        left = "; ".join(str(remark) for remark in remarks) or f"{len(lit)} lit exposures were given"
        raise FitError(
            f"{lit[0].exposure.files[0].parent}: {used.sum()} exposures are linear and below 70 % of saturation, at least "
            f"{_FEWEST} are needed: {left}"
        )
    responsivity = _through_origin(light[used], signal[used])
    times = np.array([one.exposure.time for one in lit])
    transfer = Transfer(
        light=light,
        time=times,
        signal=signal,
        dark=dark_level,
        variance=variance,
        dark_variance=dark_variance,
        variance_std=variance_std,
        dark_variance_std=dark_variance_std,
        linear=~outside,
        used=used,
        departure=departure,
        saturation=saturation,
        saturated=bool(beyond.any()),
        responsivity=responsivity,
    )
    return transfer, remarks


def fit_gain(planes: Sequence[Transfer]) -> Stated:
    """Fit the gain to the exposures of all planes, DN per electron.

    The standard deviation follows from that of the variances, and from the scatter about the line where it is larger. Exposures
    that share dark frames share their error.
    """
    x, y, std, dark, dark_std = (
        np.concatenate([of(plane)[plane.used] for plane in planes])
        for of in (
            lambda p: p.signal,
            lambda p: p.variance - p.dark_variance,
            lambda p: p.variance_std,
            lambda p: p.dark_variance,
            lambda p: p.dark_variance_std,
        )
    )
    square = float(x @ x)
    value = float(x @ y) / square
    # White (1980), Econometrica 48, 817: from the scatter about the line, for any variance of the exposures
    scatter = float((x**2) @ (y - value * x) ** 2) * len(x) / max(len(x) - 1, 1)
    own = max(float((x**2) @ std**2), scatter)
    shared = sum(float(x[dark == one].sum() * dark_std[dark == one].max()) ** 2 for one in np.unique(dark))
    if not value > 0:
        raise FitError("the variance does not grow with the light: the frames are not linear codes; give raw frames")
    return Stated(value, math.sqrt(own + shared) / square)


def _saturation(variance: np.ndarray) -> int:
    """Find the exposure that saturates (EMVA 1288, 6.6): from the right the first whose two predecessors vary less."""
    for i in range(len(variance) - 1, 1, -1):
        if variance[i] > max(variance[i - 1], variance[i - 2]):
            return i
    return int(np.argmax(variance))


def _departures(
    light: np.ndarray, signal: np.ndarray, mean_std: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute relative departures from the straight line of the linear exposures, and find the nonlinear exposures."""
    outside = np.zeros(len(light), bool)
    departure = np.full(len(light), np.nan)
    while (inside & ~outside).sum() >= _FEWEST:
        kept = inside & ~outside
        slope, offset = line_of_least_relative_error(light[kept], signal[kept])
        line = slope * light + offset
        departure = np.where(line > 0, signal / np.where(line > 0, line, 1) - 1, np.nan)
        wrong = kept & not_linear(departure, mean_std / np.maximum(signal, 1e-9), _NOT_LINEAR)
        if not wrong.any():
            break
        outside[int(np.argmax(np.where(wrong, np.abs(departure), 0)))] = True
    return departure, outside


def _through_origin(x: np.ndarray, y: np.ndarray) -> Stated:
    square = float(x @ x)
    value = float(x @ y) / square
    scatter = float(np.sum((y - value * x) ** 2)) / max(len(x) - 1, 1)
    return Stated(value, math.sqrt(scatter / square))


def _remarks(
    lit: Sequence[ExposureStatistics], clipped: np.ndarray, outside: np.ndarray, departure: np.ndarray
) -> list[Remark]:
    found = []
    names = [one.exposure.name for one in lit]
    if clipped.any():
        which = some_of([names[i] for i in np.flatnonzero(clipped)], 3)
        found.append(Remark("clipped", f"{which}: beyond saturation or clipped; not used"))
    found += [
        Remark("not-linear", f"{names[i]}: {departure[i]:+.1%} off the straight line of the others; not used")
        for i in np.flatnonzero(outside)
    ]
    return found
