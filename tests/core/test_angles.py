"""Half and difference angles against vector algebra written down here."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcam.core.grid import (
    GRID_SHAPE,
    azimuth_at_cosines,
    azimuth_difference,
    below_horizon,
    cosines,
    merl_grid,
    theta_h_edges,
)

ANGLES = st.tuples(st.floats(0, 1.5), st.floats(0, 1.5), st.floats(-7, 7))


def directions(theta_h, theta_d, phi_d):
    """Light and view as vectors, normal = z, by rotating the difference vector to the half vector."""
    d = np.array([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)])
    c, s = np.cos(theta_h), np.sin(theta_h)
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    light = rotation @ d
    half = rotation @ [0, 0, 1]
    return light, 2 * (light @ half) * half - light


@given(ANGLES)
def test_cosines(angles):
    light, view = directions(*angles)
    cos_i, cos_o = cosines(*angles)
    assert float(cos_i) == pytest.approx(light[2], abs=1e-12)
    assert float(cos_o) == pytest.approx(view[2], abs=1e-12)


@given(ANGLES)
def test_azimuth_difference_is_wrapped_to_half_a_turn(angles):
    light, view = directions(*angles)
    if np.hypot(*light[:2]) < 1e-3 or np.hypot(*view[:2]) < 1e-3:
        return
    between = np.arctan2(light[1], light[0]) - np.arctan2(view[1], view[0])
    expected = np.abs(np.angle(np.exp(1j * between)))
    assert float(azimuth_difference(*angles)) == pytest.approx(expected, abs=1e-7)
    accuracy = 1e-7 + 5e-8 / min(np.hypot(*light[:2]), np.hypot(*view[:2]))
    assert float(azimuth_at_cosines(light[2], view[2], angles[1])) == pytest.approx(expected, abs=accuracy)


@given(ANGLES)
def test_reciprocity_is_phi_d_plus_pi(angles):
    theta_h, theta_d, phi_d = angles
    one, other = cosines(*angles), cosines(theta_h, theta_d, phi_d + np.pi)
    np.testing.assert_allclose(one, other[::-1], atol=1e-12)


def test_grid_is_that_of_merls_own_reader():
    for sampling in ("centre", "edge"):
        grid = merl_grid(sampling)
        nudge = 1e-9 if sampling == "edge" else 0.0
        np.testing.assert_array_equal(np.floor(90 * np.sqrt((grid.theta_h + nudge) / (np.pi / 2))), np.arange(90))
        np.testing.assert_array_equal(np.floor((grid.theta_d + nudge) / (np.pi / 2) * 90), np.arange(90))
        np.testing.assert_array_equal(np.floor((grid.phi_d + nudge) / np.pi * 180), np.arange(180))
    assert theta_h_edges()[[0, -1]] == pytest.approx([0, np.pi / 2])


def test_share_below_the_horizon():
    """docs/model.md 5: 23.8 % of MERL's cells by their edges, 24.8 % by their centres."""
    assert below_horizon("edge").mean() == pytest.approx(0.238, abs=5e-4)
    assert below_horizon("centre").mean() == pytest.approx(0.248, abs=5e-4)
    assert below_horizon("centre").shape == GRID_SHAPE
