"""F as a function of theta_d, fitted to the strengths of all images.

The curve is that of a metal with the refractive index n + i k if it explains the strengths, and otherwise a smooth curve.
The strengths have independent and common errors. The curve interpolates F between the angles of the images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from matcam.core.jax import jax
from matcam.files.capture_settings import Stated
from matcam.inverse.fit.fit_parameters import fresnel_start, readable_value, reflectance_at
from matcam.numerics.linalg import scaled_inverse

Whitener = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ReflectanceCurve:
    """F of one channel as a function of the difference angle theta_d.

    Attributes:
        model: "conductor" for the curve of a refractive index n + i k, or "smooth" if no index explains the strengths.
        coefficients: coefficients of the curve, (coefficients,).
        gain: derivatives of the coefficients with respect to the strengths, (coefficients, pictures).
        by_scale: covariance of the coefficients due to the prior of the scale, (coefficients, coefficients).
        by_misfit: covariance of the coefficients due to the unexplained residual, same shape.
        misfit: mean squared residual of the strengths, relative to their variance.
    """

    model: str
    coefficients: np.ndarray
    gain: np.ndarray
    by_scale: np.ndarray
    by_misfit: np.ndarray
    misfit: float

    @property
    def own(self) -> np.ndarray:
        """Covariance of the coefficients due to the prior of the scale and the unexplained residual."""
        return self.by_scale + self.by_misfit

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Evaluate F at difference angles, rad, in the unit of the strengths."""
        return _curve(self.model, self.coefficients, theta)[0]

    def slopes(self, theta: np.ndarray) -> np.ndarray:
        """Evaluate the derivatives of F with respect to the coefficients at difference angles, (angles, coefficients)."""
        return _curve(self.model, self.coefficients, theta)[1]

    def parameters(self) -> dict[str, tuple[float, np.ndarray]]:
        """Compute n and k, and their derivatives with respect to the coefficients, by name.

        The result is empty for a smooth curve.
        """
        if self.model != "conductor":
            return {}
        found = {}
        for index, (name, coordinate) in enumerate(zip(("n", "k"), self.coefficients, strict=False)):
            value, slope = readable_value(name, float(coordinate))
            row = np.zeros(len(self.coefficients))
            row[index] = slope
            found[name] = value, row
        return found


def reflectance_curve(
    theta: np.ndarray, strengths: np.ndarray, covariance: np.ndarray, unit: Stated | None
) -> ReflectanceCurve:
    """Fit F as a function of theta_d to strengths. The curve has the unit of the strengths.

    Args:
        theta: difference angles of the strengths, rad, (pictures,).
        strengths: measured F, in any unit, (pictures,).
        covariance: covariance of the strengths, (pictures, pictures).
        unit: strength that corresponds to F = 1, with its relative standard deviation; None: unknown.

    Returns:
        Fitted curve.
    """
    floor = (1e-3 * np.abs(strengths).max(initial=1e-12)) ** 2  # the accuracy of the model of an image limits that of F
    root = cholesky(covariance + floor * np.eye(len(theta)), lower=True)

    def white(rows: np.ndarray) -> np.ndarray:
        return np.asarray(solve_triangular(root, rows, lower=True))

    # standard deviation of ln of an unknown scale
    scale = Stated(float(np.abs(strengths).max(initial=1e-12)), 3.0) if unit is None else unit
    curves = [one for one in (_conductor(theta, strengths, white, scale), _smooth(theta, strengths, white)) if one]
    # a curve of n and k explains the strengths up to a misfit of 2.5
    explained = [one for one in curves if one.model == "conductor" and one.misfit < 2.5]
    return explained[0] if explained else min(curves, key=lambda one: one.misfit)


def _conductor(theta: np.ndarray, strengths: np.ndarray, white: Whitener, unit: Stated) -> ReflectanceCurve | None:
    if len(theta) < 4 or not (strengths > 0).all():
        return None
    start = fresnel_start("conductor", theta, strengths / unit.value, (unit.value / strengths) ** 2)
    about, prior = float(np.log(unit.value)), max(unit.std, 1e-6)

    def rows(c: np.ndarray) -> np.ndarray:
        return np.append(white(strengths - _curve("conductor", c, theta)[0]), (c[2] - about) / prior)

    def slopes(c: np.ndarray) -> np.ndarray:
        last = np.array([[0, 0, 1 / prior]])
        return np.concatenate([-white(_curve("conductor", c, theta)[1]), last])

    low, high = ([*(b[side] for b in ((-5.0, 4.0), (-9.0, 4.0))), (-90.0, 90.0)[side]] for side in (0, 1))
    found = least_squares(
        rows,
        np.clip([*start, about], np.add(low, 1e-9), np.subtract(high, 1e-9)),
        slopes,
        bounds=(low, high),
        x_scale="jac",
    )
    return _with_gain("conductor", found.x, theta, strengths, white, np.diag([0, 0, 1 / prior**2]))


def _smooth(theta: np.ndarray, strengths: np.ndarray, white: Whitener) -> ReflectanceCurve:
    _, basis = _curve("smooth", np.zeros(min(5, max(len(theta) - 2, 1))), theta)
    coefficients = np.linalg.lstsq(white(basis), white(strengths), rcond=None)[0]
    return _with_gain("smooth", coefficients, theta, strengths, white, np.zeros((len(coefficients),) * 2))


def _with_gain(
    model: str, coefficients: np.ndarray, theta: np.ndarray, strengths: np.ndarray, white: Whitener, prior: np.ndarray
) -> ReflectanceCurve:
    value, by_coefficients = _curve(model, coefficients, theta)
    slopes, residual = white(by_coefficients), white(strengths - value)
    inverse = scaled_inverse(slopes.T @ slopes + prior, undetermined=1e14)
    whitener = white(np.eye(len(theta)))
    misfit = float(residual @ residual / max(len(theta) - len(coefficients), 1))
    by_scale, by_misfit = inverse @ prior @ inverse, max(misfit - 1, 0.0) * inverse
    return ReflectanceCurve(model, coefficients, inverse @ slopes.T @ whitener, by_scale, by_misfit, misfit)


def _curve(model: str, coefficients: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the values of a curve, (angles,), and their derivatives with respect to the coefficients."""
    if model == "smooth":
        c = 1 - np.cos(theta)
        basis = np.column_stack([np.ones_like(c), c, c**3, c**5, c**9])[:, : len(coefficients)]
        return basis @ coefficients, basis
    value, by_index = map(np.asarray, _compiled_conductor()(coefficients[:2], theta))
    value, by_index = np.exp(coefficients[2]) * value, np.exp(coefficients[2]) * by_index
    return value, np.column_stack([by_index, value])


@cache
def _compiled_conductor() -> Callable[..., tuple[jax.Array, jax.Array]]:
    def curve(c: jax.Array, theta: jax.Array) -> jax.Array:
        return reflectance_at("conductor", c).at(theta)

    return jax.jit(lambda c, theta: (curve(c, theta), jax.jacfwd(curve)(c, theta)))
