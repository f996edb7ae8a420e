"""The search for the best fit: a lattice of starts, then least squares with weights that follow the model (docs/model.md 8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.core.registry import WITH_POWER
from matcam.inverse.fit.fit_data import (
    INITIAL_NOISE,
    cell_variance,
    estimate_noise,
    huber_weights,
    standardised_residual,
)
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES, fresnel_start
from matcam.inverse.fit.fit_problem import FitModel, FitProblem
from matcam.numerics.linalg import scaled_inverse

_WIDTHS = np.log(np.geomspace(1.5e-4, 0.7, 18))
_POWERS = {"epd": np.log([0.5, 1.0, 1.8]), "sgd": np.log([0.3, 0.8, 1.5])}
_TWO_LOBES: list[tuple[float, ...]] = [
    (width, width + wider, share, *tails)
    for width in _WIDTHS[:-2:2]
    for wider in np.log([3.0, 12.0, 45.0])
    for share in (-0.8, 0.8)
    for tails in ((0.1, 0.1), (0.9, 0.1), (0.1, 0.9))
]
_STUDENT: list[tuple[float, ...]] = [(width, excess) for excess in np.log([0.7, 2.0, 6.0]) for width in _WIDTHS[::2]]
_UNNAMED = {STUDENT: _STUDENT, TWO_LOBES: _TWO_LOBES}
_ROUNDS = 6
_SETTLED = 0.02
"""Change of the parameters, in standard deviations, below which weights need no further round."""
_STEEP = np.radians(80.0)
"""theta_d from which strengths say little of a Fresnel term to begin with."""


class Solution(NamedTuple):
    """Hold the best parameters of a problem, and everything at them.

    Attributes:
        problem: what was solved.
        p: (parameters,), in the fit's coordinates.
        model: the model there.
        covariance: (parameters, parameters), of the coordinates.
        noise: of a pixel, given or estimated.
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


class Search:
    """Search the best fit of a problem. noise: of a pixel; None: estimated from the residuals."""

    def __init__(self, problem: FitProblem, noise: PixelNoise | None):
        self.problem, self.given_noise = problem, noise
        self.prior_rows = problem.prior.rows(problem.layout)
        self.low, self.high = problem.bounds()

    def best(self) -> Solution:
        """Try a lattice of starts and follow the best two; the better one to the end."""
        data = self.problem.data
        noise = self.given_noise or INITIAL_NOISE
        # to begin with, each value's own variance; from then on the model's
        weight = 1 / cell_variance(data, np.abs(data.values), INITIAL_NOISE._replace(picture_gain=noise.picture_gain))
        starts = self._starts(weight)
        tried = [self._refine(start, weight, noise, rounds=1) for start in starts[:2]]
        first = min(tried, key=lambda solution: solution.misfit)
        return self._refine(first.p, first.weight, first.noise, rounds=_ROUNDS)

    def resume(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Go on from the parameters of a fit of another model. weight: robust weights; None: each value's own variance."""
        return self._refine(self._inside(start), self._weight(weight, noise), self.given_noise or noise, rounds=_ROUNDS)

    def adjust(self, start: np.ndarray, weight: np.ndarray | None, noise: PixelNoise) -> Solution:
        """Go on from a fit of the same model to fewer slices: within its errors, a few linear steps are a fit."""
        return self._refine(start, self._weight(weight, noise), self.given_noise or noise, rounds=2, steps=(2, 2))

    def _weight(self, weight: np.ndarray | None, noise: PixelNoise) -> np.ndarray:
        data = self.problem.data
        return 1 / cell_variance(data, np.abs(data.values), noise) if weight is None else weight

    def _inside(self, p: np.ndarray) -> np.ndarray:
        return np.clip(p, self.low + 1e-9, self.high - 1e-9)

    def _starts(self, weight: np.ndarray) -> list[np.ndarray]:
        """Return starts in order of their misfit, no two neighbours on the lattice."""
        layout, problem = self.problem.layout, self.problem
        family = layout.kind.family
        lattice: list[tuple[float, ...]] = [(q,) for q in _WIDTHS]
        if family in _UNNAMED:
            lattice = _UNNAMED[family]
        elif family in WITH_POWER:
            lattice = [(q, power) for power in _POWERS[family] for q in _WIDTHS[::2]]
        kind = layout.kind._replace(bends=0, shadows=0)
        free = problem.with_layout(layout._replace(kind=kind, fresnel="free", diffuse=False))
        found = []
        for lobe in lattice:
            inside = np.clip(lobe, self.low[: len(lobe)], self.high[: len(lobe)])
            p = np.zeros(free.layout.size)
            for index in range(layout.lobes):
                p[free.layout.lobe(index)] = inside
            model = free.start_model(p, weight)
            u = free.whitening(model, weight, 0.0)(problem.data.values - model.value)
            found.append(((huber_weights(u) * u**2).sum(), inside, model))
        order = np.argsort([misfit for misfit, *_ in found])
        picked: list[np.ndarray] = []
        for index in order:
            _, lobe, _ = found[index]
            if all(np.abs(lobe[0] - other[0]) > 1.2 or np.abs(lobe - other)[1:].any() for other in picked):
                picked.append(lobe)
        best = found[order[0]][2]
        return [self._vector(lobe, best) for lobe in picked[:2]]

    def _vector(self, lobe: np.ndarray, free: FitModel) -> np.ndarray:
        """Return a whole start around a lobe; Fresnel terms come from the free strengths of a model."""
        layout, theta_d = self.problem.layout, self.problem.theta_d
        p = np.zeros(layout.size)
        for index in range(layout.lobes):
            p[layout.lobe(index)][: lobe.size] = lobe
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
        self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, rounds: int, steps: tuple[int, int] = (12, 5)
    ) -> Solution:
        """Alternate least squares with fixed weights and better weights until nothing moves.

        steps: most steps of least squares, in the first round and in others.
        """
        problem, data = self.problem, self.problem.data
        for turn in range(rounds):
            before = p
            p = self._least_squares(p, weight, noise, steps=steps[turn > 0])
            model = problem.model(p, weight)
            residual = problem.residual(model)
            if self.given_noise is None:
                noise = estimate_noise(data, residual, model.value, p.size, noise)
            u = standardised_residual(data, residual, model.value, noise, problem.gain(noise))
            weight = huber_weights(u) / cell_variance(data, model.value, noise)
            model = problem.model(p, weight)
            white = problem.whitening(model, weight, noise.picture_gain)
            flat = white(model.derivative).reshape(p.size, -1)
            covariance = scaled_inverse(flat @ flat.T + self.prior_rows.T @ self.prior_rows, undetermined=1e12)
            std = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
            if np.all(np.abs(p - before) < _SETTLED * std):
                break
        if not np.all(np.isfinite(p)):
            raise FitError("the fit ran into numbers that are none: the data do not look like a lobe of this family")
        u = white(problem.residual(model))
        strengths = data.used.any(-1).sum() if problem.layout.fresnel == "free" else 0
        freedom = int(data.used.sum() - p.size - strengths)
        misfit = float((u**2).sum() / max(freedom, 1))
        return Solution(problem, p, model, covariance, noise, misfit, freedom, weight)

    def _least_squares(self, p: np.ndarray, weight: np.ndarray, noise: PixelNoise, steps: int) -> np.ndarray:
        problem, prior = self.problem, self.prior_rows
        start = problem.model(p, weight)
        fixed = None if problem.layout.fresnel == "free" else problem.whitening(start, weight, noise.picture_gain)
        last: dict[bytes, np.ndarray] = {}

        def triangle(p: np.ndarray) -> np.ndarray:
            """Return R of slopes and residuals together: the same squares and products in few rows."""
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
        return found.x
