"""Recorded tables of the benchmark, their cases, and the draws of hidden cases."""

import json

import numpy as np
import pytest
from benchmarks.recovery import cases, generate, records

from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H
from tests.oracle.real_pixels import RealTable
from tests.oracle.sphere_cells import GGX, Setup
from tests.oracle.whole_tables import Case, truth
from tests.recovery.synthetic import CASE, table

LAST = 76
"""Slice of theta_d in which few pixels are lit."""


def test_there_are_24_cases_of_every_kind():
    assert len({case.name for case in cases.PUBLIC}) == 24
    assert {case.lens for case in cases.PUBLIC} == {"Gaussian", "Airy", "disc", "coma", "measured"}
    assert {case.table.stated and round(case.table.stated[1], 2) for case in cases.PUBLIC} == {None, 0.03, 0.3}
    assert {case.rule for case in cases.PUBLIC} == {"centre", "nearest", "bilinear"}
    widths = [term.lobe[0] for case in cases.PUBLIC for term in case.table.terms if hasattr(term, "lobe")]
    widths = [width for width in widths if isinstance(width, float)]
    assert min(widths) == 0.0007
    assert max(widths) == 0.3


def test_what_is_stated_is_plain_and_hides_the_truth():
    for case in cases.PUBLIC:
        facts = json.loads(json.dumps(cases.stated(case)))
        assert set(facts) == {"name", "sphere", "pixel_half_width_px", "lens", "cell_value"}
        assert (facts["lens"] is None) == (case.table.stated is None and case.mtf is None)
    assert cases.stated(cases.public_case("nearest-pixel"))["cell_value"] == "unknown"


def test_hidden_cases_are_drawn_from_their_seed_alone():
    some = [cases.hidden_case(f"seed {n}") for n in range(60)]
    assert some[7] == cases.hidden_case("seed 7")
    assert len({case.name for case in some}) == 60
    assert {case.lens for case in some} == {"Gaussian", "Airy", "disc", "coma", "measured"}
    assert {case.rule for case in some} == {"centre", "nearest", "bilinear"}
    assert {case.table.stated for case in some} == {None, (0.5, 0.03), (0.5, 0.3)}
    for case in some:
        json.dumps(cases.stated(case))
        assert all(term.factor(THETA_D).shape == (90, 3) for term in case.table.terms)


def test_the_hash_of_seeds_ignores_only_white_space():
    assert cases.seeds_hash("a\nb\n") == cases.seeds_hash(" a \r\n b")
    assert cases.seeds_hash("a\nb") != cases.seeds_hash("b\na")
    assert cases.seeds_hash("a\nb") != cases.seeds_hash("ab")


def test_the_mtf_of_a_lens_of_points_is_the_mean_of_its_fourier_transform():
    setup, f = cases.measured_lens(), 0.7
    share, x, y = np.array(setup.lens).T
    turn = 2 * np.pi * (np.arange(360) + 0.5) / 360
    phase = 2 * np.pi * f * (x[:, None] * np.cos(turn) + y[:, None] * np.sin(turn))
    right = (share @ np.cos(phase)).mean() * np.exp(-2 * (np.pi * setup.sigma * f) ** 2)
    assert cases.mean_mtf(setup, [f])[0] == pytest.approx(right, rel=1e-6)
    assert cases.mean_mtf(setup, [0.0])[0] == pytest.approx(1)


def test_the_stated_mtf_is_off_by_about_a_per_cent():
    f, values = map(np.array, cases.stated_mtf(cases.measured_lens(), 4))
    error = values[:-1] / cases.mean_mtf(cases.measured_lens(), f[:-1]) - 1
    assert error[0] == pytest.approx(0, abs=1e-12)
    assert 1e-3 < np.abs(error).max() < 0.03
    assert values[-1] == 0


@pytest.mark.parametrize("rule", ["nearest", "bilinear"])
def test_cells_on_real_pixels_agree_with_the_rule_for_chosen_cells(rule):
    lobe = GGX(0.05)
    case = cases.RecoveryCase(Case("a", cases.metal(lobe, cases.CHROMIUM)), "Gaussian", rule, (0.2, -0.4))
    kept = records.records(case, [LAST])[f"pixels-{LAST}"]
    share, number, _ = records.pixels(case, LAST)
    found = (share * kept[0][number]).sum(1).reshape(90, 180)
    i, k = np.argwhere(generate.judged_cells()[:, LAST])[::40].T
    right = RealTable(rule, case.phase, THETA_D[[LAST]], [(THETA_H[i], PHI_D[k])], Setup(), 0.005)
    right = right.values(right.pixels(lobe))[0]
    assert np.isfinite(right).sum() > 20
    np.testing.assert_allclose(found[i, k][np.isfinite(right)], right[np.isfinite(right)], rtol=1e-4)


def test_a_table_of_pixels_has_the_noise_of_pixels():
    case = cases.RecoveryCase(CASE.table._replace(relative=0.02, floor=0.0, gain=0.0), "Gaussian", "nearest")
    kept = {f"pixels-{j}": np.ones((1, len(records.pixels(case, j)[2]))) for j in (20, 40, 60)}
    found = generate.assemble(case, kept)
    there = np.isin(np.arange(90), (20, 40, 60))[:, None] & found.judged
    error = (found.recorded / found.clean - 1)[20:][there[20:]]  # the two pixels differ there
    assert np.std(error) == pytest.approx(0.02 / np.sqrt(2), rel=0.02)
    assert np.isfinite(error).all()
    assert np.isnan(found.recorded[:, 21]).all()
    np.testing.assert_array_equal(found.recorded, generate.assemble(case, kept).recorded)
    # cells of one pixel share its noise
    top = (found.recorded / found.clean)[0, 40, :, 0]
    assert len(np.unique(top.round(12))) < 5


def test_judged_cells_have_a_true_value():
    judged = generate.judged_cells()
    assert np.isfinite(truth(CASE.table)[judged]).all()
    assert 0.6 < judged[:, :80].mean() < 0.8
    assert table().true.shape == (90, 90, 180, 3)


def test_records_do_not_depend_on_noise_or_name():
    other = CASE._replace(table=CASE.table._replace(name="other", relative=0.5))
    assert records.fingerprint(CASE) == records.fingerprint(other)
    assert records.fingerprint(CASE) != records.fingerprint(CASE._replace(phase=(0.1, 0.0)))
