"""Uncertainty budgets of fits: what each states in all, and what a source does when it changes."""

import numpy as np
import pytest

from matcam import fit
from matcam.core.errors import ArgumentError
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18
LENS = "optics.sigma_px"


@pytest.fixture(scope="module")
def table():
    shot = recorded.made(EVERY, oracle.Setup())
    ways = shot.rule.ways(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    return shot.table(shot.rule.noisy(ways, np.random.default_rng(3)))


@pytest.fixture(scope="module")
def found(table):
    return fit(table, recorded.rig(std=0.004), noise=recorded.NOISE, every=EVERY, camera_parameters="prior")


def test_a_budget_is_the_stated_uncertainty(found):
    budgets = {one.name: one for one in found.uncertainty_budgets()}
    assert set(budgets) == {*found.params, "hwhm_rad"}
    for name, value in found.params.items():
        assert budgets[name].value == value
        assert budgets[name].combined == pytest.approx(found.std[name], rel=1e-9)
    assert budgets["hwhm_rad"].combined == pytest.approx(found.hwhm_std, rel=1e-9)
    assert found.uncertainty_budget("alpha").to_dict() == budgets["alpha"].to_dict()
    with pytest.raises(ArgumentError, match="no parameter 'beta'; it has alpha"):
        found.uncertainty_budget("beta")


@pytest.mark.parametrize("name", ["alpha", LENS])
def test_a_stated_lens_moves_the_result_by_its_sensitivity(table, found, name):
    """The fit is made again with another stated lens."""
    (lens,) = [source for source in found.uncertainty_budget(name).sources if source.name == LENS]
    assert (lens.kind, lens.value, lens.uncertainty) == ("B", 0.5, pytest.approx(0.004, rel=0.01))
    step = 0.002
    moved = [
        fit(
            table, recorded.rig(0.5 + sign * step, std=0.004), noise=recorded.NOISE, every=EVERY,
            camera_parameters="prior",
        ).params[name]
        for sign in (1, -1)
    ]  # fmt: skip
    assert lens.sensitivity == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=0.02)


def test_the_readings_move_the_result_by_their_contribution(found):
    """The same light with other noise, the stated lens unchanged."""
    shot = recorded.made(EVERY, oracle.Setup())
    ways = shot.rule.ways(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    values = []
    for seed in range(40):
        noisy = shot.table(shot.rule.noisy(ways, np.random.default_rng(seed)))
        again = fit(noisy, recorded.rig(std=0.004), noise=recorded.NOISE, every=EVERY, camera_parameters="prior")
        values.append([again.params["alpha"], again.params[LENS]])
    for name, scatter in zip(("alpha", LENS), np.std(values, axis=0, ddof=1), strict=True):
        readings = found.uncertainty_budget(name).sources[0]
        assert readings.kind == "B"  # the noise was given
        assert readings.contribution == pytest.approx(scatter, rel=4 / np.sqrt(2 * 39))


def test_estimated_noise_is_type_a(table):
    estimated = fit(table, recorded.rig(std=0.004), every=EVERY, camera_parameters="prior")
    readings = estimated.uncertainty_budget("alpha").sources[0]
    assert (readings.kind, readings.degrees) == ("A", estimated.freedom)
