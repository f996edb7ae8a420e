"""Division of the radiance into shares by the position of the surface element, for filters that depend on the position.

A kernel that varies smoothly with the position is approximated by a weighted sum of the kernels at few selected
positions. The weights are polynomials in x and y. Pivoted QR selects the positions. The kernels on the disc of the
sample are approximated by polynomials of the position. The coefficients of these polynomials are linear combinations of
the selected kernels, found by least squares.

The radiance is given on a grid, with a transform that is exact within the band of the lens. Multiplication by a smooth
weight mixes neighbouring frequencies only, so it may be applied to the values on the grid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander, chebvander2d
from scipy.linalg import qr

from matcam.core.jax import jax, jnp

_BEYOND = 4.0
"""Distance beyond the disc from which weights are constant, px. The image of a point at the limb has decreased there: the error
of the transfer functions is 1e-6, and 1e-7 for twice this distance.
"""


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

    def on_grid(self, x: np.ndarray, y: np.ndarray) -> GridWeights:
        """Prepare the weights on a grid. `x` and `y` are the positions of the columns and of the rows, px."""
        degree, end = self.coefficients.shape[0] - 1, 1 + _BEYOND / self.side
        along, across = (chebvander(np.clip(a / self.side, -end, end), degree) for a in (x, y))
        return GridWeights(across, along, np.moveaxis(self.coefficients, -1, 0))


class GridWeights(NamedTuple):
    """Weights of shares at the points of a grid, as products of factors of rows and of columns.

    Attributes:
        rows: Chebyshev polynomials of the rows, (rows, b).
        columns: Chebyshev polynomials of the columns, (columns, a).
        coefficients: coefficients of their products, (shares, a, b).
    """

    rows: np.ndarray
    columns: np.ndarray
    coefficients: np.ndarray

    def of(self, share: int | jax.Array) -> jax.Array:
        """Compute the weights of a share, (rows, columns, 1)."""
        return (self.rows @ jnp.asarray(self.coefficients)[share].T @ self.columns.T)[..., None]


def _evaluated(coefficients: np.ndarray, unit: np.ndarray) -> np.ndarray:
    degree = coefficients.shape[0] - 1
    return chebvander2d(unit[:, 0], unit[:, 1], [degree, degree]) @ coefficients.reshape((degree + 1) ** 2, -1)


def _in_disc(rings: int) -> np.ndarray:
    """Generate positions in the unit disc, (n, 2), denser towards its border."""
    radius = np.sin(np.pi / 2 * (np.arange(rings) + 0.5) / rings)
    turn = 2 * np.pi * (np.arange(2 * rings) + 0.5 * (np.arange(rings)[:, None] % 2)) / (2 * rings)
    return np.stack([radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)], axis=-1).reshape(-1, 2)
