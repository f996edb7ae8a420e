import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcam import EPD, GGX, SGD, Beckmann, Conductor, GaussianNDF, Microfacet
from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines
from matcam.core.shading import shading
from matcam.material import AnisotropicBeckmann, AnisotropicGGX
from matcam.material.masking import MASKINGS
from tests.golden import rows

MATERIALS = [
    Microfacet(GGX(0.2), Conductor([0.2, 1.0, 2.0], 3.0), diffuse=[0.1, 0.2, 0.3], masking=m) for m in MASKINGS
]


@given(st.floats(0, 1.4), st.floats(0, 1.4), st.floats(0, 6.3), st.sampled_from(MATERIALS))
def test_reciprocity_and_mirror_symmetry(theta_h, theta_d, phi_d, material):
    one = np.asarray(material.brdf(theta_h, theta_d, phi_d))
    for other in (phi_d + np.pi, -phi_d):
        np.testing.assert_allclose(one, material.brdf(theta_h, theta_d, other), rtol=1e-9)


@given(st.floats(0, 1.57), st.floats(0, 1.57), st.floats(0, 6.3))
def test_nan_below_the_horizon_and_only_there(theta_h, theta_d, phi_d):
    below = float(min(cosines(theta_h, theta_d, phi_d))) <= 0
    assert np.isnan(np.asarray(MATERIALS[0].brdf(theta_h, theta_d, phi_d))).all() == below


@pytest.mark.parametrize("row", [r for r in rows("measure_cells") if r["alpha"] >= 0.02])
def test_true_values_of_golden_cells(row):
    """The golden cells state the GGX BRDF itself, with height-correlated Smith masking and F = 1."""
    value = Microfacet(GGX(row["alpha"]), 1.0).brdf(row["theta_h"], row["theta_d"], row["phi_d"])
    assert float(value) == pytest.approx(row["true"], rel=1e-9)


def directions(cos, phi):
    """Unit vectors, as three components that broadcast."""
    sin = np.sqrt(1 - cos**2)
    return sin * np.cos(phi), sin * np.sin(phi), cos + 0 * phi


def seen_from(light, view):
    return shading((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), light, view)


@pytest.mark.parametrize(
    ("ndf", "masking"),
    [
        *((GGX(0.3), masking) for masking in MASKINGS if masking),
        (Beckmann(0.4), "smith"),
        (GaussianNDF(0.3), "van-ginneken"),
        (EPD(0.3, 0.5), "smith"),
        (EPD(0.3, 2.0), "smith-separable"),
        (SGD(0.2, 1.0), "smith"),
        (AnisotropicGGX(0.2, 0.5), "smith"),
        (AnisotropicBeckmann(0.5, 0.2), "van-ginneken"),
    ],
    ids=repr,
)
def test_a_rough_mirror_reflects_no_more_than_it_receives(ndf, masking):
    """White furnace: with F = 1 the albedo, by a grid over view directions, is at most 1, and most of it."""
    cos, phi = np.meshgrid((np.arange(300) + 0.5) / 300, (np.arange(300) + 0.5) / 300 * 2 * np.pi)
    material = Microfacet(ndf, 1.0, masking=masking)
    for cos_i in (0.95, 0.3):
        light = directions(np.float64(cos_i), np.float64(0.4))
        reflected = np.asarray(material.reflected(seen_from(light, directions(cos, phi))))
        albedo = reflected.sum() * (2 * np.pi / 300**2) / cos_i
        assert 0.7 < albedo <= 1 + 1e-4  # the grid's own error


def test_van_ginneken_against_its_formula_on_vectors():
    """Azimuths as arctangents of the vectors, their difference wrapped; Lambda in closed form."""
    random = np.random.default_rng(6)
    light, view = (directions(random.uniform(0.03, 1, 500), random.uniform(-9, 9, 500)) for _ in range(2))
    ratio = np.divide(
        *(
            np.asarray(Microfacet(GGX(0.5), 1.0, masking=masking).reflected(seen_from(light, view)))
            for masking in ("van-ginneken", None)
        )
    )
    azimuth = np.abs(np.angle(np.exp(1j * (np.arctan2(light[1], light[0]) - np.arctan2(view[1], view[0])))))
    li, lo = (np.sqrt(1 + 0.25 * (1 / v[2] ** 2 - 1)) / 2 - 0.5 for v in (light, view))
    apart = 4.41 * azimuth / (4.41 * azimuth + 1)
    np.testing.assert_allclose(ratio, 1 / (1 + np.maximum(li, lo) + apart * np.minimum(li, lo)), rtol=1e-7)


def test_lambertian_part_and_channels():
    grey = Microfacet(GGX(0.2), 0.0, diffuse=0.3)
    assert float(grey.brdf(0.1, 0.2, 0.3)) == pytest.approx(0.3 / np.pi, rel=1e-14)
    coloured = Microfacet(GGX(0.2), 0.5, diffuse=[0.1, 0.2, 0.3])
    difference = np.asarray(coloured.brdf(0.1, 0.2, 0.3)) - np.asarray(Microfacet(GGX(0.2), 0.5).brdf(0.1, 0.2, 0.3))
    np.testing.assert_allclose(difference, np.array([0.1, 0.2, 0.3]) / np.pi, rtol=1e-12)


def test_refusals():
    with pytest.raises(ArgumentError, match="ndf must be an NDF"):
        Microfacet(0.1, 1.0)
    with pytest.raises(ArgumentError, match="masking must be one of 'smith'"):
        Microfacet(GGX(0.1), 1.0, masking="torrance")
    with pytest.raises(ArgumentError, match="diffuse"):
        Microfacet(GaussianNDF(0.1), 1.0, diffuse=1.5)
    with pytest.raises(ArgumentError, match="diffuse must be a number or a list with one entry per channel"):
        Microfacet(GaussianNDF(0.1), 1.0, diffuse=np.zeros((2, 2)))
