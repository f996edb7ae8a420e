"""Microfacet materials in Mitsuba's and pbrt's words, evaluated by Mitsuba itself; roughness as Walter et al. mean it."""

import re

import mitsuba
import numpy as np
import pytest

from docs_claims import limit
from matcam import EPD, GGX, Beckmann, Conductor, Dielectric, Microfacet, Schlick
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNEL_WAVELENGTHS, brdf_table
from matcam.exchange import mitsuba_material, pbrt_material
from matcam.material import AnisotropicGGX, Tabulated
from tests.material.test_adaptive import directions, outgoing

METAL = Conductor([0.2, 1.1, 3.0], [3.0, 2.0, 4.0])


@pytest.mark.parametrize(
    ("material", "tolerance"),
    [
        (Microfacet(GGX(0.2), METAL, masking="smith-separable"), limit("mitsuba")),
        (Microfacet(AnisotropicGGX(0.1, 0.4), METAL, [0.1, 0.2, 0.3], masking="smith-separable"), limit("mitsuba")),
        (Microfacet(Beckmann(0.3), [0.2, 0.5, 0.6], masking="smith-separable"), 8e-3),  # rational masking: 0.35 % each
        (Microfacet(GGX(0.3), 0.8, 0.15, masking="smith-separable"), limit("mitsuba")),
    ],
    ids=["metal", "brushed metal, diffuse", "coloured reflectance", "grey, diffuse"],
)
def test_mitsuba_evaluates_the_same(material, tolerance):
    mitsuba.set_variant("scalar_rgb")
    theirs, context = mitsuba.load_dict(mitsuba_material(material)), mitsuba.BSDFContext()
    light, view = directions(300, 1, 0.1), directions(300, 2, 0.1)
    interaction = mitsuba.SurfaceInteraction3f()
    expected = np.empty((300, 3))
    for k in range(300):
        interaction.wi = mitsuba.Vector3f(light[k])
        expected[k] = theirs.eval(context, interaction, mitsuba.Vector3f(view[k]))
    ours = outgoing(material, light, view)
    np.testing.assert_allclose(np.broadcast_to(ours, (300, 3)), expected, rtol=tolerance, atol=1e-6)


def test_pbrt_text():
    text = pbrt_material(Microfacet(AnisotropicGGX(0.1, 0.4), METAL))
    assert text.splitlines()[1] == 'Material "conductor"'
    assert '"float uroughness" 0.1 "float vroughness" 0.4 "bool remaproughness" false' in text
    eta = np.array(re.search(r'"spectrum eta" \[ (.*) \]', text).group(1).split(), dtype=float).reshape(-1, 2)
    assert np.all(np.diff(eta[:, 0]) > 0)
    red = eta[np.isclose(eta[:, 0], CHANNEL_WAVELENGTHS[0] * 1e9)]
    np.testing.assert_allclose(red[0, 1], 0.2)
    assert 'MakeNamedMaterial "gold" "string type" "conductor"' in pbrt_material(Microfacet(GGX(0.1), METAL), "gold")


def test_what_renderers_do_not_have_is_refused():
    table = Tabulated(brdf_table(np.ones((90, 90, 180, 3)), "centre"))
    for export, material, words in (
        (mitsuba_material, table, "write the material as a .bsdf"),
        (mitsuba_material, Microfacet(EPD(0.1, 0.5), METAL), "GGX and Beckmann"),
        (mitsuba_material, Microfacet(GGX(0.1), Schlick(0.5)), "Schlick"),
        (mitsuba_material, Microfacet(GGX(0.1), Dielectric(1.5)), "Dielectric"),
        (mitsuba_material, Microfacet(GGX(0.1), METAL, 1.0), "leaves no share"),
        (mitsuba_material, Microfacet(GGX(0.1), [0.9, 0.5, 0.1], 0.5), "must not exceed 1 in Mitsuba"),
        (mitsuba_material, Microfacet(GGX(0.1), Conductor([1.0] * 4, 2.0)), "3 channels"),
        (pbrt_material, Microfacet(Beckmann(0.1), METAL), "GGX facets"),
        (pbrt_material, Microfacet(GGX(0.1), METAL, 0.1), "without a diffuse part"),
        (pbrt_material, Microfacet(GGX(0.1), 0.9), "only metals"),
    ):
        with pytest.raises(ArgumentError, match=words):
            export(material)
    with pytest.raises(ArgumentError, match="name must not be empty or contain"):
        pbrt_material(Microfacet(GGX(0.1), METAL), 'a"b')
