"""Lateral colour: colours of different size in one picture. Truth: squares drawn larger or smaller about a point."""

import numpy as np
import pytest

from matcam import calibrate
from matcam.calibration.camera.lateral_colour import lateral_remark
from matcam.figures.calibration import calibration_figure
from tests.oracle import slanted_squares

SHAPE = (420, 440)
LARGER = {"R": 1.0012, "G": 1.0, "B": 0.9995}
SIGMA = 0.6


def picture(rng, scales):
    """R, G, B of a chart at SNR 100, magnified about a point near the middle."""
    planes = [slanted_squares.field(SHAPE, 140 * m, 74 * m, 5, SIGMA, dark=0.25)[0] for m in scales.values()]
    return rng.poisson(np.stack(planes, -1) * 1e4).astype(float)


@pytest.fixture(scope="module")
def found():
    return calibrate([picture(np.random.default_rng(81), LARGER)])


def test_colours_of_different_size_are_told(found):
    assert set(found.lateral_colour) == {"R", "B"}
    half = np.hypot(*SHAPE) / 2
    for name, lateral in found.lateral_colour.items():
        truth = (LARGER[name] - 1) * half
        assert lateral.corner == pytest.approx(truth, abs=3 * lateral.corner_std + 0.003)
        assert lateral.corner_std < 0.03
        assert lateral.edges >= 12


def test_it_is_said_where_it_can_be_seen(found):
    said = [remark.text for remark in found.remarks if remark.code == "lateral-colour"]
    assert [text.split()[0] for text in said] == [
        name for name, one in found.lateral_colour.items() if lateral_remark(one, name, "G")
    ]
    assert any(text.startswith("R lies 0.3") and "further out" in text for text in said)
    assert found.to_dict()["lateral_colour"]["R"]["corner"] == found.lateral_colour["R"].corner


def test_maps_are_drawn(found):
    image = np.zeros((*SHAPE, 3))
    titles = [axes.get_title(loc="left") for axes in calibration_figure(found, image, ["a line"]).axes]
    assert sum(title.startswith("Blur in parts of the image, G") for title in titles) == 1
    assert sum(title.startswith("Lateral colour") for title in titles) == 1
    without = [axes.get_title(loc="left") for axes in calibration_figure(found, None, []).axes]
    assert not any("parts of the image" in title for title in without)


def test_equal_colours_are_not_remarked_on():
    result = calibrate([picture(np.random.default_rng(82), dict.fromkeys("RGB", 1.0))])
    assert not any(remark.code == "lateral-colour" for remark in result.remarks)
    assert all(abs(one.corner) < 4 * one.corner_std for one in result.lateral_colour.values())
