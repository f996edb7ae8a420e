"""Sources of the uncertainty budget of a fit: prior knowledge and readings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from matcam.inverse.fit.search import Solution
from matcam.inverse.operator.rig_axes import Axis
from matcam.numerics.fit_budget import Readings, StatedParameter, Statement, stated_parameters

RIG = "camera and rig, as specified"
"""Name of the source of the specified parameters of the rig if they are correlated."""
SMOOTH_LOBE = "smoothness of the lobe"
"""Name of the source of the prior on the spline modification of a lobe."""
_LEAST = 1e-3
"""Information on a coordinate below which there is no prior: a standard deviation of 30, in logarithms of widths."""


def rig_statements(axes: Sequence[Axis], information: np.ndarray, first: int, size: int) -> list[Statement]:
    """Collect the prior knowledge of the parameters of a rig.

    Args:
        axes: fitted parameters.
        information: specified information matrix of their coordinates, (axes, axes).
        first: index of the first axis among the coordinates of the fit.
        size: number of these coordinates.
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
    """Compute d value / d coordinate, as a secant from one standard deviation below the base to one above."""
    std = 1 / math.sqrt(max(information, _LEAST))
    low, high = max(-std, axis.low), min(std, axis.high)
    return (axis.value(high) - axis.value(low)) / (high - low)


def fit_statements(solution: Solution) -> list[Statement]:
    """Collect the prior knowledge of a fit: the rig as specified, and the smoothness of the lobe."""
    problem, layout = solution.problem, solution.problem.layout
    prior = problem.prior
    found = rig_statements(prior.axes, prior.rig_information(), layout.rig.start, layout.size)
    smooth = prior.rows(layout)[len(prior.root) :]
    if smooth.any():
        found.append(Statement(SMOOTH_LOBE, smooth.T @ smooth))
    return found


def fit_readings_source(freedom: int, *, noise_given: bool) -> Readings:
    """Return the readings of a fit as a source of uncertainty.

    Args:
        freedom: degrees of freedom of the fit.
        noise_given: whether the noise of a pixel is given, or estimated from the residuals.
    """
    if noise_given:
        return Readings("readings of the pixels (noise as given)", "B")
    return Readings("readings of the pixels (noise from the residuals)", "A", max(float(freedom), 1.0))
