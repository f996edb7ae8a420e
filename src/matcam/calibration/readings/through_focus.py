"""Best focus of a series of photographs of one edge at several focus positions.

Defocus adds a blur whose standard deviation is proportional to the distance z - z0 of the focus position z from the
best focus z0. Variances of blurs add, and MTF50 is inversely proportional to the width of a blur. Therefore MTF50^-2 is
a parabola in z. The parabola is fitted by weighted least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError

FEWEST_POSITIONS = 4
"""Smallest number of positions. It exceeds the number of parameters of a parabola by one, to estimate the scatter."""


class BestFocus(NamedTuple):
    """Best focus of a series.

    Attributes:
        position: focus position, in the unit of the positions of the series.
        position_std: standard deviation of `position`, in the same unit.
        mtf50: MTF50 at this position, cycles/px.
        mtf50_std: standard deviation of `mtf50`, cycles/px.
        curvature: increase of MTF50^-2 per squared distance from the best focus, (px/cycle)^2 per squared unit of position.

    Example:
        >>> matcam.calibration.BestFocus(0.1, 0.01, 0.4, 0.002, 60.0).position
        0.1
    """

    position: float
    position_std: float
    mtf50: float
    mtf50_std: float
    curvature: float

    def mtf50_at(self, position: ArrayLike) -> np.ndarray:
        """Evaluate MTF50 of the fitted parabola.

        Args:
            position: focus positions, any shape.

        Returns:
            MTF50, cycles/px, with the shape of `position`.

        Example:
            >>> focus = matcam.calibration.BestFocus(0.0, 0.01, 0.5, 0.002, 4.0)
            >>> float(focus.mtf50_at(1.0).round(3))
            0.354
        """
        z = np.asarray(checks.number("position", position)) - self.position
        return np.asarray((self.mtf50**-2 + self.curvature * z**2) ** -0.5)


def best_focus(position: ArrayLike, mtf50: ArrayLike, mtf50_std: ArrayLike) -> BestFocus:
    """Find the best focus of a series.

    Positions where MTF50 is less than half its largest value are not used. If chi-square per degree of freedom exceeds
    1, the standard deviations of the result are multiplied by the square root of this ratio.

    Args:
        position: focus positions, (n,), any unit.
        mtf50: MTF50 at these positions, (n,), cycles/px.
        mtf50_std: standard deviations of `mtf50`, (n,), cycles/px.

    Returns:
        The position of the best focus and its MTF50, with standard deviations.

    Raises:
        ArgumentError: the arguments differ in length, or an element of `mtf50` or `mtf50_std` is not positive.
        FitError: fewer than four different positions are near the focus, or MTF50 has no maximum between the positions.

    Example:
        >>> z = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
        >>> focus = matcam.calibration.best_focus(z, (4 + 9 * (z - 0.2) ** 2) ** -0.5, np.full(5, 0.002))
        >>> round(focus.position, 6), round(focus.mtf50, 6)
        (0.2, 0.5)
    """
    z, m, std = (np.asarray(checks.number(*pair), dtype=float) for pair in
                 (("position", position), ("mtf50", mtf50), ("mtf50_std", mtf50_std)))  # fmt: skip
    if z.ndim != 1 or not z.shape == m.shape == std.shape:
        raise ArgumentError(
            f"position, mtf50 and mtf50_std must be lists of equal length, got shapes {z.shape}, {m.shape} and {std.shape}"
        )
    for name, values in (("mtf50", m), ("mtf50_std", std)):
        checks.positive(name, values, "cycles/px")
    # A Gaussian does not approximate a defocus that halves MTF50.
    near = m >= 0.5 * np.max(m, initial=0.0)
    if np.unique(z[near]).size < FEWEST_POSITIONS:
        raise FitError(
            f"the best focus requires at least {FEWEST_POSITIONS} different positions where MTF50 is at least half its largest "
            f"value, but the number of such positions is {np.unique(z[near]).size}: add positions near the best focus"
        )
    low, high = float(z[near].min()), float(z[near].max())
    middle, half = (low + high) / 2, (high - low) / 2
    u, square, root = (z[near] - middle) / half, m[near] ** -2, m[near] ** 3 / (2 * std[near])
    # The weight `root` is the inverse standard deviation of MTF50^-2.
    value, covariance = np.polyfit(u, square, 2, w=root, cov="unscaled")
    chi2 = float(((root * (square - np.polyval(value, u))) ** 2).sum())
    covariance *= max(1.0, chi2 / (u.size - 3))
    bend, slope, level = value
    at = -slope / (2 * bend)
    lowest = level + slope * at + bend * at**2
    # A curvature below 3 standard deviations does not determine a best focus.
    if bend < 3.0 * np.sqrt(covariance[0, 0]) or abs(at) > 1 or lowest <= 0:
        raise FitError(
            f"no maximum of MTF50 lies between the positions {low:g} and {high:g}: add positions on both sides of the focus"
        )
    by_position = np.array([slope / (2 * bend**2), -1 / (2 * bend), 0.0])
    by_level = np.array([at**2, at, 1.0])
    best = float(lowest**-0.5)
    return BestFocus(
        position=float(middle + half * at),
        position_std=float(half * np.sqrt(by_position @ covariance @ by_position)),
        mtf50=best,
        mtf50_std=float(best**3 / 2 * np.sqrt(by_level @ covariance @ by_level)),
        curvature=float(bend / half**2),
    )
