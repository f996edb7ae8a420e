"""Distortion and growth of the blur over the field, from places and widths made by another rule."""

import numpy as np
import pytest

from matcam.calibration.camera.lens_over_field import BlurSamples, lens_over_field
from matcam.calibration.chart.registration import radial_distortion
from matcam.core.errors import FitError

SHAPE = (800, 1200)
HALF = np.hypot(*SHAPE) / 2


def photographed(k1, seed, noise=0.02, tilt=(0.1, -0.06)):
    """A grid of 15 x 10 dots on a tilted page 2 m away, seen through a lens: page, picture."""
    rng = np.random.default_rng(seed)
    page = np.stack(np.meshgrid(np.linspace(-70, 70, 15), np.linspace(-45, 45, 10)), -1).reshape(-1, 2)
    depth = 2000 + page @ tilt * 10
    u, v = 14000 * page.T / depth
    r2 = (u**2 + v**2) / HALF**2
    seen = np.stack([u * (1 + k1 * r2), v * (1 + k1 * r2)], -1) + (np.array(SHAPE[::-1]) - 1) / 2
    return page, seen + noise * rng.standard_normal(seen.shape)


def blurred(seed, growth, count=60, noise=0.01):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, SHAPE[1], count), rng.uniform(0, SHAPE[0], count)
    rho2 = ((x - 599.5) ** 2 + (y - 399.5) ** 2) / HALF**2
    sigma = 0.6 * (1 + growth * rho2) * (1 + noise * rng.standard_normal(count))
    return BlurSamples(np.column_stack([x, y]), sigma, np.full(count, 0.6 * noise))


def test_distortion_and_its_error_over_thirty_photographs():
    found = np.array([radial_distortion(*photographed(0.01, seed), SHAPE) for seed in range(30)])
    pulls = (found[:, 0] - 0.01) / found[:, 1]
    assert found[:, 1].max() < 3e-4
    assert 0.7 < np.std(pulls) < 1.3
    assert abs(pulls.mean()) < 0.6


def test_dots_that_are_elsewhere_are_left_out():
    page, seen = photographed(-0.02, 5)
    seen[7] += 3.0
    value, std = radial_distortion(page, seen, SHAPE)
    assert abs(value + 0.02) < 4 * std
    with pytest.raises(FitError, match="at least 12"):
        radial_distortion(page[:8], seen[:8], SHAPE)


def test_growth_of_the_blur_and_where_its_mean_holds():
    pulls = []
    for seed in range(30):
        field = lens_over_field([blurred(seed, 0.25)], SHAPE)
        pulls.append((field.growth.value * (1 + 0.25 * (field.holds_at / HALF) ** 2) - 0.25) / field.growth.std)
        assert field.k1 == (0.0, 0.01)
        # sigma at rho0 is the mean of all
        assert 0.6 * (1 + 0.25 * (field.holds_at / HALF) ** 2) == pytest.approx(
            np.mean(blurred(seed, 0.25).sigma), rel=0.01
        )
    assert abs(np.mean(pulls)) < 0.6
    assert 0.7 < np.std(pulls) < 1.3


def test_pictures_of_different_blur_make_one_growth():
    one, other = blurred(0, 0.2), blurred(1, 0.2)
    field = lens_over_field([one, other._replace(sigma=2 * other.sigma, sigma_std=2 * other.sigma_std)], SHAPE)
    assert abs(field.growth.value * (1 + 0.2 * (field.holds_at / HALF) ** 2) - 0.2) < 4 * field.growth.std


def test_nothing_measured_says_nothing():
    few = BlurSamples(*(column[:5] for column in blurred(0, 0.2)[:3]))
    assert lens_over_field([few], SHAPE) is None
    page, seen = photographed(0.01, 0)
    width = np.full(len(page), 0.5)
    field = lens_over_field([BlurSamples(seen, width, width / 50, page)], SHAPE)
    assert abs(field.growth.value) < 4 * field.growth.std
    assert abs(field.k1.value - 0.01) < 4 * field.k1.std
    assert field.centre == (599.5, 399.5)
    assert field.unit == pytest.approx(HALF)
