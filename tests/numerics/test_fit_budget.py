"""Budgets of fits with priors: GTC's values, Monte Carlo's, and the coverage of the expanded uncertainty.

The fit is linear: readings J p + noise, stated values of some parameters, one result that is a combination of the parameters.
GTC and Monte Carlo propagate readings and stated values by themselves, through the normal equations.
"""

import math

import numpy as np
import pytest

from docs_claims import limit
from matcam.numerics.budget import UncertaintySource
from matcam.numerics.fit_budget import (
    Readings,
    StatedParameter,
    Statement,
    VariancePart,
    parts_budget,
    posterior_budget,
    stated_parameters,
    statement_parts,
)

RANDOM = np.random.default_rng(7)
DESIGN = np.column_stack([np.ones(12), np.linspace(-1, 1, 12), np.linspace(-1, 1, 12) ** 2, np.cos(np.arange(12.0))])
SLOPE = np.array([1.0, 0.5, -2.0, 1.5])
NOISE = 0.1
PRIORS = {
    "independent": np.diag([0.0, 1 / 0.05**2, 0.0, 1 / 0.2**2]),
    "correlated": np.pad(np.linalg.inv([[0.05**2, 0.6 * 0.05 * 0.2], [0.6 * 0.05 * 0.2, 0.2**2]]), (2, 0)),
    "smooth": 4.0 * np.outer([0, 1, -2, 1], [0, 1, -2, 1]),
}
UNIT = 3.0  # of the stated parameters, of one of the coordinates


def statements(case):
    if case == "smooth":
        return [Statement("smooth", PRIORS[case])]
    stated = [StatedParameter(i, f"p{i}", UNIT * 1.5, UNIT) for i in range(4)]
    return stated_parameters("stated", PRIORS[case], stated)


def covariance(case):
    return np.linalg.inv(DESIGN.T @ DESIGN / NOISE**2 + PRIORS[case])


def budget_of(case, value=0.0, degrees=math.inf):
    return posterior_budget(
        "result", value, SLOPE, covariance(case), statements(case), Readings("readings", "A", degrees)
    )


def estimate(case, readings, stated):
    """Result of readings (..., 12), and stated values (..., 4) in the fit's coordinates."""
    right = readings @ DESIGN / NOISE**2 + stated @ PRIORS[case]
    return right @ covariance(case) @ SLOPE


@pytest.mark.parametrize("case", PRIORS)
def test_the_parts_add_up(case):
    budget = budget_of(case)
    assert budget.combined == pytest.approx(math.sqrt(SLOPE @ covariance(case) @ SLOPE), rel=1e-12)
    readings = math.sqrt(SLOPE @ covariance(case) @ DESIGN.T @ DESIGN @ covariance(case) @ SLOPE) / NOISE
    assert budget.sources[0].contribution == pytest.approx(readings, rel=1e-9)


@pytest.mark.parametrize("case", ["independent", "correlated"])
def test_gtc_gives_the_same(case):
    gtc = pytest.importorskip("GTC", reason="GTC is not installed")
    readings = [gtc.ureal(one, NOISE) for one in RANDOM.normal(size=12)]
    positions = np.flatnonzero(np.diag(PRIORS[case]))
    prior = np.linalg.inv(PRIORS[case][np.ix_(positions, positions)])
    std = np.sqrt(np.diag(prior))
    stated = [gtc.ureal(1.5, one, independent=case == "independent") for one in std]
    if case == "correlated":
        gtc.set_correlation(prior[0, 1] / std[0] / std[1], *stated)
    by_readings = DESIGN @ covariance(case) @ SLOPE / NOISE**2
    by_stated = (PRIORS[case] @ covariance(case) @ SLOPE)[positions]
    result = sum(c * one for c, one in zip([*by_readings, *by_stated], [*readings, *stated], strict=True))
    budget = budget_of(case, result.x)
    assert budget.combined == pytest.approx(result.u, rel=limit("gum-budget"))
    for one, source in zip(stated, budget.sources[1:], strict=True):
        assert source.contribution == pytest.approx(abs(gtc.component(result, one)), rel=1e-9)
        assert source.uncertainty == pytest.approx(UNIT * one.u, rel=1e-9)
        assert source.value == UNIT * 1.5
    if case == "correlated":
        assert budget.correlation[1, 2] == pytest.approx(0.6)


@pytest.mark.parametrize("case", ["independent", "correlated"])
def test_monte_carlo_gives_the_same(case):
    """JCGM 101: the readings and the stated values are drawn, and the result is estimated from each draw."""
    draws = 200_000
    readings = RANDOM.normal(scale=NOISE, size=(draws, 12))
    prior = np.linalg.pinv(PRIORS[case], hermitian=True)
    stated = RANDOM.multivariate_normal(np.zeros(4), prior, draws)
    scatter = estimate(case, readings, stated).std()
    assert budget_of(case).combined == pytest.approx(scatter, rel=4 / math.sqrt(2 * draws))


def test_the_expanded_uncertainty_covers_95_percent():
    """Truth drawn once for each of 200 cases, readings and stated values drawn about it."""
    random, covered, prior = np.random.default_rng(1), 0, np.linalg.pinv(PRIORS["correlated"], hermitian=True)
    for _ in range(200):
        truth = random.normal(size=4)
        readings = DESIGN @ truth + random.normal(scale=NOISE, size=12)
        stated = truth + random.multivariate_normal(np.zeros(4), prior)
        budget = budget_of("correlated", float(estimate("correlated", readings, stated)))
        assert budget.coverage_factor == 2
        covered += abs(budget.value - SLOPE @ truth) < budget.expanded
    assert 0.93 <= covered / 200 <= 0.97


def test_sources_of_several_results():
    """Rows of slopes: each result's parts are those of its own budget."""
    slopes, cov = np.stack([SLOPE, [0, 1, 0, 1.0]]), covariance("independent")
    variance = np.einsum("rp,pq,rq->r", slopes, cov, slopes)
    parts = statement_parts(statements("independent"), slopes, cov, variance, Readings("readings", "A", 8))
    parts = (*parts, VariancePart("model", "B", np.array([0.01, 0.0])))
    for at in (0, 1):
        found = parts_budget("result", 1.0, parts, at)
        more = [UncertaintySource("model", 0.0, 0.1, 1.0, "B")] if at == 0 else []
        want = posterior_budget(
            "result", 1.0, slopes[at], cov, statements("independent"), Readings("readings", "A", 8), more
        )
        assert found.combined == pytest.approx(want.combined, rel=1e-12)
        assert [s.name for s in found.sources] == [s.name for s in want.sources]
        for one, other in zip(found.sources, want.sources, strict=True):
            assert one.uncertainty == pytest.approx(other.uncertainty, rel=1e-9)
            assert one.contribution == pytest.approx(other.contribution, rel=1e-9)
