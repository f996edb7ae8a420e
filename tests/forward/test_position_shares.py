"""Light divided by place: kernels that drift over a disc, and what a point of light recorded through a Gaussian becomes."""

import jax.numpy as jnp
import numpy as np
import pytest

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
    """What the Gaussian has spread still belongs to the place that it comes from."""
    x, y = (one + np.arange(-24, 25) / 8 for one in position)
    u, v = np.meshgrid(x - position[0], y - position[1])
    point = np.exp(-(u**2 + v**2) / (2 * SIGMA**2))
    hermite = [lambda t: 1 + 0 * t, lambda t: -t, lambda t: t**2 - 1, lambda t: 3 * t - t**3]

    def record(along, across):
        scale = SIGMA ** -(along + across)
        return jnp.asarray(scale * point * hermite[along](u / SIGMA) * hermite[across](v / SIGMA))[..., None]

    divided = np.stack([np.asarray(one)[..., 0] for one in shares.divided(record, x, y, SIGMA)], axis=-1)
    wanted = point[..., None] * shares.at(np.array([position]))[0]
    naive = point[..., None] * shares.at(np.stack([u.ravel() + position[0], v.ravel() + position[1]], -1)).reshape(
        *u.shape, -1
    )
    through = kernels(shares.positions)
    off, uncorrected = (np.abs((one - wanted) @ through).max() for one in (divided, naive))
    assert off < max(1e-5, shares.left_over(SIGMA, through))
    assert off < 0.01 * uncorrected
