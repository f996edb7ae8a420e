"""Sources of the uncertainty budget of a fit: prior knowledge, and the readings of the pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from matcam.inverse.fit.search import Solution
from matcam.inverse.rig.rig_axes import Axis
from matcam.numerics.fit_budget import Readings, StatedParameter, Statement, stated_parameters

RIG = "camera and rig, as specified"
"""Name of the common source of uncertainty for specified parameters of the rig that are correlated."""
SMOOTH_LOBE = "smoothness of the lobe"
"""Name of the source of uncertainty for the prior on the spline modification of a lobe."""
_LEAST = 1e-3
"""Smallest information on a coordinate that is treated as a prior. It corresponds to a standard deviation of 30 in the
logarithm of a width, which does not constrain the width.
"""


def rig_statements(axes: Sequence[Axis], information: np.ndarray, first: int, size: int) -> list[Statement]:
    """Collect the prior knowledge of the parameters of a rig.

    Args:
        axes: fitted parameters of the rig.
        information: prior information matrix of the coordinates of these parameters, (axes, axes).
        first: index of the first axis among the coordinates of the fit.
        size: number of coordinates of the fit.
    """
    whole = np.zeros((size, size))
    own = slice(first, first + len(axes))
    whole[own, own] = information
    stated = [
        StatedParameter(position, axis.name, axis.value(0.0), _slope(axis, float(whole[position, position])))
        for position, axis in enumerate(axes, first)
    ]
    return stated_parameters(RIG, whole, stated, least=_LEAST)


def _slope(axis: Axis, information: float) -> float:
    """Compute the derivative of the value of a parameter with respect to its coordinate.

    It is the slope of a secant, so that the standard uncertainty of the value is the specified uncertainty. The secant of a
    width extends from the specified value to one standard deviation above it (`Axis.std`). For other parameters it extends
    from one standard deviation below the value to one above it.

    information: prior information on the coordinate.
    """
    std = 1 / math.sqrt(max(information, _LEAST))
    if axis.softening:
        return axis.slope(0.0, std)
    low, high = max(-std, axis.low), min(std, axis.high)
    return (axis.value(high) - axis.value(low)) / (high - low)


def fit_statements(solution: Solution) -> list[Statement]:
    problem, layout = solution.problem, solution.problem.layout
    prior = problem.prior
    found = rig_statements(prior.axes, prior.rig_information(), layout.rig.start, layout.size)
    smooth = prior.rows(layout)[len(prior.root) :]
    if smooth.any():
        found.append(Statement(SMOOTH_LOBE, smooth.T @ smooth))
    return found


def fit_readings_source(freedom: int, *, noise_given: bool) -> Readings:
    """Build the source of uncertainty for the readings of the pixels.

    Args:
        freedom: degrees of freedom of the fit.
        noise_given: True if the noise of a pixel is specified; False if it is estimated from the residuals.
    """
    if noise_given:
        return Readings("readings of the pixels (noise as given)", "B")
    return Readings("readings of the pixels (noise from the residuals)", "A", max(float(freedom), 1.0))
