"""Temporal and spatial variances of frames, and departures from a straight line (EMVA Standard 1288, release 4).

`matcam sensor` uses these estimators. `reconstruct` uses them for dark frames and for the check of linearity.
"""

from __future__ import annotations

import numpy as np

from matcam.numerics.normal import robust_std

_OUTLIER = 8.0
"""Number of robust standard deviations beyond which a difference is a cosmic ray or a hot pixel. Normal values exceed
it with a probability of 1e-15.
"""
_SMALLEST_SPREAD = 0.5
"""Smallest robust standard deviation, DN. The estimate may be 0, because most pixels of a frame with little noise have the
same code.
"""
_SIGNIFICANT = 5.0
"""Number of standard deviations above which a departure from a straight line is significant."""


def code_step(codes: np.ndarray) -> float:
    """Compute the step of the codes of a frame, DN.

    All codes differ by multiples of this step, and no larger number has this property.

    Args:
        codes: frame as read, (height, width), DN. A ninth of the pixels is used.

    Returns:
        Step of the codes, such as 64 for a signal of 10 bits that fills 16 bits; NaN for fractional codes.

    Example:
        >>> code_step(np.array([[256, 320, 0, 640]]))
        64.0
    """
    some = codes[::3, ::3]
    if not (some == np.round(some)).all():
        return float("nan")
    return float(np.gcd.reduce((some - some.min()).astype(np.int64), axis=None)) or 1.0


def clipped_variance(values: np.ndarray) -> float:
    """Compute the variance of values about their mean, without outliers.

    Args:
        values: values with a mean of about 0, DN, any shape. Values with a magnitude above eight robust standard
            deviations are outliers.

    Returns:
        Variance, DN^2; 0 for an empty array.
    """
    width = _OUTLIER * max(robust_std(values), _SMALLEST_SPREAD)
    kept = values[np.abs(values) <= width]
    return float(kept.var(dtype=np.float64)) if kept.size else 0.0


def pair_variance(first: np.ndarray, second: np.ndarray) -> float:
    """Compute the temporal variance of a pixel from two equal exposures (EMVA 1288, 8.2.1).

    The difference between the means of the frames is subtracted, because it is caused by a change of the lamp. Unlike in
    the standard, differences of more than eight robust standard deviations are omitted.

    Args:
        first: frame, (height, width), DN.
        second: another frame of the same exposure.

    Returns:
        Variance, DN^2.
    """
    difference = np.subtract(second, first, dtype=np.float32)  # codes of 16 bits are exact
    return clipped_variance(difference - difference.mean(dtype=np.float64)) / 2


def pair_variance_error(frames: int, pixels: int) -> float:
    """Compute the relative standard deviation, no unit, of the mean `pair_variance` of consecutive frames.

    Args:
        frames: number of frames, at least 2.
        pixels: number of pixels of a frame.

    Source:
        von Neumann (1941), "Distribution of the ratio of the mean square successive difference to the variance", Annals
        of Mathematical Statistics 12, 367.
    """
    return float(np.sqrt((3 * frames - 4) / (frames - 1) ** 2 / pixels))


def fixed_pattern_variance(measured: float, temporal: float, frames: int) -> float:
    """Compute the fixed pattern variance of the pixels from the mean of several frames (EMVA 1288, 8.2.2).

    Args:
        measured: variance of the mean of the frames over its pixels, DN^2.
        temporal: variance of one pixel from frame to frame, DN^2.
        frames: number of frames in the mean.

    Returns:
        Variance, DN^2. It may be negative by chance if the pixels do not differ.
    """
    return measured - temporal / frames


def fixed_pattern_variance_error(pattern: float, temporal: float, frames: int, pixels: int) -> float:
    """Compute the standard deviation of `fixed_pattern_variance` due to temporal noise, DN^2.

    Args:
        pattern: fixed pattern variance, DN^2.
        temporal: variance of one pixel from frame to frame, DN^2.
        frames: number of frames in the mean, at least 2.
        pixels: number of pixels of a frame.
    """
    chance = temporal / frames
    own = (4 * max(pattern, 0.0) * chance + 2 * chance**2) / pixels
    return float(np.sqrt(own + (chance * pair_variance_error(frames, pixels)) ** 2))


def line_of_least_relative_error(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Fit a line that minimises the sum of the squared relative departures (EMVA 1288, 8.2.7).

    Args:
        x: exposure, any unit, (n,).
        y: signal above dark, positive, any unit, (n,).

    Returns:
        Slope, in the unit of y per unit of x, and offset, in the unit of y.
    """
    slope, offset = np.polynomial.polynomial.polyfit(x, y, 1, w=1 / y)[::-1]
    return float(slope), float(offset)


def not_linear(departure: np.ndarray, std: np.ndarray, least: float) -> np.ndarray:
    """Find significant departures from a straight line that exceed a limit.

    Args:
        departure: departure of the signal divided by the value of the line, no unit.
        std: standard deviation of the departure, same shape.
        least: largest allowed magnitude of a departure, no unit.

    Returns:
        True where the departure exceeds `least` and five standard deviations, same shape.
    """
    return (np.abs(departure) > least) & (np.abs(departure) > _SIGNIFICANT * std)
