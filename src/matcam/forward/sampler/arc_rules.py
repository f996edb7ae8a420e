"""Tables of quadrature rules in [-1, 1] with all numbers of nodes up to a limit.

On an arc whose ends lie on the border of a window, the integrand vanishes at both ends. The midpoint rule then converges
exponentially, and requires half as many nodes as a Gauss-Legendre rule (Trefethen and Weideman 2014, 10.1137/130932132).
"""

from __future__ import annotations

from functools import cache

import numpy as np

MOST_NODES = 256
"""Largest number of nodes on an arc."""


@cache
def gauss_rules(most: int) -> np.ndarray:
    """Tabulate Gauss-Legendre rules with 0 to `most` nodes, padded with zeros, (2, most + 1, most)."""
    rules = np.zeros((2, most + 1, most))
    for count in range(1, most + 1):
        rules[:, count, :count] = np.polynomial.legendre.leggauss(count)
    return rules


@cache
def midpoint_rules(most: int) -> np.ndarray:
    """Tabulate midpoint rules with 0 to `most` nodes, padded with zeros, (2, most + 1, most)."""
    rules = np.zeros((2, most + 1, most))
    for count in range(1, most + 1):
        rules[:, count, :count] = midpoints(count)
    return rules


def midpoints(count: int) -> np.ndarray:
    """Compute the nodes of the midpoint rule, and their weights, (2, count)."""
    return np.stack([(2 * np.arange(count) + 1) / count - 1, np.full(count, 2 / count)])
