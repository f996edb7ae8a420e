"""Search for the best fit: a lattice of starts, then least squares with weights from the model (docs/model.md 8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.optimize import least_squares

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.core.registry import WITH_POWER
from matcam.core.workspace import Workspace
from matcam.inverse.fit.fit_data import (
    INITIAL_NOISE,
    cell_variance,
    estimate_noise,
    huber_weights,
    standardised_residual,
)
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES, fresnel_start
from matcam.inverse.fit.fit_problem import FitModel, FitProblem
from matcam.inverse.fit.start_records import StartRecords
from matcam.numerics.linalg import scaled_inverse

_WIDTHS = np.log(np.geomspace(1.5e-4, 0.7, 18))
_POWERS = {"epd": np.log([0.5, 1.0, 1.8]), "sgd": np.log([0.3, 0.8, 1.5])}
_EXCESSES = np.log([0.7, 2.0, 6.0])
_WIDER, _SHARES, _TAILS = np.log([3.0, 12.0, 45.0]), (-0.8, 0.8), ((0.1, 0.1), (0.9, 0.1), (0.1, 0.9))
_FOLLOWED, _NO_RIVAL = 2, 1.5
"""Number of starts that are refined, and ratio to the best misfit above which a start is dropped."""
_ROUNDS = 6
_STEPS = 12, 3
"""Largest numbers of least-squares steps, with the first weights and with later ones, which change the fit less."""
_LONGEST, _STEADY = 0.8, 0.3
"""Limits for extrapolation of a round: share of the last step that remains, and change of its direction."""
_SETTLED = 0.02
"""Change of the parameters, in standard deviations, below which the weights have converged."""
_BASE_WIDTH, _BASE = np.log(0.15), 0.1
"""Start of a base: the geometric mean of the roughnesses of flakes and satin paint, 0.05 to 0.5, and a dark paint. A base
without reflectance would have no gradient with respect to its roughness.
"""
_STEEP = np.radians(80.0)
"""theta_d above which strengths hardly constrain the start of a Fresnel term."""


def _lattice(family: str) -> np.ndarray:
    """Return the coordinates of the starts, neighbours beside each other, (..., coordinates)."""
    if family == TWO_LOBES:
        lobes: list = [
            [[[(q, q + wider, share, *tails) for tails in _TAILS] for share in _SHARES] for wider in _WIDER]
            for q in _WIDTHS[:-2:2]
        ]
    elif family == STUDENT or family in WITH_POWER:
        second = _EXCESSES if family == STUDENT else _POWERS[family]
        lobes = [[(q, power) for q in _WIDTHS[::2]] for power in second]
    else:
        lobes = [(q,) for q in _WIDTHS]
    return np.array(lobes)


def _covariance(information: np.ndarray, prior_rows: np.ndarray) -> np.ndarray:
    """Compute the posterior covariance of parameters from the information of the data and the rows of the prior."""
    return scaled_inverse(information + prior_rows.T @ prior_rows, undetermined=1e12)


class Solution(NamedTuple):
    """Best parameters of a problem, and the model at them.

    Attributes:
        problem: problem that was solved.
        p: coordinates of the fit, (parameters,).
        model: model at these coordinates.
        covariance: covariance of the coordinates, (parameters, parameters).
        noise: noise of a pixel, given or estimated.
        misfit: weighted sum of squares over the degrees of freedom.
        freedom: degrees of freedom.
        weight: (u, s, n), robust weights 1 / V.
    """

    problem: FitProblem
    p: np.ndarray
    model: FitModel
    covariance: np.ndarray
    noise: PixelNoise
    misfit: float
    freedom: int
    weight: np.ndarray

    def tempered(self, kappa: float) -> Solution:
        """Return the solution with the covariance of the likelihood to the power of kappa (`correction/evidence.py`)."""
        white = self.problem.whitening(self.model, self.weight, self.noise.picture_gain)
        flat = white(self.model.derivative).reshape(self.p.size, -1)
        rows = self.problem.prior.rows(self.problem.layout)
        return self._replace(covariance=_covariance(kappa * flat @ flat.T, rows))


class Search:
    """Search for the best fit of a problem.

    noise: noise of a pixel; None: it is estimated from the residuals. workspace: store of the records of the starts.
    """

    def __init__(self, problem: FitProblem, noise: PixelNoise | None, workspace: Workspace):
        self.problem, self.given_noise = problem, noise
        self.starts = StartRecords(problem.operator, workspace)
        self.prior_rows = problem.prior.rows(problem.layout)
        self.low, self.high = problem.bounds()

    def best(self, rounds: int = _ROUNDS) -> Solution:
        """Try a lattice of starts, and refine the best ones.

        rounds: largest number of rounds of weights; fewer suffice for the start of another fit.
        """
        data = self.problem.data
        noise = self.given_noise or INITIAL_NOISE
        # first, weights from the variance of each value; then from the model
        weight = 1 / cell_variance(data, np.abs(data.values), INITIAL_NOISE._replace(picture_gain=noise.picture_gain))
        tried = [self._least_squares(start, weight, noise, steps=_STEPS[0]) for start in self._starts(weight)]
        p, _ = min(tried, key=lambda pair: pair[1])
        _, weight, noise = self._weighed(p, weight, noise)
        return self._refine(p, weight, noise, rounds)

    def resume(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Continue from the parameters of a fit of another model. weight: robust weights; None: from the variance of
        each value.
        """
        return self._refine(self._inside(start), self._weight(weight, noise), self.given_noise or noise, rounds=_ROUNDS)

    def widen(self, few: Solution) -> Solution:
        """Continue from the best fit of the same model to some of the slices, which also gives the weights of the new
        values.
        """
        start, noise = self._inside(few.p), self.given_noise or few.noise
        model = self.problem.model(start, self._weight(None, noise))
        return self._refine(start, self._robust_weight(model, noise), noise, rounds=_ROUNDS)

    def adjust(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Continue from a fit of the same model to fewer slices: within its errors, a few linear steps suffice."""
        return self._refine(start, self._weight(weight, noise), self.given_noise or noise, rounds=2, steps=(2, 2))

    def _weight(self, weight: np.ndarray | None, noise: PixelNoise) -> np.ndarray:
        data = self.problem.data
        return 1 / cell_variance(data, np.abs(data.values), noise) if weight is None else weight

    def _weighed(self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise) -> tuple[FitModel, np.ndarray, PixelNoise]:
        """Evaluate the model at parameters, and the resulting weights and noise. weight: for free strengths."""
        model = self.problem.model(p, weight)
        if self.given_noise is None:
            noise = estimate_noise(self.problem.data, self.problem.residual(model), model.value, p.size, noise)
        weight = self._robust_weight(model, noise)
        return self.problem.model(p, weight), weight, noise

    def _robust_weight(self, model: FitModel, noise: PixelNoise) -> np.ndarray:
        data, residual = self.problem.data, self.problem.residual(model)
        u = standardised_residual(data, residual, model.value, noise, self.problem.gain(noise))
        return huber_weights(u) / cell_variance(data, model.value, noise)

    def _inside(self, p: np.ndarray) -> np.ndarray:
        return np.clip(p, self.low + 1e-9, self.high - 1e-9)

    def _starts(self, weight: np.ndarray) -> list[np.ndarray]:
        """Return the lobes of a lattice that fit better than their neighbours, the two best first."""
        layout, problem = self.problem.layout, self.problem
        kind = layout.kind._replace(spline_size=0, shadows=0)
        free = problem.with_layout(layout._replace(kind=kind, fresnel="free", diffuse=False, base=False))
        lattice = _lattice(kind.family)
        count = lattice.shape[-1]
        lobes = np.clip(lattice.reshape(-1, count), self.low[:count], self.high[:count])
        models = [free.start_model(record, weight) for record in self.starts.of(kind, lobes)]
        misfit = np.zeros(len(models))
        for index, model in enumerate(models):
            u = free.whitening(model, weight, 0.0)(problem.data.values - model.value)
            misfit[index] = (huber_weights(u) * u**2).sum()
        grid = misfit.reshape(lattice.shape[:-1])
        valleys = np.flatnonzero(grid == minimum_filter(grid, 3, mode="nearest"))
        best = valleys[np.argsort(misfit[valleys])][:_FOLLOWED]
        best = best[misfit[best] <= _NO_RIVAL * misfit[best[0]]]
        return [self._vector(lobes[index], models[best[0]]) for index in best]

    def _vector(self, lobe: np.ndarray, free: FitModel) -> np.ndarray:
        """Build a complete start from a lobe; Fresnel terms come from the free strengths of a model."""
        layout, theta_d = self.problem.layout, self.problem.theta_d
        p = np.zeros(layout.size)
        for index in range(layout.lobes):
            p[layout.lobe(index)][: lobe.size] = lobe
        p[layout.base_width] = _BASE_WIDTH
        p[layout.of_units("base")] = _BASE
        if layout.fresnel != "free":
            for u, strength in enumerate(free.strength):
                weight = np.where(
                    np.isfinite(free.strength_std[u]) & (strength > 0), 1 / np.maximum(strength, 1e-6) ** 2, 0
                )
                weight *= theta_d < _STEEP
                start = fresnel_start(layout.fresnel, theta_d, strength, weight)
                p[layout.unit(u)][: start.size] = start
        return self._inside(p)

    def _refine(
        self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, rounds: int, steps: tuple[int, int] = _STEPS
    ) -> Solution:
        """Alternate least squares with fixed weights and updates of the weights until convergence.

        Convergence is linear, so after two rounds with the same ratio the next one starts from the extrapolated limit.

        steps: largest number of least-squares steps, in the first round and in others.
        """
        problem, data = self.problem, self.problem.data
        last = np.zeros_like(p)
        for turn in range(rounds):
            before = p
            p, _ = self._least_squares(p, weight, noise, steps=steps[turn > 0])
            model, weight, noise = self._weighed(p, weight, noise)
            white = problem.whitening(model, weight, noise.picture_gain)
            flat = white(model.derivative).reshape(p.size, -1)
            covariance = _covariance(flat @ flat.T, self.prior_rows)
            std = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
            change = (p - before) / std
            if np.all(np.abs(change) < _SETTLED):
                break
            share = float(change @ last / max(last @ last, 1e-30))
            steady = 0 < share < _LONGEST and np.linalg.norm(change - share * last) < _STEADY * np.linalg.norm(change)
            last = change
            if steady and turn + 1 < rounds:
                p = self._inside(p + share / (1 - share) * (p - before))
                _, weight, noise = self._weighed(p, weight, noise)
                last = np.zeros_like(p)
        if not np.all(np.isfinite(p)):
            raise FitError(
                "the fit produced non-finite parameters: check that the table is linear and that the family suits its lobe"
            )
        u = white(problem.residual(model))
        strengths = data.used.any(-1).sum() if problem.layout.fresnel == "free" else 0
        freedom = int(data.used.sum() - p.size - strengths)
        misfit = float((u**2).sum() / max(freedom, 1))
        return Solution(problem, p, model, covariance, noise, misfit, freedom, weight)

    def _least_squares(
        self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, steps: int
    ) -> tuple[np.ndarray, float]:
        """Minimise the sum of squares; return the parameters and half of the sum."""
        problem, prior = self.problem, self.prior_rows
        start = problem.model(p, weight)
        fixed = None if problem.layout.fresnel == "free" else problem.whitening(start, weight, noise.picture_gain)
        last: dict[bytes, np.ndarray] = {}

        def triangle(p: np.ndarray) -> np.ndarray:
            """Compute R of the QR decomposition of derivatives and residuals: the same normal equations in few rows."""
            key = p.tobytes()
            if key not in last:
                model = problem.model(p, weight)
                white = fixed or problem.whitening(model, weight, np.inf)
                u = white(problem.data.values - model.value).reshape(1, -1)
                columns = np.concatenate([-white(model.derivative).reshape(p.size, -1), u])
                rows = np.concatenate([columns.T, np.column_stack([prior, prior @ p])])
                last.clear()
                last[key] = np.asarray(np.linalg.qr(rows, mode="r"))
            return last[key]

        found = least_squares(
            lambda p: triangle(p)[:, -1], self._inside(p), lambda p: triangle(p)[:, :-1], bounds=(self.low, self.high),
            x_scale="jac", ftol=1e-7, xtol=1e-6, max_nfev=steps,
        )  # fmt: skip
        return found.x, float(found.cost)
