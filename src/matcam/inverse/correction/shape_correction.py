"""The part of a lobe that its family does not explain, by a regularised inverse of the operator (docs/model.md 8).

The record is linear in D. So after a fit, D (1 + sum_k b_k B_k(theta)) with smooth B_k is one linear least-squares problem. It
is solved together with small changes of the fit's own parameters, strengths free in every slice. How much the b_k may vary is
learnt from the data, by the evidence of the linear model. Where the family explains the data they stay close to 0 and cost
nothing. Where not, what the pixels cannot resolve of them becomes uncertainty.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_data import (
    cell_variance,
    estimate_noise,
    huber_weights,
    standardised_residual,
    whitening,
)
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.fit_readings import LinearisedFit
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.material.ndf.free_lobe import KNOTS, bend_basis
from matcam.numerics.interpolate import smoothness
from matcam.numerics.linalg import scaled_inverse

FAMILY_FAILS = 0.05
"""Scale of a shape's correction beyond which its family does not explain the data."""

_SCALES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_ROUNDS = 3
_LEAST_CHANGE = -0.999
"""Smallest b_k: a lobe stays positive."""


class ShapeCorrection(NamedTuple):
    """Hold 1 + sum b_k B_k, the factor of a lobe, and what is known of it.

    Attributes:
        b: (KNOTS,), coefficients of the splines.
        covariance: of (lobe, rig, b), the first two in the fit's coordinates.
        scale: standard deviation of the second differences of b that the data ask for.
        noise: as estimated with the correction made, or as given.
        improvement: by how much the sum of squared residuals falls.
    """

    b: np.ndarray
    covariance: np.ndarray
    scale: float
    noise: PixelNoise
    improvement: float

    @property
    def family_fails(self) -> bool:
        """Say whether the lobe's family does not explain the data."""
        return self.scale > FAMILY_FAILS

    def remark(self, family: str) -> Remark:
        """Say what a reader should know of a family that does not explain the data."""
        return Remark(
            "family-fails",
            f"no {family} lobe explains the data: its shape was bent (scale {self.scale:g}), and what the pixels do "
            "not resolve of that shape counts as uncertainty",
        )


@eqx.filter_jit
def shape_records(
    operator: LobeOperator, kind: LobeKind, q: jax.Array, shifts: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the record of a lobe and what each B_k adds to it: (slices, cells) and (k, slices, cells)."""
    ndf = kind.ndf(q)
    slope2 = jnp.tan(jnp.minimum(operator.theta, 1.57)) ** 2
    factors = jnp.stack(bend_basis(slope2))
    return operator.record(ndf, kind.masking, shifts), operator.records(ndf, kind.masking, shifts, factors)


def shape_correction(found: MaterialFit, noise: PixelNoise | None) -> ShapeCorrection:
    """Return the likeliest correction of a fit with free strengths and one lobe. noise: None: estimated anew."""
    linear = found.linearised()
    solution, at = linear.solution, linear.coordinates
    data, model = solution.problem.data, solution.model
    columns = _columns(linear)
    count, shapes = len(columns), slice(len(linear.by_coordinates), len(linear.by_coordinates) + KNOTS)
    rig = slice(len(at.lobe), len(linear.by_coordinates))
    differences = smoothness(KNOTS)
    assumed = solution.noise
    result = np.zeros(count)
    scale, covariance, before, after = _SCALES[0], np.zeros((count, count)), 1.0, 1.0
    for _ in range(_ROUNDS):
        value = np.maximum(model.value + np.tensordot(result, columns, 1), 1e-3 * model.value)
        rest = linear.residual - np.tensordot(result, columns, 1)
        if noise is None:
            assumed = estimate_noise(data, np.where(data.used, rest, 0), value, count, assumed)
        robust = huber_weights(standardised_residual(data, rest, value, assumed, np.inf))
        white = whitening(data, robust / cell_variance(data, value, assumed), model.lobe, np.inf)
        flat, target = white(columns).reshape(count, -1), white(linear.residual).ravel()
        information, right = flat @ flat.T, flat @ target
        information[rig, rig] += linear.rig_information
        scale = max(_SCALES, key=lambda one: _evidence(information, right, shapes, differences / one))
        penalty = np.zeros((count, count))
        penalty[shapes, shapes] = differences.T @ differences / scale**2
        covariance = scaled_inverse(information + penalty)
        result = covariance @ right
        before, after = float(target @ target), float(((target - result @ flat) ** 2).sum())
    b = np.maximum(result[shapes], _LEAST_CHANGE)
    inner = np.r_[0 : shapes.stop]
    return ShapeCorrection(b, covariance[np.ix_(inner, inner)], scale, assumed, before - after)


def no_correction(found: MaterialFit, scale: float) -> ShapeCorrection:
    """Return no correction of a fit whose lobe is bent already: its own covariance, no b.

    scale: the scale that its family had asked for.
    """
    covariance = found.coordinates.covariance
    padded = np.pad(covariance, (0, KNOTS))
    return ShapeCorrection(np.zeros(KNOTS), padded, scale, found.noise, 0.0)


def _columns(linear: LinearisedFit) -> np.ndarray:
    """Return the derivatives of the model by lobe, rig, b and the units' parameters."""
    at, solution = linear.coordinates, linear.solution
    _, added = shape_records(solution.problem.operator, at.kind, jnp.asarray(at.lobe), jnp.asarray(at.rig))
    by_shape = np.nan_to_num(solution.model.strength)[None, :, :, None] * np.asarray(added)[:, None]
    return np.concatenate([linear.by_coordinates, by_shape, linear.by_units])


def _evidence(information: np.ndarray, right: np.ndarray, shapes: slice, rows: np.ndarray) -> float:
    """Return the logarithm of the evidence for a scale, up to a constant: all but the b_k is integrated out."""
    others = np.r_[0 : shapes.start, shapes.stop : len(right)]
    cross = information[shapes, others]
    inner = scaled_inverse(information[np.ix_(others, others)])
    data = information[shapes, shapes] - cross @ inner @ cross.T
    pull = right[shapes] - cross @ inner @ right[others]
    prior = rows.T @ rows
    total = data + prior
    return 0.5 * float(pull @ scaled_inverse(total) @ pull - np.linalg.slogdet(total)[1] + np.linalg.slogdet(prior)[1])
