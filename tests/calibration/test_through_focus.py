"""The best focus of a through-focus series. Truth is a lens whose blur has a known position of least width."""

import numpy as np
import pytest

from matcam import edge_mtf
from matcam.calibration import BestFocus, best_focus
from matcam.core.errors import ArgumentError, FitError
from tests.oracle import slanted_edge as oracle

POSITIONS = np.array([-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9])
FOCUS, SHARPEST, SPREAD = 0.13, 0.5, 0.45
"""Position of the best focus, standard deviation of the blur there, px, and its increase with distance, px per unit."""


def measured(rng, positions=POSITIONS):
    """MTF50 of noisy edges, and the stated standard deviations."""
    blur = np.hypot(SHARPEST, SPREAD * (positions - FOCUS))
    edges = [oracle.photographs(oracle.gaussian(sigma), 100, 1, int(rng.integers(1 << 30)))[0] for sigma in blur]
    found = [edge_mtf(edge) for edge in edges]
    return np.array([one.mtf50 for one in found]), np.array([one.mtf50_std for one in found])


def test_the_best_focus_of_edges_is_found_within_its_error():
    rng = np.random.default_rng(11)
    pulls, tops = [], []
    for _ in range(12):
        focus = best_focus(POSITIONS, *measured(rng))
        pulls.append((focus.position - FOCUS) / focus.position_std)
        tops.append((focus.mtf50 - oracle.gaussian_half(SHARPEST)) / oracle.gaussian_half(SHARPEST))
        assert 0 < focus.position_std < 0.02
    print(f"rms pull {np.sqrt(np.mean(np.square(pulls))):.2f}, MTF50 {np.mean(tops):+.4f} ± {np.std(tops):.4f}")
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.4  # 12 trials: 20 %; the errors of MTF50 are stated generously
    assert abs(np.mean(tops)) < 0.01


def test_a_parabola_is_given_back_in_any_unit():
    m, std = (4 + 9 * (POSITIONS - 0.2) ** 2) ** -0.5, np.full(7, 0.003)
    found = best_focus(POSITIONS, m, std)
    assert found.position == pytest.approx(0.2)
    assert found.mtf50 == pytest.approx(0.5)
    assert found.curvature == pytest.approx(9)
    np.testing.assert_allclose(found.mtf50_at(POSITIONS), m)
    microns = best_focus(1000 + 250 * POSITIONS, m, std)
    assert microns.position == pytest.approx(1050)
    assert microns.position_std == pytest.approx(250 * found.position_std)


def test_scatter_beyond_the_errors_widens_them():
    m = (4 + 9 * (POSITIONS - 0.2) ** 2) ** -0.5
    off = m * (1 + 0.03 * np.array([1, -1, 1, -1, 1, -1, 1]))
    assert (
        best_focus(POSITIONS, off, np.full(7, 0.001)).position_std
        > 5 * best_focus(POSITIONS, m, np.full(7, 0.001)).position_std
    )


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        (
            [1.0, 1.3, 1.6, 1.9, 2.2],
            "no maximum of MTF50 lies between the positions 1 and 1.9",
        ),  # the focus lies outside
        ([-0.2, -0.2, 0.2, 0.2, 0.4], "requires at least 4 different positions"),
        ([0.1, 0.11, 0.12, 0.13], "no maximum of MTF50 lies between"),  # too close together to show a curvature
    ],
)
def test_series_without_a_best_focus(positions, words):
    z = np.array(positions)
    m = (4 + 9 * (z - 0.2) ** 2) ** -0.5
    with pytest.raises(FitError, match=words):
        best_focus(z, m, np.full(z.size, 0.004))


def test_wrong_arguments():
    with pytest.raises(ArgumentError, match="equal length"):
        best_focus([0, 1, 2, 3], [0.4, 0.4, 0.4], [0.1, 0.1, 0.1])
    with pytest.raises(ArgumentError, match="mtf50_std must"):
        best_focus([0, 1, 2, 3], [0.4] * 4, [0.1, 0.1, 0.0, 0.1])
    assert BestFocus(1.0, 0.1, 0.5, 0.01, 2.0).mtf50_at(1.0) == pytest.approx(0.5)
