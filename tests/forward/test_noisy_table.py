"""The pixels behind a table's cells, and their noise, against the oracle."""

import numpy as np
import pytest

from matcam import GGX, Flat, Microfacet, Rig, Sphere, rigs
from matcam.camera import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, below_horizon, brdf_table, merl_grid
from matcam.forward import with_pixel_noise
from matcam.forward.cells_in_pictures import CellChoice
from matcam.forward.measurement import cell_pixels, true_table
from matcam.forward.pixel_grid import pixel_numbers
from tests.oracle import merl_lobe


@pytest.fixture(scope="module")
def pixels():
    return cell_pixels(Sphere(256.0), "centre")


def recorded(width):
    """The MERL rig's table of a Gaussian lobe of reflectance 1, written down by the oracle."""
    return brdf_table(merl_lobe.record(width, np.ones((90, 3))), "centre")


def test_pixels_agree_with_the_oracles_map(pixels):
    """Two cells share a pixel here if and only if they share one there."""
    for j, (_, index) in enumerate(merl_lobe.PixelMap().pairs):
        if j % 11:
            continue
        ours = pixels[:, j]
        pairs = np.unique(np.stack([ours.ravel(), index.ravel()]), axis=1)
        assert pairs.shape[1] == np.unique(ours).size == np.unique(index).size


def test_pixel_counts_add_up_to_the_lit_picture():
    """Both ways together, the cells cover the part of the disc that lamp and camera both see."""
    counts = CellChoice("centre").cells(Sphere(256.0)).pixels
    visible = ~below_horizon("centre")
    whole = 0
    for j, theta_d in enumerate(merl_grid("centre").theta_d):
        # a small cap about the highlight is seen under cos(theta_d)
        theta_h = (20 / 90) ** 2 * np.pi / 2
        if visible[:20, j].all():
            whole += 1
            assert counts[:20, j].sum() == pytest.approx(
                256**2 * np.cos(theta_d) * 2 * np.pi * (1 - np.cos(theta_h)), rel=2e-3
            )
    assert whole > 80


def test_about_seventy_five_cells_share_the_peaks_pixel(pixels):
    """docs/model.md 5."""
    first, second = pixels[:, 30].reshape(2, -1)
    numbers, counts = np.unique(np.concatenate([first, second]), return_counts=True)
    assert counts.max() > 300  # all of the first two rings
    near = (first[:, None] == numbers[counts > 20]).any(axis=1)
    per_pixel = counts[counts > 20].mean()
    assert 40 < per_pixel < 400
    assert near.any()


def test_every_pixel_of_an_image_has_its_own_number():
    """At the radius of the MERL rig, for a shifted pixel grid, too."""
    x, y = np.meshgrid(np.arange(-300.0, 301.0), np.arange(-300.0, 301.0))
    for phase in ((0.0, 0.0), (0.3, -0.4)):
        numbers = pixel_numbers(x + phase[0], y + phase[1], phase)
        assert len(np.unique(numbers)) == x.size


@pytest.mark.slow
def test_noise_belongs_to_pixels(pixels):
    """Cells of one pixel share its noise; cells of different pixels do not; size as stated."""
    rig, table = rigs.merl(), recorded(0.05)
    bright = (slice(30), 20, slice(None), 0)  # elsewhere the lobe is 0
    noisy = [with_pixel_noise(table, rig, PixelNoise(0.02, 0.0), seed).values[bright] for seed in range(6)]
    relative = (np.stack(noisy) / table.values[bright] - 1).reshape(6, -1)
    first, second = (p[20, :30].ravel() for p in pixels)
    one_pixel = first == second
    assert np.std(relative[:, one_pixel]) > 0
    for numbers in np.unique(first[one_pixel]):
        same = one_pixel & (first == numbers)
        np.testing.assert_allclose(np.ptp(relative[:, same], axis=1), 0, atol=1e-12)
    # a cell of two pixels is the mean of two independent draws
    apart = ~one_pixel
    assert np.std(relative[:, apart]) == pytest.approx(0.02 / np.sqrt(2), rel=0.05)
    assert table.shape == (*GRID_SHAPE, 3)


def test_floor_is_a_share_of_each_pictures_peak():
    rig, table = rigs.merl(), recorded(0.002)
    noise = with_pixel_noise(table, rig, PixelNoise(0.0, 1e-3), seed=0).values - table.values
    for j in (0, 40, 80):
        peak = np.nanmax(table.values[:, j, :, 1])
        assert np.nanstd(noise[60:, j, :, 1]) == pytest.approx(1e-3 * peak / np.sqrt(2), rel=0.1)


@pytest.mark.slow
def test_seeds_decide():
    rig, table = rigs.merl(), recorded(0.002)
    one, again, other = (with_pixel_noise(table, rig, PixelNoise(), seed).values for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other, equal_nan=True)


def test_refusals():
    table = recorded(0.05)
    with pytest.raises(ArgumentError, match="needs a rig with a Sphere or Cylinder, not a Flat"):
        with_pixel_noise(table, Rig(rigs.merl().camera, Flat()), PixelNoise(), 1)
    with pytest.raises(ArgumentError, match="must be 'centre' or 'edge', got 'center'"):
        with_pixel_noise(table.assign_attrs(sampling="center"), rigs.merl(), PixelNoise(), 1)
    with pytest.raises(ArgumentError, match="must be one of 'centre', 'edge'"):
        true_table(Microfacet(GGX(0.1), 1.0), sampling="center")
    for noise in (PixelNoise(-0.1, 0), PixelNoise(0, 0), PixelNoise(float("nan"), 0)):
        with pytest.raises(ArgumentError, match="noise"):
            noise.check()
