"""The command line as users run it: by its words, and where that is the question as a process."""

import json
import os
import re
import struct
import subprocess
import sys

import numpy as np
import pytest
import tifffile
import xarray as xr

from matcam import BoxPixel, Camera, ColourOptics, DiffractionOptics, GaussianOptics, convert, write_merl
from matcam.camera import Uncertainty
from matcam.core.grid import brdf_table
from matcam.core.io import write_json
from tests.exchange.test_overviews import RECONSTRUCTION
from tests.oracle import epd_peak, merl_lobe


@pytest.fixture(scope="module")
def environment():
    """Wide lines; the cache is that of all tests, away from the user's own."""
    return {**os.environ, "COLUMNS": "100"}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A MERL file of chromium as the oracle's rig records it."""
    path = tmp_path_factory.mktemp("measured") / "chromium.binary"
    n, k = np.array([3.3, 2.9, 2.26]), np.array([4.32, 4.23, 3.94])
    write_merl(
        path, brdf_table(merl_lobe.record(0.002, merl_lobe.conductor(merl_lobe.THETA_D[:, None], n, k)), "centre")
    )
    return path


def test_help_answers_without_loading_anything_heavy(environment):
    code = (
        "import sys\nfrom matcam.cli import _run\nassert _run(['--help']) == 0\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'jax', 'xarray', 'scipy', 'matplotlib', 'pandas', 'equinox'}))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


_LIGHT = [
    ("predict", "0.01"),
    ("predict", "0.01", "--ndf", "epd", "--power", "0.5", "--lamp", "0.2"),
    ("predict", "0.01", "--camera", "c.json"),
    ("edge", "edge.tif"),
    ("inspect", "c.json"),
    ("inspect", "edge.tif"),
    ("inspect", "result.json"),
    ("inspect", "."),
    ("chart", "-o", "chart.pdf"),
    ("capture", "init", "capture"),
    ("data", "merl", "--list"),
]


@pytest.mark.parametrize("words", _LIGHT, ids=" ".join)
def test_small_commands_load_neither_jax_nor_xarray(environment, tmp_path, words):
    Camera(DiffractionOptics(8, 550e-9, 5e-6)).save(tmp_path / "c.json")
    write_json(tmp_path / "result.json", RECONSTRUCTION)
    y, x = np.mgrid[-80:80, -40:40]
    edge = 5000 + 40000 / (1 + np.exp(-2 * (x - 0.1 * y)))
    tifffile.imwrite(tmp_path / "edge.tif", np.random.default_rng(1).poisson(edge).astype(np.uint16))
    code = (
        f"import sys\nfrom matcam.cli import _run\nassert _run({list(words)}) == 0\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'jax', 'equinox', 'xarray', 'pandas', 'dask'}))"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, env=environment, check=True, cwd=tmp_path)
    assert result.stdout.splitlines()[-1] == "[]"


def test_inspect_needs_no_jax(environment, tmp_path, measured):
    """Neither for a table, nor for the command that it suggests."""
    convert(measured, tmp_path / "a.nc")
    convert(measured, tmp_path / "a.bsdf", square=8)
    files = {str(measured): "next: matcam correct", "a.nc": "next: matcam correct", "a.bsdf": "resampled"}
    code = (
        f"import sys\nfrom matcam.cli import main\nfor file in {list(files)}:\n"
        "    try:\n        main(['inspect', file])\n    except SystemExit as end:\n        assert not end.code\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'jax', 'equinox', 'dask'}))"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, env=environment, check=True, cwd=tmp_path)
    assert result.stdout.splitlines()[-1] == "[]"
    assert all(words in result.stdout for words in files.values())


@pytest.mark.parametrize(
    "command", ["predict", "fresnel", "edge", "inspect", "convert", "render", "figures", "demo", ("data", "merl")]
)
def test_every_command_has_help_with_an_example(matcam, command):
    words = command if isinstance(command, tuple) else (command,)
    text = " ".join(matcam(*words, "--help").stdout.split())
    assert f"Example: matcam {' '.join(words)}" in text


def test_version(environment):
    command = [sys.executable, "-m", "matcam", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.startswith("matcam 0.")


def test_predict(matcam, tmp_path):
    result = matcam("predict", 0.002, 0.05, "--ndf", "gaussian", "-o", "loss.png", "--json")
    found = json.loads(result.stdout)
    assert found["roughness"] == [0.002, 0.05]
    assert found["loss_angle_deg"][0] == pytest.approx(23.6, abs=0.1)
    assert (tmp_path / "loss.png").read_bytes().startswith(b"\x89PNG")
    assert "relative_response" in (tmp_path / "loss.csv").read_text().splitlines()[0]
    text = matcam("predict", 0.01, "--sample", "cylinder", "--dims", 1).stdout
    assert "0.01" in text
    assert "cylinder" in text
    found = json.loads(matcam("predict", 0.01, "--ndf", "epd", "--power", 0.5, "--json").stdout)
    assert (found["ndf"], found["power"]) == ("epd", 0.5)
    across = 256 * np.cos(np.radians([found["loss_angle_deg"][0], 0]))
    there, head_on = (epd_peak.peak(0.01, 0.5, x, 256, 0.5, 0.5) for x in across)
    assert there / head_on == pytest.approx(0.95, abs=1e-4)


@pytest.mark.slow
def test_fresnel(matcam, measured, tmp_path):
    result = matcam("fresnel", measured, "--metal", "Cr", "--ndf", "beckmann", "--slice-step", 6)
    assert "lobe: beckmann, width 0.0028" in result.stdout
    assert "camera: assumed lens blur 0.50 ± 0.50 px; measure it with matcam calibrate" in result.stdout
    assert "against Cr (rakic)" in result.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "chromium-fresnel.csv",
        "chromium-fresnel.nc",
        "chromium-fresnel.png",
    ]
    with xr.open_dataset(tmp_path / "chromium-fresnel.nc") as data:
        assert data["corrected"].dims == ("theta_d", "channel")
        assert data.attrs["ndf"] == "beckmann"
        assert data.sizes["theta_d"] == 15
        # a printed angle is that of a slice in the file, and so is the value beside it
        printed = re.findall(r"^ ([\d.]+)°.* ([\d.]+) ± [\d.]+ *$", result.stdout, re.MULTILINE)
        green = data["corrected"].sel(channel="G")
        assert len(printed) > 5
        for angle, value in printed:
            there = green.sel(theta_d=np.radians(float(angle)), method="nearest", tolerance=1e-6)
            assert f"{float(there):.3f}" == value
    header = (tmp_path / "chromium-fresnel.csv").read_text().splitlines()[0]
    assert header.startswith("theta_d_rad,channel,raw,")


def test_json_is_alone_on_standard_output_and_profiles_are_used(matcam, measured, tmp_path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5), uncertainty=Uncertainty.of({"optics.sigma_px": 0.015})).save(
        tmp_path / "c.json"
    )
    result = matcam(
        "fresnel", measured, "--camera", "c.json", "--masking", "none", "--ndf", "gaussian", "--slice-step", 6, "--json",
        "-o", "out/f.svg", "--budget", "out/b.json",
    )  # fmt: skip
    found = json.loads(result.stdout)
    assert found["files"][-1] == "out/b.json"
    budgets = {one["result"]: one for one in json.loads((tmp_path / "out" / "b.json").read_text())["budgets"]}
    at = int(np.argmin(np.abs(np.array(found["theta_d_deg"]) - 75)))
    stated = found["corrected_std"]["G"][at]
    budget = budgets[f"F({found['theta_d_deg'][at]:.1f} deg), G"]
    assert budget["combined_standard_uncertainty"] == pytest.approx(stated, rel=1e-6)
    with xr.open_dataset(tmp_path / "out" / "f.nc") as data:
        assert "optics.sigma_px" in data["source"].values
        assert data["budget_std"].dims == ("source", "theta_d", "channel")
    assert found["camera_uncertainty"] == "lens blur 0.500 ± 0.015 px"
    # the record is the tangent plane's, the fit the sphere's: close to the limb, that looks like a lens with a stretch
    assert found["width"] == pytest.approx(0.002, rel=1.5e-2)
    assert set(found["corrected"]) == {"R", "G", "B"}
    assert len(found["corrected"]["G"]) == len(found["theta_d_deg"]) == 15
    assert found["corrected_std"]["G"][12] > 0
    assert (tmp_path / "out" / "f.svg").exists()


def test_inspect(matcam, measured, tmp_path):
    found = json.loads(matcam("inspect", measured, "--json").stdout)
    assert found["format"] == "merl"
    assert found["missing_share"] == pytest.approx(0.248, abs=1e-3)
    assert "MERL table, 90 theta_h x 90 theta_d x 180 phi_d" in matcam("inspect", measured).stdout
    Camera(GaussianOptics(0.5), uncertainty=Uncertainty.of({"optics.sigma_px": 0.015})).save(tmp_path / "c.json")
    text = matcam("inspect", "c.json").stdout
    assert "± 0.015" in text
    assert "MTF50" in text
    xr.Dataset({"map": (("y", "x"), np.ones((3, 4)), {"units": "1"})}).to_netcdf(tmp_path / "maps.nc")
    text = matcam("inspect", "maps.nc").stdout
    assert re.search(r"map +3 y x 4 x +1", text)
    assert "{" not in text


@pytest.mark.parametrize("command", ["limits", "predict"])
def test_a_camera_of_several_lenses_is_refused_in_words_of_the_command_line(matcam, tmp_path, command):
    lenses = (GaussianOptics(0.5), GaussianOptics(0.4), GaussianOptics(0.6))
    Camera(ColourOptics(*lenses)).save(tmp_path / "c.json")
    said = matcam(command, "0.01", "--camera", "c.json", code=2).stderr
    assert "(--camera)" in said
    assert "GaussianOptics" not in said
    assert "Camera(" not in said


def test_a_metal_of_figures_is_checked_first(matcam, tmp_path):
    assert "did you mean 'Cr'?" in matcam("figures", "--metal", "Crr", code=2).stderr
    assert not (tmp_path / "figures").exists()


@pytest.mark.slow
def test_figures(matcam, measured, tmp_path):
    files = json.loads(matcam("figures", measured, "-o", "figs", "--vector", "svg", "--json").stdout)["files"]
    names = {p.name for p in (tmp_path / "figs").iterdir()}
    assert sorted(files) == sorted(f"figs/{name}" for name in names)
    stems = ("figure-3", "figure-4", "figure-5", "figure-6-chromium")
    assert names == {f"{stem}.{suffix}" for stem in stems for suffix in ("png", "svg", "csv")}


@pytest.mark.slow
def test_demo(matcam, tmp_path):
    done = matcam("demo", "-o", "d", "--json")
    assert "lobe: epd, width 0.0028" in done.stderr
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "d").iterdir()}
    assert sorted(json.loads(done.stdout)["files"]) == sorted(str(p.relative_to(tmp_path)) for p in before)
    for name in ("chromium-fresnel.png", "predicted-loss.png", "figure-5.png", "simulated-chromium.binary"):
        assert name in done.stderr
        assert (tmp_path / "d" / name).stat().st_size > 10_000
    (tmp_path / "d" / "simulated-chromium.binary").unlink()
    assert "use --force" in matcam("demo", "-o", "d", code=2).stderr
    before.pop(tmp_path / "d" / "simulated-chromium.binary")
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "d").iterdir()} == before


def test_a_demo_replaces_nothing(matcam, tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "figure-4.csv").write_text("precious")
    assert "use --force" in matcam("demo", "-o", "d", code=2).stderr
    assert [(p.name, p.read_text()) for p in (tmp_path / "d").iterdir()] == [("figure-4.csv", "precious")]


def test_data_merl_lists_and_refuses(matcam, tmp_path):
    assert len(matcam("data", "merl", "--list").stdout.split()) == 100
    assert "did you mean 'chrome'" in matcam("data", "merl", "crome", code=2).stderr
    assert "name at least one" in matcam("data", "merl", code=2).stderr
    matcam("data", "merl", "chrome", "--source", "http://127.0.0.1:9/x", code=2)
    assert os.listdir(tmp_path) == []


@pytest.fixture
def bad_files(measured, tmp_path):
    """Files and folders that must not be read or replaced; `tmp_path` is where commands run."""
    (tmp_path / "short.binary").write_bytes(struct.pack("<3i", 90, 90, 180))
    (tmp_path / "foreign.binary").write_bytes(b"GIF89a" * 10)
    (tmp_path / "camera.json").write_text('{"format": "matcam camera profile", "version": 9}')
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "old-fresnel.png").write_text("precious")
    (tmp_path / "same.binary").write_bytes(measured.read_bytes())
    return {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


# MEASURED and SAME stand for tables elsewhere
BAD = [
    ("fresnel short.binary", "truncated: 12 bytes"),
    ("fresnel foreign.binary", "not a MERL file"),
    ("fresnel none.binary", "no such file"),
    ("fresnel MEASURED --camera camera.json", "version 9 is unknown"),
    ("fresnel MEASURED --metal Chromium", "unknown metal 'Chromium'"),
    ("fresnel MEASURED -o folder.png", "is a folder"),
    ("fresnel MEASURED -o file/a.png", "is a file, not a folder"),
    ("fresnel MEASURED -o old-fresnel.png", "use --force"),
    ("fresnel MEASURED -o a.bmp", "must end in"),
    ("fresnel same.binary -o same.binary --force", "is the input itself"),
    ("fresnel MEASURED --normalise 50 20", "--normalise must be"),
    ("fresnel MEASURED --ndf phong", "'phong' is not one of"),
    ("fresnel", "Missing argument 'file'"),  # some versions of typer write it in capitals
    ("predict -1", "No such option: -1"),
    ("predict --ndf epd", "--power must be given for epd"),
    ("predict --power 1", "--power can be given for epd and sgd, but not for ggx, got 1"),
    ("predict 0.1 --ndf epd --power 9", "--power must lie in [0.25, 4]"),
    ("predict 0", "alpha must lie in (0, 1], got 0"),
    ("predict --radius -3", "--radius must lie in"),
    ("limits --radius 1e300", "--radius must lie in (0, 1e+100] px, got 1e+300"),
    ("predict --lamp 80", "--lamp must lie in"),
    ("predict --lamp nan", "--lamp must lie in [0, 22.5] degrees, got nan"),
    ("inspect file", "unknown format; the supported formats are"),
    ("figures short.binary", "truncated"),
    ("frensel", "No such command 'frensel'"),
    ("predict 0.5 -1", "give a number that is not negative"),
    ("check", "Did you mean matcam capture check?"),
    ("figures same.binary SAME", "two files have the same name"),
]


@pytest.mark.parametrize(("line", "words"), BAD, ids=[line for line, _ in BAD])
def test_bad_input_is_one_line_code_2_and_nothing_written(matcam, measured, bad_files, tmp_path, line, words):
    named = {"MEASURED": measured, "SAME": measured.parent / "same.binary"}
    result = matcam(*(named.get(word, word) for word in line.split()), code=2)
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("matcam: ")
    assert words.lower() in lines[0].lower()
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == bad_files


_INTERRUPTED = """
import signal, sys
from matcam.cli import main

def interrupt(*arguments, **options):
    signal.raise_signal(signal.SIGINT)

def write_half(path, data):
    path.write_text("half")
    interrupt()

{position}
main(sys.argv[1:])
"""
INTERRUPTIONS = {
    "loading": "import typer; typer.Typer = interrupt",
    "fitting": "import matcam.inverse.fresnel_term as module; module.fresnel = interrupt",
    "writing": """
import pathlib, numpy, xarray
import matcam.inverse.fresnel_term as module

theta_d = numpy.radians(numpy.arange(5.0, 80.0, 10.0))
coords = {"theta_d": theta_d, "channel": ["R", "G", "B"]}
curves = {name: (("theta_d", "channel"), numpy.ones((8, 3))) for name in ("raw", "corrected")}
found = xarray.Dataset({**curves, "supported_angle": ("channel", [1.3] * 3)}, coords, {"normalised_over": [0.17, 0.79]})
module.fresnel = lambda *arguments, **options: found
pathlib.Path.write_bytes = write_half
""",
}


@pytest.mark.parametrize("position", INTERRUPTIONS.values(), ids=list(INTERRUPTIONS))
def test_interruption_is_130_and_leaves_no_file(environment, measured, tmp_path, position):
    """Ctrl-C while the command is loaded, while it fits, and while it writes its second file: the first is gone, too."""
    command = [sys.executable, "-c", _INTERRUPTED.format(position=position), "fresnel", measured, "--slice-step", "30"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 130, done.stderr
    assert "interrupted" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_ours_is_code_70_with_traceback(environment, tmp_path):
    code = (
        "import sys, matcam.cli as c, matcam.files.formats as i\n"
        "def broken(path): raise ZeroDivisionError('oops')\n"
        "i.identify = broken\nsys.exit(c._run(['inspect', 'x']))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert result.returncode == 70
    assert "ZeroDivisionError: oops" in result.stderr
    assert "a fault of matcam" in result.stderr
