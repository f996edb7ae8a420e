import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcam import GGX, Conductor, GaussianNDF, Microfacet
from matcam.angles import cosines
from matcam.errors import ArgumentError
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


def test_a_rough_mirror_reflects_no_more_than_it_receives():
    """Directional albedo with F = 1 by a grid over view directions: at most 1, and most of it."""
    material, theta_i = Microfacet(GGX(0.3), 1.0), 0.7
    theta_o, phi = np.meshgrid((np.arange(250) + 0.5) / 250 * np.pi / 2, (np.arange(250) + 0.5) / 250 * 2 * np.pi)
    light = np.array([np.sin(theta_i), 0, np.cos(theta_i)])[:, None, None]
    view = np.stack([np.sin(theta_o) * np.cos(phi), np.sin(theta_o) * np.sin(phi), np.cos(theta_o)])
    half = light + view
    half /= np.linalg.norm(half, axis=0)
    theta_h, theta_d = np.arccos(np.clip(half[2], -1, 1)), np.arccos(np.clip((light * half).sum(0), -1, 1))
    # only the azimuth's cosine matters: phi_d from cos_i = ch cd - sh sd cos(phi_d)
    with np.errstate(divide="ignore", invalid="ignore"):
        c = (np.cos(theta_h) * np.cos(theta_d) - light[2]) / (np.sin(theta_h) * np.sin(theta_d))
    values = np.asarray(material.brdf(theta_h, theta_d, np.arccos(np.clip(np.nan_to_num(c), -1, 1))))
    albedo = np.nansum(values * np.cos(theta_o) * np.sin(theta_o)) * (np.pi / 2 / 250) * (2 * np.pi / 250)
    assert 0.8 < albedo <= 1


def test_refusals():
    with pytest.raises(ArgumentError, match="ndf must be an NDF"):
        Microfacet(0.1, 1.0)
    with pytest.raises(ArgumentError, match="masking must be one of 'smith'"):
        Microfacet(GGX(0.1), 1.0, masking="torrance")
    with pytest.raises(ArgumentError, match="diffuse"):
        Microfacet(GaussianNDF(0.1), 1.0, diffuse=1.5)
