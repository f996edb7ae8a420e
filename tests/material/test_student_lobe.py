"""Student's t distribution of slopes, against the oracle's, whose masking is a quadrature of its own."""

import numpy as np
import pytest

from matcam import GGX, Beckmann
from matcam.core.jax import jnp
from matcam.material.ndf.student_lobe import StudentLobe
from tests.oracle.sphere_cells import Tails

SLOPE = np.geomspace(1e-6, 3, 60)
COS = np.cos(np.radians([60, 70, 80, 88, 89.5]))
"""Where a narrow lobe hides facets; nearer to the normal the oracle leaves masking out."""


def lobe(beta, g):
    return StudentLobe(jnp.asarray(beta), jnp.asarray(g - 1))


@pytest.mark.parametrize("g", [1.67, 2.0, 3.5])
@pytest.mark.parametrize("beta", [0.003, 0.2])
def test_slopes_and_masking_are_the_oracles(beta, g):
    truth = Tails(np.sqrt(g) * beta, g)
    np.testing.assert_allclose(lobe(beta, g).slope_density(jnp.asarray(SLOPE**2)), truth.p22(SLOPE**2), rtol=1e-9)
    shown = 1 / (1 + lobe(beta, g).smith_lambda(jnp.asarray(COS)))
    np.testing.assert_allclose(shown, 1 / (1 + truth.smith(COS)), rtol=5e-5)


def test_it_becomes_ggx_and_beckmann():
    square = jnp.asarray(SLOPE**2)
    np.testing.assert_allclose(
        lobe(0.05, 2.0).slope_density(square), GGX(0.05 * 2**0.5).slope_density(square), rtol=1e-9
    )
    near = SLOPE < 0.15
    np.testing.assert_allclose(
        lobe(0.05, 1e6).slope_density(square)[near], Beckmann(0.05).slope_density(square)[near], rtol=1e-3
    )
