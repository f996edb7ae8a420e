"""Two lobes in one, against the oracle's, whose Beckmann has its masking by quadrature."""

import numpy as np
import pytest

from matcam.core.jax import jnp
from matcam.material.ndf.two_lobes import TwoLobes
from tests.oracle import sphere_cells as oracle


@pytest.mark.parametrize(("one", "other"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.6)])
def test_two_lobes_are_the_sum_of_their_parts(one, other):
    alpha, other_alpha, share = 0.01, 0.12, 0.3
    lobe = TwoLobes(*(jnp.asarray(value) for value in (alpha, other_alpha, share, one, other)))
    parts = [
        (facets * part, family)
        for facets, width, tail in ((1 - share, alpha, one), (share, other_alpha, other))
        for part, family in ((1 - tail, oracle.GGX(width)), (tail, oracle.EPD(width, 1.0)))
    ]
    truth = oracle.Lobes(tuple(parts))
    slope = np.geomspace(1e-5, 3, 60)
    np.testing.assert_allclose(lobe.slope_density(jnp.asarray(slope**2)), truth.p22(slope**2), rtol=1e-9)
    cos = np.cos(np.radians([1, 30, 60, 80, 88, 89.5]))
    np.testing.assert_allclose(lobe.smith_lambda(jnp.asarray(cos)), truth.smith(cos), rtol=2e-4, atol=1e-9)
    assert float(lobe.roughness) == alpha
    # all facets are there
    log_slope = np.linspace(np.log(1e-7), np.log(1e4), 20001)
    inside = 2 * np.pi * np.exp(2 * log_slope) * np.asarray(lobe.slope_density(jnp.exp(2 * log_slope)))
    assert np.trapezoid(inside, log_slope) == pytest.approx(1, abs=1e-6)
