"""Lamp tables held against highlights: each usual mistake by name."""

import numpy as np
import pytest

from matcam.acquisition.lamps.lamp_table import explain_lamp_table
from matcam.acquisition.mirror_ball import unit
from matcam.core.errors import ArgumentError


def lamps(seed=0, count=14):
    rng = np.random.default_rng(seed)
    angle, azimuth = np.radians(rng.uniform(5, 80, count)), rng.uniform(0, 2 * np.pi, count)
    return polar(angle, azimuth), angle, azimuth


def polar(angle, azimuth):
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


def seen(true, degrees=0.15, seed=1):
    return unit(true + np.random.default_rng(seed).normal(0, np.radians(degrees), true.shape))


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
