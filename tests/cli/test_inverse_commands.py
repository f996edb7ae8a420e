"""`fit`, `correct` and `limits` as commands: what they write, and what they refuse, in one process."""

import csv
import json
import re

import numpy as np
import OpenEXR
import pytest
import xarray as xr
from typer.testing import CliRunner

from matcam import io, read_merl, write_merl
from matcam.cli.app import app
from matcam.core.grid import brdf_table, merl_grid
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.material.ndf.ggx import GGX
from tests.conftest import REPOSITORY
from tests.inverse import recorded


@pytest.fixture(scope="module")
def merl_file(tmp_path_factory):
    """A GGX lobe in the cells that a fit of every sixth slice reads, and at all azimuths of the peak, the rest missing."""
    cells, operator = lobe_operator(recorded.rig(), "centre", 6)
    one = recorded.table_of(cells, np.asarray(operator.record(GGX(0.004), "smith", ())) * 0.6).values
    ring = one[0].copy()
    seen = np.isfinite(ring).any(axis=1)[..., 0]
    one[0][seen] = np.nanmean(ring[seen], axis=1, keepdims=True)
    path = tmp_path_factory.mktemp("merl") / "metal.binary"
    write_merl(path, brdf_table(np.repeat(one, 3, axis=3), "centre"))
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_fit_prints_and_writes(merl_file, tmp_path):
    out = tmp_path / "fit.json"
    budget = tmp_path / "budget.csv"
    done = run("fit", merl_file, "--slice-step", 18, "--fresnel", "schlick", "-o", out, "--budget", budget, "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    with budget.open() as file:
        combined = {row["source"]: row for row in csv.DictReader(file) if row["source"].endswith(", combined")}
    assert set(combined) == {f"{name}, combined" for name in (*document["params"], "hwhm_rad")}
    for name, std in document["std"].items():
        assert float(combined[f"{name}, combined"]["standard_uncertainty"]) == pytest.approx(std, rel=1e-8)
    assert document["params"]["alpha"] == pytest.approx(0.004, rel=1e-3)
    assert document.pop("schema") == "matcam-fit-1"
    assert json.loads(out.read_text()) == document
    again = run("fit", merl_file, "--slice-step", 18, "-o", out)
    assert "--force" in str(again.exception)
    assert "must end in .json or .csv" in str(run("fit", merl_file, "--budget", tmp_path / "b.txt").exception)
    assert "give one of these options" in str(run("fit", merl_file, "--no-camera", "--lens", "free").exception)


@pytest.mark.slow
def test_fit_sets_the_camera_against_free_shadowing(merl_file, tmp_path):
    done = run("fit", merl_file, "--slice-step", 18, "--fresnel", "free", "--rival", "--json")
    assert done.exit_code == 0, done.output
    rival = json.loads(done.stdout)["rival"]
    assert rival["verdict"].startswith("the camera explains the data better")
    assert rival["camera"]["log_evidence"] > rival["shadowing"]["log_evidence"]
    assert rival["probability_of_camera"] > 0.95
    assert "give one file" in str(run("fit", merl_file, "--no-camera", "--rival").exception)


@pytest.mark.slow
def test_correct_writes_four_files(merl_file, tmp_path):
    out = tmp_path / "corrected.binary"
    more = "--layers", tmp_path / "l.exr", "--budget", tmp_path / "b.json"
    done = run("correct", merl_file, "--ndf", "ggx", "-o", out, *more, "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert len(document["files"]) == 6
    budgets = json.loads((tmp_path / "b.json").read_text())["budgets"]
    assert [one["result"] for one in budgets][-1].startswith("peak at 75.5 deg, B")
    layers = OpenEXR.File(str(tmp_path / "l.exr"), separate_channels=True).channels()
    names = {f"{layer}.{c}" for layer in ("recorded", "corrected", "std") for c in "RGB"} | {"supported.Y"}
    assert set(layers) == names
    recorded = read_merl(merl_file).values[:, :, 90, 1].T
    np.testing.assert_array_equal(layers["recorded.G"].pixels, recorded.astype(np.float32))
    before, after = read_merl(merl_file), read_merl(out)
    np.testing.assert_array_equal(np.isnan(before.values), np.isnan(after.values))
    peaks = [float(np.nanmax(table.values[0, 75, :, 1])) for table in (before, after)]
    assert peaks[1] > 2 * peaks[0]
    page = out.with_suffix(".html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert page.count("<h3>peak at") == len(budgets) == 6  # of 45 and 75 degrees: 5 is missing
    assert not re.search(r"(src|href)=['\"]http", page)
    with xr.open_dataset(out.with_suffix(".nc")) as stored:
        assert set(stored.data_vars) == {"brdf", "brdf_std", "correction_std", "noise_std", "supported", "response"}
        assert stored.attrs["ndf"] == "ggx"
        at = (*merl_grid("centre").index(theta_h=0.0, theta_d=np.radians(75), phi_d=np.pi / 2), 2)
        assert budgets[-1]["combined_standard_uncertainty"] == pytest.approx(
            float(stored["brdf_std"].values[at]), rel=1e-5
        )
    assert json.loads(out.with_suffix(".json").read_text())["fit"]["params"]["alpha"] == pytest.approx(0.004, rel=2e-3)


def test_correct_refuses(merl_file, tmp_path):
    said = str(run("correct", merl_file, "-o", tmp_path / "run", "--budget", tmp_path / "b.json").exception)
    assert "--budget is for one table" in said
    for arguments, words in (
        (("-o", tmp_path / "out.exr"), "must end in .binary"),
        (("-o", merl_file), "is the input itself"),
    ):
        assert words in str(run("correct", merl_file, *arguments).exception)
    there = tmp_path / "out.html"
    there.write_text("mine")
    assert "--force" in str(run("correct", merl_file, "-o", tmp_path / "out.binary").exception)
    assert there.read_text() == "mine"


def test_fresnel_takes_a_table_of_one_channel(merl_file, tmp_path, monkeypatch):
    """Its wavelength is unknown, so there is no metal to compare it with; angles without a value are dashes."""
    monkeypatch.chdir(tmp_path)
    table = read_merl(merl_file).isel(channel=[0]).assign_coords(channel=["Y"])
    io.write_netcdf("one.nc", table.drop_attrs().assign_attrs(sampling="centre").to_dataset(name="brdf"))
    assert "--metal is for the channels R, G, B" in str(run("fresnel", "one.nc", "--metal", "Cr").exception)
    assert "a channel of the table (Y), got 'G'" in str(run("fresnel", "one.nc", "--channel", "G").exception)
    done = run("fresnel", "one.nc", "--ndf", "ggx", "--slice-step", 6)
    assert done.exit_code == 0, done.output
    assert "one.nc, channel Y" in done.stdout
    assert "not compared with published tables" in done.stdout
    assert "nan" not in done.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--lamp-distance", 0.5), "--lamp-distance must lie in (1, inf) radii of the sample (the lamp is outside it)"),
        (("--lamp-distance", 20, "--sample-mm", 25), "--lamp-distance must lie in (1, inf) radii"),
        (("--sample-mm", 25), "--sample-mm sets the unit of --lamp-distance"),
        (("--distance", 1), "--distance must lie in (1, inf] radii"),
        (("--azimuth", 400), "--azimuth must lie in [-360, 360] degrees, got 400"),
    ],
)
@pytest.mark.parametrize("command", ["limits", "fit", "fresnel", "correct"])
def test_near_rigs_that_cannot_be_are_refused(command, options, words, merl_file, tmp_path):
    arguments = (
        [] if command == "limits" else [merl_file, "-o", tmp_path / ("a.png" if command == "fresnel" else "a.binary")]
    )
    said = str(run(command, *arguments, *options).exception)
    assert words in said
    assert "\n" not in said


def test_near_cells_of_real_pixels_are_refused(merl_file):
    said = str(run("fit", merl_file, "--lamp-distance", 20, "--cell", "nearest", "--phase", 0.1, 0.2).exception)
    assert "because each cell has its own image if one of them is near" in said


def test_limits_speaks(monkeypatch):
    done = run("limits", 0.002, "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert 0 < document["width_std"][0] < document["width_std_free"][0] < 1
    assert document["fresnel_std"]
    # the page states the same
    (row,) = re.findall(r"\| 0\.002 \|(.*)\|", (REPOSITORY / "docs" / "understand" / "limits.md").read_text())
    exact, free, *sizes = (float(re.search(r"[\d.]+", cell)[0]) for cell in row.split("|"))
    found = np.array([document["width_std"], document["width_std_free"]])[:, 0]
    assert [exact / 100, free / 100] == pytest.approx(found, abs=5e-5)
    assert sizes == pytest.approx(document["smallest"][0], rel=0.04)


@pytest.mark.slow
def test_limits_of_a_cylinder_speak_of_it():
    sphere = json.loads(run("limits", 0.01, "--json").stdout)  # its rules are those of the test before
    done = run("limits", 0.01, "--sample", "cylinder", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["change"][0] == "cylinder twice as large in the image"
    assert document["width_std"][0] != sphere["width_std"][0]
    assert "a Sphere or a Cylinder" in str(run("limits", 0.01, "--sample", "flat").exception)
