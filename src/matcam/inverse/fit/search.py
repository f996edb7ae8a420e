"""Search for the best fit: a lattice of starting points, then least squares with weights from the model (docs/model.md 8)."""

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
"""Largest number of starting points that are refined, and largest ratio of their misfit to the smallest misfit of all."""
_ROUNDS = 6
_STEPS = 12, 3
"""Largest number of least-squares steps with the first weights, and with updated weights, which change the fit less."""
_LONGEST, _STEADY = 0.8, 0.3
"""Limits for the extrapolation of rounds: largest ratio of a change of the parameters to the change in the round before, and
largest deviation from the direction of that change, as a share of the change.
"""
_SETTLED = 0.02
"""Change of the parameters in a round, in standard deviations, below which the weights have converged."""
_BASE_WIDTH, _BASE = np.log(0.15), 0.1
"""Logarithm of the roughness, and reflectance, of a base at the start of a search. The roughness is the geometric mean of the
range from 0.05 to 0.5 of flakes and satin paint. The reflectance is that of a dark paint; with a reflectance of 0 the gradient
with respect to the roughness would be 0.
"""
_STEEP = np.radians(80.0)
"""Value of theta_d, rad, above which strengths hardly constrain a Fresnel term, and are not used for its starting point."""


def _lattice(family: str) -> np.ndarray:
    """Build the lattice of starting points of a family, (..., coordinates). The leading axes are the axes of the lattice."""
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
    return scaled_inverse(information + prior_rows.T @ prior_rows, undetermined=1e12)


class Solution(NamedTuple):
    """Solution of a least-squares problem.

    Attributes:
        problem: problem that was solved.
        p: best coordinates of the fit, (coordinates,).
        model: model at these coordinates.
        covariance: covariance of the coordinates, (coordinates, coordinates).
        noise: noise of a pixel, specified or estimated.
        misfit: weighted sum of squared residuals, divided by the degrees of freedom, no unit.
        freedom: degrees of freedom.
        weight: robust weights of the cells (inverse variances), sr^2, (units, slices, cells).
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
        """Replace the covariance by the covariance of the tempered likelihood (`correction/evidence.py`).

        kappa: exponent of the likelihood, no unit, 0 to 1.
        """
        white = self.problem.whitening(self.model, self.weight, self.noise.picture_gain)
        flat = white(self.model.derivative).reshape(self.p.size, -1)
        rows = self.problem.prior.rows(self.problem.layout)
        return self._replace(covariance=_covariance(kappa * flat @ flat.T, rows))


class Search:
    """Search for the best fit of a problem.

    Args:
        problem: problem to solve.
        noise: noise of a pixel; None: the noise is estimated from the residuals.
        workspace: store of the records of the starting points.
    """

    def __init__(self, problem: FitProblem, noise: PixelNoise | None, workspace: Workspace):
        self.problem, self.given_noise = problem, noise
        self.starts = StartRecords(problem.operators, workspace)
        self.prior_rows = problem.prior.rows(problem.layout)
        self.low, self.high = problem.bounds()

    def best(self, rounds: int = _ROUNDS) -> Solution:
        """Search a lattice of starting points, and refine the best of them.

        rounds: largest number of updates of the weights. A fit that only provides the starting point of another fit requires
            fewer updates.
        """
        data = self.problem.data
        noise = self.given_noise or INITIAL_NOISE
        # the first weights are computed from the values, and later weights from the model
        weight = 1 / cell_variance(data, np.abs(data.values), INITIAL_NOISE._replace(picture_gain=noise.picture_gain))
        tried = [self._least_squares(start, weight, noise, steps=_STEPS[0]) for start in self._starts(weight)]
        p, _ = min(tried, key=lambda pair: pair[1])
        _, weight, noise = self._weighed(p, weight, noise)
        return self._refine(p, weight, noise, rounds)

    def resume(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Continue from the solution of another model.

        Args:
            start: coordinates in the layout of this problem.
            weight: robust weights, sr^2, (units, slices, cells); None: weights from the variance of each value.
            noise: first estimate of the noise of a pixel. It is not used if the noise of the search is specified.
        """
        return self._refine(self._inside(start), self._weight(weight, noise), self.given_noise or noise, rounds=_ROUNDS)

    def widen(self, few: Solution) -> Solution:
        """Continue from `few`, the solution of the same model in fewer slices.

        The first weights in all slices are computed from the model at this solution.
        """
        start, noise = self._inside(few.p), self.given_noise or few.noise
        model = self.problem.model(start, self._weight(None, noise))
        return self._refine(start, self._robust_weight(model, noise), noise, rounds=_ROUNDS)

    def adjust(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Continue from a solution of the same model, for example in fewer slices, by a few linear steps.

        The arguments are those of `resume`.
        """
        return self._refine(start, self._weight(weight, noise), self.given_noise or noise, rounds=2, steps=(2, 2))

    def _weight(self, weight: np.ndarray | None, noise: PixelNoise) -> np.ndarray:
        data = self.problem.data
        return 1 / cell_variance(data, np.abs(data.values), noise) if weight is None else weight

    def _weighed(self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise) -> tuple[FitModel, np.ndarray, PixelNoise]:
        """Evaluate the model, and update weights and noise. The results are model, weights and noise.

        The problem gets the observations of clipped cells near the model.

        weight: weights for the solution of free strengths, sr^2, (units, slices, cells).
        """
        model = self.problem.model(p, weight)
        if self.given_noise is None:
            noise = estimate_noise(self.problem.data, self.problem.residual(model), model.value, p.size, noise)
        self.problem = self.problem.around(model, noise)
        weight = self._robust_weight(model, noise)
        return self.problem.model(p, weight), weight, noise

    def _robust_weight(self, model: FitModel, noise: PixelNoise) -> np.ndarray:
        data = self.problem.data
        u = standardised_residual(data, model.value, noise, self.problem.gain(noise))
        return huber_weights(u) / cell_variance(data, model.value, noise)

    def _inside(self, p: np.ndarray) -> np.ndarray:
        return np.clip(p, self.low + 1e-9, self.high - 1e-9)

    def _starts(self, weight: np.ndarray) -> list[np.ndarray]:
        """Build at most `_FOLLOWED` starting points from lobes that fit better than their neighbours on the lattice."""
        layout, problem = self.problem.layout, self.problem
        kind = layout.kind._replace(spline_size=0, shadows=0)
        free = problem.with_layout(layout._replace(kind=kind, fresnel="free", diffuse=False, base=False, coated=False))
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
        """Build the starting point of a fit from the coordinates of a lobe.

        The starting points of the Fresnel terms are fitted to the strengths of `free`, a model with F free in every slice.
        """
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

        Convergence is linear. If two consecutive changes are nearly parallel, the next round starts from the extrapolated
        limit. There are at most `rounds` rounds. The first round has at most `steps[0]` least-squares steps, and each later
        round at most `steps[1]`.
        """
        if self.problem.data.clipped.any():
            self.problem = self.problem.around(self.problem.model(p, weight), noise)
        last = np.zeros_like(p)
        for turn in range(rounds):
            before = p
            p, _ = self._least_squares(p, weight, noise, steps=steps[turn > 0])
            model, weight, noise = self._weighed(p, weight, noise)
            white = self.problem.whitening(model, weight, noise.picture_gain)
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
                "the fit produced non-finite parameters: check that the table is linear, and try another family of the lobe"
            )
        problem, data = self.problem, self.problem.data
        u = white(problem.residual(model))
        strengths = data.used.any(-1).sum() if problem.layout.fresnel == "free" else 0
        freedom = int(data.used.sum() - p.size - strengths)
        misfit = float((u**2).sum() / max(freedom, 1))
        return Solution(problem, p, model, covariance, noise, misfit, freedom, weight)

    def _least_squares(
        self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, steps: int
    ) -> tuple[np.ndarray, float]:
        """Minimise the sum of squared residuals in at most `steps` steps.

        The results are the best coordinates, and half of the sum at these coordinates.
        """
        problem, prior = self.problem, self.prior_rows
        start = problem.model(p, weight)
        fixed = None if problem.layout.fresnel == "free" else problem.whitening(start, weight, noise.picture_gain)
        last: dict[bytes, np.ndarray] = {}

        def triangle(p: np.ndarray) -> np.ndarray:
            """Compute the factor R of a QR decomposition of derivatives and residuals.

            R defines a smaller least-squares problem with the same normal equations.
            """
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
