"""Any format to any other that can hold the data; what is resampled says by how much it errs."""

import json
import re

import numpy as np
import pytest
import xarray as xr

from matcam import GGX, Conductor, Flat, GaussianNDF, Microfacet, Rig, convert, measure, read_merl, rigs, write_merl
from matcam.cli import _run
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.jax import jnp
from matcam.exchange import adaptive_grid, conversion
from matcam.exchange.contents import Contents
from matcam.exchange.conversion import resampling_error
from matcam.io import (
    read_exr,
    read_float_tiff,
    read_rgl,
    read_sidecar,
    write_exr,
    write_float_tiff,
    write_netcdf,
    write_rgl,
    write_sidecar,
)
from matcam.material import Adaptive, Tabulated
from matcam.material.material import Material


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One file of every kind that has something to lose."""
    folder = tmp_path_factory.mktemp("exchange")
    material = Microfacet(GGX(0.2), Conductor([3.3, 2.9, 2.26], [4.32, 4.23, 3.94]), 0.1)
    write_merl(folder / "a.binary", measure(material, Rig(rigs.merl().camera, Flat())))
    write_rgl(folder / "a.bsdf", adaptive_grid(material, square=64))
    picture = np.random.default_rng(1).random((8, 9, 3)).astype(np.float32)
    write_exr(folder / "a.exr", picture)
    write_float_tiff(folder / "a.tif", picture)
    about = rigs.merl().description()
    described = {"file": "a.exr", "shape": [8, 9, 3], "quantity": "radiance", "axis_column_px": 4.0, "axis_row_px": 3.5}
    lamp = {"angles_rad": [0.5], "radius_rad": 0.0}
    parts = {"camera": about["camera"], "sample": about["sample"], "blur": about["blur"], "lamp": lamp}
    write_sidecar(folder / "a.exr.json", picture=described, exposure=None, material={}, **parts)
    result = xr.Dataset({"raw": ("theta_d", np.arange(3.0), {"units": "1/sr"})}, coords={"theta_d": [0.1, 0.2, 0.3]})
    write_netcdf(folder / "a.nc", result)
    return folder


@pytest.mark.parametrize("path", [(".nc", ".binary"), (".zarr.zip", ".nc", ".binary")])
def test_a_table_keeps_every_value(folder, tmp_path, path):
    source = folder / "a.binary"
    for suffix in path:
        report = convert(source, tmp_path / f"b{suffix}")
        assert report["resampled"] is None
        source = tmp_path / f"b{suffix}"
    assert source.read_bytes() == (folder / "a.binary").read_bytes()


def test_rgl_fields_keep_every_value(folder, tmp_path):
    for name, new in (("a.bsdf", "b.nc"), ("b.nc", "c.zarr.zip"), ("c.zarr.zip", "d.bsdf")):
        assert convert((folder if name == "a.bsdf" else tmp_path) / name, tmp_path / new)["resampled"] is None
    before, after = read_rgl(folder / "a.bsdf"), read_rgl(tmp_path / "d.bsdf")
    for name in before.variables:
        assert after[name].values.tobytes() == before[name].values.tobytes()


def test_a_table_through_text(folder, tmp_path):
    """A slice of it: the whole is 130 MB of text."""
    table = read_merl(folder / "a.binary")
    few = xr.where(table["theta_d"] < 0.05, table, np.nan).transpose(*table.dims).assign_attrs(table.attrs)
    write_merl(tmp_path / "a.binary", few)
    convert(tmp_path / "a.binary", tmp_path / "b.csv")
    convert(tmp_path / "b.csv", tmp_path / "c.binary")
    np.testing.assert_array_equal(read_merl(tmp_path / "c.binary").values, read_merl(tmp_path / "a.binary").values)


def test_negative_values_that_are_set_to_zero_are_counted(monkeypatch, tmp_path, folder):
    """Tables of RGL are negative where data are missing."""
    table = read_merl(folder / "a.binary")
    negative = table.copy(data=np.where(np.isfinite(table) & (np.arange(180)[:, None] < 18), -1.0, table.values))
    monkeypatch.setattr(conversion, "material_of", lambda contents: Tabulated(negative))
    contents, details = conversion._as_table(Contents("fields", None, None), "centre")
    share = float((negative.values < 0).mean())
    assert 0.02 < share < 0.1
    assert details["resampled"].endswith(f"negative values set to zero: {share:.2%}")
    assert float(contents.data.min()) == 0


@pytest.mark.slow
def test_to_rgl_and_back_the_error_is_told(folder, tmp_path):
    report = convert(folder / "a.binary", tmp_path / "b.bsdf", square=64)
    assert "64 x 64" in report["resampled"]
    assert report["missing_share"] < 0.01
    assert 0 < report["error"]["median"] < report["error"]["p99"] < 0.05
    back = convert(tmp_path / "b.bsdf", tmp_path / "c.binary")
    assert "MERL grid" in back["resampled"]
    assert back["error"]["median"] < 0.01
    first, last = (read_merl(p).values for p in (folder / "a.binary", tmp_path / "c.binary"))
    relative = np.abs(last / first - 1)[np.isfinite(first)]
    assert np.median(relative) < 0.01


@pytest.mark.slow
def test_an_rgl_file_on_the_merl_grid_is_the_mean_of_both_ways(real_data, goniophotometer):
    """Measured files are not reciprocal; a cell stands for both."""
    table = read_merl(goniophotometer("satin_rosaline"))
    material = Adaptive(read_rgl(real_data / "rgl" / "satin_rosaline_rgb.bsdf"))
    assert float(table.isnull().mean()) == pytest.approx(0.248, abs=1e-3)  # what lies below the horizon
    cell = table.isel(theta_h=20, theta_d=30, phi_d=40)
    angles = [float(cell[name]) for name in ("theta_h", "theta_d", "phi_d")]
    directions = [np.asarray(material.brdf(*angles[:2], angles[2] + turn)) for turn in (0, np.pi)]
    assert not np.allclose(*directions, rtol=0.01)
    np.testing.assert_allclose(cell.values, np.mean(directions, axis=0), rtol=1e-12)


def test_pictures_and_their_sidecars(folder, tmp_path):
    report = convert(folder / "a.exr", tmp_path / "b.tiff")
    np.testing.assert_array_equal(read_float_tiff(tmp_path / "b.tiff"), read_exr(folder / "a.exr"))
    assert report["sidecar"] == str(tmp_path / "b.tiff.json")
    assert read_sidecar(report["sidecar"])["picture"]["file"] == "b.tiff"
    assert "sidecar" not in convert(folder / "a.tif", tmp_path / "c.exr")


def test_other_results_go_where_they_can(folder, tmp_path):
    convert(folder / "a.nc", tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text().splitlines()[0] == "theta_d,raw_1_per_sr"
    convert(folder / "a.nc", tmp_path / "b.zarr.zip")
    for name, new, words in (
        ("a.nc", "c.binary", "cannot be stored in .binary"),
        ("a.binary", "c.exr", "is not an image"),
        ("a.exr", "c.nc", "an image cannot be stored in"),
        ("a.binary", "c.obj", "the name must end in"),
    ):
        with pytest.raises(ArgumentError, match=words):
            convert(folder / name, tmp_path / new)
        assert not (tmp_path / new).exists()
    table = read_merl(folder / "a.binary")
    write_netcdf(tmp_path / "corrected.nc", xr.Dataset({"brdf": table, "brdf_std": table}))
    assert convert(tmp_path / "corrected.nc", tmp_path / "c.binary")["omitted"] == ["brdf_std"]
    np.testing.assert_array_equal(read_merl(tmp_path / "c.binary").values, table.values)
    write_netcdf(tmp_path / "noisy.nc", (table - 1.0).to_dataset(name="brdf"))
    with pytest.raises(ArgumentError, match=r"write a table with noise about 0 to a \.nc file"):
        convert(tmp_path / "noisy.nc", tmp_path / "n.binary")
    convert(tmp_path / "corrected.nc", tmp_path / "c.csv")
    with pytest.raises(FileFormatError, match=r"for a result of matcam, give the \.nc file"):
        convert(tmp_path / "c.csv", tmp_path / "n.nc")
    (tmp_path / "s.csv").write_text("theta_h_rad,theta_d_rad,phi_d_rad,R_per_sr\n0.1,0.2,0.3,1\n")
    with pytest.raises(ArgumentError, match="scattered samples cannot be stored"):
        convert(tmp_path / "s.csv", tmp_path / "s.bsdf")
    assert convert(tmp_path / "s.csv", tmp_path / "s.nc")["holds"] == "scattered samples"


def test_nothing_is_destroyed(folder, tmp_path):
    (tmp_path / "b.nc").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        convert(folder / "a.binary", tmp_path / "b.nc")
    with pytest.raises(OutputError, match="the input itself"):
        convert(folder / "a.binary", folder / "a.binary", force=True)
    with pytest.raises(FileFormatError, match="contains no measurement"):
        convert(folder / "a.exr.json", tmp_path / "c.nc")


def test_the_command(folder, tmp_path, capsys):
    out, about = tmp_path / "b.nc", tmp_path / "b.json"
    words = [str(folder / "a.bsdf"), str(out), "--metadata", str(about), "--lamp", "0.5", "--json"]
    assert _run(["convert", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["holds"] == "a BRDF in RGL's parameterisation"
    written = json.loads(about.read_text())
    assert written["receiver"]["solid_angle_sr"] == found["receiver_sr"]
    assert written["source"]["half_angle_rad"] == pytest.approx(np.radians(0.5))
    assert _run(["convert", *words]) == 2
    assert "exists: use --force" in capsys.readouterr().err
    assert _run(["convert", str(folder / "a.exr"), str(tmp_path / "c.tif")]) == 0
    assert "all values are unchanged" in capsys.readouterr().out


def test_the_error_of_a_conversion_counts_channels_above_zero():
    """A measured channel may be negative where nothing was measured: what its relative error would be means nothing."""

    class Red(Material):
        first: float

        def reflected(self, shading):
            one = jnp.ones_like(shading.cos_i)
            return jnp.stack([one * self.first, -0.01 * one, 0 * one], axis=-1)

        @property
        def finest(self):
            return jnp.asarray(0.1)

    found = resampling_error(Red(1.0), Red(1.1))
    assert found == pytest.approx({"median": 0.1, "p99": 0.1, "largest": 0.1, "known": 1.0, "peak": 0.1})
    assert resampling_error(Red(-1.0), Red(1.0))["known"] == 0


def test_the_error_of_a_conversion_has_a_floor():
    """A narrow Gaussian lobe falls to 1e-300: relative to such values the difference had 99 digits. Where a value is below
    1e-6 of the peak, the difference is relative to that: it cannot be larger than the ratio of the two lobes there."""
    sharp, wider = (Microfacet(GaussianNDF(width), 0.6, masking=None) for width in (0.02, 0.021))
    found = resampling_error(sharp, wider)
    assert found["median"] < 1e-6
    assert 0.1 < found["largest"] < 6
    assert found["peak"] == pytest.approx(1 - (0.02 / 0.021) ** 2, rel=1e-3)
    offset = resampling_error(Microfacet(GaussianNDF(0.002), 0.6, 0.1), Microfacet(GaussianNDF(0.002), 0.6, 0.11))
    assert offset["median"] == pytest.approx(0.1)


@pytest.mark.slow
def test_no_absurd_number_is_printed(tmp_path, capsys):
    flat = Rig(rigs.merl().camera, Flat())
    write_merl(tmp_path / "a.binary", measure(Microfacet(GaussianNDF(0.002), 0.6, masking=None), flat))
    assert _run(["convert", str(tmp_path / "a.binary"), str(tmp_path / "a.bsdf"), "--square", "16"]) == 0
    printed = capsys.readouterr().out
    assert "a millionth of the peak" in printed
    assert re.findall(r"\d{6,}", printed.replace(str(tmp_path), "")) == []
