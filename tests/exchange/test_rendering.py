"""Rendered spheres: how bright a known one is, pixel by pixel; the command."""

import json
import re

import numpy as np
import pytest

from matcam import GGX, Microfacet
from matcam.cli import _run
from matcam.core.errors import ArgumentError
from matcam.exchange import adaptive_grid, rendered_sphere
from matcam.forward import true_table
from matcam.io import read_exr, write_exr, write_netcdf, write_rgl

WHITE = Microfacet(GGX(0.3), 0.0, 1.0)


def test_a_white_diffuse_sphere_is_lamberts(tmp_path):
    """Radiance max(0, n . l) + sky, the sphere lit from the right and above."""
    picture = rendered_sphere(WHITE, lamp_angle=0.7, size=32, samples=256)
    x, y = np.meshgrid((np.arange(32) - 15.5) / 16, (15.5 - np.arange(32)) / 16)
    inside = np.hypot(x, y) < 0.75
    light = np.array([np.sin(0.7), np.sin(0.7) / 3, np.cos(0.7)])
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    expected = np.maximum((x * light[0] + y * light[1] + z * light[2]) / np.linalg.norm(light), 0) + 0.2
    np.testing.assert_allclose(picture[inside], expected[inside][:, None].repeat(3, 1), atol=0.05)
    assert np.mean(picture[inside] - expected[inside][:, None]) == pytest.approx(0, abs=0.005)
    assert picture.dtype == np.float32
    assert np.all(picture[0, 0] == 0)


@pytest.fixture
def coloured(tmp_path):
    write_rgl(tmp_path / "a.bsdf", adaptive_grid(Microfacet(GGX(0.1), [0.9, 0.6, 0.2], 0.05), square=32))
    write_exr(tmp_path / "sky.exr", np.full((8, 16, 3), 0.5))
    return str(tmp_path / "a.bsdf")


SMALL = ["--size", "16", "--samples", "4"]


@pytest.mark.slow
def test_two_spheres_under_an_environment(coloured, tmp_path, capsys):
    words = ["-o", str(tmp_path / "two.png"), "--environment", str(tmp_path / "sky.exr"), "--json", *SMALL]
    assert _run(["render", coloured, coloured, *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["mean_radiance"]) == ["a.bsdf", "a.bsdf (2)"]
    assert (tmp_path / "two.png").read_bytes().startswith(b"\x89PNG")


def test_negative_noise_is_named(tmp_path, capsys):
    table = true_table(Microfacet(GGX(0.3), 0.9))
    noise = np.random.default_rng(0).normal(0, 1e-3, table.shape)
    write_netcdf(tmp_path / "noisy.nc", (0 * table + noise).to_dataset(name="brdf"))
    assert _run(["render", str(tmp_path / "noisy.nc"), "-o", str(tmp_path / "a.exr"), *SMALL]) == 0
    assert re.search(r"note: noisy\.nc: (2|3|4|5)\d% of the values are negative", capsys.readouterr().out)


def test_the_command(coloured, tmp_path, capsys):
    done = str(tmp_path / "one.exr")
    assert _run(["render", coloured, "-o", done, *SMALL]) == 0
    assert read_exr(done).shape == (16, 16, 3)
    capsys.readouterr()
    for words, said in (
        ([coloured, "-o", done], "exists"),
        ([coloured, coloured, "-o", str(tmp_path / "b.exr")], "contains the image of one sphere"),
        ([coloured, coloured, coloured], "give one file, or two files to show side by side"),
        ([coloured, "-o", str(tmp_path / "b.gif")], "must end in"),
        ([coloured, "-o", str(tmp_path / "b.png"), "--exposure", "0"], "--exposure must be above 0"),
        ([coloured, "-o", str(tmp_path / "b.png"), "--lamp-angle", "200"], "--lamp-angle must lie in"),
        ([str(tmp_path / "sky.exr"), "-o", str(tmp_path / "b.png")], "cannot be evaluated"),
    ):
        assert _run(["render", *words]) == 2
        assert said in capsys.readouterr().err


def test_numbers_out_of_range():
    for wrong in ({"size": 8}, {"samples": 0}, {"size": 20.0}):
        with pytest.raises(ArgumentError, match="must be a whole number"):
            rendered_sphere(WHITE, **wrong)
