"""Uncertainty budgets of fitted results, computed from the covariance of the fit (JCGM 100:2008, 5).

A least-squares fit with priors is linear at its solution: the parameters are p = C (J' W y + L m). Here C is the covariance
of the parameters, J the derivative of the readings y with respect to the parameters, and W the weights of the readings.
The specified values m have the information matrix L. The readings and the specified values are independent sources, and
their variances C J' W J C and C L C add up to C. A budget therefore follows from the covariance of a fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse.csgraph import connected_components

from matcam.numerics.budget import UncertaintyBudget, UncertaintySource
from matcam.numerics.linalg import scaled_inverse

_EFFECT = 1e-6
"""Share of the combined uncertainty below which a source is neglected. Its share of the variance, 1e-12, is comparable to
rounding errors.
"""
_UNCORRELATED = 1e-9
"""Relative off-diagonal information below which the priors of two parameters are independent. Smaller values are
rounding errors.
"""


class StatedParameter(NamedTuple):
    """Specified value of one parameter of a fit.

    Attributes:
        position: index of the parameter among the coordinates of the fit.
        name: name of the parameter, with its unit.
        value: specified value, in this unit.
        slope: derivative of the value with respect to the coordinate of the fit, in the unit of the value.
    """

    position: int
    name: str
    value: float
    slope: float


class Statement(NamedTuple):
    """Prior knowledge of the parameters of a fit (type B).

    Attributes:
        name: name of the source.
        information: information matrix of this knowledge about the coordinates of the fit, (n, n).
        stated: specified parameters. Each of them is a source, and these sources may be correlated. Default: (), the
            prior knowledge is one source in the unit of the result.
    """

    name: str
    information: np.ndarray
    stated: tuple[StatedParameter, ...] = ()

    def variance(self, slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Compute the variances of results, (...), due to this prior knowledge.

        slopes: derivatives of the results with respect to the coordinates of the fit, (..., n). covariance: covariance of
        the coordinates, (n, n).
        """
        moved = slopes @ covariance
        return np.einsum("...p,pq,...q->...", moved, self.information, moved)

    def sources(self, slope: np.ndarray, covariance: np.ndarray) -> tuple[list[UncertaintySource], np.ndarray]:
        """List the sources of one result, and compute their correlation matrix.

        slope: derivatives of the result with respect to the coordinates of the fit, (n,). covariance: covariance of the
        coordinates, (n, n).
        """
        if not self.stated:
            whole = math.sqrt(max(float(self.variance(slope, covariance)), 0.0))
            return [UncertaintySource(self.name, 0.0, whole, 1.0, "B")], np.eye(1)
        positions = [one.position for one in self.stated]
        prior = scaled_inverse(self.information[np.ix_(positions, positions)])
        moved = (self.information @ (covariance @ slope))[positions]
        std = np.sqrt(np.diag(prior))
        found = [
            UncertaintySource(one.name, one.value, abs(one.slope) * own, float(by / one.slope), "B")
            for one, own, by in zip(self.stated, std.tolist(), moved.tolist(), strict=True)
        ]
        signs = np.sign([one.slope for one in self.stated])
        correlation = prior / np.outer(std, std) * np.outer(signs, signs)
        np.fill_diagonal(correlation, 1.0)
        return found, correlation


class Readings(NamedTuple):
    """Readings of a fit as one source of uncertainty.

    Attributes:
        name: name of the source.
        kind: "A" if the noise is estimated from the readings, "B" if it is specified.
        degrees: degrees of freedom, no unit. Default: infinite.
    """

    name: str
    kind: Literal["A", "B"]
    degrees: float = math.inf


class VariancePart(NamedTuple):
    """Variances of several results due to one source.

    Attributes:
        name: name of the source.
        kind: type of the source, "A" or "B".
        variance: variances of the results due to this source, in the squared unit of the results.
        value: estimate of the source, in its unit. Default: 0, for a correction.
        uncertainty: standard uncertainty of the source, in its unit. Default: None, the source has the unit of the
            result and the sensitivity 1.
        degrees: degrees of freedom, no unit. Default: infinite.
    """

    name: str
    kind: Literal["A", "B"]
    variance: np.ndarray
    value: float = 0.0
    uncertainty: float | None = None
    degrees: float = math.inf

    def scaled(self, factor: np.ndarray | float) -> Self:
        return self._replace(variance=self.variance * factor)

    def source(self, at: Any) -> UncertaintySource:
        """Convert the part to a source of uncertainty of the result at index `at`."""
        std = math.sqrt(max(float(self.variance[at]), 0.0))
        if not self.uncertainty:
            return UncertaintySource(self.name, self.value, std, 1.0, self.kind, self.degrees)
        return UncertaintySource(
            self.name, self.value, self.uncertainty, std / self.uncertainty, self.kind, self.degrees
        )


def scaled_parts(parts: Sequence[VariancePart], factor: np.ndarray | float) -> tuple[VariancePart, ...]:
    return tuple(part.scaled(factor) for part in parts)


def statement_parts(
    statements: Sequence[Statement],
    slopes: np.ndarray,
    covariance: np.ndarray,
    variance: np.ndarray,
    readings: Readings,
) -> tuple[VariancePart, ...]:
    """Split variances of fitted results into the parts due to priors and readings.

    Args:
        statements: prior knowledge.
        slopes: derivatives of the results with respect to the coordinates of the fit, (..., n).
        covariance: covariance of the coordinates, (n, n).
        variance: variances of the results, (...).
        readings: source to which the remaining variance is attributed.

    Returns:
        Part of the readings, then one part for each of `statements`.
    """
    parts = []
    for one in statements:
        own = one.variance(slopes, covariance)
        if len(one.stated) == 1:
            (stated,) = one.stated
            std = abs(stated.slope) / math.sqrt(one.information[stated.position, stated.position])
            parts.append(VariancePart(stated.name, "B", own, stated.value, std))
        else:
            parts.append(VariancePart(one.name, "B", own))
    remainder = np.maximum(variance - sum((part.variance for part in parts), np.zeros_like(variance)), 0.0)
    return (VariancePart(readings.name, readings.kind, remainder, degrees=readings.degrees), *parts)


def parts_budget(name: str, value: float, parts: Sequence[VariancePart], at: Any = ()) -> UncertaintyBudget:
    """Build the budget of one of several results.

    Sources with a negligible contribution are omitted. at: index of the result. Default: (), there is only one result.
    """
    sources = [part.source(at) for part in parts]
    least = _EFFECT * math.sqrt(sum(one.contribution**2 for one in sources))
    return UncertaintyBudget(name, value, [one for one in sources if one.contribution > least] or sources[:1])


def posterior_budget(
    name: str,
    value: float,
    slope: np.ndarray,
    covariance: np.ndarray,
    statements: Sequence[Statement],
    readings: Readings,
    more: Sequence[UncertaintySource] = (),
) -> UncertaintyBudget:
    """Build the budget of a result of a fit with priors.

    The result is linear in the parameters of the fit.

    Args:
        name: name of the result, with its unit.
        value: estimate of the result, in its unit.
        slope: derivatives of the result with respect to the coordinates of the fit, (n,).
        covariance: covariance of the coordinates, (n, n).
        statements: prior knowledge of the parameters.
        readings: source to which the remaining variance of the fit is attributed.
        more: independent sources other than the fit. Default: (), none.
    """
    sources, blocks, stated = [], [np.eye(1)], 0.0
    for one in statements:
        found, correlation = one.sources(slope, covariance)
        if any(source.contribution > 0 for source in found):
            sources += found
            blocks.append(correlation)
            stated += float(one.variance(slope, covariance))
    own = math.sqrt(max(float(slope @ covariance @ slope) - stated, 0.0))
    first = UncertaintySource(readings.name, float(value), own, 1.0, readings.kind, readings.degrees)
    correlation = block_diag(*blocks, np.eye(len(more)))
    return UncertaintyBudget(name, value, [first, *sources, *more], correlation)


def stated_parameters(
    name: str, information: np.ndarray, stated: Sequence[StatedParameter], *, least: float = 0.0
) -> list[Statement]:
    """Build one `Statement` for each group of correlated parameters.

    Args:
        name: name of each group of several parameters. A single parameter keeps its own name.
        information: information matrix of the priors, in the coordinates of the fit, (n, n).
        stated: specified parameters. Parameters without prior knowledge are omitted.
        least: information of a parameter (diagonal entry) up to which the parameter is treated as having no prior. Default: 0.
    """
    known = [one for one in stated if information[one.position, one.position] > least]
    if not known:
        return []
    positions = [one.position for one in known]
    _, group = connected_components(
        np.abs(information[np.ix_(positions, positions)]) > _UNCORRELATED * _scale(information, positions)
    )
    found = []
    for index in range(max(group) + 1):
        inside = [one for one, own in zip(known, group, strict=True) if own == index]
        own = [one.position for one in inside]
        part = np.zeros_like(information)
        part[np.ix_(own, own)] = information[np.ix_(own, own)]
        found.append(Statement(name if len(inside) > 1 else inside[0].name, part, tuple(inside)))
    return found


def _scale(information: np.ndarray, positions: list[int]) -> np.ndarray:
    root = np.sqrt(np.diag(information)[positions])
    return np.outer(root, root)
