"""A camera's loss told from a surface that shadows itself: each wins on the data that it made."""

from types import SimpleNamespace

import numpy as np
import pytest

from matcam import rivals
from matcam.camera import PixelNoise
from matcam.inverse import Correction
from matcam.inverse.fit.fit_data import MOST_NOISE
from matcam.inverse.rival_fits import Rival, Rivals
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18


def seen_by_a_camera(random):
    shot = recorded.pictures(EVERY)
    light = shot.rule.directions(oracle.GGX(0.003)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    return shot.table(shot.rule.noisy(light, random, gain=0.0))


def shadowed(random):
    """F D G1(i) G1(o) / (4 cos cos) with G1 = exp(-0.6 (1 - cos)^2), which no surface so smooth has, seen by no lens; cells are
    means of two pixels of 1 % noise."""
    shot, grid = recorded.pictures(EVERY), recorded.GRID
    cells = shot.cells
    tan2 = np.tan(grid.theta_h[cells.i_theta_h]) ** 2
    d = oracle.GGX(0.01).p22(tan2) * (1 + tan2) ** 2
    cos = np.where(cells.valid[..., None], cells.cos_i, 1.0)
    hidden = np.exp(-0.6 * (1 - cos) ** 2).prod(-1)
    light = d * hidden / (4 * cos.prod(-1)) * conductor(cells.theta_d, *recorded.CHROMIUM)[:, None]
    peak = light.max(axis=1, keepdims=True)
    noise = random.standard_normal((2, *light.shape)) * np.where(cells.one_pixel, 1, np.sqrt(0.5))
    return shot.table(light * (1 + 0.01 * noise[0]) + 1e-4 * peak * noise[1])


@pytest.mark.slow
@pytest.mark.parametrize(("made", "winner"), [(seen_by_a_camera, "the camera"), (shadowed, "free shadowing")])
def test_each_wins_on_its_own_data(made, winner):
    found = rivals(made(np.random.default_rng(1)), recorded.rig(), slice_step=EVERY)
    best = found.camera if winner == "the camera" else found.shadowing
    print(f"{found.verdict}; log evidence {found.camera.log_evidence:.1f} and {found.shadowing.log_evidence:.1f}")
    assert found.verdict.startswith(f"{winner} explains the data better")
    assert found.probability > 0.99 if winner == "the camera" else found.probability < 0.01
    assert best.fit.noise.relative == pytest.approx(0.01, rel=0.15)


def test_the_largest_noise_that_a_fit_permits_is_a_lower_limit():
    """An estimate at the bound of the search, as of a model without a camera that cannot explain the data."""
    fits = (SimpleNamespace(noise=PixelNoise(relative)) for relative in (0.01, MOST_NOISE))
    found = Rivals(*(Rival(fit, log_evidence) for fit, log_evidence in zip(fits, (100.0, 0.0), strict=True)))
    assert found.verdict.endswith("1.00% with the camera and at least 20.00% with free shadowing")


@pytest.mark.slow
@pytest.mark.parametrize("made", [seen_by_a_camera, shadowed])
def test_the_verdict_is_that_of_a_correction(made):
    table = made(np.random.default_rng(2))
    found, corrected = rivals(table, recorded.rig(), slice_step=6), Correction.of(table, recorded.rig())
    assert (found.probability < 0.05) == (corrected.no_camera > 0.95)
