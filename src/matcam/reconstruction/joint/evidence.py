"""Evidence of explanations of the same pixels: their marginal likelihoods on a common scale.

The variance of pixel i is n_i^2 + (s m_i)^2. Here n_i is its noise, m_i its modelled value, and s the share of the light that
the explanation does not explain. Such misfit is correlated over c pixels (`Likelihood`), so that c pixels of pure misfit count
as one. The exponent of the likelihood of a pixel is therefore

    kappa_i = (n_i^2 + s^2 m_i^2) / (n_i^2 + c s^2 m_i^2) .

It is computed for one explanation and used for all. Laplace's approximation of the evidence E is

    ln E = sum_i kappa_i ln L_i + ln p(s) + ln p(theta) + 1/2 ln |Q| - 1/2 ln |H + Q| ,

where p is a prior density. H is the information matrix of the data for the parameters theta, and Q is that of the prior (MacKay
2003, chapter 28). Parameters that all explanations have in common have the same prior if it is not specified, so that its
width cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.inverse.correction.evidence import MISFIT_SCALE, lobe_priors
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.numerics.linalg import log_volume_ratio
from matcam.reconstruction.joint.field_change import FieldChange
from matcam.reconstruction.joint.joint_fit import JointSolution, assembled
from matcam.reconstruction.joint.joint_problem import JointProblem
from matcam.reconstruction.joint.likelihood import Likelihood, unexplained_share
from matcam.reconstruction.observed_pixels import ObservedPixels

ACCURACY = 3e-3
"""Smallest unexplained share of the light that is distinguished from none: the accuracy of a modelled pixel."""


class ComparedPixels(NamedTuple):
    """Pixels for which explanations are compared.

    Attributes:
        pixels: pixels of each image.
        changes: effect of a change of the lens field on each image.
        unstated: effect of an unspecified distortion on each image.
        exponents: exponents of the likelihoods of the pixels of each image.
        strength: largest strength of lobe and diffuse part, which is the unit of their priors.
    """

    pixels: Sequence[ObservedPixels]
    changes: Sequence[FieldChange]
    unstated: Sequence[FieldChange]
    exponents: Sequence[np.ndarray]
    strength: float

    @classmethod
    def of(cls, solution: JointSolution) -> ComparedPixels:
        """Take the pixels of a fit, and the correlation of its residuals."""
        problem, p, judge = solution.problem, solution.p, solution.likelihood
        exponents = []
        for k, pixels in enumerate(problem.pixels):
            level = problem.picture(p, k, slopes=False).value
            exponents.append((judge._replace(correlated=1.0).std(pixels, level) / judge.std(pixels, level)) ** 2)
        layout = problem.layout
        strengths = np.concatenate([p[layout.diffuse], *(p[layout.strengths(k)] for k in range(layout.pictures))])
        return cls(problem.pixels, problem.changes, problem.unstated, exponents, float(np.abs(strengths).max()))

    def judged(self, problem: JointProblem, kind: LobeKind, p: np.ndarray) -> Judged:
        """Compute the terms of the evidence of parameters p that do not depend on the specified values.

        Args:
            problem: problem of an explanation; its pixels are replaced.
            kind: lobe of the explanation.
            p: parameters, (size,).
        """
        layout = problem.layout
        problem = replace(problem, pixels=self.pixels, changes=self.changes, unstated=self.unstated)
        share = max(unexplained_share(problem, p), ACCURACY)
        judge, none = Likelihood(share), np.zeros((0, layout.size))
        at = assembled(replace(problem, prior_rows=none, prior_values=np.zeros(0)), judge, p, self.exponents)
        log_likelihood = sum(map(judge.log_density, self.pixels, at.levels, self.exponents)) - share / MISFIT_SCALE
        mean, std = np.zeros(layout.size), np.full(layout.size, np.inf)
        mean[: layout.lobe], std[: layout.lobe] = lobe_priors(kind)
        for part in (layout.diffuse, *(layout.strengths(k) for k in range(layout.pictures))):
            # prior standard deviation of strengths and diffuse parts, relative to the largest one
            std[part] = 3.0 * self.strength
        return Judged(problem, p, share, log_likelihood, at.gradient, at.normal, mean, std)


class Judged(NamedTuple):
    """Terms of the evidence of an explanation that do not depend on the specified values.

    Attributes:
        problem: problem of the explanation, with the compared pixels.
        p: parameters, (size,).
        share: unexplained share of the light, at least `ACCURACY`, no unit.
        log_likelihood: logarithm of the likelihood, and of the prior density of the unexplained share.
        gradient: gradient of minus the logarithm of the likelihood, (size,).
        information: information matrix of the data, (size, size).
        mean: means of the unspecified priors, (size,).
        std: standard deviations of the unspecified priors, (size,); infinite for a parameter with a specified prior.
    """

    problem: JointProblem
    p: np.ndarray
    share: float
    log_likelihood: float
    gradient: np.ndarray
    information: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    def log_evidence(self) -> float:
        return self._evidence(self.problem.prior_rows, self.problem.prior_values, improved=False)

    def log_evidence_with(self, rows: np.ndarray, values: np.ndarray) -> float:
        """Predict the evidence with other specified values, after a step of the parameters to their most probable values.

        The prediction is of first order. `rows` and `values` are those of `prior_of`.
        """
        return self._evidence(rows, values, improved=True)

    def _evidence(self, rows: np.ndarray, values: np.ndarray, *, improved: bool) -> float:
        free = np.flatnonzero(~self.problem.fixed)
        rows = np.concatenate([rows, np.diag(1 / self.std)])
        away = rows @ self.p - np.concatenate([values, self.mean / self.std])
        prior, information = (rows.T @ rows)[np.ix_(free, free)], self.information[np.ix_(free, free)]
        found = self.log_likelihood - 0.5 * float(away @ away) + log_volume_ratio(prior, information)
        if improved:
            posterior, slope = prior + information, (self.gradient + rows.T @ away)[free]
            scale = 1 / np.sqrt(np.diagonal(posterior))
            step = np.linalg.solve(posterior * np.outer(scale, scale), slope * scale)
            found += 0.5 * float(step @ (slope * scale))
        return found
