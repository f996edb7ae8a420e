"""What the family of a lobe does not explain, by a regularised inverse of the camera's operator.

The record is linear in D. So after a fit, D (1 + sum_k b_k B_k(theta)) with smooth B_k is one linear least-squares problem,
solved together with small changes of the fit's own numbers, strengths of all pictures free. How much the b_k may vary is
learnt from the data (the evidence of the linear model): where the family explains them, they stay close to 0 and cost nothing;
where not, what the pixels cannot resolve of them becomes uncertainty.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.sensor import PixelNoise
from matcam.core.jax import jax, jnp
from matcam.inverse.fit import fit_data as picture_noise
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.fit.fit_result import MaterialFit
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.material.masking import Masking
from matcam.material.ndf.free_lobe import KNOTS, bend_basis
from matcam.numerics.interpolate import smoothness
from matcam.numerics.linalg import scaled_inverse

BENT = 0.05
"""Strength of a shape's correction beyond which its family does not explain the data."""

_STRENGTHS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_ROUNDS = 3


class ShapeCorrection(NamedTuple):
    """1 + sum b_k B_k, and what is known of it. The fit's lobe and camera numbers come first in the covariance."""

    b: np.ndarray
    covariance: np.ndarray
    """Of (lobe, camera, b), each in the fit's coordinates."""
    strength: float
    """Standard deviation of the second differences of b that the data ask for."""
    noise: PixelNoise
    """As estimated with the correction made, or as given."""
    improvement: float
    """By how much the sum of squared residuals falls."""


@eqx.filter_jit
def shape_records(
    operator: LobeOperator, family: str, masking: Masking, q: jax.Array, shifts: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """(A, what each B_k adds to it): shapes (slices, cells) and (k, slices, cells)."""
    ndf = parameters.ndf_at(family, q)
    slope2 = jnp.tan(jnp.minimum(operator.theta, 1.57)) ** 2
    factors = jnp.stack(bend_basis(slope2))
    return operator.record(ndf, masking, shifts), operator.records(ndf, masking, shifts, factors)


def shape_correction(found: MaterialFit, noise: PixelNoise | None) -> ShapeCorrection:
    """The likeliest correction of a fit with free strengths and one lobe. noise: given; None: estimated anew."""
    problem, solved, layout = found.problem, found.solved, found.problem.layout
    lobe, camera = layout.lobe(0), layout.camera
    held = np.r_[lobe, camera]
    _, added = shape_records(
        problem.operator, layout.family, layout.masking, jnp.asarray(solved.p[lobe]), jnp.asarray(solved.p[camera])
    )
    added_to = np.nan_to_num(solved.model.strength)[None, :, :, None] * np.asarray(added)[:, None]
    columns = np.concatenate([solved.model.derivative[held], added_to])
    body = [n for u in range(len(layout.lobe_of)) for n in range(layout.unit(u).start, layout.unit(u).stop)]
    columns = np.concatenate([columns, solved.model.derivative[body]]) if body else columns
    differences = smoothness(KNOTS)
    known = np.linalg.inv(_prior_covariance(found)) if camera.stop > camera.start else np.zeros((0, 0))
    residual = np.where(problem.data.used, problem.data.values - solved.model.value, 0.0)
    assumed = solved.noise
    count, shapes = len(columns), slice(len(held), len(held) + KNOTS)
    own = slice(lobe.stop - lobe.start, len(held))
    solution = np.zeros(count)
    strength, covariance, before, after = _STRENGTHS[0], np.zeros((count, count)), 1.0, 1.0
    for _ in range(_ROUNDS):
        value = np.maximum(solved.model.value + np.tensordot(solution, columns, 1), 1e-3 * solved.model.value)
        rest = residual - np.tensordot(solution, columns, 1)
        if noise is None:
            assumed = picture_noise.estimated(problem.data, np.where(problem.data.used, rest, 0), value, count, assumed)
        robust = picture_noise.huber(picture_noise.without_gain(problem.data, rest, value, assumed, np.inf))
        weight = robust / picture_noise.variance(problem.data, value, assumed)
        white = picture_noise.whitening(problem.data, weight, solved.model.lobe, np.inf)
        flat, target = white(columns).reshape(count, -1), white(residual).ravel()
        information, right = flat @ flat.T, flat @ target
        information[own, own] += known
        strength = max(_STRENGTHS, key=lambda tau: _evidence(information, right, shapes, differences / tau))
        penalty = np.zeros((count, count))
        penalty[shapes, shapes] = differences.T @ differences / strength**2
        covariance = scaled_inverse(information + penalty)
        solution = covariance @ right
        before, after = float(target @ target), float(((target - solution @ flat) ** 2).sum())
    b = np.maximum(solution[shapes], -0.999)
    inner = np.r_[0 : shapes.stop]
    return ShapeCorrection(b, covariance[np.ix_(inner, inner)], strength, assumed, before - after)


def remark_on_shape(shape: ShapeCorrection, family: str) -> str:
    """What a reader should know of a family that does not explain the data, in plain words."""
    return (
        f"no {family} lobe explains the data: its shape was bent (strength {shape.strength:g}), and what the pixels do "
        "not resolve of that shape counts as uncertainty"
    )


def unshaped(found: MaterialFit, strength: float) -> ShapeCorrection:
    """No correction of a fit whose lobe is bent already: its own covariance, no b. strength: what the family had asked for."""
    layout, covariance = found.problem.layout, found.solved.covariance
    held = np.r_[layout.lobe(0), layout.camera]
    whole = np.zeros((held.size + KNOTS, held.size + KNOTS))
    whole[: held.size, : held.size] = covariance[np.ix_(held, held)]
    return ShapeCorrection(np.zeros(KNOTS), whole, strength, found.noise, 0.0)


def _prior_covariance(found: MaterialFit) -> np.ndarray:
    """Of the camera's shifts, as they were known before; endless where they were free."""
    root = found.prior.root
    if not root.any():
        return np.eye(len(root)) * 1e6
    return np.linalg.inv(root.T @ root)


def _evidence(information: np.ndarray, right: np.ndarray, shapes: slice, rows: np.ndarray) -> float:
    """Logarithm of the evidence for a strength, up to a constant: everything but the b_k is integrated out."""
    others = np.r_[0 : shapes.start, shapes.stop : len(right)]
    cross = information[shapes, others]
    inner = scaled_inverse(information[np.ix_(others, others)])
    data = information[shapes, shapes] - cross @ inner @ cross.T
    pull = right[shapes] - cross @ inner @ right[others]
    prior = rows.T @ rows
    total = data + prior
    return 0.5 * float(pull @ scaled_inverse(total) @ pull - np.linalg.slogdet(total)[1] + np.linalg.slogdet(prior)[1])
