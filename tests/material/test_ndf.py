"""Normal distributions: their integrals, their mixtures, their masking."""

import warnings

import numpy as np
import pytest
from scipy.integrate import quad

from matcam import GGX, GaussianNDF
from matcam._jax import jnp
from matcam.errors import ArgumentError
from matcam.material.families import FAMILIES
from matcam.material.masking import g2, smith_lambda
from tests.oracle.smith import smith_lambda as lambda_by_quadrature

LOBES = [GaussianNDF(0.0005), GaussianNDF(0.02), GaussianNDF(0.3), GGX(0.001), GGX(0.05), GGX(1.0)]


@pytest.mark.parametrize("ndf", LOBES, ids=repr)
def test_integral_of_d_cos_is_one(ndf):
    width = float(ndf.roughness)
    edges = np.minimum(width * np.array([0, 0.5, 1, 2, 4, 8, 16, 64, 256, 1e4, 1e6]), np.pi / 2)
    inside = lambda t: float(ndf.d(t)) * np.cos(t) * np.sin(t) * 2 * np.pi  # noqa: E731
    total = sum(quad(inside, a, b, epsrel=1e-10)[0] for a, b in zip(edges, edges[1:], strict=False) if b > a)
    assert total == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("ndf", LOBES, ids=repr)
def test_mixture_is_the_lobe(ndf):
    weights, widths = ndf.mixture()
    assert float(weights.sum()) == pytest.approx(1, abs=1e-12)
    theta = jnp.asarray(np.minimum(float(ndf.roughness) * np.array([0, 0.1, 0.7, 2, 5, 30]), 1.4))
    r = ndf.coordinate(theta)
    mixed = jnp.exp(-((r[:, None] / widths) ** 2) / 2) @ weights
    lobe = ndf.d(theta) / ndf.d(0.0)
    np.testing.assert_allclose(mixed, lobe / ndf.flattening(theta), rtol=0, atol=2e-11)


@pytest.mark.parametrize("alpha", [0.01, 0.3, 1.0])
def test_smith_lambda_of_ggx_is_its_closed_form(alpha):
    """Walter et al. 2007, (34)."""
    ndf, theta = GGX(alpha), np.radians([1.0, 10, 45, 75, 85, 89, 89.99])
    t2 = (alpha * np.tan(theta)) ** 2
    closed = t2 / 2 / (1 + np.sqrt(1 + t2))
    np.testing.assert_allclose(ndf.smith_lambda(jnp.cos(theta)), closed, rtol=1e-12)
    by_integral = smith_lambda(ndf.slope_density, ndf.roughness, 1 / jnp.tan(theta))
    np.testing.assert_allclose(by_integral, closed, rtol=1e-10)


@pytest.mark.parametrize("width", [0.002, 0.05, 0.3])
def test_smith_lambda_of_a_gaussian_lobe_is_the_integral(width):
    ndf = GaussianNDF(width)
    norm = (
        1
        / quad(
            lambda t: 2 * np.pi * np.exp(-(t**2) / 2 / width**2) * np.sin(t) * np.cos(t),
            0,
            min(np.pi / 2, 12 * width),
            epsrel=1e-13,
        )[0]
    )
    p22 = lambda r: norm * np.exp(-(np.arctan(r) ** 2) / 2 / width**2) / (1 + r * r) ** 2  # noqa: E731
    for degrees in (70, 85, 89, 89.9):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # quad is asked for more digits than an empty tail has
            truth = lambda_by_quadrature(p22, np.radians(degrees), width)
        ours = float(ndf.smith_lambda(jnp.cos(np.radians(degrees))))
        assert ours == pytest.approx(truth, rel=1e-9, abs=1e-30)


@pytest.mark.parametrize("ndf", LOBES, ids=repr)
def test_masking_hides_nothing_head_on_and_everything_at_grazing(ndf):
    theta = np.radians(np.append(np.linspace(0, 89.9, 40), 89.9999))
    g1 = np.asarray(ndf.g1(theta))
    assert g1[0] == pytest.approx(1, abs=1e-15)
    assert np.all(np.diff(g1) <= 1e-14)
    assert np.all((g1 > 0) & (g1 <= 1))
    assert float(ndf.g1(np.pi / 2)) < 1e-5


def test_joint_maskings_are_ordered():
    """Correlation spares the double count: separable <= height-correlated <= van Ginneken, and all <= the smaller G1."""
    li, lo = jnp.asarray([0.0, 0.3, 2.0, 5.0]), jnp.asarray([0.4, 0.4, 0.1, 5.0])
    for azimuth in (0.0, 1.0, np.pi):
        separable, smith, ginneken = (
            np.asarray(g2(m, li, lo, jnp.asarray(azimuth))) for m in ("smith-separable", "smith", "van-ginneken")
        )
        assert np.all(separable <= smith + 1e-15)
        assert np.all(smith <= ginneken + 1e-15)
        assert np.all(ginneken <= 1 / (1 + np.maximum(li, lo)) + 1e-15)
    np.testing.assert_allclose(g2("van-ginneken", li, lo, jnp.asarray(0.0)), 1 / (1 + np.maximum(li, lo)))
    np.testing.assert_allclose(g2(None, li, lo, jnp.asarray(0.0)), 1)


@pytest.mark.parametrize("value", [0, -0.1, np.nan, 1.5])
def test_roughness_is_checked(value):
    for family in FAMILIES.values():
        with pytest.raises(ArgumentError, match=r"(width|alpha) must"):
            family(value)
