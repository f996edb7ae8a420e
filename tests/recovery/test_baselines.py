"""Baselines on tables whose truth is known: a Gaussian lobe in closed form, and a lobe without a camera."""

from functools import cache

import numpy as np
import pytest
from benchmarks.recovery import baselines, cases

from tests.oracle import merl_lobe
from tests.recovery.synthetic import CASE, table

WIDTH = 0.006
"""Standard deviation of the lobe, rad: 1.5 px."""
SLICES = np.s_[5:75:10]
FACTS = {"sphere": {"radius_px": 256.0}, "pixel_half_width_px": 0.5, "lens": {"kind": "gaussian", "sigma_px": 0.5}}


@cache
def gaussian():
    """Recorded and true peaks of a Gaussian lobe, and the recorded table."""
    unit = np.ones((90, 3))
    recorded = merl_lobe.record(WIDTH, unit)
    sharp = merl_lobe.record(WIDTH, unit, merl_lobe.Rig(1e-3, 1e-3))
    return recorded, sharp


def loss(found):
    """Mean relative error of the peaks."""
    _, sharp = gaussian()
    return np.abs(found[0, SLICES, 90] / sharp[0, SLICES, 90] - 1).mean()


def test_the_record_of_the_test_loses_light():
    assert 0.1 < loss(gaussian()[0]) < 0.5


def test_nothing_is_done():
    recorded = gaussian()[0]
    assert baselines.nothing(recorded, FACTS) is recorded


def test_peaks_over_their_loss_are_right_for_a_gaussian_lobe():
    assert loss(baselines.peak_over_loss(gaussian()[0], FACTS)) < 0.02


def test_a_perfect_camera_needs_no_correction():
    true = table().true
    found = baselines.perfect_camera(true, FACTS)
    judged = table().judged
    np.testing.assert_allclose(found[judged], true[judged], rtol=2e-3)


def test_the_fit_keeps_what_the_camera_lost():
    recorded = gaussian()[0]
    assert loss(baselines.perfect_camera(recorded, FACTS)) > 0.3 * loss(recorded)


@pytest.mark.parametrize("name", ["Wiener", "Richardson-Lucy", "table deconvolution"])
def test_deconvolutions_recover_a_part_of_the_loss(name):
    if name != "table deconvolution":
        pytest.importorskip("skimage", reason="the extra matcam[benchmark] is not installed")
    recorded = gaussian()[0]
    found = baselines.BASELINES[name](recorded, FACTS)
    assert loss(found) < 0.7 * loss(recorded)
    # far from the highlight nothing changes
    far = np.s_[60, 20, 80:100]
    np.testing.assert_allclose(found[far], recorded[far], rtol=1e-2, atol=1e-6)
    assert np.array_equal(np.isnan(found), np.isnan(recorded))


@pytest.mark.parametrize(("name", "sigma"), [("coma", 0.5), ("lens-wider", 0.5), ("ggx-quiet", 0.51)])
def test_the_width_is_the_stated_one(name, sigma):
    assert baselines.sigma(cases.stated(cases.public_case(name))) == sigma


def test_the_width_of_a_stated_mtf_is_that_of_its_gaussian():
    facts = cases.stated(CASE._replace(mtf=cases.stated_mtf(CASE.table.setup, 1)))
    assert baselines.sigma(facts) == pytest.approx(0.5, rel=0.02)
