"""Uncertainty budget (*Guide to the expression of uncertainty in measurement*, JCGM 100:2008, 5 and G.4).

u_c^2 = sum_ij c_i c_j u_i u_j r_ij       combined standard uncertainty u_c, from sensitivities c_i, standard uncertainties
                                          u_i and correlations r_ij of the sources
1 / nu = sum_i (c_i u_i)^4 / (nu_i u_c^4) effective degrees of freedom nu (Welch-Satterthwaite, for independent sources)
U = k u_c                                 expanded uncertainty U: k = 2, or Student's t at 95.45 % for finite nu
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.special import stdtrit

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.io import plain, write_columns, write_json

_COVERAGE = 0.9545
"""Probability of +-2 standard deviations of a normal distribution."""
_COLUMNS = ("source", "type", "value", "standard_uncertainty", "sensitivity", "contribution", "degrees_of_freedom")
_STEP = 1e-3
"""Step of a numerical sensitivity, in standard uncertainties of the source. The relative error is its square."""


class UncertaintySource(NamedTuple):
    """One source of uncertainty.

    Attributes:
        name: name of the source, with its unit.
        value: estimate of the source, in its unit.
        uncertainty: standard uncertainty of the source, in its unit.
        sensitivity: derivative of the result with respect to the source, in the unit of the result per unit of the source.
        kind: "A": evaluated by statistics of repeated readings; "B": evaluated by other means (JCGM 100, 4.2 and 4.3).
        degrees: degrees of freedom of the uncertainty, no unit. Default: infinite.

    Example:
        >>> matcam.UncertaintySource("length, m", 1.0, 0.001, 2.0, "B").contribution
        0.002
    """

    name: str
    value: float
    uncertainty: float
    sensitivity: float
    kind: Literal["A", "B"]
    degrees: float = math.inf

    @property
    def contribution(self) -> float:
        """Standard uncertainty of the result due to this source alone.

        The unit is that of the result.
        """
        return abs(self.sensitivity) * self.uncertainty


class UncertaintyBudget:
    """Uncertainty budget of one result.

    Args:
        name: name of the result, with its unit.
        value: estimate of the result, in its unit.
        sources: sources of uncertainty, at least one.
        correlation: correlation matrix of the sources, no unit, (n, n). Default: None, the sources are independent.

    Raises:
        ArgumentError: an argument or a field of a source has the wrong type or is out of range, there is no source, or
            `correlation` is not a correlation matrix.

    Example:
        >>> one = matcam.UncertaintySource("a", 1.0, 0.3, 1.0, "A", 9)
        >>> other = matcam.UncertaintySource("b", 2.0, 0.4, 1.0, "B")
        >>> budget = matcam.UncertaintyBudget("a + b", 3.0, [one, other])
        >>> budget.combined, round(budget.coverage_factor, 2)
        (0.5, 2.04)
    """

    def __init__(
        self,
        name: str,
        value: float,
        sources: Sequence[UncertaintySource],
        correlation: Sequence[Sequence[float]] | None = None,
    ):
        self.name = checks.instance("name", name, str)
        self.value = float(checks.scalar("value", checks.numbers("value", value)))
        self.sources = tuple(_checked(one) for one in checks.instances("sources", sources, UncertaintySource))
        n = len(self.sources)
        if not n:
            raise ArgumentError(f"the budget of {name!r:.60} needs at least one source: give an UncertaintySource")
        matrix = np.eye(n) if correlation is None else np.asarray(checks.number("correlation", correlation))
        if matrix.shape != (n, n):
            raise ArgumentError(f"the correlation of {n} sources must have shape ({n}, {n}), got {matrix.shape}")
        wrong = np.abs(matrix - matrix.T).max() > 1e-9 or np.abs(np.diag(matrix) - 1).max() > 1e-9
        if wrong or np.linalg.eigvalsh(matrix)[0] < -1e-9:
            raise ArgumentError(
                "correlation must be a symmetric, positive semidefinite matrix with 1 on its diagonal, "
                f"got {matrix.tolist()!s:.60}"
            )
        self.correlation = matrix

    @classmethod
    def of(
        cls,
        name: str,
        function: Callable[..., float],
        sources: Sequence[UncertaintySource],
        correlation: Sequence[Sequence[float]] | None = None,
    ) -> UncertaintyBudget:
        """Build the budget of a function of its sources.

        Args:
            name: name of the result, with its unit.
            function: function that computes the result from the values of the sources, one argument for each source.
            sources: sources of uncertainty. Numerical derivatives replace their sensitivities.
            correlation: correlation matrix of the sources, no unit, (n, n). Default: None, the sources are independent.
        """
        given = checks.instances("sources", sources, UncertaintySource)
        values = [one.value for one in given]
        found = []
        for i, one in enumerate(given):
            step = _STEP * one.uncertainty
            high, low = (function(*[v + sign * step * (j == i) for j, v in enumerate(values)]) for sign in (1, -1))
            found.append(one._replace(sensitivity=(high - low) / (2 * step) if step else 0.0))
        return cls(name, function(*values), found, correlation)

    @property
    def combined(self) -> float:
        """Combined standard uncertainty, in the unit of the result."""
        parts = np.array([one.sensitivity * one.uncertainty for one in self.sources])
        return float(np.sqrt(max(parts @ self.correlation @ parts, 0.0)))

    @property
    def degrees(self) -> float:
        """Effective degrees of freedom, no unit.

        The value is infinite if the degrees of freedom of all sources are infinite.
        """
        total = sum(one.contribution**4 / one.degrees for one in self.sources)
        return self.combined**4 / total if total > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """Coverage factor k of the expanded uncertainty, no unit.

        The coverage probability is 95.45 %.
        """
        if not math.isfinite(self.degrees):
            return 2.0
        return float(stdtrit(max(self.degrees, 1.0), (1 + _COVERAGE) / 2))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty, in the unit of the result."""
        return self.coverage_factor * self.combined

    def to_dict(self) -> dict[str, Any]:
        """Convert the budget to a JSON object.

        Returns:
            Result, sources, correlation, combined and expanded uncertainty; infinite degrees of freedom are null.
        """
        finite = lambda degrees: degrees if math.isfinite(degrees) else None  # noqa: E731
        return plain(
            {
                "result": self.name,
                "value": self.value,
                "combined_standard_uncertainty": self.combined,
                "effective_degrees_of_freedom": finite(self.degrees),
                "coverage_factor": self.coverage_factor,
                "expanded_uncertainty": self.expanded,
                "coverage_probability": _COVERAGE,
                "sources": [
                    {**one._asdict(), "degrees": finite(one.degrees), "contribution": one.contribution}
                    for one in self.sources
                ],
                "correlation": self.correlation.tolist(),
            }
        )

    def columns(self) -> dict[str, list[Any]]:
        """Convert the budget to the columns of a table.

        The rows of the table are those of `rows`.

        Returns:
            Values of each column, by the name of the column.
        """
        return dict(zip(_COLUMNS, map(list, zip(*self.rows(), strict=True)), strict=True))

    def rows(self) -> list[list[Any]]:
        """Convert the budget to the rows of a table.

        Returns:
            One row for each source, then the rows of the combined and the expanded uncertainty. A row contains name, type,
            value, standard uncertainty, sensitivity, contribution and degrees of freedom; NaN where a number is undefined.
        """
        rows: list[list[Any]] = [
            [one.name, one.kind, one.value, one.uncertainty, one.sensitivity, one.contribution, one.degrees]
            for one in self.sources
        ]
        nan = math.nan
        rows.append([f"{self.name}, combined", "", self.value, self.combined, nan, self.combined, self.degrees])
        rows.append(
            [f"{self.name}, expanded (k = {self.coverage_factor:.3g})", "", self.value, self.expanded, nan, nan, nan]
        )
        return rows


def _checked(source: UncertaintySource) -> UncertaintySource:
    """Raise ArgumentError if a value of a source is not a single number or is out of its range."""
    name = f"of source {checks.instance('name of a source', source.name, str)!r:.60}"
    numbers = {
        "value": checks.numbers(f"value {name}", source.value),
        "uncertainty": checks.within(f"uncertainty {name}", source.uncertainty, 0, math.inf, open_high=True),
        "sensitivity": checks.number(f"sensitivity {name}", source.sensitivity),
        "degrees of freedom": checks.within(f"degrees of freedom {name}", source.degrees, 0, math.inf, open_low=True),
    }
    for what, value in numbers.items():
        checks.scalar(f"{what} {name}", value)
    checks.choice(f"kind {name}", source.kind, ("A", "B"))
    return source


def write_budgets(path: str | Path, budgets: Sequence[UncertaintyBudget], *, force: bool = False) -> None:
    """Write uncertainty budgets to a JSON or CSV file.

    Args:
        path: file to write; the suffix .json or .csv selects the format.
        budgets: budgets, one per result; the sequence may be empty.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: the suffix is neither .json nor .csv, or an argument has the wrong type.
        OutputError: the file cannot be written, or it exists and `force` is False.

    Example:
        >>> import tempfile, pathlib
        >>> source = matcam.UncertaintySource("length, m", 1.0, 0.001, 1.0, "B")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "budget.csv")
        ...     matcam.io.write_budgets(path, [matcam.UncertaintyBudget("length, m", 1.0, [source])])
        ...     path.read_text().splitlines()[1]
        '"length, m",B,1,0.001,1,0.001,inf'
    """
    check_budget_name(path)
    budgets = checks.instances("budgets", budgets, UncertaintyBudget)
    if Path(path).suffix.lower() == ".json":
        write_json(path, {"budgets": [one.to_dict() for one in budgets]}, force=force)
        return
    parts = [one.columns() for one in budgets]
    write_columns(path, {name: [cell for part in parts for cell in part[name]] for name in _COLUMNS}, force=force)


def check_budget_name(path: str | Path) -> None:
    """Raise ArgumentError if the name of a file of budgets does not end in .json or .csv."""
    if Path(path).suffix.lower() not in (".json", ".csv"):
        raise ArgumentError(f"{path}: the name of a budget file must end in .json or .csv")


def fit_budget(name: str, value: float, std: float) -> UncertaintyBudget:
    """Build the budget of a fitted value.

    The only source of the budget is the fit (type A).

    Args:
        name: name of the value, with its unit.
        value: fitted value, in its unit.
        std: standard uncertainty of the value, in its unit.
    """
    source = UncertaintySource(f"{name}: noise and departures of the fit", float(value), float(std), 1.0, "A")
    return UncertaintyBudget(name, value, [source])


def parameter_budgets(names: Sequence[str], values: Sequence[float], covariance: np.ndarray) -> list[UncertaintyBudget]:
    """Build one budget for each fitted parameter.

    Args:
        names: names of the parameters, with their units.
        values: fitted values, in these units, (n,).
        covariance: covariance of the values, (n, n).
    """
    stds = np.sqrt(np.maximum(np.diag(covariance), 0))
    return [fit_budget(*one) for one in zip(names, values, stds, strict=True)]
