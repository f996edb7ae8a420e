"""A lens over the field: places through its distortion and back, areas, circles."""

import numpy as np
import pytest

from matcam.camera.lens_field import Coefficient, LensField
from matcam.core.errors import ArgumentError

FIELD = LensField(
    (510.0, 390.0), 640.0, Coefficient(-0.02, 1e-3), Coefficient(0.004, 1e-4), Coefficient(0.3, 0.05), 320.0
)


def test_positions_go_through_the_lens_and_back():
    rng = np.random.default_rng(0)
    column, row = rng.uniform(0, 1000, 50), rng.uniform(0, 800, 50)
    seen = FIELD.seen_at(column, row)
    away, rho = np.hypot(seen[0] - 510, seen[1] - 390), np.hypot(column - 510, row - 390) / 640
    assert away / 640 == pytest.approx(rho - 0.02 * rho**3 + 0.004 * rho**5, rel=1e-12)
    again = FIELD.true_position(*seen)
    assert again[0] == pytest.approx(column, abs=1e-9)
    assert again[1] == pytest.approx(row, abs=1e-9)


def test_stretch_is_the_derivative_of_the_position():
    step = 1e-3
    for axis in (0, 1):
        ends = [
            np.array(FIELD.seen_at(*(np.array([800.0, 100.0]) + side * step * np.eye(2)[axis]))) for side in (1, -1)
        ]
        assert FIELD.stretch(800.0, 100.0)[:, axis] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-9)


def test_a_circle_about_the_centre_stays_one():
    radius = 400.0
    rho = radius / 640
    expected = 640 * (rho - 0.02 * rho**3 + 0.004 * rho**5)
    assert FIELD.seen_circle(510.0, 390.0, radius) == pytest.approx((510.0, 390.0, expected))
    assert FIELD.true_circle(510.0, 390.0, expected) == pytest.approx((510.0, 390.0, radius))
    # beside it, there and back within what an oval differs from a circle
    there = FIELD.seen_circle(480.0, 420.0, 300.0)
    assert FIELD.true_circle(*there) == pytest.approx((480.0, 420.0, 300.0), abs=0.02)


def test_blur_grows_from_where_the_profile_holds():
    assert FIELD.blur_scale(510.0 + 320, 390.0) == pytest.approx(1.0)
    assert FIELD.blur_scale(510.0, 390.0) == pytest.approx(1 - 0.3 / 4)
    assert FIELD.wider(3.0).k1 == (-0.02, pytest.approx(3e-3))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"unit": 0.0}, "unit_px must lie in"),
        ({"k1": Coefficient(-0.4, 0.0)}, "the distortion is not monotonic"),
        ({"growth": Coefficient(0.1, -1.0)}, "standard deviation of growth"),
    ],
)
def test_impossible_fields_are_refused(changes, words):
    with pytest.raises(ArgumentError, match=words):
        LensField(**({"centre": (0.0, 0.0), "unit": 100.0} | changes))
