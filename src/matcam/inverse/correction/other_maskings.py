"""Fits with other maskings, for the uncertainty of a correction due to masking.

The masking of a surface is unknown. After a fit, the record of the lobe is computed with each other masking. The linear
problem of the fit predicts the changes of all parameters and the likelihood of the data for this masking, so no further fit is
required. The difference between maskings is included in the uncertainty if the data do not distinguish them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.fit.lobe_slopes import lobe_record
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.material.masking import MASKINGS
from matcam.numerics.linalg import scaled_inverse

MOST_LINEAR = 0.1
"""Largest exponent of the likelihood with which maskings are compared, because the change of a record is predicted linearly."""


class OtherMasking(NamedTuple):
    """Predicted fit of lobe and rig with another masking.

    Attributes:
        coordinates: predicted coordinates of lobe and rig with the other masking.
        weight: factor of the difference in the uncertainty: square root of the probability of the masking (no unit).
    """

    coordinates: FitCoordinates
    weight: float


def other_maskings(found: MaterialFit, kappa: float) -> tuple[OtherMasking, ...]:
    """Predict the fit with each other masking.

    The result is empty if the fit has a free masking, or several lobes.

    Args:
        found: fit with free strengths.
        kappa: exponent of the likelihood (`evidence`).
    """
    linear = found.linearised()
    solution, at = linear.solution, linear.coordinates
    problem, model = solution.problem, solution.model
    if at.kind.shadows or problem.layout.lobes > 1:
        return ()
    white = problem.whitening(model, solution.weight, np.inf)
    flat, residual = white(model.derivative).reshape(solution.p.size, -1), white(linear.residual).ravel()
    prior = problem.prior.rows(problem.layout)
    inverse = scaled_inverse(flat @ flat.T + prior.T @ prior)
    own = len(at.lobe) + len(at.rig)
    kinds = [at.kind._replace(masking=masking) for masking in MASKINGS if masking != at.kind.masking]
    moved, gains = [], [0.0]
    for kind in kinds:
        q = np.concatenate([at.lobe, at.rig])
        record = problem.read(model, lambda one, kind=kind, q=q: lobe_record(one, kind, q))  # type: ignore[misc]
        added = white(np.nan_to_num(model.strength)[..., None] * (record - model.lobe)).ravel()
        change = -inverse @ (flat @ added)
        gains.append(float(added @ residual) - 0.5 * float(added @ (added + change @ flat)))
        moved.append(change[:own])
    tempered = kappa * (np.array(gains) - max(gains))
    share = np.exp(tempered) / np.exp(tempered).sum()
    size = len(at.lobe)
    return tuple(
        OtherMasking(at._replace(kind=kind, lobe=at.lobe + step[:size], rig=at.rig + step[size:]), float(np.sqrt(one)))
        for kind, step, one in zip(kinds, moved, share[1:], strict=True)
    )
