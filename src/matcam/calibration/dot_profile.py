"""What pixels read of a round dot: disc, Gaussian and square pixel, by quadrature over the disc; and its derivatives.

A Gaussian and a square are separable, so a node of the disc is a product of two erf differences. Derivatives by the place are
those of the Gaussian; by the variance, half the second ones. All of them come from one table of the derivatives along x and y.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from matcam.calibration.wave_fit import Array

_RADIAL, _ROUND = 5, 14
_AT_ONCE = 512  # dots: their tables fit into memory, whatever the grid
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_RADIAL)
_TURN = 2 * np.pi * (np.arange(_ROUND)[None] + 0.5 * (np.arange(_RADIAL)[:, None] % 2)) / _ROUND
_RADIUS = np.sqrt((_NODES + 1) / 2)[:, None]
_DISC = np.stack([(_RADIUS * np.cos(_TURN)).ravel(), (_RADIUS * np.sin(_TURN)).ravel()])
_SHARE = np.repeat(_WEIGHTS / 2 / _ROUND, _ROUND)


def derivatives(
    x: Array, y: Array, shape: Array, sigma: Array, half_width: float, orders: list[tuple[int, int]]
) -> Array:
    """(orders, n, height, width): derivatives by (x, y), of the given orders, of what pixels read of dots of unit content.

    x, y: (n, width), (n, height) px from the dots' centres to the pixels'. shape: (n, 2, 2) px: takes the unit disc to the
    dot. sigma: (n,) px.
    """
    if len(x) > _AT_ONCE:
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(x), _AT_ONCE)]
        return np.concatenate([derivatives(x[p], y[p], shape[p], sigma[p], half_width, orders) for p in parts], axis=1)
    offset = np.einsum("nij,jk->nik", shape, _DISC)
    along = [_axis(g[:, :, None] - o[:, None, :], sigma, half_width, max(w)) for g, o, w in (
        (x, offset[:, 0], [i for i, _ in orders]), (y, offset[:, 1], [j for _, j in orders]),
    )]  # fmt: skip
    return np.stack([np.matmul(along[1][j] * _SHARE, along[0][i].transpose(0, 2, 1)) for i, j in orders])


def _axis(t: Array, sigma: Array, half_width: float, highest: int) -> list[Array]:
    """The one-dimensional kernel, Gaussian times box, at t px (n, pixels, nodes), and its derivatives."""
    s = sigma[:, None, None]
    ends = [(t + half_width) / s, (t - half_width) / s]
    table = [(ndtr(ends[0]) - ndtr(ends[1])) / (2 * half_width)]
    if highest:
        bell = [np.exp(-z * z / 2) / np.sqrt(2 * np.pi) for z in ends]
        # d^k/dz^k of the normal density: (-1)^k He_k(z) times it
        hermite = [lambda z: 1.0, lambda z: -z, lambda z: z * z - 1, lambda z: -(z * z * z) + 3 * z]
        for k in range(highest):
            table.append(
                (hermite[k](ends[0]) * bell[0] - hermite[k](ends[1]) * bell[1]) / (2 * half_width * s ** (k + 1))
            )
    return table
