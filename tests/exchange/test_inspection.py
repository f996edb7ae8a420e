from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    ColourOptics,
    Conductor,
    GaussianOptics,
    Microfacet,
    SeidelOptics,
    fresnel_conductor,
    inspect,
    read_merl,
    rigs,
    write_merl,
)
from matcam.batch.job import Job, write_corrected
from matcam.batch.recipe import Options, Recipe
from matcam.camera import Uncertainty
from matcam.cli import _run
from matcam.cli.suggestions import after
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import brdf_table
from matcam.exchange.contents import read_contents
from matcam.exchange.inspection import inspect_contents, inspect_table
from matcam.files.formats import identify
from matcam.forward import true_table
from matcam.io import write_exr, write_netcdf
from matcam.material import Tabulated, albedo
from tests.oracle import merl_lobe


@pytest.fixture(scope="module")
def blurred():
    return brdf_table(merl_lobe.record(0.002, np.ones((90, 3))), "centre")


def test_lobe_widens_in_the_plane_as_the_camera_makes_it(blurred):
    report = inspect_table(blurred)
    rows = {row["theta_d_deg"]: row for row in report["lobe"]}
    kernel, lobe = np.sqrt(0.25 + 1 / 12) / 256, 0.002  # rad at normal view, to the accuracy of a Gaussian for the box
    for angle, row in rows.items():
        expected = np.degrees(np.sqrt(2 * np.log(2)) * np.hypot(lobe, kernel / np.cos(np.radians(angle + 0.5))))
        if angle <= 75:
            assert row["in_plane_hwhm_deg"] == pytest.approx(expected, rel=0.1)
    assert rows[75]["across_hwhm_deg"] == pytest.approx(rows[0]["across_hwhm_deg"], rel=0.25)


def test_report_of_a_table(blurred):
    report = inspect_table(blurred)
    assert report["grid"] == {"theta_h": 90, "theta_d": 90, "phi_d": 180}
    assert report["missing_share"] == pytest.approx(0.248, abs=5e-4)
    assert report["missing_above_horizon_share"] == 0
    assert report["valid_below_horizon_share"] == 0
    assert report["reciprocity_rms"] < 1e-12


def test_broken_reciprocity_is_measured(blurred):
    rng = np.random.default_rng(5)
    noisy = blurred * (1 + 0.03 * rng.standard_normal(blurred.shape))
    noisy.attrs = blurred.attrs
    # difference of two cells over their mean: sqrt(2) of one cell's noise
    assert inspect_table(noisy.clip(min=0))["reciprocity_rms"] == pytest.approx(0.03 * np.sqrt(2), rel=0.02)


def test_a_table_without_lobe_has_no_width():
    report = inspect_table(brdf_table(np.ones((90, 90, 180, 3)), "edge"))
    assert all(row["in_plane_hwhm_deg"] is None for row in report["lobe"])
    assert report["reciprocity_rms"] == 0


def test_files_are_known_by_their_content(tmp_path, stand_in):
    assert identify(stand_in("chrome")) == "merl"
    Camera(GaussianOptics(0.5)).save(tmp_path / "a.dat")
    assert identify(tmp_path / "a.dat") == "camera profile"
    (tmp_path / "b.txt").write_text("hello")
    for path, words in (
        (tmp_path / "b.txt", "unknown format; the supported formats are"),
        (tmp_path / "c", "no such file"),
        (tmp_path, "cannot be read"),
    ):
        with pytest.raises(FileFormatError, match=words):
            identify(path)


def test_the_camera_shows_in_a_blurred_table_and_not_in_another(blurred, stand_in):
    found = inspect_table(blurred)["camera"]
    assert found["visible"]
    assert found["kernel_rad"] == pytest.approx(np.sqrt(0.25 + 1 / 12) / 256, rel=0.1)
    assert found["widening"] > 2
    # chrome's stand-in has the same lobe at every angle by construction
    assert inspect_table(read_merl(stand_in("chrome")))["camera"]["visible"] is False


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vch_golden_yellow", "cc_ibiza_sunset", "satin_rosaline"])
def test_a_goniophotometer_shows_no_camera(real_data, name):
    found = inspect_contents(read_contents(real_data / "rgl" / f"{name}_rgb.bsdf"))
    assert found["camera"]["visible"] is False
    assert found["own_grid"]["isotropic"]
    assert found["own_grid"]["light_directions"] == {"phi_i": 1, "theta_i": 8}
    assert all(0 < row["G"] < 1.05 for row in found["albedo"])


@pytest.mark.parametrize("sampling", ["centre", "edge"])
@pytest.mark.parametrize("alpha", [0.001, 0.01, 0.3])
def test_the_albedo_of_a_table_is_that_of_its_material(alpha, sampling):
    """Between the values of a narrow lobe, interpolation is too bright by 6 to 14 %."""
    material, angles = Microfacet(GGX(alpha), 0.97, diffuse=0.02), np.radians([0.0, 20, 45, 60])
    found = albedo(Tabulated(true_table(material, sampling)), angles)
    np.testing.assert_allclose(found, np.tile(albedo(material, angles), 3), rtol=2.5e-3)


def test_albedo_is_energy():
    angles = [0.0, 0.5, 1.2]
    lambert = Microfacet(GGX(0.3), 0.0, [0.2, 0.5, 1.0])
    np.testing.assert_allclose(albedo(lambert, angles), np.tile([0.2, 0.5, 1.0], (3, 1)), rtol=2e-5)
    # facets far smaller than anything else send back all that they mirror
    sharp = albedo(Microfacet(GGX(1e-3), Conductor(0.2, 3.0)), angles)[:, 0]
    np.testing.assert_allclose(sharp, fresnel_conductor(angles, 0.2, 3.0), rtol=1e-4)
    table = brdf_table(np.full((90, 90, 180, 3), 0.3 / np.pi), "centre")
    assert inspect_table(table)["albedo"][3] == pytest.approx(
        {"theta_o_deg": 45, "R": 0.3, "G": 0.3, "B": 0.3, "missing_share": 0.0}, rel=1e-3
    )


def test_missing_values_are_no_darkness():
    """A channel without values has no albedo; for others the share of the light without values is given."""
    table = brdf_table(np.full((90, 90, 180, 3), 0.3 / np.pi), "centre")
    table[:, 60:, :, :2] = np.nan  # theta_d beyond 60 degrees: lamp beyond 120 degrees from the camera
    table[..., 2] = np.nan
    rows = inspect_table(table)["albedo"]
    assert all(row["B"] is None for row in rows)
    for row in rows:
        assert row["R"] == pytest.approx(0.3 * (1 - row["missing_share"]), rel=2e-3)
    assert rows[0]["missing_share"] == 0.0
    assert rows[-1]["missing_share"] > 0.1


def test_other_contents(tmp_path):
    (tmp_path / "a.csv").write_text("theta_h_deg,theta_d_deg,phi_d_deg,G_per_sr\n1,2,3,4\n5,6,7,\n")
    found = inspect_contents(read_contents(tmp_path / "a.csv"))
    assert (found["holds"], found["samples"], found["missing_share"]) == ("scattered samples", 2, 0.5)
    np.testing.assert_allclose(found["angles_deg"]["theta_d"], [2, 6])
    write_exr(tmp_path / "a.exr", np.array([[1.0, np.nan], [3.0, 4.0]]))
    found = inspect_contents(read_contents(tmp_path / "a.exr"))
    assert (found["shape"], found["missing_share"], found["range"]) == ([2, 2], 0.25, [1.0, 4.0])
    write_netcdf(tmp_path / "a.nc", xr.Dataset({"a": ("x", [1.0], {"units": "m"})}, attrs={"b": 1}))
    found = inspect_contents(read_contents(tmp_path / "a.nc"))
    assert found["variables"]["a"] == {"shape": {"x": 1}, "units": "m"}
    for name in ("a.csv", "a.exr", "a.nc"):
        assert _run(["inspect", str(tmp_path / name)]) == 0


def test_report_of_a_camera(tmp_path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5), uncertainty=Uncertainty.of({"optics.sigma_px": 0.015})).save(
        tmp_path / "c.json"
    )
    report = inspect(tmp_path / "c.json")
    assert report["parameters"] == {"optics.sigma_px": 0.5, "pixel.half_width_px": 0.5}
    assert report["std"] == {"optics.sigma_px": pytest.approx(0.015)}
    f = report["mtf50_cycles_per_px"]
    assert np.exp(-2 * (np.pi * 0.5 * f) ** 2) * np.sinc(f) == pytest.approx(0.5, abs=1e-3)


def test_report_of_a_camera_whose_lens_has_colours(tmp_path, capsys):
    """Of a Gaussian lens and a box MTF50 is known; of an aberrated one it is that at the centre of the picture."""
    lens = ColourOptics(GaussianOptics(0.4), GaussianOptics(0.5), SeidelOptics(8.0, 550e-9, 5e-6, unit=400.0, coma=0.2))
    Camera(lens, BoxPixel(0.5)).save(tmp_path / "c.json")
    mtf50 = inspect(tmp_path / "c.json")["mtf50_cycles_per_px"]
    assert list(mtf50) == ["red", "green", "blue, centre"]
    for sigma, colour in ((0.4, "red"), (0.5, "green")):
        f = mtf50[colour]
        assert np.exp(-2 * (np.pi * sigma * f) ** 2) * np.sinc(f) == pytest.approx(0.5, abs=1e-3)
    cutoff = 5e-6 / (550e-9 * 8.0)
    s = mtf50["blue, centre"] / cutoff
    airy = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))
    assert airy * np.sinc(mtf50["blue, centre"]) == pytest.approx(0.5, abs=2e-3)
    assert _run(["inspect", str(tmp_path / "c.json")]) == 0
    assert f"green: {mtf50['green']:.4f} cycles/px" in capsys.readouterr().out


@pytest.mark.parametrize("rule", [pytest.param("nearest", marks=pytest.mark.slow), "bilinear"])
def test_how_cells_were_read_from_pixels(rule, tmp_path, capsys):
    """A table in which every cell is the mean of two places in one picture that is smooth, by the rule."""
    from matcam.core.grid import GRID_SHAPE, merl_grid
    from tests.oracle.real_pixels import angles_of, behind

    grid, values = merl_grid("centre"), np.full((*GRID_SHAPE, 3), np.nan)
    theta_h, phi_d = (a.ravel() for a in np.meshgrid(grid.theta_h[:16], grid.phi_d, indexing="ij"))
    for j in range(3, 84, 6):
        found = behind(rule, (0.25, -0.125), theta_h, grid.theta_d[j], phi_d, 200.0)
        light = 1 / (1 + (angles_of(found.position, grid.theta_d[j], 200.0)[0] / 0.01) ** 2) ** 2
        values[:16, j] = (found.share * light).sum(1).reshape(16, 180, 1)
    cells = inspect_table(brdf_table(values, "centre"), radius=200.0)["cells"]
    assert cells["rule"] == rule
    np.testing.assert_allclose(cells["phase_px"], [0.25, -0.125], atol=2e-3)
    assert (cells["repeated_share"] > 0.3) == (rule == "nearest")
    if rule == "nearest":
        assert 20 < cells["distinct_values"] < 2000
        write_netcdf(tmp_path / "a.nc", brdf_table(values, "centre").to_dataset())
        assert _run(["inspect", str(tmp_path / "a.nc"), "--radius", "200"]) == 0
        assert "cells: read from the nearest pixel" in capsys.readouterr().out
        assert _run(["inspect", str(tmp_path / "a.nc")]) == 0
        assert "try another --radius" in capsys.readouterr().out


def test_a_corrected_table_is_named_and_not_corrected_again(tmp_path, blurred, monkeypatch):
    """A MERL file has no attributes: those of the NetCDF file beside it count, if it holds the same values."""
    monkeypatch.chdir(tmp_path)
    made = {"units": "1/sr", "long_name": "BRDF corrected for the camera", "corrected_for_camera": 1}
    brdf = blurred.assign_attrs(made)
    supported = np.isfinite(brdf)
    write_netcdf("chrome.nc", xr.Dataset({"brdf": brdf, "brdf_std": brdf * 0.01, "supported": supported}))
    write_merl("chrome.binary", blurred)
    write_merl("other.binary", blurred * 0.5)
    Path("other.nc").write_bytes(Path("chrome.nc").read_bytes())
    for name in ("chrome.nc", "chrome.binary"):
        report = inspect(name)
        assert report["holds"] == "a BRDF corrected for the camera"
        assert report["albedo"]
        with pytest.raises(
            ArgumentError,
            match=f"{name}: the table is already a BRDF corrected for the camera: give the table as it was",
        ):
            write_corrected(Job(Path(name), Path("out.binary"), Recipe(rigs.merl(), Options())))
    assert inspect("other.binary")["holds"] == "a table on the MERL grid"
    assert _next("chrome.binary") == "matcam convert chrome.binary chrome.bsdf"
    assert _next("chrome.nc") is None
    assert _next("other.binary") == "matcam correct other.binary"
    assert _run(["inspect", "chrome.nc"]) == 0


def _next(name):
    return after("inspect", {"file": Path(name), "report": inspect(name)})


def test_a_table_of_a_cylinder_is_corrected_as_one(blurred, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_netcdf("strip.nc", blurred.assign_attrs(sample="cylinder").to_dataset(name="brdf"))
    report = inspect("strip.nc")
    assert (report["sample"], report["cells"]["rule"]) == ("cylinder", None)
    assert _next("strip.nc") == "matcam correct strip.nc --sample cylinder"
