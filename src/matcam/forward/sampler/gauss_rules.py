"""Table of Gauss-Legendre rules with all numbers of nodes up to a limit."""

from __future__ import annotations

from functools import cache

import numpy as np

MOST_NODES = 256
"""Largest number of Gauss-Legendre nodes on an arc."""


@cache
def gauss_rules(most: int) -> np.ndarray:
    """Tabulate Gauss-Legendre rules with 0 to `most` nodes, padded with zeros, (2, most + 1, most)."""
    rules = np.zeros((2, most + 1, most))
    for count in range(1, most + 1):
        rules[:, count, :count] = np.polynomial.legendre.leggauss(count)
    return rules
