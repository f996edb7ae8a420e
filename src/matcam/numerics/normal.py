"""Normal distribution: density, standard deviation of values with outliers, and least squares without outliers."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core.arrays import FloatArray, xp

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

SIGNIFICANT = 5.0
"""Number of standard deviations above which a deviation is not noise. A normal value exceeds it with probability 6e-7."""
IMPROBABLE = 1e-3
"""Probability of the data under a model below which the model is rejected."""
_ROBUST = 1.4826
"""Standard deviation of normal values divided by their median absolute value."""
_FAR = 4.0
"""Number of standard deviations above which a residual is an outlier. The probability of a larger normal value is 1 in
16,000.
"""
_ROUNDS = 4
"""Number of fits, each without the outliers of the previous fit."""


def normal_density(x: ArrayLike, std: ArrayLike = 1.0) -> jax.Array:
    """Evaluate the normal density exp(-x^2 / (2 std^2)) / (sqrt(2 pi) std)."""
    return xp.exp(-xp.square(xp.divide(x, std)) / 2) / (np.sqrt(2 * np.pi) * std)


class RobustFit(NamedTuple):
    """Linear fit without outliers.

    Attributes:
        parameters: fitted parameters, (k,).
        covariance: covariance of the parameters that follows from the given standard deviations of the values, (k, k).
        chi2: chi squared per degree of freedom. `covariance` times `chi2` is the covariance that follows from the residuals.
        kept: True for values that are not outliers, (n,).
    """

    parameters: FloatArray
    covariance: FloatArray
    chi2: float
    kept: np.ndarray


def robust_std(values: FloatArray) -> float:
    """Estimate the standard deviation of normal values of mean 0.

    Outliers have little effect.
    """
    return _ROBUST * float(np.median(np.abs(values)))


def robust_fit(
    design: FloatArray,
    values: FloatArray,
    std: FloatArray | float = 1.0,
    *,
    least: float = 1e-12,
    resolved: float = 1e-12,
) -> RobustFit:
    """Fit values by linear least squares without outliers.

    Args:
        design: derivatives of the values with respect to the parameters, (n, k).
        values: measured values, (n,).
        std: standard deviations of the values, (n,), or one standard deviation for all values. Default: 1.0.
        least: smallest robust standard deviation of the residuals, relative to `std`, with which outliers are found.
            Default: 1e-12.
        resolved: smallest singular value of the design, relative to the largest. Smaller values are treated as 0.
            Default: 1e-12.
    """
    design, values = design / np.broadcast_to(std, len(values))[:, None], values / std
    kept = np.ones(len(values), bool)
    for _ in range(_ROUNDS):
        parameters = np.linalg.lstsq(design[kept], values[kept], rcond=resolved)[0]
        left = values - design @ parameters
        kept = np.abs(left) < _FAR * max(robust_std(left[kept]), least)
    chi2 = float((left[kept] ** 2).sum()) / max(int(kept.sum()) - design.shape[1], 1)
    inverse = np.linalg.pinv(design[kept], rcond=resolved)
    return RobustFit(np.asarray(parameters, float), np.asarray(inverse @ inverse.T, float), chi2, kept)
