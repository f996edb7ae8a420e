"""Joint fit of all images of a sample: lobe, reflectance, lens, lamps and distances in one likelihood (docs/model.md 10).

The value of a clipped pixel is a lower bound. Residuals that exceed the noise are modelled as a share of the light, so that
any error of the model increases the uncertainty. Images are processed in parallel, and their results are added in order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from matcam.core.errors import FitError
from matcam.core.threads import available_cores, in_order
from matcam.numerics.anderson import AndersonMixing
from matcam.numerics.linalg import scaled_inverse
from matcam.reconstruction.joint.joint_problem import JointProblem
from matcam.reconstruction.joint.likelihood import Likelihood

T = TypeVar("T")
_STEPS, _ATTEMPTS = 25, 9
_SLIGHT, _LOOK_BACK = 10.0, 3
"""Factor of the threshold below which a step is small, and number of steps without progress after which the iteration ends."""
_NO_CHANGE, _ALL_LOST = 1e-12, 1e-6
"""Relative change of information below which it is neglected, and smallest share of information that remains."""


class JointSolution(NamedTuple):
    """Solution of a joint fit.

    Attributes:
        problem: problem that was solved.
        p: fitted parameters.
        covariance: covariance of the parameters, including unexplained residuals and an unspecified distortion.
        fitted: covariance of the parameters without the contribution of an unspecified distortion.
        cost: minus twice the logarithm of likelihood and prior, up to a constant.
        likelihood: likelihood of the pixels, with the unexplained light.
        theta_d: angle to which the strengths of each image apply, rad, (pictures,).
        theta_d_slope: derivatives of these angles, (pictures, parameters).
        chi2: mean squared residual of each image, relative to the variance of photon and read noise, (pictures,).
        left_out: number of pixels with a residual above 6 standard deviations in each image, (pictures,).
    """

    problem: JointProblem
    p: np.ndarray
    covariance: np.ndarray
    fitted: np.ndarray
    cost: float
    likelihood: Likelihood
    theta_d: np.ndarray
    theta_d_slope: np.ndarray
    chi2: np.ndarray
    left_out: np.ndarray

    @property
    def unexplained(self) -> float:
        """Standard deviation of the residuals that the noise does not explain, as a share of the model, no unit."""
        return self.likelihood.share

    def covariance_with(self, information: np.ndarray) -> np.ndarray:
        """Compute the covariance `covariance` with additional information.

        information: information matrix of low rank that is added, (size, size).
        """
        return self._informed(self.covariance, information)

    def covariance_without(self, information: np.ndarray) -> np.ndarray:
        """Compute the covariance `fitted` without some of its information.

        information: information matrix of low rank that is subtracted, (size, size).
        """
        return self._informed(self.fitted, -information)

    def _informed(self, covariance: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Update a covariance for a change of the information matrix by Woodbury's identity.

        Inversion to the information matrix and back would lose small contributions.
        """
        judged = np.flatnonzero(self.problem.judged)
        inner = np.ix_(judged, judged)
        scale = np.sqrt(np.maximum(np.diag(covariance)[judged], 1e-300))
        old, found = covariance[inner] / np.outer(scale, scale), np.zeros_like(covariance)
        size, eigenvectors = np.linalg.eigh(change[inner] * np.outer(scale, scale))
        some = np.abs(size) > _NO_CHANGE * np.abs(size).max(initial=0.0)
        eigenvectors, sign = eigenvectors[:, some] * np.sqrt(np.abs(size[some])), np.sign(size[some])
        moved = old @ eigenvectors
        middle, turn = np.linalg.eigh(np.diag(sign) + eigenvectors.T @ moved)
        if np.all(sign < 0):  # rounding must not remove more information than exists
            middle = np.minimum(middle, -_ALL_LOST)
        moved = moved @ turn
        found[inner] = (old - (moved / middle) @ moved.T) * np.outer(scale, scale)
        return found


def solve(problem: JointProblem, start: np.ndarray, judge: Likelihood, enough: float) -> np.ndarray:
    """Minimise the cost for a given likelihood of the pixels.

    The noise in a Levenberg-Marquardt step is that of the model before the step. Successive steps are combined as long as
    this reduces the cost, because single steps are too short for the residuals of real images.

    Args:
        problem: problem to fit.
        start: parameters, (size,).
        judge: likelihood of the pixels.
        enough: decrease of the cost below which the iteration ends.

    Raises:
        FitError: a parameter is not finite.
    """
    p = np.clip(start, problem.low, problem.high)
    free = np.flatnonzero(~problem.fixed)
    damping, mixing = 1e-3, AndersonMixing()
    at = assembled(problem, judge, p)
    costs = [at.cost]
    for _ in range(_STEPS):
        scale = np.sqrt(np.maximum(np.diag(at.normal), 1e-30))
        first = _damped_step(problem, at, scale, free, damping, p)
        step, accepted, raised = mixing.step(p, first, at.normal), False, False
        mixed = step is not first
        for _ in range(_ATTEMPTS):
            trial = np.clip(p + step, problem.low, problem.high)
            cost = cost_at(problem, judge, trial, at.levels)
            accepted = bool(np.isfinite(cost) and cost <= at.cost + 1e-9 * abs(at.cost))
            if accepted:
                break
            mixing.forget()
            if mixed:
                mixed, step = False, first
            else:
                damping, raised = 8 * damping, True
                step = _damped_step(problem, at, scale, free, damping, p)
        if not accepted:
            break
        gained, moved = at.cost - cost, np.abs((trial - p) * scale).max()
        p, damping = trial, damping if raised else max(damping / 10, 1e-9)
        # largest step at convergence, as a share of a standard deviation
        if moved < 1e-3 or (gained < enough and (not mixed or abs(at.gradient @ first) < 5 * enough)):
            break
        at = assembled(problem, judge, p)
        costs.append(at.cost)
        # the noise depends on the model, so near the end the new noise may cancel the improvement of a step
        if gained < _SLIGHT * enough and len(costs) > _LOOK_BACK and at.cost > costs[-1 - _LOOK_BACK] - enough:
            break
    if not np.all(np.isfinite(p)):
        raise FitError(
            "the fit of the images produced non-finite parameters: check that the images show the highlights of the sample"
        )
    return p


def _damped_step(
    problem: JointProblem, at: Assembled, scale: np.ndarray, free: np.ndarray, damping: float, p: np.ndarray
) -> np.ndarray:
    """Compute a step of the free parameters that keeps parameters at their bounds fixed (Bertsekas 1982)."""
    held = ((p <= problem.low) & (at.gradient > 0)) | ((p >= problem.high) & (at.gradient < 0))
    free = free[~held[free]]
    inner = np.ix_(free, free)
    matrix = (at.normal / np.outer(scale, scale))[inner] + damping * np.eye(free.size)
    step = np.zeros_like(p)
    step[free] = -np.linalg.solve(matrix, (at.gradient / scale)[free]) / scale[free]
    return np.clip(p + step, problem.low, problem.high) - p


def summed_up(problem: JointProblem, p: np.ndarray, judge: Likelihood) -> JointSolution:
    """Build the solution at given parameters: their covariance, and theta_d and chi squared of each image."""
    layout = problem.layout
    moving = replace(problem, changes=problem.unstated) if problem.unstated else problem
    at, free = assembled(moving, judge, p), ~problem.fixed
    normal = at.normal
    fitted = np.zeros_like(normal)
    fitted[np.ix_(free, free)] = scaled_inverse(normal[np.ix_(free, free)], undetermined=1e14)
    covariance = fitted + _of_the_unstated(problem, normal, fitted) if problem.unstated else fitted
    theta, slopes, chi2, out = [], [], [], []
    for k in range(layout.pictures):
        fit = moving.picture(p, k, slopes=True)
        plain, _, _ = Likelihood(0.0).residual(problem.pixels[k], fit.value)
        theta.append(fit.theta_d)
        slopes.append(fit.theta_d_slope)
        count = max(int(problem.pixels[k].used.sum()), 1)
        chi2.append(float((plain**2).sum() / count))
        residual, _, _ = judge.residual(problem.pixels[k], fit.value)
        out.append(int((np.abs(residual) > 6).sum()))
    return JointSolution(
        problem,
        p,
        covariance,
        fitted,
        at.cost,
        judge,
        np.array(theta),
        np.array(slopes),
        np.array(chi2),
        np.array(out),
    )


def _of_the_unstated(problem: JointProblem, normal: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Compute the contribution of an unspecified distortion to the covariance of a fit that ignores distortion.

    This is the "consider" covariance of Schmidt (1966).
    """
    at, field = problem.layout.field.start, problem.unstated[0].field
    moved = -covariance @ normal[:, at]
    moved[at] = 1.0
    return field.k1.std**2 * np.outer(moved, moved)


class Assembled(NamedTuple):
    """Cost, half its gradient and half its Hessian (Gauss-Newton), and the model of each image."""

    cost: float
    gradient: np.ndarray
    normal: np.ndarray
    levels: list[np.ndarray]


def assembled(
    problem: JointProblem, judge: Likelihood, p: np.ndarray, exponents: Sequence[np.ndarray] | None = None
) -> Assembled:
    """Sum cost, gradient and Hessian over the images and the prior.

    Args:
        problem: problem to fit.
        judge: likelihood of the pixels.
        p: parameters, (size,).
        exponents: exponents of the likelihoods of the pixels of each image. Default: None, 1.
    """

    def share(k: int) -> tuple[np.ndarray, Assembled]:
        fit, pixels = problem.picture(p, k, slopes=True), problem.pixels[k]
        assert fit.jacobian is not None
        exponent = 1.0 if exponents is None else exponents[k]
        residual, slope, weight = judge.residual(pixels, fit.value, exponent=exponent)
        columns = np.flatnonzero(np.any(fit.jacobian != 0, axis=0))
        jacobian = fit.jacobian[:, columns] * slope[:, None]
        weighted = jacobian * weight[:, None]
        cost = judge.cost(pixels, fit.value, exponent=exponent)
        return columns, Assembled(cost, weighted.T @ residual, weighted.T @ jacobian, [fit.value])

    away = problem.prior_rows @ p - problem.prior_values
    cost, levels = float(away @ away), []
    gradient, normal = problem.prior_rows.T @ away, problem.prior_rows.T @ problem.prior_rows
    for columns, own in _of_pictures(share, problem):
        gradient[columns] += own.gradient
        normal[np.ix_(columns, columns)] += own.normal
        cost += own.cost
        levels += own.levels
    return Assembled(cost, gradient, normal, levels)


def _of_pictures(work: Callable[[int], T], problem: JointProblem) -> Iterator[T]:
    # the derivatives of one image take up to 12 MB, so 8 images are processed at a time
    return in_order(work, range(problem.layout.pictures), min(available_cores(), 8))


def cost_at(problem: JointProblem, judge: Likelihood, p: np.ndarray, levels: Sequence[np.ndarray]) -> float:
    """Compute minus twice the logarithm of likelihood and prior, up to a constant.

    Args:
        problem: problem to fit.
        judge: likelihood of the pixels.
        p: parameters, (size,).
        levels: expected values of the pixels of each image, from which the noise follows.
    """

    def share(k: int) -> float:
        value = problem.picture(p, k, slopes=False).value
        return judge.cost(problem.pixels[k], value, levels[k])

    away = problem.prior_rows @ p - problem.prior_values
    return float(away @ away) + sum(_of_pictures(share, problem))
