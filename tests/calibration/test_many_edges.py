"""What is computed over thousands of edges at once, against what does it one by one."""

from types import SimpleNamespace

import numpy as np
import pytest

from matcam.calibration.camera.consensus import widest_angle
from matcam.calibration.edge.free_curve import CoreShape
from matcam.calibration.edge.rows import EdgeRegions, clearance


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
def test_the_clearance_is_a_quantile_of_the_rows_with_samples():
    rng = np.random.default_rng(2)
    value, y, x = rng.normal(size=(3, 30, 41)), np.arange(30) - 14.5, np.arange(-20.0, 21.0)
    value[rng.random(value.shape) < 0.3] = np.nan
    value[0, 3], value[1, 2:9], value[2] = np.nan, np.nan, np.nan
    curve, sigma = rng.normal(size=(3, 6)) * [1, 0.1, 0, 0, 0, 0], np.array([0.5, 0.8, 1.0])
    shape = CoreShape(sigma, np.zeros(3), np.full(3, 0.5), np.ones(3), np.ones(3))
    found = SimpleNamespace(curve=curve, length=np.ones(3), slope=curve[:, 1], free=SimpleNamespace(shape=shape))
    rows = EdgeRegions(value, np.tile(y, (3, 1)), np.full((3, 30), x[0]), 1, None, 2)
    known, position = np.where(np.isfinite(value), x, np.nan), curve[:, :1] + curve[:, 1:2] * y
    ends = np.stack([position - np.nanmin(known, 2), np.nanmax(known, 2) - position])
    expected = np.nanquantile(ends, 0.1, axis=2).min(0) / np.hypot(1, curve[:, 1]) / np.sqrt(sigma**2 + 1 / 12)
    np.testing.assert_allclose(clearance(found, rows), expected, rtol=1e-12, equal_nan=True)
