"""What is computed over thousands of edges at once, against what does it one by one."""

import numpy as np
import pytest

from matcam.calibration.camera.consensus import widest_angle
from matcam.calibration.edge.rows import known_quantile


@pytest.mark.parametrize("spread", [0.01, 0.5, np.pi])
def test_the_widest_angle_is_that_of_all_pairs(spread):
    rng = np.random.default_rng(1)
    for count in (1, 2, 3, 8, 40):
        angle = rng.uniform(-np.pi, np.pi) + rng.uniform(-spread, spread, count)
        between = np.abs(angle[:, None] - angle) % np.pi
        pairs = np.minimum(between, np.pi - between)
        assert widest_angle(angle) == pytest.approx(pairs.max(), abs=1e-12)


def test_a_right_angle_is_the_widest():
    assert widest_angle(np.array([-np.pi, 0.0, np.pi / 2])) == pytest.approx(np.pi / 2)
    assert widest_angle(np.array([0.0, np.pi, -np.pi])) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore:All-NaN slice")
def test_the_quantile_of_what_is_known_is_numpys():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(2, 7, 30))
    values[rng.random(values.shape) < 0.3] = np.nan
    values[0, 3], values[1, 2, 1:] = np.nan, np.nan
    for share in (0.0, 0.1, 0.37, 1.0):
        expected = np.nanquantile(values, share, axis=-1)
        np.testing.assert_allclose(known_quantile(values, share), expected, rtol=1e-13, equal_nan=True)
