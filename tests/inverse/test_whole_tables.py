"""Whole tables of the oracle against its adaptive quadrature and against its rule for chosen cells."""

import numpy as np
import pytest

from tests.oracle import sphere_cells, sphere_record
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H
from tests.oracle.sphere_cells import EPD, GGX, coma
from tests.oracle.whole_tables import CASES, Body, Case, Facets, case_of, finest, noisy, positions, records, truth

LIMB = 4.5
"""Distance from limb or terminator, px, up to which less accuracy is required."""


def _distances(j):
    """Distance of both positions of each cell from limb or terminator, px, along the row for the terminator."""
    x, y, _, _ = positions(THETA_D[j])
    dark = -np.cos(2 * THETA_D[j]) * np.sqrt(np.maximum(256.0**2 - y**2, 0))
    return np.minimum(256 - np.hypot(x, y), x - dark)


def _ggx(alpha):
    return Case("GGX", (Facets(GGX(alpha), (1.5,) * 3),))


def _check(alpha, j, cells, found):
    peak = np.nanmax(found)
    for i, k in cells:
        right = sphere_record.recorded_cell(
            THETA_H[i], THETA_D[j], PHI_D[k], sphere_record.Surface(alpha), sphere_record.Setup(), 1e-7
        )
        error = np.abs(found[i, k] - right)
        edge = _distances(j)[i, k] < LIMB
        allowed = np.maximum(np.where(edge, 1e-2, 1e-4) * right, np.where(edge, 1e-5, 1e-7) * peak)
        if i == 0 and j <= 80:
            allowed = 1e-6 * np.array(right)
        assert (error <= allowed).all(), (alpha, j, i, k, error / right, error / peak)


@pytest.mark.parametrize(("j", "cells"), [(20, [(0, 40), (87, 99)]), (60, [(0, 90), (23, 115), (57, 136)])])
def test_cells_agree_with_adaptive_quadrature(j, cells):
    _check(0.05, j, cells, records(_ggx(0.05), [j])[0, :, 0])


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.003, 0.05])
def test_random_cells_agree_with_adaptive_quadrature(alpha):
    random = np.random.default_rng(5)
    for j in (0, 13, 33, 44, 45, 60, 70, 78, 79, 80, 85):
        found = records(_ggx(alpha), [j])[0, :, 0]
        above = np.isfinite(found).all(-1)
        groups = [np.argwhere(above), np.argwhere(above[:25]), np.argwhere(above & (_distances(j).min(-1) < LIMB))]
        cells = [(0, 90)] + [tuple(group[n]) for group in groups for n in random.integers(0, len(group), 2)]
        _check(alpha, j, cells, found)


def test_other_lobes_lenses_and_bodies_agree_with_the_rule_for_chosen_cells():
    i, k = np.array([0, 3, 7, 14, 30, 60]), np.array([20, 150, 90, 45, 100, 95])
    case = Case("coma", (Facets(EPD(0.003, 1.0), (1.5,) * 3), Body((1, 1, 1), 1.0)), coma(0.5, angle=0.6))
    rule = sphere_cells.Cells(THETA_H[i][None], THETA_D[[50]], PHI_D[k][None], case.setup, finest=finest(case))
    found = records(case, [50])[:, i, 0, k]
    for terms, right in zip(found, (rule.directions(EPD(0.003, 1.0))[0], rule.body()[0]), strict=True):
        np.testing.assert_allclose(terms, right, rtol=1e-4, atol=1e-7 * right.max())


def test_each_cell_above_the_horizon_has_a_value():
    for name in ("underflow", "clear coat"):
        case = case_of(name)
        x, _, cos_i, cos_o = positions(THETA_D[70])
        above = (cos_i > 0) & (cos_o > 0)
        found = records(case, [70])[:, :, 0]
        assert np.isfinite(found[:, above]).all()
        assert (found[:, above] >= 0).all()
        assert np.isnan(found[:, ~above]).all()
        assert x.shape == found.shape[1:]


def test_the_truth_is_reciprocal_and_finite_above_the_horizon():
    for case in CASES:
        value = truth(case)
        np.testing.assert_array_equal(np.isnan(value), np.isnan(value[:, :, ::-1]))
        np.testing.assert_allclose(value[:, ::8], value[:, ::8, ::-1], rtol=1e-9)


def test_noise_has_the_stated_size():
    case = Case("noise", (), relative=0.02, floor=0.0, gain=0.01)
    pairs = np.ones((90, 90, 180, 2, 3))
    table = noisy(case, pairs)
    gains = table[40:70].mean((0, 2))
    assert np.std(gains) == pytest.approx(0.01, rel=0.2)
    # the mean of two pixels
    assert np.std(table[60:, 10] / gains[10]) == pytest.approx(0.02 / np.sqrt(2), rel=0.1)
    np.testing.assert_array_equal(noisy(case._replace(relative=0.0, gain=0.0), pairs), np.ones((90, 90, 180, 3)))
