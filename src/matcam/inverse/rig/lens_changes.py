"""Changes of the kernel of a lens along coordinates that a fit may change, as sums of Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

WIDTH = "lens_width"
"""Name of the logarithm of the width of a lens without a width parameter, relative to the lens of the rig, no unit."""
SHAPE = "lens_shape"
"""Name of the change of the fourth moment of the kernel of the lens at constant variance, no unit. It is 0 for the lens of
the rig, -1 for a kernel that is as flat as a disc, and positive for longer tails.
"""
SIXTH, EIGHTH = "lens_sixth_moment", "lens_eighth_moment"
"""Names of the changes of the next even moments of the kernel of the lens at constant lower moments, no unit. With `SHAPE`
they describe a disc to 2 % of its difference from the Gaussian of the same variance. This also holds at the limb, where a
highlight is narrower than the lens.
"""
STRETCH = "lens_stretch"
"""Name of the stretch: variance of the kernel of the lens along the plane of camera and lamp minus that across it, divided
by the variance.
"""
ASSUMED = 0.1
"""Relative standard deviation that is assumed for the width of a lens if its profile has no uncertainty."""

_STEP = 0.4
"""Relative step in variance between the Gaussians of a finite difference. A smaller step would amplify the errors of their
quadrature rules.
"""
VARIANCES = tuple(1 + step * _STEP for step in range(-2, 3))
"""Variances of the isotropic Gaussians of the changes of a lens, relative to that of the lens."""


class KernelChange(NamedTuple):
    """Change of the kernel of a lens along a coordinate.

    The change is the polynomial through the changes at given points and 0 at coordinate 0. The change at a point is a sum of
    Gaussians. The variances of the Gaussians are relative to the variance of the Gaussian that is as wide as the lens.

    Attributes:
        points: Gaussians at each given point, by the coordinate of the point. A Gaussian is (variance along the plane of camera
            and lamp, variance across it, share), no unit. The shares add up to 0.
        std: prior standard deviation of the coordinate.
        low: smallest coordinate.
        high: largest coordinate.
        power: power of the variance of the kernel to which the changed moment is proportional; 0: no moment is changed.
    """

    points: Mapping[float, tuple[tuple[float, float, float], ...]]
    std: float
    low: float
    high: float
    power: int


def _difference(factor: float, *shares: int) -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build a finite difference with respect to the variance, from isotropic Gaussians at -2 to 2 steps.

    shares: shares of the five Gaussians, which are multiplied by `factor`.
    """
    return {1.0: tuple((scale, scale, factor * share) for scale, share in zip(VARIANCES, shares, strict=True) if share)}


def _widened() -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build differences between wider or narrower Gaussians, those of `VARIANCES`, and the kernel of the lens.

    The points are the logarithms of the ratios of the widths.
    """
    others = (scale for scale in VARIANCES if scale != 1)
    return {0.5 * float(np.log(scale)): ((scale, scale, 1.0), (1.0, 1.0, -1.0)) for scale in others}


def _stretched(*points: float) -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build differences between elliptical Gaussians and the kernel of the lens.

    points: stretches, the differences of the two relative variances of each Gaussian.
    """
    return {point: ((1 + point / 2, 1 - point / 2, 1.0), (1.0, 1.0, -1.0)) for point in points}


CHANGES = {
    WIDTH: KernelChange(_widened(), ASSUMED, -0.5, 0.5, 0),
    # a disc has the moments of a mixture of Gaussians whose relative variance has the second and third central moments
    # -1/3 and 1/3
    SHAPE: KernelChange(_difference(1 / (18 * _STEP**2), 1, -1, 0, -1, 1), 1.0, -1.5, 4.0, 2),
    SIXTH: KernelChange(_difference(1 / (36 * _STEP**3), -1, 2, 0, -2, 1), 1.0, -3.0, 3.0, 3),
    EIGHTH: KernelChange(_difference(1 / (72 * _STEP**4), 1, -4, 6, -4, 1), 1.0, -3.0, 3.0, 4),
    STRETCH: KernelChange(_stretched(-1.0, 1.0), 0.5, -1.5, 1.5, 1),  # third-order coma has 1
}
"""Changes of the kernel of the lens by name. A disc has shape -1 and sixth moment 1, and its eighth moment is below 1."""
