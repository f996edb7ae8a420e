"""Lamp tables held against highlights: distances, arcs, and each usual mistake by name."""

import numpy as np
import pytest

from matcam.acquisition.lamps.lamp_table import explain_lamp_table, fit_arc, radius_by_highlights
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.core.errors import ArgumentError, FitError


def lamps(seed=0, count=14):
    rng = np.random.default_rng(seed)
    angle, azimuth = np.radians(rng.uniform(5, 80, count)), rng.uniform(0, 2 * np.pi, count)
    return polar(angle, azimuth), angle, azimuth


def polar(angle, azimuth):
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


def seen(true, degrees=0.15, seed=1):
    return unit(true + np.random.default_rng(seed).normal(0, np.radians(degrees), true.shape))


def test_highlight_radius_tells_the_sum_of_inverse_distances():
    rng = np.random.default_rng(2)
    true, *_ = lamps(count=40)
    true = true[true[:, 2] > 0.7]
    rows, columns = MirrorBall(100.0, 100.0, 80.0, 60.0).mirror_position(true, 90.0)
    rows, columns = rows + rng.normal(0, 0.02, rows.shape), columns + rng.normal(0, 0.02, rows.shape)
    found = radius_by_highlights(rows, columns, true, MirrorBall(100.0, 100.0, 80.0), np.array([0.01, 0.01, 0.02]))
    assert found.inverse_distances == pytest.approx(1 / 60 + 1 / 90, abs=max(3 * found.inverse_distances_std, 0.003))
    assert [remark.code for remark in found.remarks] == ["radius-mismatch"]
    rows, columns = MirrorBall(100.0, 100.0, 80.0).mirror_position(true)
    assert abs(radius_by_highlights(rows, columns, true, MirrorBall(100.0, 100.0, 80.0)).mismatch) < 1e-9
    with pytest.raises(FitError, match="at least 4"):
        radius_by_highlights(rows[:3], columns[:3], true[:3], MirrorBall(100.0, 100.0, 80.0))


def test_arc_is_found():
    """An arm that turns about a tilted axis, its lamp 1.2 degrees off the great circle."""
    axis = unit(np.array([0.2, 1.0, 0.1]))
    first = unit(np.cross(axis, [1.0, 0.0, 0.0]))
    turn, opening = np.radians([-60, -30, -5, 20, 45, 75]), np.radians(88.8)
    on = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(axis, first)
    true = np.cos(opening) * axis + np.sin(opening) * on
    found = fit_arc(seen(true, 0.05), std=np.radians(0.05))
    side = np.sign(found.axis @ axis)
    assert np.degrees(np.arccos(abs(found.axis @ axis))) < 0.2
    assert np.degrees(found.opening if side > 0 else np.pi - found.opening) == pytest.approx(88.8, abs=0.15)
    assert np.degrees(found.angles) * side == pytest.approx(np.degrees(turn - turn[0]), abs=0.3)
    assert found.rms < np.radians(0.1)
    with pytest.raises(FitError, match="deviate from one arc"):
        fit_arc(lamps()[0])


def named(table, true=None):
    true = lamps()[0] if true is None else true
    verdict = explain_lamp_table(seen(true), table)
    return verdict.mistake, [remark.code for remark in verdict.remarks]


def test_a_right_table_has_no_mistake():
    assert named(lamps()[0]) == ("none", [])


def test_flipped_y_axis():
    assert named(lamps()[0] * [1, -1, 1]) == ("y-flipped", ["table-y-flipped"])


def test_lamp_directions_taken_for_normals():
    """The table holds the normals at the highlights, where it should hold lamps."""
    assert named(unit(lamps()[0] + [0, 0, 1]))[0] == "normals"


def test_lamps_reflected_twice():
    _, angle, azimuth = lamps()
    assert named(polar(2 * angle, azimuth))[0] == "halved"


def test_degrees_for_radians():
    _, angle, azimuth = lamps()
    assert named(polar(np.degrees(angle), np.degrees(azimuth)))[0] == "degrees-as-radians"


def test_radians_for_degrees():
    _, angle, azimuth = lamps()
    assert named(polar(np.radians(angle), np.radians(azimuth)))[0] == "radians-as-degrees"


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("x-flipped", lambda table: table * [-1, 1, 1]),
        ("z-flipped", lambda table: table * [1, 1, -1]),
        ("xy-swapped", lambda table: table[:, [1, 0, 2]]),
        ("xy-flipped", lambda table: table * [-1, -1, 1]),
        ("light-reversed", lambda table: -table),
        ("order-reversed", lambda table: table[::-1]),
    ],
)
def test_other_mistakes(name, made):
    assert named(made(lamps()[0]))[0] == name


def test_a_table_of_other_lamps_is_not_explained():
    assert named(lamps(seed=7)[0]) == ("unexplained", ["table-contradicts"])
    with pytest.raises(ArgumentError, match="shape"):
        explain_lamp_table(lamps()[0], lamps()[0][:5])
    with pytest.raises(ArgumentError, match="at least 3"):
        explain_lamp_table(np.full((5, 3), np.nan), lamps()[0][:5])
