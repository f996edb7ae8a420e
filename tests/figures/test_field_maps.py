"""Maps of a calibration over the picture: the numbers that are drawn. That they are drawn: `test_lateral_colour`."""

import numpy as np
import pytest

from matcam.calibration import EdgeTable, LateralColour
from matcam.figures.field_maps import blur_map, lateral_shift


def table(x, y, sigma):
    one, mtf = np.ones(len(x)), np.full((len(x), 81), 0.5)
    return EdgeTable(x, y, one, sigma, 0.01 * one, one, one, mtf, mtf, np.array(["a.png"] * len(x)))


def test_a_part_of_the_picture_has_its_own_edges_median():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.5, 799.5, 600), rng.uniform(-0.5, 599.5, 600)
    found = blur_map(table(x, y, 0.5 + 1e-3 * x), (600, 800))
    assert found.sigma.shape == (6, 8)
    assert found.edges.sum() == 600
    here = (x > 99.5) & (x < 199.5) & (y > 199.5) & (y < 299.5)
    assert found.edges[2, 1] == here.sum()
    assert found.sigma[2, 1] == np.median(0.5 + 1e-3 * x[here])


def test_parts_with_few_edges_stay_empty():
    x = np.r_[np.full(288, 5.0), 500.0]
    found = blur_map(table(x, np.full(289, 5.0), np.r_[np.full(144, 0.5), np.full(144, 0.7), 9.0]), (600, 800))
    assert np.isfinite(found.sigma).sum() == 1
    assert found.sigma[0, 0] == pytest.approx(0.6)
    assert blur_map(table(x, x, x), (800, 600)).sigma.shape == (8, 6)


def test_few_edges_have_few_parts():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 799, 43), rng.uniform(0, 599, 43)
    found = blur_map(table(x, y, np.full(43, 0.5)), (600, 800))
    assert found.sigma.shape == (2, 3)
    assert np.isfinite(found.sigma).sum() >= 5
    assert blur_map(table(x[:1], y[:1], np.ones(1)), (800, 600)).sigma.shape == (1, 1)


def test_lateral_colour_is_what_was_fitted():
    lateral = LateralColour(0.4, 0.02, 1e-3, 1e-5, 60)
    shift = lateral_shift(lateral, np.array([0.0, 1e-3, 500.0]), 500.0)
    assert shift[0] == 0
    assert shift[1] == pytest.approx(1e-6, rel=1e-6)
    assert shift[2] == pytest.approx(0.4)
