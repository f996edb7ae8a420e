"""The table around the highlight, and the pixels behind it, against the oracle."""

import numpy as np
import pytest

from matcam import (
    GGX,
    Conductor,
    Cylinder,
    GaussianNDF,
    Microfacet,
    PixelNoise,
    Rig,
    Sphere,
    lobe_table,
    rigs,
    with_pixel_noise,
)
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, below_horizon, merl_grid
from matcam.forward.lobe_table import PICTURE_STRIDE, CellSet, cell_pixels
from tests.oracle import merl_lobe

ALL_CELLS = CellSet(*(a.ravel() for a in np.indices((90, 180))), np.ones(90 * 180))


@pytest.fixture(scope="module")
def pixels():
    return cell_pixels(Sphere(256.0), "centre", ALL_CELLS)


def test_lobe_table_is_the_oracles_record():
    n, k = np.array([3.3, 2.9, 2.3]), np.array([4.3, 4.2, 3.9])
    ours = lobe_table(Microfacet(GaussianNDF(0.002), Conductor(n, k), masking=None), rigs.merl())
    truth = merl_lobe.record(0.002, merl_lobe.conductor(merl_lobe.THETA_D[:, None], n, k))
    np.testing.assert_allclose(ours.values, truth, rtol=1e-9, atol=1e-12 * np.nanmax(truth))
    np.testing.assert_array_equal(np.isnan(ours.values[..., 0]), below_horizon("centre"))
    assert ours.dims == ("theta_h", "theta_d", "phi_d", "channel")
    assert ours.attrs["sampling"] == "centre"


def test_far_from_the_camera_the_table_is_the_material():
    """A lobe much wider than the kernel is recorded as it is, diffuse part included."""
    material = Microfacet(GGX(0.3), [0.5, 0.6, 0.7], diffuse=[0.1, 0.0, 0.3], masking=None)
    table = lobe_table(material, Rig(rigs.merl().camera, Sphere(20000.0)), sampling="edge")
    grid = merl_grid("edge")
    true = material.brdf(grid.theta_h[::9, None, None], grid.theta_d[None, ::9, None], grid.phi_d[None, None, ::30])
    np.testing.assert_allclose(table.values[::9, ::9, ::30], true, rtol=1e-4)


def test_pixels_agree_with_the_oracles_map(pixels):
    """Two cells share a pixel here if and only if they share one there."""
    for j, (_, index) in enumerate(merl_lobe.PixelMap().pairs):
        if j % 11:
            continue
        ours = np.stack([pixels.first[j], pixels.second[j]]).reshape(2, 90, 180)
        pairs = np.unique(np.stack([ours.ravel(), index.ravel()]), axis=1)
        assert pairs.shape[1] == np.unique(ours).size == np.unique(index).size


def test_pixel_content_adds_up_to_the_lit_picture(pixels):
    """Both ways together, the cells cover the part of the disc that lamp and camera both see."""
    visible = ~below_horizon("centre").transpose(1, 0, 2).reshape(90, -1)
    for j, theta_d in enumerate(merl_grid("centre").theta_d):
        # content counts cos(theta_o) at the peak; the tangent plane's area of a small cap is what it is used for
        cap = (ALL_CELLS.i_theta_h < 20) & visible[j]
        theta_h = (20 / 90) ** 2 * np.pi / 2
        share = cap.sum() / (20 * 180)
        if share == 1:
            assert pixels.content[j][cap].sum() == pytest.approx(
                256**2 * np.cos(theta_d) * 2 * np.pi * (1 - np.cos(theta_h)), rel=2e-3
            )


def test_about_seventy_five_cells_share_the_peaks_pixel(pixels):
    """MODEL 5."""
    numbers, counts = np.unique(np.concatenate([pixels.first[30], pixels.second[30]]), return_counts=True)
    assert counts.max() > 300  # all of the first two rings
    near = (pixels.first[30][:, None] == numbers[counts > 20]).any(axis=1)
    per_pixel = counts[counts > 20].mean()
    assert 40 < per_pixel < 400
    assert near.any()
    assert PICTURE_STRIDE > 2 * 256


@pytest.mark.slow
def test_noise_belongs_to_pixels(pixels):
    """Cells of one pixel share its noise; cells of different pixels do not; size as stated."""
    rng_table = merl_lobe.record(0.05, np.ones((90, 1)))
    rig = rigs.merl()
    table = lobe_table(Microfacet(GaussianNDF(0.05), 1.0, masking=None), rig)
    noisy = [
        with_pixel_noise(table, rig, PixelNoise(0.02, 0.0), seed).values[..., 0] / table.values[..., 0] - 1
        for seed in range(6)
    ]
    relative = np.stack(noisy)[:, :30, 20].reshape(6, -1)
    first, second = (p[20].reshape(90, 180)[:30].ravel() for p in (pixels.first, pixels.second))
    one_pixel = first == second
    assert np.std(relative[:, one_pixel]) > 0
    for numbers in np.unique(first[one_pixel]):
        same = one_pixel & (first == numbers)
        np.testing.assert_allclose(np.ptp(relative[:, same], axis=1), 0, atol=1e-12)
    # a cell of two pixels is the mean of two independent draws
    apart = ~one_pixel
    assert np.std(relative[:, apart]) == pytest.approx(0.02 / np.sqrt(2), rel=0.05)
    assert rng_table.shape == (*GRID_SHAPE, 1)


def test_floor_is_a_share_of_each_pictures_peak():
    rig = rigs.merl()
    table = lobe_table(Microfacet(GaussianNDF(0.002), 1.0, masking=None), rig)
    noise = with_pixel_noise(table, rig, PixelNoise(0.0, 1e-3), seed=0).values - table.values
    for j in (0, 40, 80):
        peak = np.nanmax(table.values[:, j, :, 1])
        assert np.nanstd(noise[60:, j, :, 1]) == pytest.approx(1e-3 * peak / np.sqrt(2), rel=0.1)


@pytest.mark.slow
def test_seeds_decide():
    rig = rigs.merl()
    table = lobe_table(Microfacet(GaussianNDF(0.002), 1.0, masking=None), rig)
    one, again, other = (with_pixel_noise(table, rig, PixelNoise(), seed).values for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other, equal_nan=True)


def test_refusals():
    material = Microfacet(GGX(0.1), 1.0)
    with pytest.raises(ArgumentError, match="recorded from a Sphere, this rig has a Cylinder"):
        lobe_table(material, Rig(rigs.merl().camera, Cylinder(10)))
    with pytest.raises(ArgumentError, match="sampling must be one of 'centre', 'edge'"):
        lobe_table(material, rigs.merl(), sampling="center")
    for noise in (PixelNoise(-0.1, 0), PixelNoise(0, 0), PixelNoise(float("nan"), 0)):
        with pytest.raises(ArgumentError, match="noise"):
            noise.checked()
