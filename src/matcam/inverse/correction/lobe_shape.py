"""Uncertainty of the shape of a lobe.

The record is linear in the distribution D of the normals. After a fit, the coefficients b_k of a modified lobe D (1 + sum_k
b_k B_k(theta)) with smooth B_k are therefore determined by a linear least-squares problem (docs/model.md 8). This problem
includes small changes of the parameters of the fit, and the strengths are free in every slice. The evidence of the linear
model determines the prior variance of the b_k, and the posterior covariance of the b_k is the uncertainty of the shape. The
lobe itself is not modified, because a spline-modified lobe is a separate explanation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import placed
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_data import cell_variance, estimate_noise, huber_weights, standardised_residual, whitening
from matcam.inverse.fit.fit_readings import LinearisedFit
from matcam.inverse.fit.fit_statements import SMOOTH_LOBE, fit_statements, rig_statements
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.material.ndf.free_lobe import KNOTS, spline_smoothness
from matcam.numerics.approximation import smoothness
from matcam.numerics.fit_budget import Statement
from matcam.numerics.linalg import scaled_inverse

FAMILY_FAILS = 0.05
"""Scale of the shape correction above which the family does not explain the data."""

_SCALES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_ROUNDS = 3


class ShapeUncertainty(NamedTuple):
    """Uncertainty of the shape of a lobe, described by a factor 1 + sum_k b_k B_k of D.

    Attributes:
        covariance: covariance of the coordinates of lobe and rig and of the coefficients b, (lobe + rig + b, lobe + rig + b).
        scale: estimated prior standard deviation of the second differences of b (no unit).
        noise: noise of a pixel, specified or estimated with free coefficients b.
        statements: prior knowledge of lobe, rig and b. Default: none.
    """

    covariance: np.ndarray
    scale: float
    noise: PixelNoise
    statements: tuple[Statement, ...] = ()

    @property
    def family_fails(self) -> bool:
        return self.scale > FAMILY_FAILS

    def remark(self, family: str) -> Remark:
        return Remark(
            "family-fails",
            f"a {family} lobe does not explain the data (scale of the shape correction: {self.scale:g}): the fitted lobe was "
            "multiplied by a smooth factor, and the uncertainty includes the part of the shape that the pixels do not resolve",
        )


def shape_uncertainty(found: MaterialFit, noise: PixelNoise | None, kappa: float = 1.0) -> ShapeUncertainty:
    """Estimate the uncertainty of the shape of a fit with free strengths and one lobe.

    Args:
        found: fit with free strengths and one lobe.
        noise: noise of a pixel; None: it is estimated together with the shape.
        kappa: exponent of the likelihood (`evidence`). Default: 1.
    """
    linear = found.linearised()
    solution, at = linear.solution, linear.coordinates
    data, model = solution.problem.data, solution.model
    columns = _columns(linear)
    count, shapes = len(columns), slice(len(linear.by_coordinates), len(linear.by_coordinates) + KNOTS)
    rig = slice(len(at.lobe), len(linear.by_coordinates))
    # the scale is estimated with a uniform prior; with a stiffer tail, a deviating tail would increase the scale at the peak
    even, differences = smoothness(KNOTS), spline_smoothness()
    assumed = solution.noise
    result = np.zeros(count)
    scale, covariance = _SCALES[0], np.zeros((count, count))
    for _ in range(_ROUNDS):
        value = np.maximum(model.value + np.tensordot(result, columns, 1), 1e-3 * model.value)
        residual = linear.residual - np.tensordot(result, columns, 1)
        if noise is None:
            assumed = estimate_noise(data, np.where(data.used, residual, 0), value, count, assumed)
        robust = huber_weights(standardised_residual(data, value, assumed, np.inf))
        white = whitening(data, robust / cell_variance(data, value, assumed), model.lobe, np.inf)
        flat, target = white(columns).reshape(count, -1), white(linear.residual).ravel()
        information, right = kappa * flat @ flat.T, kappa * flat @ target
        information[rig, rig] += linear.rig_information
        scale = max(_SCALES, key=lambda one: linear_evidence(information, right, shapes, even / one))
        penalty = np.zeros((count, count))
        penalty[shapes, shapes] = differences.T @ differences / scale**2
        covariance = scaled_inverse(information + penalty)
        result = covariance @ right
    inner = slice(0, shapes.stop)
    statements = rig_statements(at.axes, linear.rig_information, rig.start, shapes.stop)
    smooth = Statement(SMOOTH_LOBE, penalty[inner, inner])
    return ShapeUncertainty(covariance[inner, inner], scale, assumed, (*statements, smooth))


def known_shape(found: MaterialFit, scale: float) -> ShapeUncertainty:
    """Build the uncertainty from the covariance of a fit, without a variance of the coefficients b.

    scale: scale of the shape correction that was estimated for the family of the lobe.
    """
    covariance = found.coordinates.covariance
    own = slice(0, len(covariance))
    statements = tuple(
        one._replace(information=np.pad(one.information[own, own], (0, KNOTS)))
        for one in fit_statements(found._solution)
    )
    return ShapeUncertainty(np.pad(covariance, (0, KNOTS)), scale, found.noise, statements)


def _columns(linear: LinearisedFit) -> np.ndarray:
    """Compute the derivatives of the model with respect to lobe, rig, b and units, (coordinates, u, s, n)."""
    at, solution = linear.coordinates, linear.solution
    ndf = at.kind.ndf(placed(at.lobe))
    added = solution.problem.read(solution.model, lambda one: one.by_shape(ndf, at.kind.masking, at.rig)[1])
    by_shape = np.nan_to_num(solution.model.strength)[None, :, :, None] * np.moveaxis(added, 0, 1)
    return np.concatenate([linear.by_coordinates, by_shape, linear.by_units])


def linear_evidence(information: np.ndarray, right: np.ndarray, shapes: slice, rows: np.ndarray) -> float:
    """Compute the log evidence of a scale, up to a constant.

    All parameters except the b_k are marginalised.

    Args:
        information: matrix of the normal equations of all parameters, without the prior of the b_k.
        right: right-hand side of these equations.
        shapes: indices of the b_k.
        rows: linear combinations of the b_k that have prior mean 0 and unit variance for this scale.
    """
    others = np.r_[0 : shapes.start, shapes.stop : len(right)]
    cross = information[shapes, others]
    inner = scaled_inverse(information[np.ix_(others, others)])
    data = information[shapes, shapes] - cross @ inner @ cross.T
    pull = right[shapes] - cross @ inner @ right[others]
    prior = rows.T @ rows
    total = data + prior
    return 0.5 * float(pull @ scaled_inverse(total) @ pull - np.linalg.slogdet(total)[1] + np.linalg.slogdet(prior)[1])
