"""Quadrature rules in [-1, 1]: Gauss-Legendre rules, and midpoint rules for integrands that vanish at both ends.

If all derivatives of a smooth integrand are negligible at both ends, the midpoint rule converges exponentially
(Trefethen and Weideman 2014, 10.1137/130932132). It requires half as many nodes as a Gauss-Legendre rule. The
derivatives are negligible at both ends of an arc if both ends lie on the border of a window.
"""

from __future__ import annotations

from functools import cache

import numpy as np

MOST_NODES = 256
"""Largest number of nodes on an arc."""


@cache
def arc_rule(even: bool, count: int) -> np.ndarray:
    """Compute nodes and weights of a rule, (2, count). even: True for the midpoint rule, False for Gauss-Legendre."""
    if even:
        return np.stack([(2 * np.arange(count) + 1) / count - 1, np.full(count, 2 / count)])
    return np.stack(np.polynomial.legendre.leggauss(count))


@cache
def arc_rules(even: bool, most: int, step: int = 2) -> np.ndarray:
    """Tabulate nodes and weights of rules by their number of nodes, padded with zeros, (2, most + 1, most).

    Only the numbers `step`, 2 `step`, ... up to `most` have rules. The numbers of nodes on arcs are even.
    """
    rules = np.zeros((2, most + 1, most))
    for count in range(step, most + 1, step):
        rules[:, count, :count] = arc_rule(even, count)
    return rules
