"""Texts for people: an object's `repr`, and hints in messages."""

import re

import numpy as np
import pytest

import matcam
from matcam.camera import Uncertainty
from matcam.core.errors import ArgumentError


@pytest.mark.parametrize(
    ("thing", "text"),
    [
        (matcam.GGX(0.005), "GGX(alpha=0.005)"),
        (matcam.GGX(1 / 3), "GGX(alpha=0.3333333333333333)"),
        (matcam.Conductor(3.1, 3.3), "Conductor(n=3.1, k=3.3)"),
        (matcam.Conductor([0.2, 0.4], 3.3), "Conductor(n=[0.2, 0.4], k=[3.3, 3.3])"),
        (matcam.Schlick(0.9), "Schlick(f0=0.9)"),
        (
            matcam.Microfacet(matcam.Beckmann(0.1), 0.5, masking=None),
            "Microfacet(ndf=Beckmann(alpha=0.1), fresnel=Constant(value=0.5), diffuse=0.0, masking=None)",
        ),
        (matcam.material.AnisotropicGGX(0.1, 0.2), "AnisotropicGGX(alpha_along=0.1, alpha_across=0.2)"),
        (matcam.NearLamp(30.0, 0.01), "NearLamp(distance=30.0, radius=0.01)"),
        (
            matcam.material.Sampled(np.linspace(0, 1.5, 90), np.linspace(0.5, 1, 270).reshape(90, 3)),
            "Sampled(theta=<90 values from 0 to 1.5>, values=<90 x 3 values from 0.5 to 1>)",
        ),
        (Uncertainty.of({"a": 0.01, "b": 2}), "Uncertainty.of({'a': 0.01, 'b': 2.0})"),
        (Uncertainty(["a", "b"], [[1e-4, 1e-3], [1e-3, 4.0]]), "<Uncertainty: a ± 0.01, b ± 2, correlated>"),
    ],
)
def test_a_repr_has_values(thing, text):
    assert repr(thing) == text


def test_the_repr_of_a_material_rebuilds_it():
    material = matcam.Microfacet(matcam.EPD(0.1, 0.8), matcam.Conductor([0.2, 0.4], 3.3), [0.1, 0.0])
    again = eval(repr(material), vars(matcam) | {name: getattr(matcam, name) for name in matcam.__all__})
    angles = 0.1, 0.5, 1.0
    np.testing.assert_array_equal(again.brdf(*angles), material.brdf(*angles))


def test_a_traced_value_has_a_repr():
    texts = []

    def density(alpha):
        lobe = matcam.GGX(alpha)
        texts.append(repr(lobe))
        return lobe.d(0.0)

    matcam.core.jax.jax.grad(density)(0.1)
    assert re.match(r"GGX\(alpha=\w*Tracer", texts[0])


RIG = matcam.rigs.merl()


@pytest.mark.parametrize(
    ("call", "degrees"),
    [
        (lambda: matcam.fresnel_conductor(45, 1.5, 2.0), 45),
        (lambda: matcam.peak_response(RIG, matcam.GGX(0.1), [0, 5, 75]), 75),
        (lambda: matcam.DistantLamp(2), 2),
        (lambda: matcam.GaussianNDF(3), 3),
        (lambda: matcam.picture(matcam.Microfacet(matcam.GGX(0.1), 1.0), RIG, 30), 30),
        (lambda: matcam.fresnel(matcam.io.example_table(), RIG, normalise=(10, 45)), 45),
    ],
)
def test_an_angle_in_degrees_is_recognised(call, degrees):
    with pytest.raises(ArgumentError, match=rf"; if {degrees} is in degrees, give np.radians\({degrees}\)$"):
        call()


@pytest.mark.parametrize("angle", [-0.1, 2.0, 1e6])
def test_an_angle_that_is_wrong_in_degrees_too_has_no_hint(angle):
    with pytest.raises(ArgumentError, match="must lie in") as caught:
        matcam.fresnel_conductor(angle, 1.5, 2.0)
    assert "degrees" not in str(caught.value)


def test_a_table_in_degrees_is_recognised():
    table = matcam.io.example_table()
    wrong = table.assign_coords(theta_d=np.degrees(table["theta_d"]))
    with pytest.raises(ArgumentError, match=r"its values are in degrees: give np.radians\(table\['theta_d'\]\)"):
        matcam.fresnel(wrong, RIG)
