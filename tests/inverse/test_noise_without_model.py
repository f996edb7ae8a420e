"""Noise of a pixel without a model of the lobe: the truth is the noise that the test adds."""

import numpy as np
import pytest

from matcam.core.grid import brdf_table
from matcam.inverse import FitSetup
from matcam.inverse.correction.evidence import noise_without_model
from tests.inverse import recorded
from tests.oracle import merl_lobe


@pytest.fixture(scope="module")
def noisy():
    exact = merl_lobe.record(0.01, np.full((90, 3), 0.9))
    return brdf_table(exact * np.random.default_rng(4).normal(1, 0.01, exact.shape), "centre")


def noise_of(table):
    setup = FitSetup((table,), recorded.rig(), "gaussian", fresnel="free", slice_step=18)
    return noise_without_model(setup, setup.solve())


def test_mirrored_cells_and_channels_show_the_noise(noisy):
    for table in (noisy, noisy.isel(channel=[0])):
        assert noise_of(table).relative == pytest.approx(
            0.01 * np.sqrt(2), rel=0.15
        )  # a cell is the mean of two pixels


def test_equal_mirrored_cells_do_not_hide_the_noise(noisy):
    """The cells of a symmetrised table are means of two, so they have less noise, which the channels show."""
    symmetrised = noisy.copy(data=(noisy.values + noisy.values[:, :, ::-1]) / 2)
    assert noise_of(symmetrised).relative == pytest.approx(0.01, rel=0.15)
    assert noise_of(symmetrised.isel(channel=[0])) is None


@pytest.mark.parametrize("channels", [[0, 1, 2], [0]])
def test_clipped_noise_does_not_hide_the_floor(noisy, channels):
    """The noise of a cell, the mean of two pixels, has a floor of 1e-4. That of a pixel is larger by the root of 2."""
    floor = 1e-4 * noisy.max(("theta_h", "phi_d")).values[:, None] * np.random.default_rng(5).normal(size=noisy.shape)
    table = noisy.copy(data=np.maximum(noisy.values + floor, 0)).isel(channel=channels)
    assert noise_of(table).floor == pytest.approx(1e-4 * np.sqrt(2), rel=0.2)
