"""Normal distributions: their integrals, their mixtures, their masking."""

import warnings
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import gammainccinv

from matcam import EPD, GGX, SGD, Beckmann, GaussianNDF
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.core.registry import FAMILIES, WITH_POWER, family_ndf
from matcam.material.masking import g2, smith_lambda
from tests.golden import rows as golden_rows
from tests.oracle.smith import smith_lambda as lambda_by_quadrature

MIXTURES = [
    GaussianNDF(0.0005),
    GaussianNDF(0.02),
    GaussianNDF(0.3),
    GGX(0.001),
    GGX(0.05),
    GGX(1.0),
    Beckmann(0.0003),
    Beckmann(0.8),
    SGD(1e-4, 0.4),
    SGD(0.05, 1.0),
    SGD(0.7, 2.0),
]
LOBES = [*MIXTURES, EPD(1e-4, 0.3), EPD(0.05, 0.7), EPD(0.5, 3.0), EPD(1.0, 1.3)]


@pytest.mark.parametrize("ndf", LOBES, ids=repr)
def test_integral_of_d_cos_is_one(ndf):
    width = float(ndf.roughness)
    edges = np.minimum(width * np.array([0, 1e-4, 0.1, 0.5, 1, 2, 4, 8, 16, 64, 256, 1e4, 1e6]), np.pi / 2)
    inside = lambda t: float(ndf.d(t)) * np.cos(t) * np.sin(t) * 2 * np.pi  # noqa: E731
    total = sum(quad(inside, a, b, epsrel=1e-10)[0] for a, b in zip(edges, edges[1:], strict=False) if b > a)
    assert total == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("ndf", MIXTURES, ids=repr)
def test_mixture_is_the_lobe(ndf):
    weights, widths = ndf.mixture()
    assert float(weights.sum()) == pytest.approx(1, abs=1e-12)
    theta = jnp.asarray(np.minimum(float(ndf.roughness) * np.array([0, 0.1, 0.7, 2, 5, 30]), 1.4))
    r = ndf.coordinate(theta)
    mixed = jnp.exp(-((r[:, None] / widths) ** 2) / 2) @ weights
    lobe = ndf.d(theta) / ndf.d(0.0)
    np.testing.assert_allclose(mixed, lobe / ndf.flattening(theta), rtol=0, atol=2e-11)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9, 0.9999])
@pytest.mark.parametrize(("beta", "power"), [(1e-4, 0.3), (0.1, 1.0), (0.6, 3.0)])
def test_quantiles_of_epd_are_those_of_its_sampling_formula(beta, power, share):
    """docs/model.md 6: tan^2 = beta^2 Q^-1(1/p, u)^(1/p) leaves a share u of the facets steeper."""
    ndf = EPD(beta, power)
    steepest = beta * gammainccinv(1 / power, 1 - share) ** (1 / (2 * power))
    inside = lambda r: 2 * np.pi * r * float(ndf.slope_density(jnp.asarray(r * r)))  # noqa: E731
    edges = steepest * np.array([0, 0.01, 0.1, 0.4, 0.7, 1])
    total = sum(quad(inside, x, y, epsrel=1e-10)[0] for x, y in pairwise(edges))
    assert total == pytest.approx(share, rel=1e-8)


@pytest.mark.parametrize(
    ("alpha", "power", "normalisation"),
    [
        (0.014832, 0.459076, 46.3841),  # alum-bronze: R, G, B
        (0.0300126, 0.450056, 24.5961),
        (0.0490339, 0.529272, 14.8261),
        (0.000159222, 0.377727, 4381.96),  # alumina-oxide: R, G
        (0.000139421, 0.318496, 5413.74),
        (0.0012241, 0.537669, 449.321),  # aluminium: R
    ],
)
def test_normalisation_of_sgd_is_the_published_one(alpha, power, normalisation):
    """Constants K of Bagher et al. 2012, supplemental table, as printed: six digits of alpha and p go in and out."""
    peak = float(SGD(alpha, power).d(0.0))
    assert peak * np.pi * alpha**power * np.exp(alpha) == pytest.approx(normalisation, rel=3e-6)


@pytest.mark.parametrize("power", [1e-3, 0.5, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("alpha", [1e-4, 0.03, 1.0])
def test_normalisation_of_sgd_is_the_incomplete_gamma_function(alpha, power):
    k = 1 / (alpha * mpmath.gammainc(1 - mpmath.mpf(power), alpha))
    peak = float(k * mpmath.exp(-alpha) / (mpmath.pi * mpmath.mpf(alpha) ** power))
    assert float(SGD(alpha, power).d(0.0)) == pytest.approx(peak, rel=1e-12)


def test_epd_of_power_1_is_beckmann():
    theta, slope2 = np.linspace(0, 1.5, 50), jnp.asarray(np.geomspace(1e-6, 10, 50))
    np.testing.assert_allclose(EPD(0.2, 1.0).d(theta), Beckmann(0.2).d(theta), rtol=1e-13)
    np.testing.assert_allclose(EPD(0.2, 1.0).slope_density(slope2), Beckmann(0.2).slope_density(slope2), rtol=1e-13)
    np.testing.assert_allclose(EPD(0.2, 1.0).g1(theta), Beckmann(0.2).g1(theta), rtol=1e-12)


def test_sgd_of_power_0_tends_to_beckmann():
    theta = np.linspace(0, 1.2, 50)
    np.testing.assert_allclose(SGD(0.04, 1e-9).d(theta), Beckmann(0.2).d(theta), rtol=1e-7)


@pytest.mark.parametrize("row", golden_rows("epd_smith"))
def test_golden_masking_of_epd(row):
    ndf = EPD(row["beta"], row["power"])
    assert float(ndf.g1(row["theta"])) == pytest.approx(row["smith_g1"], rel=1e-8)


@pytest.mark.parametrize("roughness", [1e-4, 0.01, 0.3, 1.0])
def test_closed_forms_of_lambda(roughness):
    """GGX: Walter et al. 2007, (34), without its cancellation; Beckmann: in 40 digits."""
    theta = np.radians([0.01, 1.0, 10, 45, 75, 85, 89, 89.99, 89.9999])
    t2 = (roughness * np.tan(theta)) ** 2
    np.testing.assert_allclose(GGX(roughness).smith_lambda(jnp.cos(theta)), t2 / 2 / (1 + np.sqrt(1 + t2)), rtol=1e-7)
    with mpmath.workdps(40):
        for t, ours in zip(theta, Beckmann(roughness).smith_lambda(jnp.cos(theta)), strict=True):
            nu = 1 / (roughness * mpmath.tan(mpmath.mpf(t)))
            closed = (mpmath.erf(nu) - 1) / 2 + mpmath.exp(-(nu**2)) / (2 * nu * mpmath.sqrt(mpmath.pi))
            assert float(ours) == pytest.approx(float(closed), rel=1e-9, abs=1e-16)


@pytest.mark.parametrize("ndf", [GGX(1e-3), GGX(1.0), Beckmann(0.01), Beckmann(0.7)], ids=repr)
def test_closed_forms_of_lambda_are_the_integral(ndf):
    cos = jnp.cos(jnp.asarray(np.radians([20.0, 60, 80, 85, 89, 89.9, 89.999])))
    integral = smith_lambda(ndf.slope_density, ndf.roughness, cos / jnp.sqrt(1 - cos**2))
    np.testing.assert_allclose(ndf.smith_lambda(cos), integral, rtol=1e-10, atol=1e-16)


@pytest.mark.parametrize(
    "ndf",
    [
        EPD(0.3, 4.0),
        EPD(1e-4, 1.8),
        *(pytest.param(ndf, marks=pytest.mark.slow) for ndf in (EPD(1e-4, 0.3), EPD(1.0, 0.25), SGD(1e-4, 2.0))),
        SGD(0.5, 0.7),
    ],
    ids=repr,
)
def test_the_table_of_lambda_is_the_integral(ndf):
    cos = jnp.asarray(np.sin(np.exp(np.random.default_rng(2).uniform(np.log(1e-10), np.log(1.5), 3000))))
    few = jnp.concatenate([ndf.smith_lambda(part) for part in jnp.split(cos, 2)])  # so few are integrated one by one
    np.testing.assert_allclose((1 + few) / (1 + ndf.smith_lambda(cos)), 1, rtol=0, atol=1e-9)


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
    for name, family in FAMILIES.items():
        with pytest.raises(ArgumentError, match=r"(width|alpha|beta) must lie in \(0, (1|0.5)\]"):
            family(value, *([1.0] if name in WITH_POWER else []))


def test_families_by_name():
    assert repr(family_ndf("epd", 0.1, 0.5)) == "EPD(beta=0.1, power=0.5)"
    assert repr(family_ndf("beckmann", 0.1)) == "Beckmann(alpha=0.1)"
    with pytest.raises(ArgumentError, match="unknown family of lobes 'ggxx'; did you mean 'ggx'"):
        family_ndf("ggxx", 0.1)
    with pytest.raises(ArgumentError, match="power must be given for sgd"):
        family_ndf("sgd", 0.1)
    with pytest.raises(ArgumentError, match="power can be given for epd and sgd, but not for ggx, got 2"):
        family_ndf("ggx", 0.1, 2)


def test_powers_are_checked():
    for power in (0.2, 4.1, np.inf):
        with pytest.raises(ArgumentError, match=r"power must lie in \[0.25, 4\]"):
            EPD(0.1, power)
    for power in (0, 2.1):
        with pytest.raises(ArgumentError, match=r"power must lie in \(0, 2\]"):
            SGD(0.1, power)
    with pytest.raises(ArgumentError, match="power must be a single number"):
        EPD(0.1, [1.0, 2.0])
