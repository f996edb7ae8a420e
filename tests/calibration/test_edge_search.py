"""Edges are found without help, each where it is, and strips along them say what rectangles round them say."""

import json

import numpy as np
import pytest

from matcam.calibration.edge.edge import AT_ONCE, EdgeSettings, edge_mtf_stack, edge_stack
from matcam.calibration.photograph.linear_image import LinearImage, flaw
from matcam.calibration.search.edge_search import find_edges
from matcam.calibration.search.photograph_edges import strip_regions, strips_along
from matcam.files.photographs import read_photograph
from tests.oracle import slanted_edge, slanted_squares

# one worker, because all strips are measured by one compiled program


def measured(picture, cfa=None, channel=None):
    plane = LinearImage.of(picture, channel, cfa)
    strips = strips_along(find_edges(picture, mosaic=cfa is not None), plane.shape)
    regions = [rows for rows, _ in strip_regions(strips, plane, AT_ONCE)]
    return edge_stack([(rows, [flaw(value) for value in rows.value]) for rows in regions], EdgeSettings())


def matched(x, y, angle, sides):
    """For each side of a square the edge that was found on it, and how far away: px along the normal, rad."""
    away = np.hypot(x - sides[:, :1], y - sides[:, 1:2])
    nearest = away.argmin(1)
    c, s = np.cos(sides[:, 2]), np.sin(sides[:, 2])
    off = (x[nearest] - sides[:, 0]) * c + (y[nearest] - sides[:, 1]) * s
    turned = np.angle(np.exp(1j * (angle[nearest] - sides[:, 2])))
    return nearest, off, turned


SMALL, LARGE, HUGE = (300, 70, 36, 0.5), (900, 300, 170, 0.8), (2400, 800, 480, 3.0)


@pytest.mark.parametrize(
    ("size", "pitch", "side", "sigma", "degrees"),
    [(*scale, d) for scale in (SMALL, LARGE) for d in (5, 17, 31, 40, 95, -12)] + [(*HUGE, 5), (*HUGE, 40)],
)
def test_every_side_is_found_at_any_scale_and_rotation(size, pitch, side, sigma, degrees):
    picture, sides = slanted_squares.field((size, size + 40), pitch, side, degrees, sigma, light=0.5)
    noisy = picture + np.random.default_rng(1).normal(0, 1 / 60, picture.shape)
    found = find_edges(noisy)
    _, off, turned = matched(found.x, found.y, found.angle, sides)
    assert len(sides) >= 4
    assert np.max(np.abs(off)) < 0.6 * max(1, size / 1400)
    assert np.max(np.abs(turned)) < np.radians(1.0)
    assert found.x.size <= len(sides)


def test_nothing_is_found_in_noise():
    rng = np.random.default_rng(2)
    assert find_edges(rng.normal(100, 5, (400, 500))).x.size == 0
    assert find_edges(np.full((400, 500), 7, np.uint8)).x.size == 0
    assert find_edges(rng.normal(100, 5, (10, 12))).x.size == 0


@pytest.fixture(scope="module")
def chart():
    picture, sides = slanted_squares.field((420, 440), 140, 74, 5, 0.5, dark=0.25)
    return np.random.default_rng(3).poisson(picture * 1e4).astype(float), sides


def test_strips_say_where_edges_lie_and_what_they_are(chart):
    picture, sides = chart
    result = measured(picture)
    assert not any(result.problems)
    nearest, off, turned = matched(*result.position, result.angle, sides)
    assert len(set(nearest)) == len(sides) == len(result)
    assert np.max(np.abs(off)) < 0.05
    assert np.max(np.abs(turned)) < 0.002
    pulls = (result.mtf50 - slanted_edge.gaussian_half(0.5)) / result.mtf50_std
    assert abs(pulls.mean()) < 4 / np.sqrt(pulls.size)
    assert 0.6 < pulls.std() < 1.4
    assert np.max(np.abs(result.bow)) < 0.1


@pytest.mark.slow
def test_a_strip_is_a_rectangle_that_leans(chart):
    """The same edge in a rectangle, by the function for rectangles, has the same MTF to a part of its noise."""
    picture, _ = chart
    result = measured(picture)
    x, y = result.position
    upright = np.flatnonzero(np.abs(np.cos(result.angle)) > 0.9)[:3]
    boxes = [(round(y[i]), round(x[i])) for i in upright]
    cut = np.stack([picture[row - 30 : row + 30, column - 28 : column + 28] for row, column in boxes])
    rectangles = edge_mtf_stack(cut)
    assert np.all(np.abs(rectangles.mtf50 - result.mtf50[upright]) < 2 * result.mtf50_std[upright])
    assert rectangles.angle == pytest.approx(result.angle[upright], abs=2e-3)


@pytest.mark.parametrize("channel", [pytest.param(c, marks=pytest.mark.slow) for c in "RGB"])
def test_strips_of_a_mosaic_hold_one_colour(channel):
    sigmas = {"R": 0.6, "G": 0.45, "B": 0.8}
    planes = [slanted_squares.field((420, 440), 140, 74, 5, s, dark=0.25)[0] for s in sigmas.values()]
    cfa = "GRBG"
    picture = np.random.default_rng(4).poisson(slanted_squares.mosaic(planes, cfa) * 1e4).astype(float)
    result = measured(picture, cfa, channel)
    assert not any(result.problems)
    pulls = (result.mtf50 - slanted_edge.gaussian_half(sigmas[channel])) / result.mtf50_std
    assert abs(pulls.mean()) < 4 / np.sqrt(pulls.size)
    assert 0.6 < pulls.std() < 1.4


@pytest.fixture(scope="module")
def real_chart(real_data):
    """All edges of a real chart, and what is published of eight regions of it."""
    result = measured(read_photograph(real_data / "edges" / "chart_squares.png"))
    return result, json.loads((real_data / "edges" / "chart_squares.json").read_text())["rois"]


def test_the_squares_of_a_real_chart_are_found(real_chart):
    # nine whole squares, and what the picture's corners show of four more
    assert len(real_chart[0]) >= 36


_OFF = pytest.mark.xfail(
    strict=True, reason="-10.8 %: the strip is longer than the published region, in which edge_mtf is off by -6.8 %"
)


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=_OFF), 2, 3, 4, 5, 6, 7])
def test_the_squares_of_a_real_chart_are_measured_as_published(real_chart, number):
    result, published = real_chart
    roi = published[number]
    # named centres, but upper left corners; the edge runs through the middle of its region
    middle = roi["centre_x"] + roi["width"] / 2, roi["centre_y"] + roi["height"] / 2
    away = np.hypot(result.position[0] - middle[0], result.position[1] - middle[1])
    nearest = np.nanargmin(away)
    assert away[nearest] < 8, roi
    assert result.mtf50[nearest] == pytest.approx(roi["mtf50"], rel=0.1)
