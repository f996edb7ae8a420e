"""Gain of an image, found in the scatter of F: smooth curves have none, and a scatter that was added is found."""

import numpy as np
import pytest

from matcam.inverse.picture_gain import picture_gain
from tests.oracle.merl_lobe import conductor

NOISE = 2e-3


@pytest.mark.parametrize("step", [1, 6])
@pytest.mark.parametrize(("n", "k"), [(1.3, 0.0), (1.5, 0.0), (2.5, 0.0), (3.18, 3.3), (0.2, 3.5)])
def test_a_smooth_curve_has_no_gain_and_a_rough_one_has(n, k, step):
    theta_d = np.radians(np.arange(3.5, 88, step))
    curve = conductor(theta_d, np.array([n]), np.array([k])).reshape(-1)
    covariance = NOISE**2 * np.eye(theta_d.size)[None]
    random = np.random.default_rng(6)
    noisy = [curve * random.normal(1, NOISE, curve.size) for _ in range(20)]
    found = [picture_gain(theta_d, one[None], covariance) for one in noisy]
    assert np.mean(np.array(found) > 0) <= 0.15  # the limit is two standard deviations
    rough = [picture_gain(theta_d, (one * random.normal(1, 0.02, one.size))[None], covariance) for one in noisy]
    assert np.sqrt(np.mean(np.square(rough))) == pytest.approx(0.02, rel=0.4)
