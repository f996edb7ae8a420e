"""A bent lobe in all slices, as smooth as it turned out to be.

How far a lobe bends is guessed from the family that failed, by a linear model: far from the lobe it asks for too much. A few
slices then show the lobe itself, and the evidence of the linear model there says how smooth it is where the camera shows it.
What no camera shows, below a pixel and beyond 45 degrees, stays as open as it was. All slices say what the lobe is then.
"""

from __future__ import annotations

import numpy as np

from matcam.inverse.correction.doubts import linear_evidence
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit

_LEAST = 0.03
"""Smallest bend that is tried, as a share of the largest."""
TRIED_BENDS = 16
"""Scales of a bend that are tried."""


def in_all_slices(few: MaterialFit, setup: FitSetup, slice_step: int) -> tuple[MaterialFit, FitSetup]:
    """Return a bent lobe in every `every`-th slice, and its setup. few: the solution of `setup`, in fewer of them."""
    whole = setup.with_(slice_step=slice_step, learned_bend=learned_bend(few, setup.bend))
    return whole.solve(start=few), whole


def learned_bend(found: MaterialFit, most: float) -> float:
    """Return the standard deviation of second differences, at most `most`, that a bent lobe asks for where it is shown."""
    linear = found.linearised()
    solution = linear.solution
    problem, p, model = solution.problem, solution.p, solution.model
    prior, layout = problem.prior, problem.layout
    white = problem.whitening(model, solution.weight, solution.noise.picture_gain)
    flat = white(model.derivative).reshape(p.size, -1)
    information = flat @ flat.T
    # at the solution the slope of the likelihood is that of the prior
    rows = prior.rows(layout)
    right = information @ p + rows.T @ (rows @ p)
    information[layout.rig, layout.rig] += linear.rig_information
    first = layout.lobe(0).start + len(layout.kind.family_names)
    bends = slice(first, first + layout.kind.bends)

    def probability(scale: float) -> float:
        smooth = prior._replace(learned=scale).rows(layout)[len(prior.root) :, bends]
        return linear_evidence(information, right, bends, smooth)

    return float(max(np.geomspace(_LEAST * most, most, TRIED_BENDS), key=probability))
