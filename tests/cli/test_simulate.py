"""`matcam simulate` as a user runs it."""

import json
import os
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from matcam import read_merl
from matcam.exchange.contents import read_table
from matcam.io import read_exr, read_float_tiff, read_sidecar, sidecar_path


@pytest.fixture
def simulate(matcam):
    """simulate(*arguments) runs the command in an empty folder."""
    return partial(matcam, "simulate")


OPTIONS = ("--roughness", 0.05, "--radius", 40, "--lamp-angle", 60, "--lamp", 0.25, "--size", 31, 33)


@pytest.mark.slow
def test_a_picture_with_all_that_is_needed_to_invert_it(simulate, tmp_path):
    done = simulate(*OPTIONS, "-o", "a.exr", "--preview", "a.png", "--json")
    assert json.loads(done.stdout)["what"] == "image of 33 x 31 px"
    picture, about = read_exr(tmp_path / "a.exr"), read_sidecar(sidecar_path(tmp_path / "a.exr"))
    assert picture.shape == (31, 33, 3)
    assert picture.dtype == np.float32
    assert picture.max() > 0
    assert about["sample"] == {"kind": "sphere", "radius_px": 40.0, "distance_radii": None}
    assert about["lamp"]["angles_rad"] == pytest.approx([np.pi / 3])
    assert about["lamp"]["radius_rad"] == pytest.approx(np.radians(0.25))
    assert (about["lamp"]["azimuths_rad"], about["lamp"]["distance_radii"]) == ([0.0], None)
    assert (about["picture"]["axis_column_px"], about["picture"]["axis_row_px"]) == (16.0, 15.0)
    assert about["material"]["roughness"] == 0.05
    assert (tmp_path / "a.png").stat().st_size > 5000
    # the lamp stands to the right: so does the highlight
    assert picture[15, :, 1].argmax() > 16
    assert "--force" in simulate(*OPTIONS, "-o", "a.exr", code=2).stderr


@pytest.mark.slow
def test_a_tiff_holds_the_same_picture(simulate, tmp_path):
    for name in ("a.exr", "b.tif"):
        simulate(*OPTIONS, "-o", name)
    np.testing.assert_array_equal(read_float_tiff(tmp_path / "b.tif"), read_exr(tmp_path / "a.exr"))


@pytest.mark.slow
def test_a_table_in_the_format_of_merl(simulate, tmp_path):
    simulate("--ndf", "beckmann", "--roughness", 0.3, "--diffuse", 0.1, "-o", "a.binary")
    table = read_merl(tmp_path / "a.binary")
    assert 0.2 < float(table.isnull().mean()) < 0.3
    assert float(table.min()) > 0


@pytest.mark.slow
def test_a_flat_samples_table_is_the_materials_own(simulate, tmp_path):
    """As NetCDF, which is read back as a material."""
    simulate("--sample", "flat", "--roughness", 0.2, "-o", "a.nc")
    simulate("--sample", "flat", "--roughness", 0.2, "-o", "a.binary")
    np.testing.assert_allclose(read_table(tmp_path / "a.nc"), read_merl(tmp_path / "a.binary"), rtol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "a.png"), "must end in one of"),
        (("-o", "a.exr", "--roughness", -1), "alpha must lie in"),
        (("-o", "a.exr", "--radius", 0), "--radius must lie in"),
        (("-o", "a.exr", "--radius", 0.3), "radius must exceed the camera's blur"),
        (("-o", "a.exr", "--distance", 0.5), "--distance must lie in"),
        (("-o", "a.exr", "--lamp-angle", 200), "behind the sample"),
        (("-o", "a.exr", "--azimuth", 400), "--azimuth must lie in [-360, 360] degrees, got 400"),
        (("-o", "a.exr", "--lamp-distance", 0.5), "--lamp-distance must lie in (1, inf) radii"),
        (("-o", "a.exr", "--lamp-distance", 20, "--sample-mm", 25), "--lamp-distance must lie in (1, inf) radii"),
        (("-o", "a.exr", "--sample-mm", 25), "--sample-mm sets the unit of --lamp-distance"),
        (("-o", "a.exr", "--metal", "Unobtainium"), "Unobtainium"),
        (("-o", "a.exr", "--exposure", 100), "camera with a sensor"),
        (("--capture", "shots", "--seed", -1), "--seed must be a whole number >= 0, got -1"),
        (("--capture", "shots", "--lamp-positions", 0), "--lamp-positions must be a whole number >= 1, got 0"),
        (("-o", "a.exr", "--size", 0, 5), "--size must be (height, width)"),
        (("-o", "a.binary", "--sample", "cylinder", "--azimuth", 20), "omit the azimuth of the lamp"),
        (("-o", "a.binary", "--preview", "a.png"), "--preview shows an image"),
        (("-o", "a.exr", "--sample", "flat"), "a flat sample has only one normal"),
        (("-o", "a.binary", "--crop", 0, 5), "--crop must be (height, width)"),
        (("absent.binary", "-o", "a.exr"), "absent.binary"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(simulate, tmp_path, arguments, message):
    done = simulate(*arguments, code=2)
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_eight_commands_on_one_empty_cache(tmp_path):
    """Each finds what another is just writing: no warning, no damaged file, the same picture."""
    names = [f"{number}.exr" for number in range(8)]
    options = ["--size", "60", "60", "--radius", "20"]
    runs = [
        subprocess.Popen(
            [sys.executable, "-m", "matcam", "simulate", *options, "-o", name], cwd=tmp_path, text=True,
            env={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        for name in names
    ]  # fmt: skip
    for name, run in zip(names, runs, strict=True):
        said = run.communicate()[1]
        assert run.returncode == 0, said
        assert "cache" not in said
        assert "damaged" not in said
        assert (tmp_path / name).read_bytes() == (tmp_path / names[0]).read_bytes()
    files = [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    assert files
    assert not [path for path in files if path.name.startswith(".") and path.suffix != ".lock"]
