"""Charts found in photographs by the oracle's camera, in all poses."""

import dataclasses
import json

import numpy as np
import pytest

from matcam.calibration.chart.chart_file import write_chart
from matcam.calibration.chart.chart_layout import design_chart
from matcam.calibration.chart.registration import register_chart
from matcam.core.errors import ArgumentError, FitError
from tests.oracle.chart_camera import ChartCamera

SIZE = {"width": 800, "height": 620}


@pytest.fixture(scope="module")
def chart(tmp_path_factory):
    """A chart, and its description for the oracle; its dots are left out of pictures, which takes a second each."""
    path = tmp_path_factory.mktemp("chart") / "chart.json"
    found = design_chart(("squares", "star", "dots"), pixels_across=700)
    write_chart(path, found)
    document = json.loads(path.read_text())
    document["elements"] = [e for e in document["elements"] if e["kind"] != "patch"]
    return found, document


POSES = [
    {"distortion": 0.02, "vignetting": 0.3},
    {"roll": 2.9, "filled": 0.65, "distortion": -0.02},
    {"tilt": (0.4, 0.3), "filled": 0.75, "vignetting": 0.4},
    {"roll": 0.5, "filled": 0.65, "sigma": 0.7},
]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("cfa", [None, "BGGR"])
def test_any_pose(chart, pose, cfa):
    description, document = chart
    camera = ChartCamera(**SIZE, page=description.page, **pose)
    photograph = camera.photograph(camera.expected(document), 60, 1, cfa)
    found = register_chart(photograph, description, mosaic=cfa is not None)
    assert found.found >= 7
    points = np.random.default_rng(0).uniform(0.05, 0.95, (200, 2)) * description.page
    error = found(points) - np.stack(camera.sensor_of(*points.T), axis=-1)
    assert np.hypot(*error.T).max() < 0.6  # targets find the rest themselves
    middle = (description.page[0] / 2, description.page[1] / 2)
    near = np.hypot(
        *np.diff(np.stack(camera.sensor_of(np.array([0, 1]) + middle[0], np.full(2, middle[1])), -1), axis=0)[0]
    )
    assert found.scale(middle) == pytest.approx(near, rel=0.1)


def test_a_mosaic_of_any_type(chart):
    description, document = chart
    camera = ChartCamera(**SIZE, page=description.page)
    photograph = camera.photograph(camera.expected(document), 60, 1, "RGGB")
    positions = np.array([[50.0, 50], [200, 100]])
    expected = register_chart(photograph, description, mosaic=True)(positions)
    for kind in (np.uint16, np.int32, np.float32):
        taken = photograph.astype(kind)
        np.testing.assert_allclose(register_chart(taken, description, mosaic=True)(positions), expected, atol=1e-3)
        assert (taken == photograph.astype(kind)).all()


def test_a_hidden_corner_is_no_harm(chart):
    description, document = chart
    camera = ChartCamera(**SIZE, page=description.page)
    photograph = camera.photograph(camera.expected(document), 60, 1)
    x, y = camera.sensor_of(*max((m.centre for m in description.fiducials), key=sum))
    photograph[int(y) - 20 :, int(x) - 20 :] = 500
    found = register_chart(photograph, description)
    assert found.found == len(description.fiducials) - 1
    points = np.array([[50.0, 50], [200, 100]])
    assert np.abs(found(points) - np.stack(camera.sensor_of(*points.T), axis=-1)).max() < 0.3


@pytest.mark.parametrize("seed", [21, 39])
def test_other_marks_among_the_charts_own(seed):
    """Fourteen of the kind, anywhere on the page: a loose match of all eight is not the last word."""
    description, random = design_chart(), np.random.default_rng(seed)
    positions = np.array([mark.centre for mark in description.fiducials])
    y, x = np.indices((620, 840))
    seen = [*(2.4 * positions + [60, 50])]
    while len(seen) < 22:
        position = random.uniform([70, 60], [762.8, 544])
        if min(np.hypot(*(position - other)) for other in seen) > 30:
            seen.append(position)
    page = np.ones(y.shape)
    for i, (at_x, at_y) in enumerate(seen):
        radius = np.hypot(x - at_x, y - at_y) / (2.4 * description.fiducials[0].radius if i < 8 else 3.0)
        second = i < 8 and description.fiducials[i].rings == 2
        page[(radius < 1) | ((radius > 2) & (radius < 3)) | (second & (radius > 4) & (radius < 5))] = 0.1
    found = register_chart(page, description)
    assert np.abs(found(positions) - seen[:8]).max() < 1


def test_refusals(chart):
    description, document = chart
    noise = np.random.default_rng(0).poisson(1000, (300, 400)).astype(float)
    with pytest.raises(FitError) as error:
        register_chart(noise, description)
    assert "fiducials" in str(error.value)
    with pytest.raises(ArgumentError):
        register_chart(noise, dataclasses.replace(description, fiducials=()))
    camera = ChartCamera(**SIZE, page=description.page)
    photograph = camera.photograph(camera.expected(document), 60, 1)
    moved = [
        dataclasses.replace(m, centre=(m.centre[0] + 40 * (i % 2), m.centre[1]))
        for i, m in enumerate(description.fiducials)
    ]
    with pytest.raises(FitError):
        register_chart(photograph, dataclasses.replace(description, fiducials=tuple(moved)))
    with pytest.raises(FitError):
        register_chart(photograph[:, ::-1], description)
