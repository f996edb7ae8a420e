"""Lambda from the table that fits read, against closed forms."""

import numpy as np
import pytest

from matcam import EPD, GGX
from matcam.core.jax import jax, jnp
from matcam.material.lambda_table import TabulatedDirections, lambda_at, position_of
from matcam.material.ndf.student_lobe import StudentLobe
from matcam.material.ndf.two_lobes import TwoLobes
from matcam.material.tabulated_masking import COTS, quick_lambda, quick_table

COSINES = jnp.asarray(np.random.default_rng(4).uniform(0, 1, 4000) ** 3)


def visible(lambdas):
    return np.asarray(1 / (1 + lambdas))


@pytest.mark.parametrize("alpha", [1e-4, 0.003, 0.1, 0.7])
def test_a_table_follows_closed_forms(alpha):
    """Two lobes of GGX and Beckmann have closed forms, and are read from the table."""
    lobe = TwoLobes(*(jnp.asarray(v) for v in (alpha, min(8 * alpha, 1.0), 0.3, 0.2, 0.7)))
    assert quick_table(lobe) is not None
    error = np.abs(visible(quick_lambda(lobe, COSINES)) - visible(lobe.smith_lambda(COSINES)))
    print(f"alpha {alpha}: {error.max():.1e}")
    assert error.max() < 3e-6
    steep = jnp.asarray([1e-5, 1e-7, 1e-10])
    np.testing.assert_allclose(visible(quick_lambda(lobe, steep)), visible(lobe.smith_lambda(steep)), rtol=3e-6)


@pytest.mark.parametrize("lobe", [EPD(0.01, 0.8), EPD(1e-4, 1.8), StudentLobe(jnp.asarray(0.05), jnp.asarray(2.0))])
def test_a_table_follows_integrals(lobe):
    few = COSINES[:2000]  # of so few, Lambda is integrated
    np.testing.assert_allclose(visible(quick_lambda(lobe, few)), visible(lobe.smith_lambda(few)), rtol=0, atol=1e-5)


def test_lobes_in_closed_form_need_no_table():
    assert quick_table(GGX(0.1)) is None


def test_positions_are_shares_of_the_table():
    cos = COTS / np.sqrt(1 + COTS**2)
    entries = position_of(cos) * (COTS.size - 1)
    apart = COTS < 10  # a cosine nearer to 1 has too few digits
    np.testing.assert_allclose(entries[apart], np.arange(COTS.size)[apart], atol=1e-9)
    assert isinstance(position_of(cos), np.ndarray)
    np.testing.assert_allclose(position_of(jnp.asarray(cos)), position_of(cos), rtol=1e-12)


def test_derivatives_by_entries_are_those_of_the_sum():
    table = quick_table(StudentLobe(jnp.asarray(0.05), jnp.asarray(2.0)))  # of long tails: nowhere is Lambda 0
    rng = np.random.default_rng(5)
    cos, share = 0.9 * rng.uniform(0, 1, (6, 50, 2)) ** 3, rng.normal(size=(6, 50, 2))
    directions = TabulatedDirections.of(cos, COTS.size)
    lambdas = lambda_at(table, jnp.asarray(cos))
    np.testing.assert_allclose(directions.one_plus_lambda(np.asarray(table)), 1 + lambdas, rtol=1e-11)
    own = jax.vmap(jax.grad(lambda t, c, s: jnp.sum(s * lambda_at(t, c))), (None, 0, 0))(table, cos, share)
    found = directions.by_tables(share * np.asarray(1 + lambdas), np.eye(COTS.size)).T
    np.testing.assert_allclose(found, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())
