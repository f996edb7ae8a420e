"""Microfacet materials against Mitsuba 3's rough conductor, in its own float32: code that nobody here wrote."""

import mitsuba
import numpy as np
import pytest

from matcam import GGX, Beckmann, Conductor, Microfacet
from matcam.core.jax import jnp
from matcam.core.shading import shading
from matcam.material import AnisotropicBeckmann, AnisotropicGGX

NDFS = {
    "isotropic ggx": ("ggx", 0.2, 0.2, GGX(0.2)),
    "isotropic beckmann": ("beckmann", 0.3, 0.3, Beckmann(0.3)),
    "anisotropic ggx": ("ggx", 0.05, 0.4, AnisotropicGGX(0.05, 0.4)),
    "anisotropic beckmann": ("beckmann", 0.5, 0.1, AnisotropicBeckmann(0.5, 0.1)),
}
FLOAT32 = 2e-5
RATIONAL = 4e-3  # Mitsuba's Beckmann masking is Walter's rational approximation, good to 0.35 %


@pytest.fixture(scope="module", autouse=True)
def _scalar():
    mitsuba.set_variant("scalar_rgb")


def _directions(count, seed):
    """Unit vectors of the upper hemisphere, (count, 3), grazing ones among them."""
    random = np.random.default_rng(seed)
    cos, phi = random.uniform(0.02, 1, count), random.uniform(0, 2 * np.pi, count)
    sin = np.sqrt(1 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)


@pytest.mark.parametrize("name", NDFS)
def test_distribution_and_masking(name):
    kind, along, across, ndf = NDFS[name]
    theirs = mitsuba.MicrofacetDistribution(
        getattr(mitsuba.MicrofacetType, {"ggx": "GGX", "beckmann": "Beckmann"}[kind]), along, across, False
    )
    half, view = _directions(200, 1), _directions(200, 2)
    d = [theirs.eval(mitsuba.Vector3f(m)) for m in half]
    slope_along, slope_across = half[:, 0] / half[:, 2], half[:, 1] / half[:, 2]
    ours = np.asarray(ndf.density(jnp.asarray(slope_along), jnp.asarray(slope_across))) / half[:, 2] ** 4
    np.testing.assert_allclose(ours, d, rtol=FLOAT32, atol=1e-6)
    # masking of a view by facets that face it: the mirror direction, where light and view are alike
    normal = mitsuba.Vector3f(0, 0, 1)
    g1 = [theirs.smith_g1(mitsuba.Vector3f(v), normal) for v in view]
    _, lambda_o = ndf.lambdas(_seen(view * [-1, -1, 1], view))
    np.testing.assert_allclose(1 / (1 + lambda_o), g1, rtol=RATIONAL if kind == "beckmann" else FLOAT32)


@pytest.mark.parametrize("name", NDFS)
def test_the_whole_reflectance(name):
    """F D G / (4 cos_i) with a conductor's F and separable masking, for any pair of directions."""
    kind, along, across, ndf = NDFS[name]
    scene = {"type": "roughconductor", "distribution": kind, "alpha_u": along, "alpha_v": across, "eta": 0.4, "k": 2.5}
    theirs, context = mitsuba.load_dict(scene), mitsuba.BSDFContext()
    light, view = _directions(300, 3), _directions(300, 4)
    expected = []
    for i, o in zip(light, view, strict=True):
        interaction = mitsuba.SurfaceInteraction3f()
        interaction.wi = mitsuba.Vector3f(o)
        expected.append(theirs.eval(context, interaction, mitsuba.Vector3f(i))[0])
    material = Microfacet(ndf, Conductor(0.4, 2.5), masking="smith-separable")
    ours = material.reflected(_seen(light, view)) / view[:, 2]  # theirs is the BRDF times the light's cosine alone
    tolerance = 2 * RATIONAL if kind == "beckmann" else 10 * FLOAT32
    np.testing.assert_allclose(ours, expected, rtol=tolerance, atol=1e-5)
    assert np.max(expected) > 0.1


def _seen(light, view):
    return shading((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), tuple(light.T), tuple(view.T))
