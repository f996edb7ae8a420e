"""A lamp table held against highlights before the fit: what is taken of it, and what is said."""

from types import SimpleNamespace

import numpy as np
import pytest

from matcam.files.capture import LampGuess
from matcam.reconstruction.stated.stated_lamps import first_lamps, stated_lamps

ANGLE, AZIMUTH = np.radians([15, 40, 75, 110, 140]), np.radians([20, 100, 200, 300, 45])
NAMES = [f"L{k}" for k in range(5)]
STD = np.radians(0.3)


def polar(angle, azimuth):
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


def stated(angle, azimuth):
    """What is taken of a table; the highlights are right to 0.1 degrees."""
    seen = polar(ANGLE, AZIMUTH) + np.radians(0.1) * np.random.default_rng(0).normal(size=(5, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    table = {name: LampGuess(*pair) for name, *pair in zip(NAMES, angle, azimuth, strict=True)}
    remarks = []
    settings = {"distances": {"lamp_mm": [1000.0, 5.0]}}
    given = SimpleNamespace(lamps=table, direction_std=STD, settings=settings)
    directions, stds = stated_lamps(given, NAMES, seen, remarks)
    return directions, stds, seen, [remark.code for remark in remarks]


def test_a_right_table_is_taken_as_it_is():
    directions, stds, _, codes = stated(ANGLE, AZIMUTH)
    assert codes == ["lamp-table"]
    assert directions == pytest.approx(polar(ANGLE, AZIMUTH))
    assert stds == pytest.approx(STD)


@pytest.mark.parametrize(
    ("mistake", "angle", "azimuth"),
    [
        ("y-flipped", ANGLE, -AZIMUTH),
        ("normals", ANGLE / 2, AZIMUTH),
        ("radians-as-degrees", np.radians(ANGLE), np.radians(AZIMUTH)),
        ("degrees-as-radians", np.degrees(ANGLE), np.degrees(AZIMUTH)),
    ],
)
def test_a_usual_mistake_is_named_and_the_highlights_are_used(mistake, angle, azimuth):
    directions, stds, seen, codes = stated(angle, azimuth)
    assert codes == ["lamp-table", f"table-{mistake}"]
    assert directions == pytest.approx(seen)
    assert stds.min() > np.radians(15)


def test_a_table_a_few_degrees_off_is_left_to_the_joint_fit():
    _, stds, _, codes = stated(ANGLE + np.radians([5, -4, 6, -5, 4]), AZIMUTH)
    assert codes == ["lamp-table"]
    assert stds == pytest.approx(STD)


def test_a_table_of_other_lamps_is_hardly_believed():
    _, stds, _, codes = stated(ANGLE[[2, 0, 4, 1, 3]], AZIMUTH[[1, 3, 0, 4, 2]])
    assert codes == ["lamp-table", "table-contradicts"]
    assert stds.min() > np.radians(15)


def test_where_nothing_is_stated_the_highlights_begin():
    directions, stds, seen, codes = stated(ANGLE * np.nan, AZIMUTH)
    assert codes == []
    assert directions == pytest.approx(seen)
    assert stds.min() > np.radians(15)


def test_a_highlight_that_contradicts_the_table_alone_is_no_start():
    """Seen in a capture of gold of roughness 0.001: the highlight of the lamp at 160 degrees was 8 degrees off, +- 11."""
    table = polar(ANGLE, AZIMUTH)
    seen = polar(ANGLE + np.radians([0.2, -0.3, 0.2, 0.3, 8.0]), AZIMUTH)

    def first(std_deg, off=seen):
        variance = np.radians(std_deg) ** 2 * np.ones(5)
        return first_lamps(off, variance[:, None, None] * np.diag([1, 1, 0]), table, np.full(5, STD))

    assert first(11.0)[:4] == pytest.approx(seen[:4])
    assert first(11.0)[4] == pytest.approx(table[4])
    # a highlight that is known well is right, and so are highlights that all contradict the table
    assert first(0.1) == pytest.approx(seen)
    all_off = polar(ANGLE + np.radians(8.0), AZIMUTH)
    assert first(11.0, all_off) == pytest.approx(all_off)
