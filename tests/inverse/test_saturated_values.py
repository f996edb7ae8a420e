"""Tables whose highlights were saturated give the same material as tables without saturation."""

import numpy as np
import pytest

from matcam import fit, fresnel
from matcam.inverse import Correction
from matcam.inverse.saturated_values import without_saturated
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18


@pytest.fixture(scope="module")
def noisy():
    shot = recorded.pictures(EVERY)
    exact = shot.rule.directions(oracle.GGX(0.012)).mean(-1)
    exact = exact * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None]
    rng = np.random.default_rng(1)
    return shot, exact * (1 + 0.01 * rng.standard_normal(exact.shape))


def peaks_of(values):
    return np.max(values, axis=1, keepdims=True, where=np.isfinite(values), initial=-np.inf)


LEVELS = {
    "each image at 60 % of its peak": lambda values: 0.6 * peaks_of(values),
    "all images at one level": lambda values: np.full_like(peaks_of(values), 0.5 * np.median(peaks_of(values)[:4])),
}


@pytest.mark.parametrize("level", LEVELS.values(), ids=LEVELS)
def test_a_saturated_highlight_is_missing(noisy, level):
    shot, values = noisy
    level = level(values)
    clipped = np.minimum(values, level)
    assert (clipped == level).sum() > 10
    whole, found = (fit(shot.table(one), recorded.rig(), slice_step=EVERY) for one in (values, clipped))
    assert not any(remark.code == "saturated" for remark in whole.remarks)
    assert any(remark.code == "saturated" for remark in found.remarks)
    assert found.params["alpha"] == pytest.approx(0.012, abs=3 * found.std["alpha"])
    assert found.std["alpha"] < 4 * whole.std["alpha"]
    table = shot.table(clipped).values
    lost = np.isnan(without_saturated(shot.table(clipped), recorded.rig())[0].values) & np.isfinite(table)
    np.testing.assert_array_equal(lost[:, shot.cells.slices], table[:, shot.cells.slices] >= 0.9 * level[:, :, None])


def test_correction_and_fresnel_agree_with_the_fit(noisy):
    shot, values = noisy
    table = shot.table(np.minimum(values, 0.6 * peaks_of(values)))
    found = fit(table, recorded.rig(), slice_step=EVERY)
    done = Correction.of(table, recorded.rig(), "ggx")
    assert done.fit.hwhm == pytest.approx(found.hwhm, abs=2 * done.fit.hwhm_std)
    assert any(remark.code == "saturated" for remark in done.remarks)
    assert np.isnan(done.table["brdf"].values[np.isnan(without_saturated(table, recorded.rig())[0].values)]).all()
    curve = fresnel(table, recorded.rig(), "ggx", slice_step=EVERY)
    assert np.isnan(curve["raw"].values).all()
    assert np.isfinite(curve["corrected"].values[:4]).all()  # the last slice is at the limb
    assert float(curve["hwhm"]) == pytest.approx(found.hwhm, abs=2 * done.fit.hwhm_std)


def test_equal_values_of_a_symmetric_or_rounded_lobe_are_not_saturation(noisy):
    shot, values = noisy
    assert not without_saturated(shot.table(values), recorded.rig())[1]
    for alpha in (0.012, 0.05, 0.3):  # without noise, stored with few digits
        exact = shot.rule.directions(oracle.GGX(alpha)).mean(-1)
        for digits in (1, 2, 3, 4, 16):
            rounded = np.round(exact / np.nanmax(exact), digits)
            assert not without_saturated(shot.table(rounded), recorded.rig())[1], (alpha, digits)
    assert not without_saturated(shot.table(np.ones_like(exact)), recorded.rig())[1]
