"""BRDF times both cosines: the form in which materials are integrated; finite and differentiable to the horizon."""

import equinox as eqx
import numpy as np
import pytest

from matcam import EPD, GGX, SGD, Beckmann, Conductor, GaussianNDF, Microfacet
from matcam.core.grid import cosines
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, shading
from matcam.material import AnisotropicBeckmann
from matcam.material.masking import MASKINGS
from matcam.material.material import shading_at

RANDOM = np.random.default_rng(11)
ANGLES = RANDOM.uniform(0, 1.57, 200), RANDOM.uniform(0, 1.57, 200), RANDOM.uniform(0, 6.28, 200)


@pytest.mark.parametrize("masking", MASKINGS)
def test_reflected_is_the_brdf_times_the_cosines_and_0_below(masking):
    material = Microfacet(GGX(0.3), Conductor([0.2, 1.0], 3.0), diffuse=0.2, masking=masking)
    cos_i, cos_o = cosines(*ANGLES)
    above = np.minimum(cos_i, cos_o) > 0
    reflected = np.asarray(material.reflected(shading_at(*ANGLES)))
    assert reflected.shape == (200, 2)
    np.testing.assert_array_equal(reflected[~above], 0)
    brdf = np.asarray(material.brdf(*ANGLES))
    np.testing.assert_allclose(reflected[above], (brdf * (cos_i * cos_o)[:, None])[above], rtol=1e-12)


def test_finite_at_the_horizon_with_a_limit():
    """F D / 4 with the lobe's own peak: masking alone dims it, down to 0."""
    at = lambda cos: Shading(  # noqa: E731
        jnp.asarray(cos), jnp.asarray(cos), jnp.zeros(()), jnp.zeros(()), jnp.arccos(cos), jnp.zeros(())
    )
    for ndf in (GGX(0.2), GaussianNDF(0.2)):
        unmasked = Microfacet(ndf, 1.0, masking=None)
        for cos in (1e-3, 1e-9, 1e-16, 1e-60):
            assert float(unmasked.reflected(at(cos))) == pytest.approx(float(ndf.d(0.0)) / 4, rel=1e-12)
            assert (
                0 <= float(Microfacet(ndf, 1.0).reflected(at(cos))) < 10 * cos + 1e-28
            )  # a cosine below 1e-30 counts as that
        assert float(unmasked.reflected(at(0.0))) == 0


@pytest.mark.parametrize(
    ("ndf", "masking"),
    [
        (GGX(0.2), "smith"),
        (GaussianNDF(0.1), None),
        (Beckmann(0.2), "smith-separable"),
        (EPD(0.1, 0.4), "smith"),
        (SGD(0.1, 0.4), "smith"),
        (AnisotropicBeckmann(0.1, 0.3), "van-ginneken"),
    ],
    ids=repr,
)
def test_derivatives_are_finite_wherever_light_and_view_may_be(ndf, masking):
    """By the material's parameters and by the angles: at the mirror direction, along the normal, at and below the horizon."""
    material = Microfacet(ndf, Conductor(0.5, 3.0), diffuse=0.1, masking=masking)
    seen = Shading(
        cos_i=jnp.asarray([1.0, 0.5, 0.0, -0.3, 0.7, 1e-12]),
        cos_o=jnp.asarray([1.0, 0.5, 0.5, 0.5, 0.0, 0.4]),
        slope_along=jnp.asarray([0.0, 0.0, 0.3, jnp.inf, -2.0, 0.1]),
        slope_across=jnp.asarray([0.0, 0.0, 0.3, 1.0, -2.0, 0.1]),
        theta_d=jnp.asarray([0.0, 1.0, 0.8, 0.8, 0.8, 0.8]),
        phi_d=jnp.asarray([0.0, 0.3, 0.3, 0.3, 0.3, 0.3]),
    )
    leaves, rest = eqx.partition(material, eqx.is_array)
    total = lambda leaves, seen: jnp.sum(eqx.combine(leaves, rest).reflected(seen))  # noqa: E731
    by_parameters, by_angles = jax.grad(total, argnums=(0, 1))(leaves, seen)
    for leaf in jax.tree.leaves((by_parameters, by_angles)):
        assert np.all(np.isfinite(leaf))


def test_a_single_theta_d_serves_many_normals():
    """Fresnel's term is evaluated on theta_d's own shape, and broadcasts."""
    material = Microfacet(GGX(0.3), Conductor([0.2, 1.0], 3.0), diffuse=[0.1, 0.2])
    one = shading_at(ANGLES[0], 0.7, ANGLES[2])
    assert one.theta_d.shape == ()
    many = shading_at(ANGLES[0], np.full(200, 0.7), ANGLES[2])
    np.testing.assert_array_equal(material.reflected(one), material.reflected(many))


@pytest.mark.parametrize(
    "ndf",
    [EPD(0.2, 0.7), *(pytest.param(ndf, marks=pytest.mark.slow) for ndf in (GaussianNDF(0.1), SGD(0.1, 0.8)))],
    ids=repr,
)
def test_derivatives_through_the_table_of_lambda(ndf):
    """By the NDF's parameters, against central differences of the integral itself."""
    angles = np.random.default_rng(4).uniform(0, [[1.3], [1.3], [6.3]], (3, 3000))
    seen = shading_at(*angles)
    assert seen.cos_i.size > 2048
    leaves, rest = jax.tree.flatten(ndf)

    def total(leaves):
        return jnp.sum(Microfacet(jax.tree.unflatten(rest, leaves), 1.0).reflected(seen))

    def integrated(leaves):
        """The same, a few directions at a time."""
        parts = [jax.tree.map(lambda a, k=k: a[k::2], seen) for k in range(2)]
        return sum(float(jnp.sum(Microfacet(jax.tree.unflatten(rest, leaves), 1.0).reflected(part))) for part in parts)

    for k, slope in enumerate(jax.grad(total)(leaves)):
        moved = [[leaf * (1 + sign * 1e-4 * (j == k)) for j, leaf in enumerate(leaves)] for sign in (1, -1)]
        by_difference = (integrated(moved[0]) - integrated(moved[1])) / (2e-4 * float(leaves[k]))
        assert float(slope) == pytest.approx(by_difference, rel=1e-6)


def test_vectors_and_angles_tell_the_same_story_at_the_mirror_direction():
    """Half vector along the normal to rounding: its azimuth is noise, but light's and view's must not be."""
    theta_d, azimuth = 0.9, 2.2
    light = np.sin(theta_d) * np.cos(azimuth), np.sin(theta_d) * np.sin(azimuth), np.cos(theta_d)
    for tilt in (0.0, 1e-17, 1e-12):
        view = -light[0] + tilt, -light[1] - tilt, light[2]
        seen = shading((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), light, view)
        phi_h = np.arctan2(seen.slope_across, seen.slope_along)
        assert np.exp(1j * (phi_h + seen.phi_d)) == pytest.approx(np.exp(1j * azimuth), abs=1e-9)
