"""Nodes in theta_h: their rule integrates what circles that touch the limb contribute."""

import numpy as np
import pytest

from matcam.inverse.operator.theta_nodes import NODES, ThetaRange


@pytest.mark.parametrize("root", [-0.05, 0.0, 0.1, 0.3, 0.5, 0.7])
def test_square_roots_are_integrated(root):
    """A root inside the range, at its ends, and outside."""
    low, high = np.array([0.0]), np.array([0.5])
    theta, weight = ThetaRange(low, high).nodes(NODES, [np.array([root])])
    found = (weight * (1 + 3 * np.sqrt(np.maximum(theta - root, 0)))).sum()
    start = max(root, 0.0)
    truth = 0.5 + (2 * (np.maximum(0.5 - root, 0) ** 1.5 - (start - root) ** 1.5) if root < 0.5 else 0.0)
    assert found == pytest.approx(truth, rel=1e-12)


def test_two_roots():
    roots = [np.array([0.1, np.inf]), np.array([0.12, np.inf])]
    theta, weight = ThetaRange(np.zeros(2), np.full(2, 0.5)).nodes(NODES, roots)
    light = 1 + sum(np.sqrt(np.maximum(theta - root[:, None], 0)) for root in roots)
    truth = [0.5 + 2 / 3 * (0.4**1.5 + 0.38**1.5), 0.5]
    np.testing.assert_allclose((weight * light).sum(1), truth, rtol=1e-6)
    without = ThetaRange(np.zeros(2), np.full(2, 0.5)).nodes(NODES)
    for one, other in zip((theta, weight), without, strict=True):
        np.testing.assert_allclose(one[1, : NODES[0].size], other[1], rtol=1e-12, atol=1e-15)
