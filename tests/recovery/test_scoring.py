"""Scores of tables whose errors are known, and the comparison of methods."""

import numpy as np
import pytest
from benchmarks.recovery import generate, scoring, summary

from tests.recovery.synthetic import table


def rows_of(score):
    return {(row["quantity"], row["theta_d"]): row for row in score["rows"]}


def test_the_truth_has_no_error():
    score = scoring.score(table(), table().true, 0.1 * table().true)
    rows = rows_of(score)
    assert {quantity for quantity, _ in rows} == {"peak", "slope", "tail", "F"}
    assert {band for _, band in rows} == set(scoring.BANDS)
    assert max(row["rms"] for row in rows.values()) < 1e-12
    assert score["harm"] == 0
    assert score["answered"] == 1
    assert all(part["within 1"] == 1 for part in score["coverage"].values())
    assert all(row["predicted"] == pytest.approx(0.1) for (q, _), row in rows.items() if q != "F")


def test_a_common_factor_is_an_error_of_peaks_and_not_of_f():
    rows = rows_of(scoring.score(table(), 1.1 * table().true))
    for (quantity, _), row in rows.items():
        assert row["rms"] == pytest.approx(0 if quantity == "F" else 0.1, abs=1e-12)
        assert row["predicted"] is None


def test_f_is_the_shape_of_the_peaks_over_theta_d():
    tilted = table().true * (1 + 0.2 * (np.degrees(generate.THETA_D) > 60))[:, None, None]
    rows = rows_of(scoring.score(table(), tilted))
    assert rows["F", "60-80"]["rms"] == pytest.approx(0.2)
    assert rows["F", "0-30"]["rms"] == pytest.approx(0, abs=1e-12)


def test_the_record_loses_half_of_the_peaks():
    score = scoring.score(table(), table().recorded)
    assert rows_of(score)["peak", "0-30"]["rms"] > 0.3
    assert rows_of(score)["tail", "0-30"]["rms"] < 1e-5
    assert score["harm"] == 0
    assert score["peak curve"][0] == pytest.approx(0.5, abs=1e-3)
    assert score["coverage"] == {}
    assert score["supported peaks"] is None


def test_coverage_is_the_share_of_normal_errors():
    random = np.random.default_rng(1)
    std = 0.02 * table().true
    value = table().true + std * random.standard_normal(std.shape)
    for part in scoring.score(table(), value, std)["coverage"].values():
        assert part["within 1"] == pytest.approx(0.683, abs=0.01)
        assert part["within 2"] == pytest.approx(0.954, abs=0.01)


def test_what_is_missing_counts_as_recorded():
    value = table().true.copy()
    value[:, ::2] = np.nan
    score = scoring.score(table(), value, 0.01 * table().true)
    assert score["answered"] == pytest.approx(0.5, abs=0.02)
    half = scoring.score(table(), np.where(np.isfinite(value), value, table().recorded))
    assert rows_of(score)["peak", "30-60"]["rms"] == pytest.approx(rows_of(half)["peak", "30-60"]["rms"])
    # nothing is stated of an entry that is not answered
    assert all(part["within 1"] == 1 for part in score["coverage"].values())


def test_harm_is_judged_with_the_stated_error():
    worse = table().true * np.where(np.arange(90)[:, None] % 2, 1.0, 1.5)[:, :, None, None]
    harm = scoring.score(table(), worse)["harm"]
    assert 0.2 < harm < 0.6
    assert scoring.score(table(), worse, 0.3 * table().true)["harm"] == 0


def test_support_is_derived_from_the_error_and_false_beyond_three():
    value = table().true * 1.04
    score = scoring.score(table(), value, 0.01 * table().true)
    assert score["supported peaks"] == 1
    assert score["false support"] == 1
    score = scoring.score(table(), value, 0.06 * table().true)
    assert score["supported peaks"] == 0
    assert score["false support"] is None
    flagged = scoring.score(table(), value, 0.06 * table().true, np.ones(value.shape, bool))
    assert flagged["supported peaks"] == 1
    assert flagged["false support"] == 0


def test_a_stated_error_counts_as_all_of_the_value_at_most():
    rows = rows_of(scoring.score(table(), table().true, 1e12 * table().true))
    assert rows["peak", "0-30"]["predicted"] == 1


def test_entries_below_the_noise_are_in_no_row():
    rows = rows_of(scoring.score(table(), table().true, floor=0.1))
    assert ("tail", "0-30") not in rows
    assert ("peak", "0-30") in rows


def one_row(rms, predicted=None):
    return {"case": {"rows": [{"quantity": "peak", "theta_d": "0-30", "rms": rms, "predicted": predicted}]}}


@pytest.mark.parametrize(
    ("rms", "predicted", "best", "within"),
    [(0.01, 0.01, 1, 1), (0.02, 0.01, 1, 1), (0.025, 0.01, 0, 1), (0.05, 0.01, 0, 0), (0.025, None, 0, 0)],
)
def test_comparison_with_the_best_rival(rms, predicted, best, within):
    scores = {"a": one_row(rms, predicted), "b": one_row(0.02), "c": one_row(0.3), "d": one_row(0.001)}
    found = summary.comparison(scores, "a", ["b", "c"])
    assert (found["rows"], found["best"], found["within"]) == (1, best, within)
    assert [(one["rival"], one["within"]) for one in found["beaten"]] == ([] if best else [("b", bool(within))])


def test_coverage_outside_of_the_ranges_is_named():
    score = {"coverage": {"peak": {"within 1": 0.7, "within 2": 0.95}, "tail": {"within 1": 0.85, "within 2": 0.97}}}
    assert summary.outside(score) == ["tail"]
    found = summary.coverage({"a": score, "b": score})
    assert found["tail"] == {"within 1": 0.85, "within 2": 0.97, "tables": 2}
    assert "slope" not in found
