"""Fit of a spline-modified lobe in all slices, with the smoothness of the spline estimated from the data.

A linear model estimates the scale of the modification from the residuals of the family. Far from the solution this estimate is
too large. The lobe is therefore first fitted in few slices. The evidence of the linear model at this solution then determines
the scale at the angles that the camera resolves. At angles below one pixel and above 45 degrees the prior is not changed.
Finally the lobe is fitted in all slices.
"""

from __future__ import annotations

import numpy as np

from matcam.inverse.correction.lobe_shape import linear_evidence
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit

_LEAST = 0.03
"""Smallest scale whose evidence is computed, as a share of the largest scale."""
TRIED_SPLINES = 16
"""Number of scales whose evidence is computed, evenly spaced in the logarithm."""


def in_all_slices(few: MaterialFit, setup: FitSetup, slice_step: int) -> tuple[MaterialFit, FitSetup]:
    """Fit a spline-modified lobe in every `slice_step`-th slice.

    Args:
        few: fit with `setup`.
        setup: setup with fewer slices.
        slice_step: spacing of the slices of theta_d.

    Returns:
        Fit in every `slice_step`-th slice, and the setup of this fit.
    """
    whole = setup.with_(slice_step=slice_step, learned_spline=learned_spline(few, setup.spline))
    return whole.solve(start=few), whole


def learned_spline(found: MaterialFit, most: float) -> float:
    """Estimate the scale of a spline modification at the angles that the camera resolves.

    The scale is the prior standard deviation of the second differences of the coefficients.

    Args:
        found: fit of the spline-modified lobe.
        most: largest scale (no unit).
    """
    linear = found.linearised()
    solution = linear.solution
    problem, p, model = solution.problem, solution.p, solution.model
    prior, layout = problem.prior, problem.layout
    white = problem.whitening(model, solution.weight, solution.noise.picture_gain)
    flat = white(model.derivative).reshape(p.size, -1)
    information = flat @ flat.T
    # at the solution the gradient of the log likelihood equals that of the prior
    rows = prior.rows(layout)
    right = information @ p + rows.T @ (rows @ p)
    information[layout.rig, layout.rig] += linear.rig_information
    first = layout.lobe(0).start + len(layout.kind.family_names)
    own = slice(first, first + layout.kind.spline_size)

    def probability(scale: float) -> float:
        smooth = prior._replace(learned=scale).rows(layout)[len(prior.root) :, own]
        return linear_evidence(information, right, own, smooth)

    return float(max(np.geomspace(_LEAST * most, most, TRIED_SPLINES), key=probability))
