"""Gain, responsivity, saturation and linearity from means and variances of exposures (EMVA Standard 1288, release 4).

The temporal variance s^2 of a pixel increases with its mean: s^2 - s_dark^2 = K (mean - dark). Here s_dark^2 and dark
are the variance and the mean of the dark frames, and K is the gain. The mean increases with the light: mean - dark = R
light, where R is the responsivity. As the standard requires (sections 6 to 8), both lines pass through the origin, and
are fitted by ordinary least squares up to 70 % of saturation. Exposures that are clipped, or that deviate from the line
of the others, are excluded from both fits.
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
from matcam.numerics.normal import SIGNIFICANT

_FEWEST = 3
"""Smallest number of exposures below 70 % of saturation for a gain.

A straight line fits any two exposures, so that their nonlinearity is not detected.
"""


class Transfer(NamedTuple):
    """Signals of one plane of the mosaic in the lit exposures, in ascending order, and the results of the fit.

    Attributes:
        light: photons per pixel, or exposure time, s, (n,).
        time: exposure time, s, (n,).
        signal: mean above dark, DN, (n,).
        dark: mean dark code, DN, (n,).
        variance: temporal variance, DN^2, (n,).
        dark_variance: temporal variance of the dark frames, DN^2, (n,).
        variance_std: standard deviation of `variance`, DN^2, (n,).
        dark_variance_std: standard deviation of `dark_variance`, DN^2, (n,).
        judged: mask of the exposures between 5 and 95 % of saturation that were not excluded as nonlinear, (n,).
        used: mask of the exposures to which gain and responsivity were fitted, (n,).
        departure: relative deviation from the line fitted between 5 and 95 % of saturation, no unit, (n,).
        saturation: index of the exposure at saturation; the last one if no exposure saturates.
        saturated: whether the series contains an exposure beyond saturation.
        responsivity: responsivity, DN per unit of light.
    """

    light: np.ndarray
    time: np.ndarray
    signal: np.ndarray
    dark: np.ndarray
    variance: np.ndarray
    dark_variance: np.ndarray
    variance_std: np.ndarray
    dark_variance_std: np.ndarray
    judged: np.ndarray
    used: np.ndarray
    departure: np.ndarray
    saturation: int
    saturated: bool
    responsivity: Stated


def is_clipped(one: ExposureStatistics, lit: Sequence[ExposureStatistics]) -> bool:
    """Check whether more than 0.1 % of the pixels clip. Hot pixels are a smaller share.

    The largest code of the exposures `lit` is the clip level if more than 5 % of the pixels of an exposure have this code.
    """
    top = max(other.largest for other in lit)
    piled = max(other.at_largest for other in lit if other.largest == top)
    return piled > 0.05 and one.largest >= top and one.at_largest > 1e-3


def measure_transfer(
    lit: Sequence[ExposureStatistics], dark: Sequence[ExposureStatistics], plane: int
) -> tuple[Transfer, list[Remark]]:
    """Compute the photon transfer of one plane of the mosaic.

    Args:
        lit: exposures of an evenly lit field.
        dark: dark exposures.
        plane: index of the plane.

    Returns:
        The transfer, and remarks on the exposures that were not used.

    Raises:
        FitError: dark and lit frames are exchanged, fewer than three exposures can be used, most exposures are not linear, or a
            tone curve was applied.
    """
    # The exposures are sorted by signal, because the specified light of an exposure may be wrong.
    lit = sorted(lit, key=lambda one: (round(float(one.mean[plane])), one.light))
    own_dark = [
        min(dark, key=lambda d: (abs(d.exposure.time - one.exposure.time), -len(d.exposure.files))) for one in lit
    ]

    def columns(some: Sequence[ExposureStatistics]) -> np.ndarray:
        rows = [(of.light, of.exposure.time, of.mean[plane], of.variance[plane], of.variance_error) for of in some]
        return np.array(rows).T

    light, times, mean, variance, variance_error = columns(lit)
    _, _, dark_level, dark_variance, dark_error = columns(own_dark)
    variance_std, dark_variance_std = variance * variance_error, dark_variance * dark_error
    signal = mean - dark_level
    pixels = np.array([one.pixels for one in lit])
    mean_std = np.sqrt(variance / pixels)
    darker = signal < -SIGNIFICANT * np.hypot(mean_std, np.sqrt(dark_variance / pixels))
    if darker.mean() > 0.5:
        lit_file, dark_file = (of[int(np.argmin(signal))].exposure.files[0] for of in (lit, own_dark))
        raise FitError(
            f"{dark_file}: the dark frames are brighter than the lit frames of the same exposure time, such as {lit_file}: "
            "exchange the dark frames and the lit frames"
        )
    clipped = np.array([is_clipped(one, lit) for one in lit])
    saturation = _saturation(variance, variance_std)
    falls = variance[saturation] - variance[-1] > SIGNIFICANT * math.hypot(variance_std[saturation], variance_std[-1])
    saturation = saturation if falls or clipped.any() else len(lit) - 1
    beyond = np.arange(len(lit)) > saturation
    top = signal[saturation]
    # If the variance decreases above a small signal, a tone curve has reduced the noise of bright frames.
    if top < 0.5 * signal.max():
        raise FitError(
            f"{lit[0].exposure.files[0].parent}: the temporal variance decreases above {top:.0f} DN, although the signal "
            f"increases to {signal.max():.0f} DN: a tone curve was applied to the frames; give raw frames"
        )
    # Linearity is tested between 5 and 95 % of saturation (EMVA 1288, 8.2.7), and the lines are fitted up to 70 % (6.6).
    tested = (signal >= 0.05 * top) & (signal <= 0.95 * top) & ~beyond
    inside = tested & ~clipped
    departure, outside = _departures(light, signal, mean_std, inside)
    used = (signal <= 0.7 * top) & ~beyond & ~clipped & ~outside
    remarks = _remarks(lit, beyond | clipped, outside, departure)
    if used.sum() < _FEWEST or (outside.sum() > 0.5 * inside.sum()):
        left = "; ".join(str(remark) for remark in remarks) or f"lit exposures: {len(lit)}"
        text = f"{outside.sum()} of {inside.sum()} exposures between 5 and 95 % of saturation deviate from a line"
        text += ": give raw frames"
        if used.sum() < _FEWEST:
            text = "the number of exposures that are linear and below 70 % of saturation is "
            text += f"{used.sum()}, but at least {_FEWEST} are needed: add exposures"
        raise FitError(f"{lit[0].exposure.files[0].parent}: {text} ({left})")
    responsivity = _through_origin(light[used], signal[used])
    transfer = Transfer(
        light=light,
        time=times,
        signal=signal,
        dark=dark_level,
        variance=variance,
        dark_variance=dark_variance,
        variance_std=variance_std,
        dark_variance_std=dark_variance_std,
        judged=tested & np.isfinite(departure) & ~outside,
        used=used,
        departure=departure,
        saturation=saturation,
        saturated=bool(beyond.any()),
        responsivity=responsivity,
    )
    return transfer, remarks


def fit_gain(planes: Sequence[Transfer]) -> Stated:
    """Fit the gain to the exposures of all planes, DN per electron.

    The standard deviation follows from the standard deviations of the variances, or from the scatter about the line if the
    scatter is larger. Exposures that share dark frames have a common error.
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
    # Heteroscedasticity-consistent estimate from the scatter about the line (White 1980, Econometrica 48, 817).
    scatter = float((x**2) @ (y - value * x) ** 2) * len(x) / max(len(x) - 1, 1)
    own = max(float((x**2) @ std**2), scatter)
    shared = sum(float(x[dark == one].sum() * dark_std[dark == one].max()) ** 2 for one in np.unique(dark))
    if not value > 0:
        raise FitError(
            "the variance does not increase with the signal: the codes of the frames are not linear; give raw frames"
        )
    return Stated(value, math.sqrt(own + shared) / square)


def _saturation(variance: np.ndarray, std: np.ndarray) -> int:
    """Find the index of the exposure at saturation (EMVA 1288, 6.6).

    It is the last exposure whose variance exceeds the variances of both preceding exposures. Beyond saturation, noise alone
    causes such an increase in a third of all cases, because the variance is constant there. Therefore, exposures whose variance
    is significantly below the maximum are skipped. `std`: standard deviations of the variances.
    """
    highest = int(np.argmax(variance))
    below = variance[highest] - variance > SIGNIFICANT * np.hypot(std[highest], std)
    for i in range(len(variance) - 1, 1, -1):
        if variance[i] > max(variance[i - 1], variance[i - 2]) and not below[i]:
            return i
    return highest


def _departures(
    light: np.ndarray, signal: np.ndarray, mean_std: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute relative deviations from a line through the linear exposures, and mark the nonlinear exposures."""
    outside = np.zeros(len(light), bool)
    departure = np.full(len(light), np.nan)
    while (inside & ~outside).sum() >= _FEWEST:
        kept = inside & ~outside
        slope, offset = line_of_least_relative_error(light[kept], signal[kept])
        line = slope * light + offset
        departure = np.where(line > 0, signal / np.where(line > 0, line, 1) - 1, np.nan)
        # The nonlinearity of sensors is below 1 %. An exposure that deviates by more than 3 % is not used.
        wrong = kept & not_linear(departure, mean_std / np.maximum(signal, 1e-9), 0.03)
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
        found.append(Remark("clipped", f"exposures that are beyond saturation or clipped were not used: {which}"))
    found += [
        Remark(
            "not-linear",
            f"{names[i]}: this exposure was not used, because its signal deviates by {departure[i]:+.1%} from the line of "
            "the other exposures",
        )
        for i in np.flatnonzero(outside)
    ]
    return found
