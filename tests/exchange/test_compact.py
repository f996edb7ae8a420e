"""RGL files of a given error: the smallest grid that reaches it, evaluated by Mitsuba."""

import numpy as np
import pytest

import matcam
from matcam.core.errors import ArgumentError
from matcam.exchange.conversion import convert, resampling_error
from matcam.exchange.parameterisation import GRID_SIZES, peak_angles, resampled_grid
from matcam.material.measured import Adaptive


@pytest.fixture(scope="module")
def satin(tmp_path_factory):
    path = tmp_path_factory.mktemp("satin") / "satin.binary"
    material = matcam.Microfacet(matcam.GGX(0.3), matcam.Dielectric(1.5), diffuse=[0.2, 0.3, 0.4])
    matcam.write_merl(path, matcam.forward.true_table(material))
    return path


def test_a_satin_table_takes_less_than_a_megabyte_at_one_percent(satin, tmp_path):
    report = convert(satin, tmp_path / "a.bsdf", error=0.01)
    assert (tmp_path / "a.bsdf").stat().st_size < 1e6
    assert max(report["error"]["median"], report["error"]["peak"]) <= 0.01
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "a.bsdf")})
    table = matcam.material.Tabulated(matcam.read_merl(satin))
    random = np.random.default_rng(5)
    ratios = []
    for _ in range(400):
        theta, phi = np.arccos(random.uniform(0.2, 1, 2)), random.uniform(0, 2 * np.pi, 2)
        light, view = (
            np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]) for t, p in zip(theta, phi, strict=True)
        )
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(*light)
        seen = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(*view)))
        half = [np.asarray(a) for a in matcam.core.grid.half_and_difference(theta[0], phi[0], theta[1], phi[1])]
        ratios.append(seen / np.cos(theta[1]) / np.asarray(table.brdf(*half)) - 1)
    assert np.median(np.abs(ratios)) < 0.01


@pytest.fixture(scope="module")
def restless(tmp_path_factory):
    """A satin table whose F scatters by 3 % from degree to degree, as those of measured materials do."""
    path = tmp_path_factory.mktemp("restless") / "restless.binary"
    angle = np.radians(np.arange(90) + 0.5)
    term = matcam.material.Sampled(angle, 0.8 * (1 + 0.03 * np.random.default_rng(3).standard_normal((90, 3))))
    matcam.write_merl(path, matcam.forward.true_table(matcam.Microfacet(matcam.GGX(0.2), term)))
    return path


def test_a_peak_that_scatters_from_degree_to_degree_is_followed_within_a_megabyte(restless, tmp_path, monkeypatch):
    monkeypatch.setattr("matcam.exchange.conversion.GRID_SIZES", GRID_SIZES[1:2])
    report = convert(restless, tmp_path / "a.bsdf", error=0.01)
    assert (tmp_path / "a.bsdf").stat().st_size < 1e6
    assert report["error"]["peak"] < 0.002
    table = matcam.material.Tabulated(matcam.read_merl(restless))
    plain = Adaptive(resampled_grid(table, GRID_SIZES[1]))
    assert resampling_error(table, plain)["peak"] > 0.005  # without the angles that the peak needs
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "a.bsdf")})
    interaction = mi.SurfaceInteraction3f()
    for theta in np.radians(np.arange(2.3, 45, 1.7)):
        interaction.wi = mi.Vector3f(np.sin(theta), 0, np.cos(theta))
        seen = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(-np.sin(theta), 0, np.cos(theta))))
        truth = np.asarray(table.brdf(0.0, theta, np.pi / 2))
        np.testing.assert_allclose(seen / np.cos(theta), truth, rtol=0.012)


@pytest.mark.parametrize("error", [0.01, 0.1])
def test_the_peak_is_linear_between_the_chosen_angles(restless, error):
    table = matcam.material.Tabulated(matcam.read_merl(restless))
    chosen = peak_angles(table, error)
    fine = np.radians(np.linspace(0, 45.5, 500))
    truth, nodes = (np.asarray(table.brdf(0 * at, at, 0 * at + np.pi / 2)) for at in (fine, chosen))
    line = np.stack([np.interp(fine, chosen, one) for one in nodes.T], axis=1)
    assert np.max(np.abs(line / truth - 1)) < 1.05 * error
    assert (len(chosen) < 10) == (error > 0.05)


def test_what_no_grid_reaches_is_stated(satin, tmp_path, monkeypatch):
    sizes = matcam.exchange.conversion.GRID_SIZES[:1]
    monkeypatch.setattr("matcam.exchange.conversion.GRID_SIZES", sizes)
    report = convert(satin, tmp_path / "a.bsdf", error=1e-6)
    assert "no grid has an error of at most 0.00%" in report["resampled"]
    with pytest.raises(ArgumentError, match="error must lie in"):
        convert(satin, tmp_path / "b.bsdf", error=-1.0)
