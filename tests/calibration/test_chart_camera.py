"""The oracle's camera against truth from elsewhere: its own error is far below the figures that it judges."""

import galsim
import numpy as np
import pytest

from tests.oracle import slanted_edge
from tests.oracle.chart_camera import ChartCamera

FRONT = {"page": (100.0, 60.0), "width": 200, "height": 120, "filled": 1.0}


def chart(*elements):
    return {"fiducials": [], "ink_level": 0.05, "elements": list(elements)}


@pytest.mark.parametrize(("sigma", "fill"), [(0.4, 0.6), (0.4, 1.0), (1.0, 0.8)])
def test_edge_is_that_of_the_closed_form(sigma, fill):
    camera = ChartCamera(**FRONT, sigma=sigma, fill=fill)
    # an edge through the middle, 5 degrees off the columns, of a square that reaches beyond the picture on all other sides
    slope = np.tan(np.radians(5))
    corners = [[50 + 60 * slope, -30], [200, -30], [200, 90], [50 - 60 * slope, 90]]
    picture = camera.expected(chart({"kind": "square", "corners_mm": corners, "level": 0.25}))
    truth = 1 - 0.75 * slanted_edge.gaussian(sigma, 5.0, fill / 2, height=120, width=200)
    assert np.abs(picture - truth).max() < 1e-6


def test_dot_is_that_of_galsim():
    camera = ChartCamera(**FRONT, sigma=0.5)
    dot = {"kind": "dots", "centres_mm": [[50.1, 30.2]], "radius_mm": 0.7, "pitch_mm": 9.0, "level": 0.0}
    picture = 1 - camera.expected(chart(dot))
    fine = galsim.GSParams(folding_threshold=1e-5, maxk_threshold=1e-6, kvalue_accuracy=1e-9, maximum_fft_size=16384)
    profile = galsim.Convolve(galsim.TopHat(1.4, flux=np.pi * 1.4**2), galsim.Gaussian(sigma=0.5), gsparams=fine)
    stamp = profile.shift(0.2, 0.4).drawImage(nx=200, ny=120, scale=1.0, dtype=float).array
    assert np.abs(picture - stamp).max() < 1e-5


def test_pictures_do_not_depend_on_the_sampling():
    star = {
        "kind": "star", "centre_mm": [30, 30], "inner_mm": 4, "outer_mm": 25, "cycles": 48, "phase_rad": 0.3, "dark": 0.25,
        "bright": 0.95,
    }  # fmt: skip
    bars = {
        "kind": "grating", "profile": "bars", "centre_mm": [78, 30], "size_mm": [30, 40], "angle_rad": 0.2, "period_mm": 1.3,
        "phase_rad": 0.1, "dark": 0.25, "bright": 1.0, "duty": 0.5,
    }  # fmt: skip
    camera = ChartCamera(**FRONT, sigma=0.4, fill=0.6, tilt=(0.1, -0.05), distortion=0.02)
    pictures = [camera.expected(chart(star, bars), fine) for fine in (4, 7)]
    assert np.abs(pictures[0] - pictures[1]).max() < 1e-6


def test_positions_there_and_back():
    camera = ChartCamera(**FRONT, tilt=(0.2, -0.1), roll=0.3, distortion=-0.02, shift=(3, 4))
    x, y = np.array([5.0, 95, 40]), np.array([7.0, 50, 20])
    np.testing.assert_allclose(camera.page_of(*camera.sensor_of(x, y)), [x, y], atol=1e-9)


def test_wave_that_arrives_has_the_stated_mtf():
    f, direction = 0.31, 0.2
    sine = {
        "kind": "grating", "profile": "sine", "centre_mm": [50, 30], "size_mm": [80, 40], "angle_rad": direction,
        "period_mm": 0.5 / f, "phase_rad": 0.0, "dark": 0.2, "bright": 0.8, "duty": 0.5,
    }  # fmt: skip
    camera = ChartCamera(**FRONT, sigma=0.45, fill=0.7)
    picture = camera.expected(chart(sine))
    y, x = np.mgrid[-15:16, -30:31]
    part = picture[60 - 15 : 60 + 16, 100 - 30 : 100 + 31]
    phase = 2 * np.pi * f * ((x + 0.5) * np.cos(direction) + (y + 0.5) * np.sin(direction))
    design = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=-1).reshape(-1, 3)
    found, residual, *_ = np.linalg.lstsq(design, part.ravel(), rcond=None)
    np.testing.assert_allclose(found, [0.5, 0.3 * camera.mtf(f, direction), 0], atol=1e-6)
    assert residual < 1e-8
