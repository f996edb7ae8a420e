"""Spline-modified lobe in all slices, with its smoothness estimated from the data.

A linear model predicts the scale of the modification from the residuals of the family, and overestimates it far from
the solution. A fit in few slices gives the lobe, and the evidence of the linear model there gives the smoothness at the
angles that the camera resolves. Below a pixel and beyond 45 degrees the prior stays as wide as it was. The lobe is then
fitted in all slices.
"""

from __future__ import annotations

import numpy as np

from matcam.inverse.correction.lobe_shape import linear_evidence
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit

_LEAST = 0.03
"""Smallest scale that is tried, as a share of the largest."""
TRIED_SPLINES = 16
"""Number of scales that are tried."""


def in_all_slices(few: MaterialFit, setup: FitSetup, slice_step: int) -> tuple[MaterialFit, FitSetup]:
    """Fit a spline-modified lobe in every `slice_step`-th slice, and return it with its setup. few: the solution of
    `setup`, in fewer of them.
    """
    whole = setup.with_(slice_step=slice_step, learned_spline=learned_spline(few, setup.spline))
    return whole.solve(start=few), whole


def learned_spline(found: MaterialFit, most: float) -> float:
    """Estimate the standard deviation of the second differences, at most `most`, at the angles that the camera resolves."""
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
