"""MERL tables as RGL files: what Mitsuba evaluates and samples from them."""

import mitsuba
import numpy as np
import pytest

from matcam import GGX, Conductor, Flat, GaussianOptics, Microfacet, Rig, measure, read_merl, rigs
from matcam.core.errors import ArgumentError
from matcam.core.grid import brdf_table, merl_grid
from matcam.exchange import adaptive_grid
from matcam.io import write_rgl
from matcam.material import Adaptive, AnisotropicGGX, Tabulated, albedo
from tests.material.test_adaptive import directions, outgoing
from tests.oracle import measured_bsdf

CHROMIUM = Conductor([3.3, 2.9, 2.26], [4.32, 4.23, 3.94])
LOWEST = np.cos(np.radians(80))


def table_of(alpha, diffuse):
    return measure(Microfacet(GGX(alpha), CHROMIUM, diffuse), Rig(rigs.merl().camera, Flat()))


def highlight(count, seed, width):
    """Pairs whose half vectors spread evenly in the logarithm, from width / 30 to 30 widths."""
    random = np.random.default_rng(seed)
    light = directions(4 * count, seed, LOWEST)
    theta = np.minimum(width * 10 ** random.uniform(-1.5, 1.5, 4 * count), 1.2)
    phi = random.uniform(0, 2 * np.pi, 4 * count)
    half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    view = 2 * np.sum(light * half, axis=1, keepdims=True) * half - light
    seen = np.flatnonzero(view[:, 2] > LOWEST)[:count]
    return light[seen], view[seen].astype(np.float32).astype(float)


def relative_errors(path, material, pairs):
    ours = outgoing(material, *pairs)
    return np.max(np.abs(measured_bsdf.evaluated(path, *pairs) - ours) / ours, axis=1)


@pytest.mark.parametrize(
    ("alpha", "diffuse"),
    [
        pytest.param(0.02, 0.2, marks=pytest.mark.slow),
        pytest.param(0.02, 0.0, marks=pytest.mark.slow),
        pytest.param(0.1, 0.1, marks=pytest.mark.slow),
        pytest.param(0.4, 0.0, marks=pytest.mark.slow),
        pytest.param(1.0, 0.3, marks=pytest.mark.slow),
    ],
)
def test_mitsuba_sees_the_table(tmp_path, alpha, diffuse):
    """At 10,000 random pairs to 80 degrees, and at as many spread over the highlight, which random ones seldom meet."""
    material = Tabulated(table_of(alpha, diffuse))
    path = tmp_path / "a.bsdf"
    write_rgl(path, adaptive_grid(material))
    for pairs in ((directions(10_000, 1, LOWEST), directions(10_000, 2, LOWEST)), highlight(10_000, 3, alpha)):
        error = relative_errors(path, material, pairs)
        assert np.mean(error > 0.01) <= 3e-4
        assert np.max(error) < 0.015
        assert np.median(error) < 1e-3
    assert measured_bsdf.chi_square(path, np.radians(60), count=50_000, points=8) > 0.01
    # samples are worth having: their weights hardly differ
    _, weights = measured_bsdf.sampled(path, np.radians(45), 5000, 2)
    assert np.std(weights[:, 1]) < 0.5 * np.mean(weights[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.4])
def test_samples_are_distributed_as_the_density_says(tmp_path, alpha):
    """Nine tests at 1 % together."""
    path = tmp_path / "a.bsdf"
    write_rgl(path, adaptive_grid(Tabulated(table_of(alpha, 0.1))))
    for angle in (0, 45, 75):
        assert measured_bsdf.chi_square(path, np.radians(angle)) > 0.01 / 9


@pytest.mark.slow
def test_a_sharp_and_noisy_table(stand_in, tmp_path):
    """Chrome's stand-in: what is lost is what is finer than the grid of light directions. Sampling holds all the same."""
    material = Tabulated(read_merl(stand_in("chrome")))
    path = tmp_path / "a.bsdf"
    write_rgl(path, adaptive_grid(material))
    error = relative_errors(path, material, (directions(10_000, 1, LOWEST), directions(10_000, 2, LOWEST)))
    assert np.median(error) < 0.02
    for angle in (0, 45, 75):
        assert measured_bsdf.chi_square(path, np.radians(angle)) > 0.01 / 3


def test_a_grey_material_with_gaps(tmp_path):
    """Lambert's BRDF on a table with a third of its cells missing: what is there is kept, what is not is made up and told."""
    values = np.where(np.random.default_rng(1).random((90, 90, 180, 1)) < 1 / 3, np.nan, 0.2 / np.pi)
    fields = adaptive_grid(Tabulated(brdf_table(np.repeat(values, 3, axis=3), "centre")), description="grey")
    assert fields.attrs["missing_share"] == pytest.approx(1 / 3, abs=0.02)
    assert bytes(fields["description"].values) == b"grey"
    light, view = directions(500, 7, LOWEST), directions(500, 8, LOWEST)
    np.testing.assert_allclose(
        outgoing(Adaptive(fields), light, view), 0.2 / np.pi * view[:, 2:].repeat(3, 1), rtol=0.05
    )


def test_a_lobe_that_is_wider_at_grazing_angles():
    """As a camera records it: 0.003 rad, and 0.05 rad beyond 80 degrees. The file reflects the light of the table."""
    grid = merl_grid("centre")
    width = np.where(grid.theta_d < np.radians(80), 0.003, 0.05)[:, None]
    lobe = np.exp(-((grid.theta_h[:, None, None] / width) ** 2)) / np.cos(grid.theta_d)[:, None]
    material = Tabulated(brdf_table(np.broadcast_to(1e3 * lobe[..., None], (90, 90, 180, 3)).copy(), "centre"))
    angles = np.radians([30, 70, 82, 85])
    np.testing.assert_allclose(albedo(Adaptive(adaptive_grid(material)), angles), albedo(material, angles), rtol=0.1)


def test_it_renders(tmp_path):
    """A white furnace: a sphere of albedo 1 under light from all around disappears, by Mitsuba's own sampling."""
    write_rgl(tmp_path / "a.bsdf", adaptive_grid(Microfacet(GGX(0.3), [0.0] * 3, 1.0), square=32))
    mitsuba.set_variant("scalar_rgb")
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1},
            "light": {"type": "constant"},
            "sphere": {"type": "sphere", "bsdf": {"type": "measured", "filename": str(tmp_path / "a.bsdf")}},
            "sensor": {
                "type": "orthographic",
                "to_world": mitsuba.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 256},
            },
        }
    )
    picture = np.array(mitsuba.render(scene))[4:12, 4:12, :3]
    np.testing.assert_allclose(picture, 1, atol=0.05)
    assert np.mean(picture) == pytest.approx(1, abs=0.01)


def test_what_cannot_be_put_there():
    good = Microfacet(GGX(0.3), 0.9)
    for arguments, words in (
        ((GaussianOptics(0.5),), "must be a Material"),
        ((Microfacet(GGX(0.3), [0.5, 0.5]),), "this material has 2"),
        ((Microfacet(GGX(0.3), 0.0),), "no lobe to sample: give a material that is not black"),
        ((Microfacet(AnisotropicGGX(0.1, 0.4), 0.9),), "isotropic"),
    ):
        with pytest.raises(ArgumentError, match=words):
            adaptive_grid(*arguments)
    for square in (7, 9, 1024, 32.0):
        with pytest.raises(ArgumentError, match="square must be"):
            adaptive_grid(good, square=square)
