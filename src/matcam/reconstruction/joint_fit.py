"""All pictures of a sphere fitted at once: lobe, reflectance, lens, lamps and distances in one likelihood (docs/model.md 10).

The model of pixel i of channel c in picture k is

    exp(g_k) [F_kc (1 + slope (theta_i - theta_k)) lobe_i + diffuse_c lambert_i]

with a strength F_kc that is free in every picture, and the gain g_k within what is known of it. A pixel that was clipped says
that the truth is at least its value. What the noise does not explain enters as a share of the model, so that errors of any kind
widen the stated uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.special import log_ndtr

from matcam.core.errors import FitError
from matcam.numerics.linalg import scaled_inverse
from matcam.reconstruction.observed_pixels import ObservedPixels
from matcam.reconstruction.picture_model import OWN, SCENE, LampFrame, Recorded
from matcam.reconstruction.rig.field_change import FIELD, STEP, FieldChange

_CLIPPED_OUT = 30.0  # standard deviations above which a clipped pixel says nothing more
_HUBER = 4.0
_STEPS = 25
_SETTLED = 1e-3  # of a standard deviation


class JointLayout(NamedTuple):
    """Order the vector of all parameters: lobe, scene, diffuse, field, then each picture's own, its gain and its strengths.

    Attributes:
        lobe: number of the lobe's parameters.
        channels: number of channels.
        pictures: number of pictures.
    """

    lobe: int
    channels: int
    pictures: int

    @property
    def shared(self) -> int:
        """Count the parameters of all pictures."""
        return self.lobe + len(SCENE) + self.channels + len(FIELD)

    @property
    def each(self) -> int:
        """Count the parameters of one picture."""
        return len(OWN) + 1 + self.channels

    @property
    def size(self) -> int:
        """Count all parameters."""
        return self.shared + self.pictures * self.each

    @property
    def scene(self) -> slice:
        """Place of lens, radius and nearnesses."""
        return slice(self.lobe, self.lobe + len(SCENE))

    @property
    def diffuse(self) -> slice:
        """Place of the diffuse parts."""
        return slice(self.lobe + len(SCENE), self.lobe + len(SCENE) + self.channels)

    @property
    def field(self) -> slice:
        """Place of what the lens's field differs by from its profile."""
        return slice(self.diffuse.stop, self.shared)

    def own(self, k: int) -> slice:
        """Place of a picture's centre and lamp."""
        first = self.shared + k * self.each
        return slice(first, first + len(OWN))

    def gain(self, k: int) -> int:
        """Place of a picture's gain."""
        return self.own(k).stop

    def strengths(self, k: int) -> slice:
        """Place of a picture's strengths, one per channel."""
        first = self.gain(k) + 1
        return slice(first, first + self.channels)

    def of_picture(self, k: int) -> np.ndarray:
        """Return the places of the parameters that the picture model takes."""
        own = self.own(k)
        return np.concatenate([np.arange(self.lobe + len(SCENE)), np.arange(own.start, own.stop)])


class PixelModel(Protocol):
    """Say what pixels record of unit strengths, with derivatives by the parameters of one picture where asked for."""

    def window(self, p: np.ndarray, frame: LampFrame, window: Any, *, slopes: bool) -> tuple[Recorded, Recorded | None]:
        """Return what the pixels about the highlight record; two axes, flattened in order."""

    def pixels(
        self, p: np.ndarray, frame: LampFrame, column: np.ndarray, row: np.ndarray, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Return what the other pixels record; one axis."""


@dataclass(frozen=True)
class JointProblem:
    """Hold pictures, model and what is known beforehand.

    Attributes:
        model: what pixels record.
        layout: order of the parameters.
        pixels: chosen pixels of each picture.
        frames: base direction of each picture's lamp.
        prior_rows: combinations of the parameters, (rows, size), that are
        prior_values: these values +- 1, (rows,).
        prior_sources: where each row comes from: "lens", "outline", "lamp", "gain", ...
        low: smallest value of each parameter.
        high: largest value of each parameter.
        slope: d ln F / d theta_d of each picture and channel, 1/rad, (pictures, channels).
        fixed: parameters that stay as they are, (size,).
        changes: what a change of the lens's field does to each picture; empty where the field is exact.
        unstated: what a distortion that nobody has stated does to each picture; it is not fitted, but enters the covariance.
    """

    model: PixelModel
    layout: JointLayout
    pixels: Sequence[ObservedPixels]
    frames: Sequence[LampFrame]
    prior_rows: np.ndarray
    prior_values: np.ndarray
    prior_sources: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    slope: np.ndarray
    fixed: np.ndarray
    changes: Sequence[FieldChange] = ()
    unstated: Sequence[FieldChange] = ()

    @property
    def judged(self) -> np.ndarray:
        """Which parameters have an error: those that are fitted, and an unstated distortion."""
        judged = ~self.fixed
        judged[self.layout.field.start] |= len(self.unstated) > 0
        return judged

    def information_of(self, source: str) -> np.ndarray:
        """Return the information matrix of what one source states, (size, size)."""
        rows = self.prior_rows[[one == source for one in self.prior_sources]]
        return rows.T @ rows

    def recorded(self, p: np.ndarray, k: int, *, slopes: bool) -> tuple[Recorded, Recorded | None]:
        """Return what the chosen pixels of picture k record of unit strengths, window first, with derivatives."""
        at, pixels, frame = p[self.layout.of_picture(k)], self.pixels[k], self.frames[k]
        window, column, row = pixels.window, pixels.column, pixels.row
        beside = at
        if self.changes:
            window = self.changes[k].window(window, p[self.layout.field])
            column, row = self.changes[k].places(p[self.layout.field])
            # blur matters to pixels next to the highlight only: there it is the highlight's
            beside = at.copy()
            beside[self.layout.lobe] += np.log(window.widened)
        near, near_slopes = self.model.window(at, frame, window, slopes=slopes)
        far, far_slopes = self.model.pixels(beside, frame, column, row, slopes=slopes)

        def joined(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            first = np.asarray(first)
            return np.concatenate([first.reshape(-1, *first.shape[2:]), np.asarray(second)])

        value = Recorded(*map(joined, near, far))
        if near_slopes is None or far_slopes is None:
            return value, None
        return value, Recorded(*map(joined, near_slopes, far_slopes))

    def picture(self, p: np.ndarray, k: int, *, slopes: bool) -> PictureFit:
        """Return the model of the chosen pixels of picture k, and its derivatives."""
        layout, pixels = self.layout, self.pixels[k]
        recorded, derivative = self.recorded(p, k, slopes=slopes)
        channel = pixels.channel
        strength, diffuse = p[layout.strengths(k)][channel], p[layout.diffuse][channel]
        gain = np.exp(p[layout.gain(k)])
        peak = int(np.argmax(np.where(pixels.used, recorded.lobe, -1.0)))
        theta = recorded.theta_d[peak]
        slope = self.slope[k][channel]
        bend = 1 + slope * (recorded.theta_d - theta)
        lobe, lambert = strength * bend * recorded.lobe, diffuse * recorded.lambert
        value = gain * (lobe + lambert)
        if derivative is None:
            return PictureFit(value, None, theta, None)
        jacobian = np.zeros((value.size, layout.size))
        columns = layout.of_picture(k)
        by_theta = derivative.theta_d - derivative.theta_d[peak]
        jacobian[:, columns] = gain * (
            (strength * bend)[:, None] * derivative.lobe
            + (strength * slope * recorded.lobe)[:, None] * by_theta
            + diffuse[:, None] * derivative.lambert
        )
        angle = np.zeros(layout.size)
        angle[columns] = derivative.theta_d[peak]
        if self.changes:
            of_k1, of_growth = layout.field.start, layout.field.start + 1
            change, wider = p[layout.field], self.changes[k].widening(p[layout.field])
            jacobian[:, of_growth] = jacobian[:, layout.lobe] * wider
            angle[of_growth] = angle[layout.lobe] * wider
            window = self.changes[k].window(pixels.window, change + np.array([STEP, 0.0]))
            moved, _ = self.model.window(p[columns], self.frames[k], window, slopes=False)
            near = slice(0, window.pixel_u.size * window.pixel_v.size)
            by_k1 = Recorded(*((np.asarray(a).ravel() - b[near]) / STEP for a, b in zip(moved, recorded, strict=True)))
            angle[of_k1] = by_k1.theta_d[peak] if peak < near.stop else 0.0
            jacobian[near, of_k1] = gain * (
                (strength * bend)[near] * by_k1.lobe
                + (strength * slope * recorded.lobe)[near] * (by_k1.theta_d - angle[of_k1])
                + diffuse[near] * by_k1.lambert
            )
            # a pixel read elsewhere is a sphere that has moved the other way
            far, centre = slice(near.stop, None), layout.own(k).start + np.arange(2)
            away = self.changes[k].places_slopes(change).T
            jacobian[far, of_k1] = -(jacobian[far][:, centre] * away).sum(axis=1)
        jacobian[:, layout.gain(k)] = value
        everything = np.arange(value.size)
        jacobian[everything, layout.strengths(k).start + channel] = gain * bend * recorded.lobe
        jacobian[everything, layout.diffuse.start + channel] = gain * recorded.lambert
        return PictureFit(value, jacobian, float(theta), angle)


class PictureFit(NamedTuple):
    """Hold the model of one picture's chosen pixels.

    Attributes:
        value: (pixels,).
        jacobian: its derivatives, (pixels, parameters); None: not asked for.
        theta_d: where its strengths are read, rad.
        theta_d_slope: derivatives of that angle, (parameters,).
    """

    value: np.ndarray
    jacobian: np.ndarray | None
    theta_d: float
    theta_d_slope: np.ndarray | None


class JointSolution(NamedTuple):
    """Hold the best fit.

    Attributes:
        problem: what was solved.
        p: parameters.
        covariance: of the parameters, with what the fit does not explain, and what nobody has stated.
        fitted: the same without what nobody has stated: it weighs.
        cost: minus twice the logarithm of likelihood and prior, but for a constant.
        unexplained: share of the model that enters the noise, no unit.
        theta_d: angle of each picture's strengths, rad, (pictures,).
        theta_d_slope: derivatives of these angles, (pictures, parameters).
        chi2: mean squared residual of each picture, in standard deviations of photon and read noise, (pictures,).
        left_out: pixels beyond 6 standard deviations in each picture, (pictures,).
    """

    problem: JointProblem
    p: np.ndarray
    covariance: np.ndarray
    fitted: np.ndarray
    cost: float
    unexplained: float
    theta_d: np.ndarray
    theta_d_slope: np.ndarray
    chi2: np.ndarray
    left_out: np.ndarray

    def covariance_with(self, change: np.ndarray) -> np.ndarray:
        """Return the covariance if the information matrix were larger by `change`, (size, size)."""
        judged = np.flatnonzero(self.problem.judged)
        inner = np.ix_(judged, judged)
        covariance = np.zeros_like(self.covariance)
        information = scaled_inverse(self.covariance[inner], undetermined=1e16) + change[inner]
        covariance[inner] = scaled_inverse(information, undetermined=1e16)
        return covariance


class Likelihood:
    """Judge a model by its pixels, with a share of the model as noise.

    Args:
        unexplained: that share, no unit.
    """

    def __init__(self, unexplained: float):
        self.unexplained = unexplained

    def residual(self, pixels: ObservedPixels, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return standardised residuals, their derivatives by the model, and their robust weights, (pixels,).

        A clipped pixel's residual is the root of minus twice the logarithm of the chance that it was clipped.
        """
        std = np.hypot(pixels.std, self.unexplained * np.abs(value))
        z = (value - pixels.values) / std
        by_value = 1 / std
        bound = np.clip(z, -_CLIPPED_OUT, _CLIPPED_OUT)
        chance = log_ndtr(bound)
        root = np.sqrt(np.maximum(-2 * chance, 1e-300))
        hazard = np.exp(-0.5 * bound**2 - chance) / np.sqrt(2 * np.pi)
        residual = np.where(pixels.clipped, -root, z)
        slope = np.where(pixels.clipped, hazard / np.maximum(root, 1e-12), 1.0) * by_value
        slope = np.where(pixels.clipped & (np.abs(z) > _CLIPPED_OUT), 0.0, slope)
        weight = np.where(np.abs(residual) > _HUBER, _HUBER / np.maximum(np.abs(residual), _HUBER), 1.0)
        used = pixels.used
        return np.where(used, residual, 0.0), np.where(used, slope, 0.0), np.where(used, weight, 0.0)

    def cost(self, pixels: ObservedPixels, value: np.ndarray) -> float:
        """Return Huber's cost of a picture, with the logarithm of its noise."""
        residual, _, _ = self.residual(pixels, value)
        size = np.abs(residual)
        huber = np.where(size > _HUBER, 2 * _HUBER * size - _HUBER**2, size**2)
        return float(huber.sum())

    def surprise(self, pixels: ObservedPixels, value: np.ndarray) -> float:
        """Return minus twice the logarithm of the likelihood per pixel, but for a constant: it compares lobes."""
        std = np.hypot(pixels.std, self.unexplained * np.abs(value))
        measured = pixels.used & ~pixels.clipped
        return (self.cost(pixels, value) + 2 * float(np.log(std[measured]).sum())) / max(int(pixels.used.sum()), 1)


def solve(
    problem: JointProblem, start: np.ndarray, unexplained: float, progress: Callable[[str], None] | None = None
) -> tuple[np.ndarray, float]:
    """Return the parameters of least cost and the cost, at a given share of unexplained noise, by Levenberg and Marquardt."""
    judge = Likelihood(unexplained)
    p = np.clip(start, problem.low, problem.high)
    free = ~problem.fixed
    damping = 1e-3
    cost, gradient, normal = _assembled(problem, judge, p)
    for _ in range(_STEPS):
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        accepted = False
        for _ in range(8):
            matrix = normal / np.outer(scale, scale) + damping * np.eye(len(p))
            step = np.zeros_like(p)
            inner = np.ix_(free, free)
            step[free] = -np.linalg.solve(matrix[inner], (gradient / scale)[free]) / scale[free]
            trial = np.clip(p + step, problem.low, problem.high)
            trial_cost = cost_at(problem, judge, trial)
            if np.isfinite(trial_cost) and trial_cost <= cost + 1e-9 * abs(cost):
                accepted = True
                break
            damping *= 8
        if not accepted:
            break
        gained, moved = cost - trial_cost, np.abs((trial - p) * scale).max()
        p, damping = trial, max(damping / 10, 1e-9)
        if progress is not None:
            progress(f"cost {trial_cost:.6g}")
        if gained < 1e-2 or moved < _SETTLED:
            cost = trial_cost
            break
        cost, gradient, normal = _assembled(problem, judge, p)
    if not np.all(np.isfinite(p)):
        raise FitError(
            "the fit of the pictures ran into numbers that are none: they do not look like a sphere's highlights"
        )
    return p, cost


def summed_up(problem: JointProblem, p: np.ndarray, unexplained: float) -> JointSolution:
    """Return the solution at parameters: covariance, angles and how well each picture is explained."""
    judge = Likelihood(unexplained)
    layout = problem.layout
    moving = replace(problem, changes=problem.unstated) if problem.unstated else problem
    cost, _, normal = _assembled(moving, judge, p)
    free = ~problem.fixed
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
        cost,
        unexplained,
        np.array(theta),
        np.array(slopes),
        np.array(chi2),
        np.array(out),
    )


def _of_the_unstated(problem: JointProblem, normal: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return what an unstated distortion adds to the covariance of what was fitted without it (as Schmidt 1966 "considers")."""
    at, field = problem.layout.field.start, problem.unstated[0].field
    moved = -covariance @ normal[:, at]
    moved[at] = 1.0
    return field.k1.std**2 * np.outer(moved, moved)


def _assembled(problem: JointProblem, judge: Likelihood, p: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return cost, half its gradient and half its curvature (Gauss and Newton)."""
    away = problem.prior_rows @ p - problem.prior_values
    cost = float(away @ away)
    gradient, normal = problem.prior_rows.T @ away, problem.prior_rows.T @ problem.prior_rows
    for k in range(problem.layout.pictures):
        fit = problem.picture(p, k, slopes=True)
        assert fit.jacobian is not None
        residual, slope, weight = judge.residual(problem.pixels[k], fit.value)
        columns = np.flatnonzero(np.any(fit.jacobian != 0, axis=0))
        jacobian = fit.jacobian[:, columns] * slope[:, None]
        weighted = jacobian * weight[:, None]
        gradient[columns] += weighted.T @ residual
        normal[np.ix_(columns, columns)] += weighted.T @ jacobian
        cost += judge.cost(problem.pixels[k], fit.value)
    return cost, gradient, normal


def cost_at(problem: JointProblem, judge: Likelihood, p: np.ndarray) -> float:
    """Return minus twice the logarithm of likelihood and prior, but for a constant."""
    away = problem.prior_rows @ p - problem.prior_values
    return float(away @ away) + sum(
        judge.cost(problem.pixels[k], problem.picture(p, k, slopes=False).value) for k in range(problem.layout.pictures)
    )
