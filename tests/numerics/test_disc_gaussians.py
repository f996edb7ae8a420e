"""A blurred disc against its sum of Gaussians, by the integral over its rings."""

import numpy as np
import pytest
from scipy.special import ive

from matcam.numerics.disc_gaussians import DISC_GAUSSIANS, LARGEST

SHARE, VARIANCE = DISC_GAUSSIANS.T


def test_moments():
    """Light, variance and fourth moment: the mean of r^2n over a unit disc is 1 / (n + 1)."""
    for n, of_gaussian in ((0, 1.0), (1, 2.0), (2, 8.0)):
        assert np.sum(SHARE * of_gaussian * VARIANCE**n) == pytest.approx(1 / (n + 1), abs=1e-6)


@pytest.mark.parametrize(("radius", "most"), [(0.5, 2e-6), (1.0, 4e-5), (LARGEST, 2.1e-4)])
def test_profile(radius, most):
    """A disc through a Gaussian of standard deviation 1, ring by ring, as far as 1e-5 of its middle."""
    at = np.linspace(0, 6 + radius, 300)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ring, light = radius * (nodes + 1) / 2, weights * (nodes + 1) / 2
    truth = (light * np.exp(-((at[:, None] - ring) ** 2) / 2) * ive(0, at[:, None] * ring)).sum(-1)
    total = 1 + VARIANCE * radius**2
    found = (SHARE / total * np.exp(-(at[:, None] ** 2) / 2 / total)).sum(-1)
    seen = truth > 1e-5 * truth[0]
    assert np.abs(found / truth - 1)[seen].max() < most
