"""Inversion of information matrices whose parameters have different units.

An information matrix (the inverse of a covariance) is symmetric and positive semidefinite. Its entries may differ by a
factor of 1e20, because its parameters have different units; so it is scaled to a unit diagonal before it is inverted.
The data do not determine a direction whose eigenvalue is below `FLOOR`. `whitening` transforms correlated errors to
independent errors.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from matcam.core.arrays import linalg, xp

FLOOR = 1e-12
"""Smallest eigenvalue of a matrix with a unit diagonal. Rounding in sums of 1e6 products stays below it. A direction at
the floor has a standard deviation of 1e6 times that of its parameters alone: the data do not determine it.
"""

AnyMatrix = TypeVar("AnyMatrix", bound=Any)


def scaled_inverse(information: AnyMatrix, undetermined: float = 0.0) -> AnyMatrix:
    """Invert a symmetric, positive semidefinite matrix by means of a matrix with a unit diagonal.

    The matrix is scaled to a unit diagonal, and the inverse is scaled back. NumPy arrays are inverted by eigenvalue
    decomposition. Eigenvalues below `FLOOR` are replaced by `FLOOR`, so a matrix may be indefinite by rounding. JAX arrays
    are inverted by Cholesky decomposition, which compiles to a smaller program, after `FLOOR` is added to the diagonal.
    The relative difference between the two methods is `FLOOR` divided by the smallest eigenvalue.

    Args:
        information: matrix, or a stack of matrices (NumPy only), shape (..., n, n), in inverse squares of the units of
            the parameters.
        undetermined: variance of a parameter whose diagonal entry is not positive. Default: 0.0, the parameter is fixed.

    Returns:
        Inverse, the covariance of the parameters, an array of the same shape and kind.
    """
    if isinstance(information, np.ndarray):
        unit, inverse_std = _to_unit_diagonal(information)
        values, axes = np.linalg.eigh(unit)
        inverse = (axes / np.maximum(values, FLOOR)[..., None, :]) @ np.swapaxes(axes, -1, -2)
        covariance = inverse * inverse_std[..., :, None] * inverse_std[..., None, :]
        if undetermined:
            covariance += np.where(inverse_std > 0, 0.0, undetermined)[..., None] * np.eye(unit.shape[-1])
        return covariance
    return lifted_inverse(information, undetermined)


def lifted_inverse(information: AnyMatrix, undetermined: float = 0.0) -> AnyMatrix:
    """Invert one matrix by Cholesky decomposition, as `scaled_inverse` does for JAX arrays."""
    diagonal = xp.diagonal(information)
    scale = 1 / xp.sqrt(xp.where(diagonal > 0, diagonal, xp.inf))
    units = scale[:, None] * scale
    half = linalg.inv(linalg.cholesky(information * units + xp.diag(xp.where(scale > 0, FLOOR, 1.0))))
    inverse = half.T @ half * units
    return inverse + xp.diag(xp.where(scale > 0, 0.0, undetermined)) if undetermined else inverse


def whitening(covariance: np.ndarray) -> np.ndarray:
    """Compute the matrix that transforms errors with a covariance to independent errors of unit variance.

    covariance: positive definite matrix, shape (n, n).
    """
    return np.linalg.inv(np.linalg.cholesky(covariance))


def log_volume_ratio(prior: np.ndarray, information: np.ndarray) -> float:
    """Compute the logarithm of the ratio of the volumes of a normal posterior and of its prior.

    Args:
        prior: information matrix of the prior, positive definite, shape (n, n).
        information: information matrix of the data, same shape.
    """
    posterior, scale = _to_unit_diagonal(prior + information)
    before, after = (np.linalg.slogdet(one)[1] for one in (prior * np.outer(scale, scale), posterior))
    return 0.5 * float(before - after)


def least_eigenvalue(information: np.ndarray) -> float:
    """Compute the smallest eigenvalue of a matrix that is scaled to a unit diagonal.

    If the eigenvalue is below `FLOOR`, the data do not determine one direction of the parameters.
    """
    return float(np.linalg.eigvalsh(_to_unit_diagonal(information)[0])[0])


def _to_unit_diagonal(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale a matrix to a unit diagonal.

    The results are the scaled matrix and the factor of each row, which is 0 where the diagonal is not positive.
    """
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    return matrix * scale[..., :, None] * scale[..., None, :], scale
