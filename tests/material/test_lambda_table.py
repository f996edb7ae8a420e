"""Lambda from the table that fits read, against closed forms."""

import numpy as np
import pytest

from matcam import EPD, GGX
from matcam.core.jax import jax, jnp
from matcam.material.lambda_table import COTS, by_entries, lambda_at, position_of, quick_lambda, quick_table
from matcam.material.ndf.student_lobe import StudentLobe
from matcam.material.ndf.two_lobes import TwoLobes

COSINES = jnp.asarray(np.random.default_rng(4).uniform(0, 1, 4000) ** 3)


def visible(lambdas):
    return np.asarray(1 / (1 + lambdas))


@pytest.mark.parametrize("alpha", [1e-4, 0.003, 0.1, 0.7])
def test_a_table_follows_closed_forms(alpha):
    """Two lobes of GGX and Beckmann have closed forms, and are read from the table."""
    lobe = TwoLobes(*(jnp.asarray(v) for v in (alpha, min(8 * alpha, 1.0), 0.3, 0.2, 0.7)))
    assert quick_table(lobe) is not None
    there = COSINES > 1e-4
    error = np.abs(visible(quick_lambda(lobe, COSINES)) - visible(lobe.smith_lambda(COSINES)))[there]
    print(f"alpha {alpha}: {error.max():.1e}")
    assert error.max() < 3e-6
    if alpha > 1e-3:  # steeper than the table G falls as the cosine
        steep = jnp.asarray([1e-5, 1e-7])
        np.testing.assert_allclose(visible(quick_lambda(lobe, steep)), visible(lobe.smith_lambda(steep)), rtol=0.02)


@pytest.mark.parametrize("lobe", [EPD(0.01, 0.8), StudentLobe(jnp.asarray(0.05), jnp.asarray(2.0))])
def test_a_table_follows_integrals(lobe):
    there = COSINES[COSINES > 1e-4]
    np.testing.assert_allclose(visible(quick_lambda(lobe, there)), visible(lobe.smith_lambda(there)), rtol=0, atol=1e-5)


def test_lobes_in_closed_form_need_no_table():
    assert quick_table(GGX(0.1)) is None


def test_positions_are_counted_from_the_first_direction():
    cos = COTS / np.sqrt(1 + COTS**2)
    np.testing.assert_allclose(position_of(cos)[:100], np.arange(100), atol=1e-9)
    np.testing.assert_allclose(position_of(jnp.asarray(cos)), position_of(cos), rtol=1e-12)


def test_derivatives_by_entries_are_those_of_the_sum():
    table = quick_table(StudentLobe(jnp.asarray(0.05), jnp.asarray(2.0)))  # of long tails: nowhere is Lambda 0
    rng = np.random.default_rng(5)
    position, share = jnp.asarray(rng.uniform(-3, 110, (6, 50, 2))), jnp.asarray(rng.normal(size=(6, 50, 2)))
    own = jax.vmap(jax.grad(lambda t, p, s: jnp.sum(s * lambda_at(t, p))), (None, 0, 0))(table, position, share)
    found = by_entries(position, share * (1 + lambda_at(table, position)))
    np.testing.assert_allclose(found, own, atol=1e-5)
