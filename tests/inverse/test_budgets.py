"""Uncertainty budgets of fits: what each states in all, and what a source does when it changes."""

import numpy as np
import pytest

from matcam import GGX, fit, fresnel
from matcam.camera import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.grid import merl_grid
from matcam.inverse import Correction, fresnel_budget
from matcam.inverse.operator.lobe_operator import lobe_operator
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18
LENS = "optics.sigma_px"


@pytest.fixture(scope="module")
def table():
    shot = recorded.made(EVERY, oracle.Setup())
    directions = (
        shot.rule.directions(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    )
    return shot.table(shot.rule.noisy(directions, np.random.default_rng(3)))


@pytest.fixture(scope="module")
def found(table):
    return fit(table, recorded.rig(std=0.004), noise=recorded.NOISE, slice_step=EVERY, camera_parameters="prior")


def test_a_budget_is_the_stated_uncertainty(found):
    budgets = {one.name: one for one in found.uncertainty_budgets()}
    assert set(budgets) == {*found.params, "hwhm_rad"}
    for name, value in found.params.items():
        assert budgets[name].value == value
        assert budgets[name].combined == pytest.approx(found.std[name], rel=1e-9)
    assert budgets["hwhm_rad"].combined == pytest.approx(found.hwhm_std, rel=1e-9)
    assert found.uncertainty_budget("alpha").to_dict() == budgets["alpha"].to_dict()
    with pytest.raises(ArgumentError, match="no parameter 'beta'; give one of: alpha"):
        found.uncertainty_budget("beta")


@pytest.mark.parametrize("name", ["alpha", LENS])
def test_a_stated_lens_moves_the_result_by_its_sensitivity(table, found, name):
    """The fit is made again with another stated lens."""
    (lens,) = [source for source in found.uncertainty_budget(name).sources if source.name == LENS]
    assert (lens.kind, lens.value, lens.uncertainty) == ("B", 0.5, pytest.approx(0.004, rel=0.01))
    step = 0.002
    moved = [
        fit(
            table, recorded.rig(0.5 + sign * step, std=0.004), noise=recorded.NOISE, slice_step=EVERY,
            camera_parameters="prior",
        ).params[name]
        for sign in (1, -1)
    ]  # fmt: skip
    assert lens.sensitivity == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=0.02)


@pytest.mark.slow
def test_the_readings_move_the_result_by_their_contribution(found):
    """The same light with other noise, the stated lens unchanged."""
    shot = recorded.made(EVERY, oracle.Setup())
    directions = (
        shot.rule.directions(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    )
    values = []
    for seed in range(40):
        noisy = shot.table(shot.rule.noisy(directions, np.random.default_rng(seed)))
        again = fit(noisy, recorded.rig(std=0.004), noise=recorded.NOISE, slice_step=EVERY, camera_parameters="prior")
        values.append([again.params["alpha"], again.params[LENS]])
    for name, scatter in zip(("alpha", LENS), np.std(values, axis=0, ddof=1), strict=True):
        readings = found.uncertainty_budget(name).sources[0]
        assert readings.kind == "B"  # the noise was given
        assert readings.contribution == pytest.approx(scatter, rel=4 / np.sqrt(2 * 39))


def test_estimated_noise_is_type_a(table):
    estimated = fit(table, recorded.rig(std=0.004), slice_step=EVERY, camera_parameters="prior")
    readings = estimated.uncertainty_budget("alpha").sources[0]
    assert (readings.kind, readings.degrees) == ("A", estimated.freedom)


@pytest.mark.slow
def test_the_expanded_uncertainty_covers_95_percent():
    """200 fits of few cells, whose noise is estimated: roughness and half width."""
    shot = recorded.made(EVERY, oracle.Setup())
    directions = (
        shot.rule.directions(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    )
    random, covered = np.random.default_rng(8), 0
    for _ in range(200):
        noisy = shot.table(shot.rule.noisy(directions, random))
        budget = fit(noisy, recorded.rig(), slice_step=EVERY).uncertainty_budget("alpha")
        covered += abs(budget.value - 0.004) < budget.expanded
    assert 0.93 <= covered / 200 <= 0.97


GAUSSIAN = oracle.EPD(0.002 * np.sqrt(2), 1.0)  # half a pixel wide


def noisy_gaussian():
    shot = recorded.pictures(6)
    directions = shot.rule.directions(GAUSSIAN) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    return shot.table(shot.rule.noisy(directions, np.random.default_rng(11), gain=0.0))


def check_fresnel(term):
    seen = np.isfinite(term["corrected"].values[:, 0])
    assert seen.sum() > 8
    for theta_d, value, std in zip(
        term["theta_d"].values[seen],
        term["corrected"].values[seen, 0],
        term["corrected_std"].values[seen, 0],
        strict=True,
    ):
        budget = fresnel_budget(term, theta_d, "G")
        assert budget.value == value
        assert budget.combined == pytest.approx(std, rel=1e-6)
    return {one.name: one for one in fresnel_budget(term, recorded.SEVENTY_FIVE).sources}


@pytest.mark.slow
def test_a_budget_of_the_fresnel_term_is_its_stated_uncertainty():
    given = {
        "ndf": "epd",
        "noise": PixelNoise(0.01, 1e-4, 0.0),
        "slice_step": 6,
    }  # an estimate would move with the lens
    term = fresnel(noisy_gaussian(), recorded.rig(std=0.002), **given)
    sources = check_fresnel(term)
    assert sources[LENS].kind == "B"
    assert sources[LENS].value == 0.5
    assert sources[LENS].uncertainty == pytest.approx(0.002, rel=0.01)
    step = 0.002
    high, low = (fresnel(noisy_gaussian(), recorded.rig(0.5 + sign * step, std=0.002), **given) for sign in (1, -1))
    at = {"theta_d": recorded.SEVENTY_FIVE, "method": "nearest"}
    moved = float((high["corrected"] - low["corrected"]).sel(**at).item()) / (2 * step)
    # Width and lens nearly compensate each other, so the lens contributes a hundredth of the combined uncertainty. Derivatives
    # of free strengths are approximate (Kaufman 1975): the contribution is right to a two-hundredth of it.
    error = abs(abs(sources[LENS].sensitivity) - abs(moved)) * sources[LENS].uncertainty
    assert error < 0.005 * fresnel_budget(term, recorded.SEVENTY_FIVE).combined
    assert abs(moved) * sources[LENS].uncertainty > 0.008 * fresnel_budget(term, recorded.SEVENTY_FIVE).combined
    with pytest.raises(ArgumentError, match="channel must be"):
        fresnel_budget(term, 0.5, "R")
    with pytest.raises(ArgumentError, match="with budget_std, got"):
        fresnel_budget(term.drop_dims("source"), 0.5)


@pytest.mark.slow
def test_other_explanations_are_sources_of_the_fresnel_term():
    """A lens that contradicts the data, and several lobes."""
    term = fresnel(noisy_gaussian(), recorded.rig(0.47, std=0.002), slice_step=6)
    sources = check_fresnel(term)
    assert {one.kind for one in sources.values()} == {"A", "B"}


@pytest.fixture(scope="module")
def drawn():
    """A GGX lobe with noise in the cells that a fit of every sixth slice reads, and at all azimuths of the peak."""
    cells, operator = lobe_operator(recorded.rig(), "centre", 6)
    values = np.asarray(operator.record(GGX(0.004), "smith", ())) * 0.6
    noise = 1 + 0.01 * np.random.default_rng(2).standard_normal(values.shape)
    table = recorded.table_of(cells, values * noise)
    ring = table.values[0].copy()
    seen = np.isfinite(ring).any(axis=1)[..., 0]
    table.values[0][seen] = np.nanmean(ring[seen], axis=1, keepdims=True)
    return table


def check_correction(done):
    budgets = done.uncertainty_budgets()
    assert len(budgets) == 2  # of 45 and 75 degrees: 5 is missing
    for degrees in range(3, 80, 6):
        budget = done.uncertainty_budget(np.radians(degrees + 0.5))
        at = merl_grid("centre").index(theta_h=0.0, theta_d=np.radians(degrees + 0.5), phi_d=np.pi / 2)
        assert budget.value == done.table["brdf"].values[at][0]
        assert budget.combined == pytest.approx(float(done.table["brdf_std"].values[at][0]), rel=1e-6)
    with pytest.raises(ArgumentError, match=r"no standard deviation of the peak at 5.5 degrees, G"):
        done.uncertainty_budget(np.radians(5.0))
    return {one.name: one for one in budgets[-1].sources}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ndf", "sigma", "force_correction"),
    [("ggx", 0.5, False), ("auto", 0.5, False), ("ggx", 0.6, False), ("ggx", 0.6, True)],
)
def test_a_budget_of_a_corrected_peak_is_its_stated_uncertainty(drawn, ndf, sigma, force_correction):
    done = Correction.of(drawn, recorded.rig(sigma, std=0.01), ndf, force_correction=force_correction)
    sources = check_correction(done)
    assert {LENS, "glare", "noise of the pixels of the entry"} <= set(sources) or done.withheld
