"""Two roughnesses: laws that the distribution and its masking must obey together, and their isotropic limit."""

import numpy as np
import pytest

from matcam import EPD, GGX, SGD, Beckmann, GaussianNDF, Microfacet
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.material import AnisotropicBeckmann, AnisotropicGGX
from matcam.material.material import shading_at

RANDOM = np.random.default_rng(3)
ANGLES = (
    RANDOM.uniform(0, 1.2, 300),
    RANDOM.uniform(0, 1.5, 300),
    RANDOM.uniform(0, 6.28, 300),
    RANDOM.uniform(0, 6.28, 300),
)
PAIRS = [(AnisotropicGGX, GGX), (AnisotropicBeckmann, Beckmann)]


@pytest.mark.parametrize(("stretched", "isotropic"), PAIRS)
def test_equal_roughnesses_are_the_isotropic_surface(stretched, isotropic):
    for masking in ("smith", "van-ginneken"):
        one, other = (Microfacet(ndf, 1.0, masking=masking) for ndf in (stretched(0.3, 0.3), isotropic(0.3)))
        np.testing.assert_allclose(one.brdf(*ANGLES), other.brdf(*ANGLES[:3]), rtol=1e-12)


@pytest.mark.parametrize("stretched", [AnisotropicGGX, AnisotropicBeckmann])
def test_a_quarter_turn_exchanges_the_roughnesses(stretched):
    one, other = (Microfacet(stretched(*alphas), 1.0) for alphas in ((0.1, 0.4), (0.4, 0.1)))
    theta_h, theta_d, phi_d, phi_h = ANGLES
    np.testing.assert_allclose(one.brdf(*ANGLES), other.brdf(theta_h, theta_d, phi_d, phi_h + np.pi / 2), rtol=1e-9)


@pytest.mark.parametrize("stretched", [AnisotropicGGX, AnisotropicBeckmann])
def test_reciprocity(stretched):
    material = Microfacet(stretched(0.05, 0.4), 0.5, masking="van-ginneken")
    theta_h, theta_d, phi_d, phi_h = ANGLES
    np.testing.assert_allclose(material.brdf(*ANGLES), material.brdf(theta_h, theta_d, phi_d + np.pi, phi_h), rtol=1e-9)


NDFS = [
    AnisotropicGGX(0.2, 0.6),
    AnisotropicBeckmann(0.7, 0.1),
    GGX(0.4),
    Beckmann(0.5),
    GaussianNDF(0.3),
    EPD(0.5, 0.6),
    EPD(0.5, 2.0),
    SGD(0.3, 0.8),
]


@pytest.mark.parametrize("ndf", NDFS, ids=repr)
@pytest.mark.parametrize(("theta", "azimuth"), [(0.4, 0.3), (1.2, 2.0), (1.45, 1.4)])
def test_a_view_sees_as_many_facets_as_the_flat_surface(ndf, theta, azimuth):
    """The facets turned to a direction, foreshortened, fill (1 + Lambda) cos theta (Heitz 2014): no integral of Smith's
    is used, only the density of slopes; midpoints of a polar grid, slopes along powers of the radius."""
    step = 1e-3
    v = np.arange(step / 2, 1, step)
    radius = (3 * v / (1 - v)) ** 2 * 0.1
    by_v = 2 * radius * (1 / v + 1 / (1 - v))
    phi = (np.arange(720) + 0.5) / 720 * 2 * np.pi
    along, across = radius[:, None] * np.cos(phi), radius[:, None] * np.sin(phi)
    p22 = np.asarray(ndf.density(jnp.asarray(along), jnp.asarray(across))) * (radius * by_v)[:, None]
    # a facet of slope (sx, sy) has the normal (sx, sy, 1), unnormalised, over a unit of flat surface
    facing = np.cos(theta) + np.sin(theta) * (along * np.cos(azimuth) + across * np.sin(azimuth))
    measure = step * 2 * np.pi / phi.size
    assert (p22.sum() * measure) == pytest.approx(1, abs=2e-5)
    seen = np.sum(p22 * np.maximum(facing, 0)) * measure
    # light mirrored about the normal: half vector along it, its azimuth by definition 0
    _, lambda_o = ndf.lambdas(shading_at(0.0, theta, azimuth + np.pi))
    assert (1 + float(lambda_o)) * np.cos(theta) == pytest.approx(seen, rel=1e-3 if "GGX" in repr(ndf) else 1e-4)


def test_finest_is_the_narrower():
    assert float(Microfacet(AnisotropicGGX(0.3, 0.02), 1.0).finest) == 0.02


@pytest.mark.parametrize("bad", [(0, 0.1), (0.1, 1.1), (0.1, np.nan)])
def test_refusals(bad):
    for stretched in (AnisotropicGGX, AnisotropicBeckmann):
        with pytest.raises(ArgumentError, match=r"alpha_(along|across) must lie in \(0, 1\]"):
            stretched(*bad)
