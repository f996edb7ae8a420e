"""Spheres before and after: a mirror's highlight is seen, and so is the rest of the sphere."""

import numpy as np
import pytest
from PIL import Image

from matcam import GGX, GaussianNDF, Microfacet
from matcam.figures.spheres import SIZE, highlight_zoom, logarithmic, logarithmic_range, table_sphere, write_thumbnail
from matcam.forward import true_table


@pytest.fixture(scope="module")
def mirror():
    """A lobe of 0.002 rad, a fifteenth of a thumbnail's pixel, and no diffuse part: outside of the lobe all is 0."""
    return true_table(Microfacet(GaussianNDF(0.002), 0.6, masking=None))


def test_a_thumbnail_of_a_mirror_is_no_dot_on_black(mirror, tmp_path):
    """Ground, sphere, a highlight that no pixel's centre meets, and the same magnified: brighter where it is corrected."""
    write_thumbnail(tmp_path / "a.png", mirror, 2 * mirror)
    before, after = np.split(np.asarray(Image.open(tmp_path / "a.png")).astype(int), 2, axis=1)
    for half in (before, after):
        assert half[0, 0, 0] > half[3, SIZE // 2, 0] > 10  # the ground, then the body
        assert half[: SIZE // 2 + 2, SIZE // 2 :].max() > 200  # the highlight, right of the middle
    inset = np.s_[-26:, :26, 0]
    assert np.unique(after[inset]).size > 5
    assert (after[inset] > 60).mean() > 0.02
    assert after[inset].max() > before[inset].max() > 100


def test_highlights_are_magnified_as_far_as_they_are_whole(mirror):
    assert highlight_zoom(mirror.values) >= 60
    rough = true_table(Microfacet(GGX(0.3), 0.6, 0.1)).values
    assert highlight_zoom(rough) is None
    assert highlight_zoom(mirror.values, rough) is None


def test_a_logarithmic_picture_keeps_order_and_colour():
    ramp = np.geomspace(1e-3, 1e3, 32)[None, :, None] * np.array([1.0, 0.5, 0.25]) * np.ones((32, 1, 1))
    black, white = logarithmic_range(ramp)
    assert white == 1e3
    assert 2 <= np.log10(white / black) <= 8
    row = logarithmic(ramp, black, white)[16]
    assert (np.diff(row[:, 0]) >= 0).all()
    assert (row[-1] > 0.5).all()
    assert (np.diff(row[-1]) < 0).all()


def test_noise_is_drawn_black():
    rng = np.random.default_rng(1)
    picture = np.maximum(rng.standard_normal((64, 64, 3)), 0)  # negative noise was set to 0
    picture[32, 32] = 1e4
    assert 0.8 < logarithmic_range(picture)[0] < 3


def test_nothing_lit_is_drawn(mirror):
    dark = table_sphere(np.zeros_like(mirror.values), 16)
    assert np.isfinite(logarithmic(dark, *logarithmic_range(dark))).all()
