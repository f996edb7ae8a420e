"""Fits of tables whose negative noise was set to 0 agree with fits of tables with negative noise."""

import numpy as np
import pytest
from scipy.stats import norm

from matcam import fit
from matcam.inverse.fit.clipped_values import as_normal, clipped_values
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18


@pytest.fixture(scope="module")
def noisy():
    """Noisy cells of a metal without a diffuse part. Many cells are darker than the noise."""
    shot = recorded.pictures(EVERY)
    exact = shot.rule.directions(oracle.GGX(0.008))
    exact = exact * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    return shot, shot.rule.noisy(exact, np.random.default_rng(1), gain=0.0)


def test_clipped_noise_changes_no_result(noisy):
    shot, values = noisy
    clipped = np.maximum(values, 0)
    assert (clipped == 0).sum() > 0.1 * np.isfinite(values).sum()
    kept, found = (fit(shot.table(one), recorded.rig(), diffuse=True, slice_step=EVERY) for one in (values, clipped))
    for name, std in kept.std.items():
        assert abs(found.params[name] - kept.params[name]) < 0.1 * std, name
        assert 0.99 * std < found.std[name] < 1.2 * std, name  # a clipped cell contains less information
    assert found.noise.relative == pytest.approx(kept.noise.relative, rel=0.02)
    assert found.noise.floor == pytest.approx(kept.noise.floor, rel=0.1)
    assert found.misfit == pytest.approx(1, abs=0.1)


def test_which_zeros_are_clipped_noise(noisy):
    shot, values = noisy
    values, used = np.nan_to_num(values)[None], np.isfinite(values)[None]
    theta_h = shot.cells.theta_h
    positive = np.maximum(values, 0)
    np.testing.assert_array_equal(clipped_values(positive, used, theta_h), used & (positive == 0))
    assert not clipped_values(np.where(theta_h > 0.1, 0.0, positive + 1e-9), used, theta_h).any(), "a tail that is 0"
    values[0, 0, np.flatnonzero(used[0, 0])[0]] = 0
    assert not clipped_values(values, used, theta_h).any(), "a table that keeps negative values"


@pytest.mark.parametrize("z", [-2.0, 0.0, 1.0, 5.0, 49.0, 51.0, 1e4])
def test_a_clipped_value_as_a_normal_observation(z):
    """The likelihood Phi(-z) and its normal stand-in have equal derivatives."""
    step = 1e-3
    lower, middle, upper = norm.logcdf([step - z, -z, -z - step])
    residual, information = as_normal(np.array(z))
    assert information * residual == pytest.approx((upper - lower) / (2 * step), rel=1e-5)
    assert information == pytest.approx(-(upper - 2 * middle + lower) / step**2, rel=2e-3 if z < 1e3 else 0.5)
