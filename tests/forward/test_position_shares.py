"""Light divided by place: kernels that drift over a disc, and what a point of light recorded through a Gaussian becomes."""

import jax.numpy as jnp
import numpy as np
import pytest

from matcam.forward.frequencies.band_limited import fine_line, transformed
from matcam.forward.frequencies.position_shares import PositionShares

SIDE, SIGMA = 40.0, 0.6
WAVES = np.linspace(0.1, 0.6, 12)


def kernels(positions):
    """Transfer functions, at some frequencies, of a kernel that moves and changes as aberrations do."""
    x, y = (positions / SIDE).T[:, :, None]
    return np.exp(1j * (2.0 * WAVES * x + 5 * WAVES**2 * x * y) - WAVES**2 * (1 + y**2))


@pytest.fixture(scope="module")
def shares():
    return PositionShares.of(13, SIDE, kernels, 1e-5)


def test_few_kernels_serve_for_all(shares):
    assert 4 < len(shares.positions) < 40
    turn = np.linspace(0, 6, 50)
    positions = SIDE * np.sqrt(turn / 6)[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    np.testing.assert_allclose(shares.at(positions) @ kernels(shares.positions), kernels(positions), rtol=0, atol=2e-5)


@pytest.mark.parametrize("position", [(0.0, 0.0), (11.3, -20.7), (-26.0, 30.0)])
def test_a_share_of_a_point_is_its_weight_times_the_point(shares, position):
    """What the Gaussian has spread belongs to the place that it comes from, at every frequency below the limit."""
    per_px, highest = 3, 0.6
    line = fine_line(np.zeros(1), -SIDE - 10, SIDE + 10, per_px)
    x, y = np.meshgrid(line.at - position[0], line.at - position[1])
    gaussian = np.exp(-(x**2 + y**2) / (2 * SIGMA**2)) / (2 * np.pi * SIGMA**2)
    blurred = transformed(jnp.asarray(gaussian)[..., None], line, line, per_px, False)
    point, weights = blurred.undone(SIGMA, highest, compact=True), shares.on_grid(line.at, line.at)
    low = np.hypot(point.fx, point.fy[:, None]) < highest
    through = kernels(shares.positions)

    def error(of, wanted):
        divided = np.stack(
            [np.asarray(of.of(weights.of(k) * of.values()).spectrum)[low, 0] for k in range(len(through))], -1
        )
        return np.abs((divided - np.asarray(of.spectrum)[low] * wanted) @ through).max() / per_px**2

    wanted = shares.at(np.array([position]))[0]
    off, uncorrected = error(point, wanted), error(blurred, wanted)
    assert off < 2e-6
    assert off < 0.01 * uncorrected
