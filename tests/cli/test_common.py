"""What all commands share: help, rig files, quiet, JSON with a name, the next command, numbers with commas, completion."""

import contextlib
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
import xarray as xr

from matcam import BoxPixel, Camera, DiffractionOptics, GaussianOptics, inspect, io
from matcam.cli import _run, show, suggestions
from matcam.cli.help_page import EXIT_CODES, GROUPS
from matcam.cli.options import Command
from matcam.cli.rig_file import read_rig_file
from matcam.core.errors import ArgumentError
from matcam.core.grid import brdf_table
from matcam.core.io import all_or_nothing, replacing, write_json
from matcam.core.threads import ONE_BLAS_THREAD
from matcam.files import datasets

RIG = """schema = "matcam-rig-1"
camera = "camera.json"

[sample]
radius_px = 100
"""


@pytest.fixture
def rig_file(tmp_path):
    Camera(GaussianOptics(1.5), BoxPixel(0.4)).save(tmp_path / "camera.json")
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def test_help_groups_commands_and_tells_exit_codes(matcam):
    text = matcam("-h").stdout
    positions = [text.index(f"\n{title}:") for title in GROUPS]
    assert positions == sorted(positions)
    assert "Other:" not in text
    assert all(f"{code} {words}" in " ".join(text.split()) for code, words in EXIT_CODES.items())
    assert text == matcam("--help").stdout


@pytest.mark.parametrize("group", [[], ["capture"], ["data"]], ids=str)
def test_a_group_without_arguments_prints_its_help(matcam, group):
    said = matcam(*group, code=2).stderr
    assert said == matcam(*group, "-h").stdout
    assert ("Commands:" in said) == bool(group)


@pytest.mark.parametrize("columns", [40, 80])
def test_a_table_keeps_its_numbers_and_headings_in_a_narrow_terminal(matcam, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    said = matcam("predict", "0.001", "0.02", "--radius", "400").stdout
    assert "…" not in said
    assert "roughness" in said
    assert max(map(len, said.splitlines())) <= 80


@pytest.mark.parametrize(
    "words",
    [
        ["reconstruct", "LONG"], ["reconstruct", "LONG", "-o", "a.binary"], ["correct", "LONG"],
        ["correct", "LONG", "-o", "out"], ["correct", "a.binary", "-o", "LONG"], ["fit", "LONG"], ["fresnel", "LONG"],
        ["calibrate", "LONG"], ["calibrate", "a.tif", "--tone", "LONG"], ["capture", "init", "out", "--from", "LONG"],
        ["capture", "check", "LONG"], ["simulate", "--capture", "LONG"], ["app", "LONG"], ["inspect", "LONG"],
        ["convert", "LONG", "a.nc"], ["edge", "LONG"], ["sensor", "LONG"], ["predict", "0.01", "--rig", "LONG"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_name_that_the_system_refuses_is_one_line(matcam, words):
    said = matcam(*["x" * 300 if word == "LONG" else word for word in words], code=2).stderr
    assert said.startswith("matcam: ")
    assert said.count("\n") == 1


def test_a_rig_file_stands_for_options(matcam, rig_file):
    by_file = json.loads(matcam("predict", 0.01, "--rig", rig_file, "--json").stdout)
    by_options = json.loads(
        matcam("predict", 0.01, "--camera", rig_file.parent / "camera.json", "--radius", 100, "--json").stdout
    )
    merl = json.loads(matcam("predict", 0.01, "--json").stdout)
    assert by_file == by_options
    assert by_file["response"] != merl["response"]
    wins = json.loads(matcam("predict", 0.01, "--radius", 256, "--rig", rig_file, "--json").stdout)
    assert wins["response"] != by_file["response"]


@pytest.mark.parametrize(
    ("text", "command", "words"),
    [
        ("x = [", "predict", "not TOML"),
        ('schema = "other"', "predict", 'is not a rig file, which must contain schema = "matcam-rig-1"'),
        (RIG + "[lamp]\ncolour = 3\n", "predict", "lamp.colour; the entries of a rig file are camera, sample.shape"),
        (RIG.replace("100", '"wide"'), "predict", "sample.radius_px must be a number, got 'wide'"),
        (RIG.replace("camera.json", "../camera.json"), "predict", "the name of a profile in the folder of this file"),
        (RIG.replace("camera.json", "x" * 300), "predict", "cannot be read: File name too long"),
        (RIG + "[lens]\nglare = 0.01\n", "limits", "matcam limits does not support lens.glare"),
        (RIG + "[lens]\nglare = 0.01\n", "correct", "matcam correct does not support lens.glare"),
        (RIG.replace("100", "-1"), "predict", "--radius must lie in"),
    ],
)
def test_wrong_rig_files_are_one_line(matcam, rig_file, text, command, words):
    rig_file.write_text(text)
    arguments = ["nothing.binary"] if command == "correct" else []
    said = matcam(command, *arguments, "--rig", rig_file, code=2).stderr
    assert words in said
    assert said.count("\n") == 1


def test_a_camera_that_is_a_link_is_refused(matcam, rig_file):
    rig_file.with_name("camera.json").rename(rig_file.with_name("other.json"))
    rig_file.with_name("camera.json").symlink_to("other.json")
    assert "the name of a profile in the folder" in matcam("predict", "--rig", rig_file, code=2).stderr


def test_every_entry_of_a_rig_file_is_an_option(tmp_path):
    known = {"camera", "sample", "radius", "sample_mm", "distance", "glare", "glare_radius", "lamp", "lamp_distance"}
    known |= {"cell", "phase", "azimuth"}
    page = (Path(__file__).parents[2] / "docs" / "reference" / "schemas.md").read_text()
    path = tmp_path / "rig.toml"
    path.write_text(page.split("```toml\n")[1].split("```")[0])
    assert set(read_rig_file(path, known, "predict")) == known
    of_table = {"cell", "phase"}
    assert set(read_rig_file(path, known - of_table, "predict")) == known - of_table
    with pytest.raises(ArgumentError, match=r"matcam limits does not support lens\.glare"):
        read_rig_file(path, known - of_table - {"glare"}, "limits")


def test_quiet_prints_nothing_but_errors_and_json(matcam):
    assert matcam("predict", 0.01, "--quiet").stdout == ""
    assert json.loads(matcam("predict", 0.01, "-q", "--json").stdout)["ndf"] == "ggx"
    assert "--radius" in matcam("predict", 0.01, "-q", "--radius", -1, code=2).stderr
    assert matcam("predict", 0.01).stdout


def test_json_has_a_name_and_arrays_on_one_line(matcam):
    text = matcam("predict", 0.01, 0.02, "--json").stdout
    document = json.loads(text)
    assert next(iter(document.items())) == ("schema", "matcam-predict-1")
    assert '  "roughness": [0.01, 0.02],' in text.splitlines()
    assert json.loads(matcam("data", "merl", "--list", "--json").stdout)["schema"] == "matcam-data-merl-1"


@pytest.mark.parametrize(("end", "files"), [(typer.Exit(1), ["a.json"]), (RuntimeError("fault"), [])])
def test_an_exit_code_publishes_files_and_a_failure_does_not(tmp_path, monkeypatch, end, files):
    """However a command ends regularly; its files appear together."""
    monkeypatch.chdir(tmp_path)

    def write():
        write_json("a.json", {})
        raise end

    app = typer.Typer()
    app.command(cls=Command)(write)
    with contextlib.suppress(RuntimeError):
        assert app(args=[], standalone_mode=False) == 1
    assert [path.name for path in tmp_path.iterdir()] == files


def test_layout_is_json():
    value = {"a": [1, 2.5, None], "b": {"c": [[1, 2], [3]], "d": {}}, "e": [], "f": [{"g": "h"}], "ä": True}
    assert json.loads(show._laid_out(value)) == value


def test_the_next_command_is_one_that_runs(matcam, tmp_path):
    """What is suggested is understood by the command line; JSON is left alone."""
    *_, last = matcam("predict", 0.01, "--radius", 300).stdout.strip().splitlines()
    assert last == "next: matcam limits 0.01 --radius 300"
    matcam("limits", "--help")
    assert "next" not in json.loads(matcam("predict", 0.01, "--json").stdout)
    *_, last = matcam("chart", "squares", "-o", "my chart.svg").stdout.strip().splitlines()
    words = shlex.split(last.partition(": ")[2])
    assert words == ["matcam", "calibrate", "PHOTOGRAPHS", "--chart", "my chart.json"]
    assert (tmp_path / "my chart.json").exists()
    assert "next:" not in last  # somebody has to take the photographs first


def test_the_next_command_is_about_the_same_rig_and_images(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("p.tif", "q.tif", "a.binary"):
        Path(name).touch()
    predicted = {"roughness": [0.01], "lamp": 0.5, "radius": 60.0}
    assert suggestions.after("predict", predicted) == "matcam limits 0.01 --radius 60 --lamp 0.5"
    assert (
        suggestions.after("predict", {**predicted, "roughness": [1e-4, 0.01]})
        == "matcam limits 0.01 --radius 60 --lamp 0.5"
    )
    assert suggestions.after("predict", {**predicted, "sample": "flat"}) is None
    Camera(DiffractionOptics(16.0, 550e-9, 3.45e-6), BoxPixel(0.5)).save("f16.json")
    assert (
        suggestions.after("predict", {**predicted, "camera": Path("f16.json")}) is None
    )  # bounds need a Gaussian lens
    edge = {"pictures": [Path("p.tif"), Path("q.tif")], "cfa": "RGGB", "tone": "auto", "roi": (1, 2, 30, 40)}
    assert suggestions.after("edge", edge) == "matcam calibrate p.tif q.tif --cfa RGGB -o camera.json"
    edge |= {"half_width": 0.4, "accept_sharpened": True}
    more = "--cfa RGGB --half-width 0.4 --accept-sharpened"
    assert suggestions.after("edge", edge) == f"matcam calibrate p.tif q.tif {more} -o camera.json"
    assert suggestions.after("edge", {**edge, "focus": "0,1"}) is None
    whole = {**edge, "roi": None}  # each shows one edge, and a camera requires eight
    assert suggestions.after("edge", whole) == "matcam chart squares star -o chart.pdf"
    assert suggestions.after("edge", {**whole, "pictures": 8 * [Path("p.tif")]}).startswith(
        "matcam calibrate p.tif p.tif"
    )
    fitted = {"files": [Path("a.binary")], "lamp": 0.0}
    assert suggestions.after("fit", fitted) == "matcam correct a.binary"
    assert suggestions.after("fit", {**fitted, "blind": True}) is None
    cells = {**fitted, "sampling": "edge", "cell": "nearest", "phase": (0.1, -0.25)}
    told = "matcam correct a.binary --sampling edge --cell nearest --phase 0.1 -0.25"
    assert suggestions.after("fit", cells) == told
    Path("a-corrected.binary").touch()  # an output is not replaced without --force
    assert suggestions.after("fit", fitted) == "matcam correct a.binary -o a-corrected-2.binary"


def test_no_next_command_reads_a_file_that_is_not_there(tmp_path, monkeypatch):
    """Of every command that has a next one: nothing where its files were not written, and a file where they were."""
    monkeypatch.chdir(tmp_path)
    written = {
        "output": Path("a.binary"), "capture": None, "camera": None, "folder": Path("shots"), "pictures": [Path("p.tif")],
        "file": Path("a.binary"), "files": [Path("a.binary")], "paths": [Path("a.binary")], "target": Path("b.binary"),
        "materials": ["chrome"], "roughness": None, "roi": (1, 2, 30, 40),
    }  # fmt: skip
    maker = suggestions._NEXT
    assert len(maker) > 10
    for name in set(maker) - {"predict", "inspect"}:  # the former reads nothing, the latter has read its file
        assert (
            suggestions.after(name, {**written, "output": Path("folder")} if name == "data merl" else written) is None
        )
    Path("shots").mkdir()
    assert suggestions.after("capture init", written) is None  # an empty template
    filled = {**written, "photographs": Path("photographs")}
    assert suggestions.after("capture init", filled) == "matcam capture check shots"
    assert suggestions.after("capture check", written) == "matcam reconstruct shots -o shots.binary"
    Path("shots.binary").touch()
    assert suggestions.after("capture check", written) == "matcam reconstruct shots -o shots-2.binary"


@pytest.mark.parametrize(
    ("files", "output", "next_one"),
    [
        (["f.binary", "f.nc"], Path("f.binary"), "matcam inspect f.binary"),
        (["f.nc", "f.json"], Path("f.binary"), "matcam inspect f.nc"),
        (["shots-reconstructed.nc"], None, "matcam inspect shots-reconstructed.nc"),
    ],
)
def test_what_follows_a_reconstruction_was_written(tmp_path, monkeypatch, files, output, next_one):
    """Also while the files wait for the end of the command: those of a flat sample have no MERL table."""
    monkeypatch.chdir(tmp_path)
    with all_or_nothing():
        for name in files:
            with replacing(name) as temporary:
                temporary.touch()
        assert suggestions.after("reconstruct", {"output": output, "capture": Path("shots")}) == next_one


@pytest.mark.parametrize("theta_h", [0, 5])  # on the MERL grid, and scattered
def test_nothing_follows_the_inspection_of_a_single_sample(tmp_path, theta_h):
    path = tmp_path / "a.csv"
    path.write_text(f"theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n{theta_h},30,90,0.31\n")
    assert _after_inspect(path) is None


def test_a_prediction_follows_the_inspection_of_a_camera(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Camera(GaussianOptics(0.5)).save("a.json")
    assert _after_inspect(Path("a.json")) == "matcam predict --camera a.json"


def _after_inspect(file):
    return suggestions.after("inspect", {"file": file, "report": inspect(file)})


@pytest.mark.parametrize(
    ("slices", "sample", "next_one"),
    [
        (90, "sphere", "matcam correct a.nc"),
        (40, "sphere", "matcam correct a.nc"),
        (2, "sphere", None),  # such as the table of a few photographs
        (90, "flat", None),
    ],
)
def test_a_correction_is_suggested_for_a_table_that_it_accepts(tmp_path, monkeypatch, slices, sample, next_one):
    monkeypatch.chdir(tmp_path)
    values = np.full((90, 90, 180, 3), np.nan)
    values[:, :slices] = 0.3
    io.write_netcdf("a.nc", brdf_table(values, "centre", sample=sample).to_dataset(name="brdf"))
    assert _after_inspect(Path("a.nc")) == next_one


@pytest.mark.parametrize(
    "words",
    [
        ("correct", "none.binary"),
        ("fit", "none.binary"),
        ("fresnel", "none.binary"),
        ("convert", "none.binary", "a.bsdf"),
        ("convert", "a.csv", "a.xyz"),
        ("render", "none.binary"),
        ("reconstruct", "none"),
        ("reconstruct", "."),
    ],
    ids=" ".join,
)
def test_a_missing_input_is_refused_before_jax_is_loaded(tmp_path, words):
    (tmp_path / "a.csv").touch()
    code = f"import sys\nfrom matcam.cli import _run\nassert _run({list(words)}) == 2\nassert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_a_converted_container_is_inspected_next(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.zarr.zip").touch()
    assert suggestions.after("convert", {"target": Path("a.zarr.zip")}) == "matcam inspect a.zarr.zip"


def test_the_columns_of_a_result_are_not_inspected(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    io.write_netcdf("a.nc", xr.Dataset({"corrected": ("theta_d", np.ones(3))}, {"theta_d": np.arange(3.0)}))
    assert _run(["convert", "a.nc", "a.csv"]) == 0
    assert "next" not in capsys.readouterr().out


def test_inspect_reads_a_table_once(tmp_path, monkeypatch, capsys):
    path = tmp_path / "a.nc"
    io.write_netcdf(
        path, brdf_table(np.full((90, 90, 180, 3), 0.3), "centre").isel(channel=[0]).to_dataset(name="brdf")
    )
    reads = []
    monkeypatch.setattr(datasets, "read_netcdf", lambda one, own=datasets.read_netcdf: reads.append(one) or own(one))
    assert _run(["inspect", str(path)]) == 0
    assert "next: matcam correct" in capsys.readouterr().out
    assert reads == [path]


@pytest.mark.parametrize(
    ("sample", "next_one"),
    [
        ("sphere", "matcam fresnel a.binary"),
        ("cylinder", "matcam fresnel a.binary --sample cylinder"),
        ("flat", "matcam inspect a.binary"),
    ],
)
def test_a_table_is_followed_by_a_command_that_takes_it_for_what_it_is(tmp_path, monkeypatch, sample, next_one):
    monkeypatch.chdir(tmp_path)
    Path("a.binary").touch()
    values = {"output": Path("a.binary"), "sample": sample, "camera": None}
    assert suggestions.after("simulate", values) == next_one


@pytest.mark.parametrize("command", ["inspect", "fit", "fresnel"])
def test_a_table_of_one_channel_is_corrected_without_a_merl_file(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    one = brdf_table(np.full((90, 90, 180, 3), 0.3), "centre").isel(channel=[0])
    io.write_netcdf("a.nc", one.to_dataset(name="brdf"))
    values = {"file": Path("a.nc"), "files": [Path("a.nc")], "channels": 1, "report": inspect("a.nc")}
    assert suggestions.after(command, values) == "matcam correct a.nc -o a-corrected.nc"


def test_suggestions_are_for_commands_that_exist():
    from docs_commands import commands

    assert set(suggestions._NEXT) <= set(commands())


def test_completion_knows_commands(environment_of_completion):
    done = subprocess.run(
        [sys.executable, "-m", "matcam"], env=environment_of_completion, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["predict"]


@pytest.fixture
def environment_of_completion():
    return {**os.environ, "_MATCAM_COMPLETE": "complete_bash", "COMP_WORDS": "matcam pre", "COMP_CWORD": "1"}


def processor_time(*arguments):
    """Smallest processor time of eight runs of Python, because others use the machine."""
    seconds = []
    for _ in range(8):
        before = os.times()
        subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
        after = os.times()
        seconds.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return min(seconds)


def test_help_is_quick():
    """At most three times the processor time of importing the library that prints it, on this machine."""
    bare, whole = processor_time("-c", "import typer"), processor_time("-m", "matcam", "--help")
    print(f"import typer {bare:.2f} s, matcam --help {whole:.2f} s")
    assert whole <= 3 * bare


@pytest.mark.parametrize(("said", "threads"), [(None, 1), ("2", 2)])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(said, threads):
    """What NumPy's own OpenBLAS then says, in a process that has run a command."""
    script = (
        "import contextlib, ctypes, pathlib, sys\n"
        "from matcam.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['inspect', 'nothing.binary'])\n"
        "import numpy\n"
        "folder = pathlib.Path(numpy.__file__).parent.with_name('numpy.libs')\n"
        "libraries = [ctypes.CDLL(str(path)) for path in folder.glob('*openblas*')]\n"
        "print(*(library.scipy_openblas_get_num_threads64_() for library in libraries))"
    )
    variables = {name: value for name, value in os.environ.items() if name not in ONE_BLAS_THREAD}
    if said:
        variables["OPENBLAS_NUM_THREADS"] = said
    if (os.cpu_count() or 1) < 2:
        pytest.skip("one processor: one thread in any case")
    ran = subprocess.run([sys.executable, "-c", script], env=variables, capture_output=True, text=True, check=True)
    if not ran.stdout.split():
        pytest.skip("this NumPy has another linear algebra than OpenBLAS of its own")
    assert {int(count) for count in ran.stdout.split()} == {threads}


def test_layers_of_a_correction(tmp_path):
    from matcam.files.float_pictures import write_exr_layers

    OpenEXR = pytest.importorskip("OpenEXR")
    supported = np.eye(3)
    write_exr_layers(tmp_path / "a.exr", {"corrected": np.full((3, 3, 3), 2.0), "supported": supported})
    channels = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    assert sorted(channels) == ["corrected.B", "corrected.G", "corrected.R", "supported.Y"]
    np.testing.assert_array_equal(channels["supported.Y"].pixels, supported)
