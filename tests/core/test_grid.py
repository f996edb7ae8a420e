"""A table is addressed by angle, in rad, and says so where an angle is none of its own."""

import numpy as np
import pytest

from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, SAMPLINGS, merl_grid, theta_h_edges

DEGREES = np.pi / 180


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_each_sampling_point_lies_in_its_cell(sampling):
    grid = merl_grid(sampling)
    found = grid.index(theta_h=grid.theta_h, theta_d=grid.theta_d, phi_d=grid.phi_d)
    for index, count in zip(found, GRID_SHAPE, strict=True):
        np.testing.assert_array_equal(index, np.arange(count))


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_whole_degrees_are_the_cells_that_begin_there_whatever_the_sampling(sampling):
    grid = merl_grid(sampling)
    np.testing.assert_array_equal(grid.index(theta_d=np.arange(90) * DEGREES)[1], np.arange(90))
    np.testing.assert_array_equal(grid.index(phi_d=np.arange(180) * DEGREES)[2], np.arange(180))
    np.testing.assert_array_equal(grid.index(theta_h=theta_h_edges()[:-1])[0], np.arange(90))


def test_the_ends_belong_to_the_last_cells():
    assert merl_grid("centre").index(theta_h=np.pi / 2, theta_d=np.pi / 2, phi_d=np.pi) == (89, 89, 179)


def test_angles_that_are_not_given_are_all_there_are():
    values = np.arange(np.prod(GRID_SHAPE)).reshape(GRID_SHAPE)
    at = merl_grid("edge").index(theta_h=0.0, phi_d=np.pi / 2)
    np.testing.assert_array_equal(values[at], values[0, :, 90])
    several = merl_grid("edge").index(theta_h=0.0, theta_d=np.array([5.0, 45.0]) * DEGREES)
    np.testing.assert_array_equal(values[several], values[0, [5, 45]])


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ({"theta_d": 45}, r"theta_d must lie in \[0, 1.5708\] rad, got 45"),
        ({"theta_h": [0.1, -0.1]}, "theta_h must lie in .* rad, got -0.1"),
        ({"phi_d": 3.2}, r"phi_d must lie in \[0, 3.14159\] rad, got 3.2"),
        ({"phi_d": np.nan}, "phi_d must lie in .*, got nan"),
        ({"theta_d": "x"}, "theta_d must be a number"),
    ],
)
def test_an_angle_out_of_range_is_refused(angles, words):
    with pytest.raises(ArgumentError, match=words):
        merl_grid("centre").index(**angles)
