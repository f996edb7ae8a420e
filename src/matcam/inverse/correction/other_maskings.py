"""What other maskings would make of a correction: where the data do not tell them apart, the difference is uncertainty.

A lobe is seen through its masking, and which one a surface has nobody knows. After a fit the record is made again with each
other masking of the same lobe. The fit's linear problem says how lobe, rig and the units' parameters would give way to it, and
how probable the data would then be: no second search is needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import placed
from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.fit.lobe_slopes import lobe_record
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.material.masking import MASKINGS
from matcam.numerics.linalg import scaled_inverse


class OtherMasking(NamedTuple):
    """Hold the lobe and rig that another masking would have been fitted by.

    Attributes:
        coordinates: of lobe and rig, the other masking in their kind.
        weight: how often its difference counts as uncertainty: the root of its probability.
    """

    coordinates: FitCoordinates
    weight: float


def other_maskings(found: MaterialFit, kappa: float) -> tuple[OtherMasking, ...]:
    """Predict the fit of one lobe with free strengths under each other masking.

    kappa: share of a difference of log likelihoods that counts (`evidence`).
    """
    linear = found.linearised()
    solution, at = linear.solution, linear.coordinates
    problem, model = solution.problem, solution.model
    if at.kind.shadows or problem.layout.lobes > 1:
        return ()
    white = problem.whitening(model, solution.weight, np.inf)
    flat, rest = white(model.derivative).reshape(solution.p.size, -1), white(linear.residual).ravel()
    prior = problem.prior.rows(problem.layout)
    inverse = scaled_inverse(flat @ flat.T + prior.T @ prior)
    own = len(at.lobe) + len(at.rig)
    kinds = [at.kind._replace(masking=masking) for masking in MASKINGS if masking != at.kind.masking]
    moved, gains = [], [0.0]
    for kind in kinds:
        q = placed(np.concatenate([at.lobe, at.rig]))
        record = problem.read(model, lambda one, kind=kind, q=q: np.asarray(lobe_record(one, kind, q)))  # type: ignore[misc]
        added = white(np.nan_to_num(model.strength)[..., None] * (record - model.lobe)).ravel()
        change = -inverse @ (flat @ added)
        gains.append(float(added @ rest) - 0.5 * float(added @ (added + change @ flat)))
        moved.append(change[:own])
    tempered = kappa * (np.array(gains) - max(gains))
    share = np.exp(tempered) / np.exp(tempered).sum()
    size = len(at.lobe)
    return tuple(
        OtherMasking(at._replace(kind=kind, lobe=at.lobe + step[:size], rig=at.rig + step[size:]), float(np.sqrt(one)))
        for kind, step, one in zip(kinds, moved, share[1:], strict=True)
    )
