"""Polynomials of two coordinates."""

from __future__ import annotations

import numpy as np

from matcam.core.arrays import FloatArray


def plane_orders(degree: int) -> list[tuple[int, int]]:
    """List the exponents (i, j) of x^i y^j up to a degree: 1, x, y, x^2, x y, y^2, ..."""
    return [(n - j, j) for n in range(degree + 1) for j in range(n + 1)]


def plane_powers(x: FloatArray, y: FloatArray, degree: int) -> FloatArray:
    """Compute the terms x^i y^j of a polynomial, in the order of `plane_orders` along an additional last axis.

    Args:
        x: first coordinate, any shape.
        y: second coordinate, of the same shape.
        degree: largest sum of the exponents i and j.
    """
    # products are faster than powers
    of_x, of_y = [np.ones_like(x)], [np.ones_like(y)]
    for _ in range(degree):
        of_x.append(of_x[-1] * x)
        of_y.append(of_y[-1] * y)
    return np.moveaxis(np.stack([of_x[i] * of_y[j] for i, j in plane_orders(degree)]), 0, -1)


def plane_fit(x: FloatArray, y: FloatArray, values: FloatArray, degree: int) -> FloatArray:
    """Fit a polynomial of x and y by least squares.

    Args:
        x: first coordinate, (n,).
        y: second coordinate, (n,).
        values: values at the coordinates, (n, ...).
        degree: largest sum of the exponents i and j.

    Returns:
        Coefficients of x^i y^j, (degree + 1, degree + 1, ...), as for `numpy.polynomial.polynomial.polyval2d`.
    """
    found = np.zeros((degree + 1, degree + 1, *values.shape[1:]))
    i, j = np.transpose(plane_orders(degree))
    found[i, j] = np.linalg.lstsq(plane_powers(x, y, degree), values, rcond=None)[0]
    return found
