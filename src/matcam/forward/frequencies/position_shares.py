"""Division of the radiance into shares by the position of the surface element, for filters that depend on the position.

A kernel that varies smoothly with the position is approximated by a weighted sum of the kernels at few selected
positions. The weights are polynomials in x and y. Pivoted QR selects the positions. The kernels on the disc of the
sample are approximated by polynomials of the position. The coefficients of these polynomials are linear combinations of
the selected kernels, found by least squares.

The radiance is given by its record R through a Gaussian of standard deviation s. Multiplication by x before the blur
corresponds to the operator x + s^2 d/dx after the blur. The record of the radiance multiplied by a weight w therefore
follows from R, as a sum over the orders a and b of derivatives in x and y (Laplace is the Laplace operator):

    sum over a, b of  s^(2a + 2b) / (a! b!)  d^(a+b)/dx^a dy^b [exp(s^2 Laplace / 2) w]  d^(a+b) R / dx^a dy^b.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander2d
from scipy.linalg import qr

from matcam.core.jax import jax, jnp

ORDER = 3
"""Highest order of the derivatives of a weight that are used."""
_STEEPEST = 3.0
"""Largest fourth derivative of a Gaussian with peak 1 and standard deviation 1."""


class PositionShares(NamedTuple):
    """Weights of the shares of the radiance, as functions of the position on the sensor.

    Attributes:
        side: radius of the disc about the optical axis in which the weights are valid, px.
        positions: positions of the selected kernels, (shares, 2), px.
        coefficients: coefficients of the products T_a(x / side) T_b(y / side) of Chebyshev polynomials of the degrees a
            and b, (a, b, shares). They are 0 if a + b exceeds the degree of the weights.
    """

    side: float
    positions: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def of(
        cls, degree: int, side: float, values: Callable[[np.ndarray], np.ndarray], left_out: float
    ) -> PositionShares:
        """Select positions, and compute the weights.

        Args:
            degree: degree of the polynomials.
            side: radius of the disc, px.
            values: function of positions, px, (positions, 2), that returns complex values of the kernels at these
                positions, (positions, values).
            left_out: largest norm of the neglected part of the values of a kernel.
        """
        unit = _in_disc(degree + 3)
        every = values(side * unit)
        every = np.concatenate([every.real, every.imag], axis=1)
        _, r, order = qr(every.T, mode="economic", pivoting=True)
        chosen = order[: max(1, int(np.sum(np.abs(np.diag(r)) > left_out)))]
        low = np.add.outer(np.arange(degree + 1), np.arange(degree + 1)).ravel() <= degree
        basis = chebvander2d(unit[:, 0], unit[:, 1], [degree, degree])[:, low]
        # the polynomials of the kernels are smooth; weights of nearly equal kernels need not be
        polynomials = np.linalg.lstsq(basis, every, rcond=None)[0]
        coefficients = np.zeros((low.size, chosen.size))
        coefficients[low] = np.linalg.lstsq(every[chosen].T, polynomials.T, rcond=None)[0].T
        return cls(side, side * unit[chosen], coefficients.reshape(degree + 1, degree + 1, -1))

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Evaluate the weights, (positions, shares).

        `positions` are on the sensor, px, (positions, 2).
        """
        return _evaluated(self.coefficients, positions / self.side)

    def left_over(self, sigma: float, values: np.ndarray) -> float:
        """Compute an upper bound of the error due to neglected derivatives, as a share of the peak of a record.

        Args:
            sigma: standard deviation of the Gaussian of the record, px.
            values: values of the kernels at the selected positions, (shares, values).
        """
        positions = _in_disc(self.coefficients.shape[0])
        more = [
            np.abs(_evaluated(self._derived(a, ORDER + 1 - a), positions) @ values).max()
            / (factorial(a) * factorial(ORDER + 1 - a))
            for a in range(ORDER + 2)
        ]
        return float(_STEEPEST * sigma ** (ORDER + 1) * max(more))

    def divided(
        self, record: Callable[[int, int], jax.Array], x: np.ndarray, y: np.ndarray, sigma: float
    ) -> list[jax.Array]:
        """Compute the record of each share of the radiance.

        Args:
            record: function that returns a derivative of the total record, (rows, columns, channels). Its arguments are
                the orders in x and in y.
            x: positions of the columns, px.
            y: positions of the rows, px.
            sigma: standard deviation of the Gaussian of the record, px.
        """
        degree = self.coefficients.shape[0] - 1
        along, across = (np.polynomial.chebyshev.chebvander(a / self.side, degree) for a in (x, y))
        shares: list[jax.Array] = [jnp.zeros(())] * len(self.positions)
        for a in range(ORDER + 1):
            for b in range(ORDER + 1 - a):
                one = record(a, b) * (sigma ** (2 * a + 2 * b) / (factorial(a) * factorial(b)))
                weight = self._spread(sigma)._derived(a, b)
                for k in range(len(shares)):
                    shares[k] = shares[k] + jnp.asarray(across @ weight[..., k].T @ along.T)[..., None] * one
        return shares

    def _spread(self, sigma: float) -> PositionShares:
        """Blur the weights w by a Gaussian: exp(sigma^2 Laplace / 2) w, up to the order sigma^4.

        `sigma` is the standard deviation of the Gaussian, px, and Laplace the Laplace operator.
        """
        one = self._replace(coefficients=self._derived(2, 0) + self._derived(0, 2))
        two = one._derived(2, 0) + one._derived(0, 2)
        return self._replace(coefficients=self.coefficients + sigma**2 / 2 * one.coefficients + sigma**4 / 8 * two)

    def _derived(self, along: int, across: int) -> np.ndarray:
        """Compute the coefficients of a derivative of the weights with respect to position in px.

        `along` is the order of the derivative in x, and `across` the order in y. The result has the shape of
        `coefficients`.
        """
        found = self.coefficients
        for axis, times in ((0, along), (1, across)):
            if times:
                found = chebder(found, times, scl=1 / self.side, axis=axis)
        padding = [(0, n - m) for n, m in zip(self.coefficients.shape, found.shape, strict=True)]
        return np.pad(found, padding)


def _evaluated(coefficients: np.ndarray, unit: np.ndarray) -> np.ndarray:
    degree = coefficients.shape[0] - 1
    return chebvander2d(unit[:, 0], unit[:, 1], [degree, degree]) @ coefficients.reshape((degree + 1) ** 2, -1)


def _in_disc(rings: int) -> np.ndarray:
    """Generate positions in the unit disc, (n, 2), denser towards its border."""
    radius = np.sin(np.pi / 2 * (np.arange(rings) + 0.5) / rings)
    turn = 2 * np.pi * (np.arange(2 * rings) + 0.5 * (np.arange(rings)[:, None] % 2)) / (2 * rings)
    return np.stack([radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)], axis=-1).reshape(-1, 2)
