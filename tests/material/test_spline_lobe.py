"""Spline-modified lobes and sampled Fresnel terms."""

import numpy as np
import pytest

from matcam import GGX
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.material import Sampled
from matcam.material.ndf.free_lobe import KNOTS, SplineNDF, slope_of_knot, spline_basis, spline_smoothness
from tests.oracle.sphere_cells import Tails

THETA = np.concatenate([[0.0], np.geomspace(1e-5, 1.5, 40)])


def test_a_spline_of_zeros_is_the_base():
    base = GGX(0.01)
    modified = SplineNDF(base, jnp.zeros(KNOTS))
    np.testing.assert_allclose(modified.d(THETA), base.d(THETA), rtol=1e-7)
    np.testing.assert_allclose(modified.g1(THETA), base.g1(THETA), rtol=1e-6)


@pytest.mark.parametrize("alpha", [0.001, 0.05, 0.3])
def test_a_modified_lobe_keeps_its_integral(alpha):
    """The integral of D cos over the hemisphere, by the trapezoid rule over the logarithm of the slope."""
    coefficients = jnp.asarray(np.random.default_rng(1).normal(0, 0.5, KNOTS))
    log_slope = np.linspace(np.log(alpha) - 14, np.log(alpha) + 14, 20001)
    slope = np.exp(log_slope)
    inside = 2 * np.pi * slope**2 * np.asarray(SplineNDF(GGX(alpha), coefficients).slope_density(jnp.asarray(slope**2)))
    assert np.trapezoid(inside, log_slope) == pytest.approx(1, abs=1e-5)


def test_the_basis_sums_to_one_and_is_level_at_the_peak():
    slope2 = jnp.asarray(np.geomspace(1e-12, 1e3, 50))
    np.testing.assert_allclose(sum(spline_basis(slope2)), 1, atol=1e-12)
    slope = jax.grad(lambda s: spline_basis(s**2)[1])(1e-6)
    assert abs(float(slope)) < 5.0  # per unit of slope; elsewhere it is some hundreds


def test_sampled_reflectance():
    term = Sampled([0.1, 0.5, 1.0], [[0.5, 0.6], [0.7, 0.8], [0.9, 1.0]])
    np.testing.assert_allclose(term.at(jnp.array([0.0, 0.3, 1.2])), [[0.5, 0.6], [0.6, 0.7], [0.9, 1.0]])
    assert Sampled([0.1, 0.5], [0.5, 0.7]).at(jnp.asarray(0.3)).shape == ()
    for theta, values, words in (
        ([0.5, 0.1], [0.5, 0.7], "must increase strictly"),
        ([0.1, 0.5], [0.5], "must have shape"),
        ([0.1, 0.5], [-0.5, 0.1], "values must lie in"),
    ):
        with pytest.raises(ArgumentError, match=words):
            Sampled(theta, values)


def test_a_spline_is_differentiated_along_every_direction():
    """By its coefficients, the base's roughness and the slope at once, against central differences."""
    coefficients = np.random.default_rng(2).normal(0, 0.5, KNOTS)
    at, rng = np.geomspace(1e-7, 0.5, 30), np.random.default_rng(3)

    def density(alpha, coefficients, slope2):
        return jnp.log(SplineNDF(GGX(alpha), coefficients).slope_density(slope2))

    direction = 0.01 * rng.standard_normal(), rng.standard_normal(KNOTS), at * rng.standard_normal(at.size)
    _, found = jax.jvp(density, (0.05, jnp.asarray(coefficients), jnp.asarray(at)), direction)
    ends = [
        density(*(v + s * 1e-5 * d for v, d in zip((0.05, coefficients, at), direction, strict=True))) for s in (1, -1)
    ]
    np.testing.assert_allclose(found, (ends[0] - ends[1]) / 2e-5, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("gamma", "asked"), [(1.67, 0.11), (2.5, 0.005)])
def test_a_spline_gives_long_tails_their_masking(gamma, asked):
    """Of Student's t with exponent 1.67 most of Lambda comes from facets steeper than 45 degrees, some from beyond 88."""
    true, slope2 = Tails(0.2, gamma), np.geomspace(1e-6, 26.0, 400) ** 2
    wanted = np.log(true.p22(slope2) / np.asarray(GGX(0.2).slope_density(jnp.asarray(slope2))))
    coefficients = np.linalg.lstsq(np.asarray(spline_basis(jnp.asarray(slope2))).T, wanted, rcond=None)[0]
    theta = np.radians([45.0, 60.0, 75.0, 81.0])
    g1 = 1 / (1 + true.smith(np.cos(theta)))
    to_45 = np.where(np.arange(KNOTS) < 12, coefficients, coefficients[11])
    error, level = (np.abs(SplineNDF(GGX(0.2), jnp.asarray(b)).g1(theta) / g1 - 1).max() for b in (coefficients, to_45))
    print(f"G1 of exponent {gamma}: {error:.3f} off; modified to 45 degrees only {level:.3f}")
    assert error < asked
    assert level > 2 * error


def test_the_invisible_tail_keeps_about_the_exponent_of_its_family():
    """Facets steeper than 45 degrees are hardly seen, but mask: a tail that rises there is improbable, a gentle bend is not."""
    knots = np.arange(KNOTS)
    above = np.maximum(np.log(slope_of_knot(knots + 1e-9) / 0.27), 0.0)
    chi2 = [float(((spline_smoothness() @ (change * above)) ** 2).sum()) for change in (0.3, 2.0)]
    assert chi2[0] < 10
    assert chi2[1] > 50
    seen = np.minimum(knots, 8.0)  # a lobe of another family, where the camera sees it
    assert ((spline_smoothness() @ seen) ** 2).sum() < 10
