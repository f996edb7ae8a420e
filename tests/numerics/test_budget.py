"""Uncertainty budgets: GTC's values, Monte Carlo's (JCGM 101), and the coverage of the expanded uncertainty."""

import json
import math

import numpy as np
import pytest

from docs_claims import limit
from matcam.core.errors import ArgumentError
from matcam.numerics.budget import UncertaintyBudget, UncertaintySource, write_budgets

A, B, C = (
    UncertaintySource("a", 2.0, 0.03, 1.0, "A", 7.0),
    UncertaintySource("b", 3.0, 0.02, 1.0, "B"),
    UncertaintySource("c", 0.5, 0.01, 1.0, "A", 12.0),
)
CORRELATED = [[1, 0.6, 0], [0.6, 1, -0.2], [0, -0.2, 1]]
CASES = {
    "sum": (lambda a, b, c: a + 2 * b - 3 * c, None),
    "correlated sum": (lambda a, b, c: a + 2 * b - 3 * c, CORRELATED),
    "product": (lambda a, b, c: a * b / c, None),
}


@pytest.mark.parametrize("case", CASES)
def test_gtc_gives_the_same(case):
    gtc = pytest.importorskip("GTC", reason="GTC is not installed")
    function, correlation = CASES[case]
    budget = UncertaintyBudget.of(case, function, [A, B, C], correlation)
    if correlation:  # GTC asks for infinite degrees of freedom, or an ensemble, where quantities are correlated
        inputs = [gtc.ureal(s.value, s.uncertainty, independent=False) for s in (A, B, C)]
        for i, j in ((0, 1), (1, 2)):
            gtc.set_correlation(correlation[i][j], inputs[i], inputs[j])
    else:
        inputs = [gtc.ureal(s.value, s.uncertainty, s.degrees) for s in (A, B, C)]
    result = function(*inputs)
    assert budget.value == pytest.approx(result.x, rel=1e-12)
    assert budget.combined == pytest.approx(result.u, rel=limit("gum-budget"))
    if not correlation:
        assert budget.degrees == pytest.approx(result.df, rel=1e-5)


@pytest.mark.parametrize("case", CASES)
def test_monte_carlo_gives_the_same(case):
    function, correlation = CASES[case]
    budget = UncertaintyBudget.of(case, function, [A, B, C], correlation)
    std = np.array([s.uncertainty for s in (A, B, C)])
    covariance = (np.eye(3) if correlation is None else np.array(correlation)) * std * std[:, None]
    draws = np.random.default_rng(0).multivariate_normal([s.value for s in (A, B, C)], covariance, 400_000)
    scatter = function(*draws.T).std()
    # the product is curved: its second order is (u_b / b)^2 + (u_c / c)^2, 4e-4 of the variance
    assert budget.combined == pytest.approx(scatter, rel=4 / math.sqrt(2 * len(draws)) + 1e-3 * (case == "product"))


def test_the_expanded_uncertainty_covers_95_percent():
    random = np.random.default_rng(4)
    covered = 0
    for _ in range(200):
        readings = random.normal(5.0, 0.2, 10)
        offset = random.normal(0.0, 0.05)  # of a certificate that states 0.05
        sources = [
            UncertaintySource("readings", readings.mean(), readings.std(ddof=1) / math.sqrt(10), 1.0, "A", 9),
            UncertaintySource("certificate", 0.0, 0.05, 1.0, "B"),
        ]
        budget = UncertaintyBudget("length", readings.mean() + offset, sources)
        covered += abs(budget.value - 5.0) < budget.expanded
    assert 0.93 <= covered / 200 <= 0.97


def test_files(tmp_path):
    budget = UncertaintyBudget.of("a b / c", CASES["product"][0], [A, B, C])
    write_budgets(tmp_path / "a.json", [budget])
    (document,) = json.loads((tmp_path / "a.json").read_text())["budgets"]
    assert document["expanded_uncertainty"] == pytest.approx(budget.expanded)
    assert document["sources"][1]["degrees"] is None
    assert [one["type" if "type" in one else "kind"] for one in document["sources"]] == ["A", "B", "A"]
    write_budgets(tmp_path / "a.csv", [budget, budget])
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0].startswith("source,type,value,standard_uncertainty,sensitivity,contribution")
    assert len(lines) == 11
    write_budgets(tmp_path / "none.csv", [])
    assert (tmp_path / "none.csv").read_text().splitlines() == lines[:1]


def test_wrong_budgets_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match="needs at least one source"):
        UncertaintyBudget("x", 0.0, [])
    with pytest.raises(ArgumentError, match=r"uncertainty of source .* must lie in \[0, inf\), got -1"):
        UncertaintyBudget("x", 0.0, [A._replace(uncertainty=-1.0)])
    with pytest.raises(ArgumentError, match="correlation must be a symmetric"):
        UncertaintyBudget("x", 0.0, [A, B], [[1, 0.5], [0.4, 1]])
    with pytest.raises(ArgumentError, match="must have shape"):
        UncertaintyBudget("x", 0.0, [A, B], [[1]])
    with pytest.raises(ArgumentError, match=r"must end in .json or .csv"):
        write_budgets(tmp_path / "a.txt", [UncertaintyBudget("x", 0.0, [A])])
