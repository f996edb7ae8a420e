"""One reader and one writer for all formats: what goes out comes back, and what cannot go is refused."""

import numpy as np
import pytest
import xarray as xr

from matcam import Camera, GaussianOptics
from matcam.cli.app import app
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.grid import CORRECTED, brdf_table
from matcam.exchange.contents import read, read_contents, read_recorded_table, read_table, write
from matcam.files.formats import CONTENTS, FORMATS, MEASUREMENTS, format_for, format_named, identify, suffixes_for
from matcam.io import read_samples, write_sidecar
from matcam.targets import design_chart


def table():
    return brdf_table(np.random.default_rng(1).random((90, 90, 180, 3)) + 0.5, "edge")


@pytest.fixture
def samples(tmp_path):
    (tmp_path / "s.csv").write_text("theta_h_rad,theta_d_rad,phi_d_rad,R_per_sr\n0.1,0.2,0.3,1\n0.2,0.2,0.3,2\n")
    return read_samples(tmp_path / "s.csv")


@pytest.mark.parametrize("suffix", suffixes_for("table"))
def test_a_table_comes_back_from_every_format_that_can_hold_it(tmp_path, suffix):
    before = table()
    if suffix == ".csv":  # a row of text for each cell: some slices say as much as all
        before[:, np.arange(90) % 15 != 0] = np.nan
    write(tmp_path / f"a{suffix}", before)
    after = read(tmp_path / f"a{suffix}", sampling="edge")
    np.testing.assert_allclose(after.values, before.values, rtol=1e-15)  # MERL's scale rounds
    assert after.attrs["sampling"] == "edge"


@pytest.mark.parametrize("suffix", [s for s in suffixes_for("samples") if s == ".csv"])
def test_samples(tmp_path, samples, suffix):
    write(tmp_path / f"a{suffix}", samples)
    xr.testing.assert_equal(read(tmp_path / f"a{suffix}"), samples)


@pytest.mark.parametrize("suffix", [".nc", ".zarr.zip"])
def test_a_result(tmp_path, suffix):
    result = xr.Dataset({"raw": ("theta_d", np.arange(3.0))}, coords={"theta_d": [0.1, 0.2, 0.3]})
    write(tmp_path / f"a{suffix}", result)
    xr.testing.assert_identical(read(tmp_path / f"a{suffix}"), result)
    write(tmp_path / f"b{suffix}", result["raw"])
    assert "raw" in read(tmp_path / f"b{suffix}")


@pytest.mark.parametrize("suffix", suffixes_for("picture"))
def test_a_picture(tmp_path, suffix):
    picture = np.random.default_rng(1).random((4, 5, 3)).astype(np.float32)
    write(tmp_path / f"a{suffix}", picture)
    np.testing.assert_array_equal(read(tmp_path / f"a{suffix}"), picture)


def test_a_camera_a_chart_and_a_sidecar(tmp_path):
    camera = Camera(GaussianOptics(0.5))
    write(tmp_path / "camera.json", camera)
    assert repr(read(tmp_path / "camera.json")) == repr(camera)
    chart = design_chart(["squares"])
    write(tmp_path / "chart.json", chart)
    assert read(tmp_path / "chart.json") == chart
    picture = {"file": "a.exr", "shape": [2, 2], "quantity": "radiance", "axis_column_px": 0.5, "axis_row_px": 0.5}
    sample, lamp = (
        {"kind": "sphere", "radius_px": 9.0, "distance_radii": None},
        {"angles_rad": [0.5], "radius_rad": 0.0},
    )
    blur = {"jitter_px": 0.0, "aperture": 0.0, "focus_rad": 0.0}
    parts = {"picture": picture, "camera": camera.profile(), "sample": sample, "lamp": lamp, "blur": blur}
    write_sidecar(tmp_path / "a.exr.json", exposure=None, material={}, **parts)
    assert read(tmp_path / "a.exr.json")["picture"]["file"] == "a.exr"
    for name in ("camera.json", "chart.json", "a.exr.json"):
        with pytest.raises(FileFormatError, match="which contains no measurement"):
            read_contents(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "thing", "words"),
    [
        (
            "a.exr",
            table(),
            "a table on the MERL grid is not an image and cannot be stored in .exr: use .binary, .csv, .nc, .zarr.zip",
        ),
        ("a.bsdf", table(), "cannot be stored in .bsdf: use .binary, .csv, .nc, .zarr.zip"),
        ("a.nc", np.ones((2, 2, 3)), "an image cannot be stored in .nc: use .exr, .tif, .tiff"),
        ("a.obj", np.ones((2, 2, 3)), "the name must end in one of .binary, .bsdf, .csv"),
        ("a.nc", Camera(GaussianOptics(0.5)), "a Camera cannot be stored in .nc: use .json"),
        ("a.json", table(), "the name must end in one of .binary"),
        ("a.nc", {"raw": 1}, "thing must be an xarray.DataArray or Dataset, .* got dict"),
    ],
)
def test_what_cannot_go_is_refused(tmp_path, name, thing, words):
    with pytest.raises(ArgumentError, match=words):
        write(tmp_path / name, thing)
    assert not any(tmp_path.iterdir())


def test_nothing_is_replaced_unless_asked(tmp_path):
    picture = np.ones((2, 2, 3), np.float32)
    (tmp_path / "a.exr").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        write(tmp_path / "a.exr", picture)
    write(tmp_path / "a.exr", picture, force=True)
    assert read(tmp_path / "a.exr").shape == (2, 2, 3)


def test_the_table_of_formats_is_whole():
    """Each format can be read by someone, holds something known, and writes nothing that it cannot hold."""
    assert len({form.name for form in FORMATS}) == len(FORMATS)
    for form in FORMATS:
        assert set(form.holds) <= set(CONTENTS)
        assert set(form.writers) <= set(form.holds)
        assert form.mark or form.written in ((), form.holds)
        for content in form.writers:
            assert callable(form.writer(content))
        assert format_named(form.name) is form
    assert set().union(*(form.holds for form in FORMATS)) == set(CONTENTS)
    assert set(MEASUREMENTS) < set(CONTENTS)
    assert format_for("A.ZARR.ZIP").name == "zarr"


def test_json_of_no_format_of_ours_is_read_as_a_camera_profile_and_refused(tmp_path):
    (tmp_path / "a.json").write_text('{"format": "matcam lens"}')
    assert identify(tmp_path / "a.json") == "camera profile"
    with pytest.raises(FileFormatError, match="not a camera profile"):
        read(tmp_path / "a.json")


@pytest.mark.parametrize("suffix", [".binary", ".nc"])
def test_a_table_is_read_by_any_name(tmp_path, suffix):
    """Also with a coordinate beside it, as `measure` writes it, and among a correction's other results."""
    path, plain = tmp_path / f"a{suffix}", table()
    write(path, plain)
    np.testing.assert_allclose(read_table(path, "edge").values, plain.values, rtol=1e-15)
    if suffix == ".nc":
        dims = ("theta_h", "theta_d", "phi_d")
        measured = plain.assign_coords(pixels=(dims, np.ones(plain.shape[:3])))
        results = xr.Dataset({"brdf": measured, "brdf_std": measured * 0.01, "noise_std": 0.1})
        write(tmp_path / "b.nc", results)
        again = read_table(tmp_path / "b.nc")
        np.testing.assert_array_equal(again.values, plain.values)
        assert again.attrs["sampling"] == "edge"


def test_what_holds_no_table_is_refused(tmp_path):
    write(tmp_path / "a.nc", xr.Dataset({"raw": ("theta_d", np.arange(3.0))}))
    with pytest.raises(FileFormatError, match=r"a\.nc: the file contains .*, not a BRDF table on the MERL grid"):
        read_table(tmp_path / "a.nc")


def test_a_corrected_table_is_not_taken_as_recorded(tmp_path):
    """`fit`, `fresnel` and `correct` would apply the camera a second time."""
    write(tmp_path / "recorded.nc", table())
    assert read_recorded_table(tmp_path / "recorded.nc").shape == (90, 90, 180, 3)
    write(tmp_path / "corrected.nc", table().assign_attrs({CORRECTED: 1, "long_name": "corrected BRDF"}))
    for command in (["fit"], ["fresnel"], ["correct"], ["figures"]):
        with pytest.raises(
            ArgumentError, match=r"corrected\.nc: the table is already a corrected BRDF: give the table as"
        ):
            app([*command, str(tmp_path / "corrected.nc")], standalone_mode=False)
