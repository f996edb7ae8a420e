"""Inverses, interpolation and quadrature against closed forms."""

import numpy as np
import pytest

from matcam.core.jax import jax, jnp
from matcam.numerics.anderson import AndersonMixing
from matcam.numerics.approximation import (
    cubic_basis,
    cubic_spline,
    cubic_sums,
    lagrange_basis,
    lagrange_slopes,
    nodes_between,
    nodes_in_panels,
)
from matcam.numerics.linalg import FLOOR, least_eigenvalue, scaled_inverse

UNITS = np.array([1e-12, 1.0, 1e9])


def information(correlation=0.5):
    """A matrix in these units, and its inverse."""
    unit = np.full((3, 3), correlation) + (1 - correlation) * np.eye(3)
    return unit * np.outer(UNITS, UNITS), np.linalg.pinv(unit) / np.outer(UNITS, UNITS)


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_units_that_differ_by_1e21_cost_no_digits(kind):
    matrix, inverse = information()
    np.testing.assert_allclose(scaled_inverse(kind(matrix)), inverse, rtol=1e-11)


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_what_the_data_do_not_determine_has_the_variance_of_the_floor(kind):
    matrix, _ = information(1.0)
    covariance = np.asarray(scaled_inverse(kind(matrix))) * np.outer(UNITS, UNITS)
    assert 0.3 / FLOOR < covariance[0, 0] < 1 / FLOOR
    assert np.ones(3) @ covariance @ np.ones(3) == pytest.approx(1.0, rel=2e-3)  # their sum is determined


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_a_parameter_without_information(kind):
    matrix = np.diag([4.0, 0.0])
    np.testing.assert_allclose(scaled_inverse(kind(matrix)), np.diag([0.25, 0.0]), rtol=1e-11)
    np.testing.assert_allclose(scaled_inverse(kind(matrix), undetermined=7.0), np.diag([0.25, 7.0]), rtol=1e-11)


def test_a_stack_is_inverted_one_by_one():
    stack = np.stack([information(c)[0] for c in (0.1, 0.5, 0.9)])
    for whole, one in zip(scaled_inverse(stack), stack, strict=True):
        np.testing.assert_allclose(whole, scaled_inverse(one), rtol=1e-12)


def test_a_sum_that_rounding_made_indefinite_is_no_harm():
    matrix = np.array([[1.0, 1.0 + 1e-14], [1.0 + 1e-14, 1.0]])
    assert np.linalg.eigvalsh(matrix)[0] < 0
    assert (np.diag(scaled_inverse(matrix)) > 0).all()
    assert least_eigenvalue(matrix) < FLOOR < least_eigenvalue(information()[0])


def test_lagrange_is_exact_for_polynomials_and_has_derivatives_at_its_points():
    points = np.array([-1.0, 0.0, 0.5, 2.0])
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    at = np.linspace(-1, 2, 7)
    value = sum(cubic(point) * weight for point, weight in zip(points, lagrange_basis(points, at), strict=True))
    np.testing.assert_allclose(value, cubic(at), atol=1e-12)

    def through(x):
        return jnp.asarray(cubic(points)) @ jnp.stack(lagrange_basis(points, x))

    for x in (0.5, 1.3):
        assert float(jax.grad(through)(x)) == pytest.approx(cubic.deriv()(x), abs=1e-12)


@pytest.mark.parametrize("at", [-1.0, 0.3, 2.0])
def test_slopes_of_a_lagrange_basis_differentiate_a_cubic(at):
    points = np.array([-1.0, 0.5, 1.0, 2.0])
    assert lagrange_slopes(points, at) @ (points**3 - 2 * points) == pytest.approx(3 * at**2 - 2, rel=1e-12)
    assert lagrange_slopes(points[:1], at) == 0


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_gauss_legendre_is_exact_to_its_order_on_every_panel(kind):
    power = 2 * 5 - 1
    nodes, weights = nodes_between(kind(1.0), kind(3.0), 5)
    assert isinstance(nodes, type(kind(1.0)))
    assert float(weights @ nodes**power) == pytest.approx((3.0**10 - 1) / 10, rel=1e-13)
    nodes, weights = nodes_in_panels(kind([0.0, 0.5, 2.0]), 5)
    assert nodes.shape == (10,)
    assert float(weights @ nodes**power) == pytest.approx(2.0**10 / 10, rel=1e-13)


def test_mixed_steps_end_where_plain_ones_creep():
    """A linear iteration that shrinks by a twentieth a step, or turns over: 8 plain steps leave half of it."""
    rng = np.random.default_rng(5)
    basis = np.linalg.qr(rng.normal(size=(20, 20)))[0]
    rates = np.r_[0.05, 0.3, 1.9, np.ones(17)]
    truth = rng.normal(size=20)

    def step(x):
        return basis @ (rates * (basis.T @ (truth - x)))

    mixing, x = AndersonMixing(), np.zeros(20)
    for _ in range(8):
        x = x + mixing.step(x, step(x), np.eye(20))
    assert np.abs(x - truth).max() < 1e-6
    mixing.forget()
    np.testing.assert_array_equal(mixing.step(x, step(x), np.eye(20)), step(x))


def test_splines_of_four_are_those_of_the_whole_basis():
    """Their value, and sums of weights times each, from the first knot to the last."""
    rng = np.random.default_rng(6)
    position = jnp.asarray(np.concatenate([[0.0, 1.0, 15.5, 16.0], rng.uniform(0, 16, 200)]))
    coefficients, weights = jnp.asarray(rng.normal(size=17)), jnp.asarray(rng.normal(size=position.shape))
    basis = cubic_basis(position, 17)
    np.testing.assert_allclose(cubic_spline(coefficients, position), coefficients @ basis, atol=1e-14)
    np.testing.assert_allclose(cubic_sums(position, weights, 17), basis @ weights, atol=1e-12)
    np.testing.assert_allclose(
        cubic_sums(position.reshape(4, 3, 17), weights.reshape(4, 3, 17), 17, axes=2),
        (basis * weights).reshape(17, 4, 51).sum(-1), atol=1e-12,
    )  # fmt: skip
