"""Tutorials and gallery: each downloaded file runs on its own. `make docs`, of which CI is a part, executes them all."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from examples import make_chromium

import matcam
from matcam.inverse.operator.sample_view import rig_behind

ROOT = Path(__file__).parents[2]
EXAMPLES = [path for folder in ("tutorials", "gallery") for path in sorted((ROOT / "examples" / folder).rglob("*.py"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ASKED = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["docs"]]
INSTALLED = {re.split(r"[\[><= ]", one)[0].lower() for one in ASKED} | {"matcam"}


def imported(path):
    """Top names of the modules that a script imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").partition(".")[0]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_download_imports_only_what_is_installed(path):
    """A reader downloads one file: what lies beside it in the sources is not there."""
    assert set(imported(path)) <= INSTALLED | set(sys.stdlib_module_names)


def test_the_example_table_is_of_a_sphere():
    """A table of a flat sample is not blurred, and every command with the sphere's rig refuses it."""
    table = matcam.io.example_table()
    assert rig_behind(table, matcam.rigs.merl()).sample.kind == "sphere"
    assert 1000 < int(table.notnull().any("channel").sum()) < 2000


def test_the_script_of_the_example_table_makes_its_values():
    """One slice: the noise of its pixels is another draw, so the bright cells agree within 8 standard deviations."""
    made = make_chromium.chromium(slice_step=90)
    table = matcam.io.example_table().values
    drawn = made["value"][made["valid"]]
    slices = np.broadcast_to(made["theta_d"][:, None], made["valid"].shape)
    stored = table[made["theta_h"][made["valid"]], slices[made["valid"]], made["phi_d"][made["valid"]]]
    bright = stored > 0.1 * np.nanmax(stored)
    assert bright.sum() >= 12
    np.testing.assert_allclose(drawn[bright], stored[bright], rtol=0.08 * np.sqrt(2))


@pytest.mark.slow
def test_the_script_makes_the_whole_example_table():
    made = make_chromium.chromium()
    with np.load(make_chromium.FILE) as stored:
        for name in stored.files:
            np.testing.assert_allclose(made[name], stored[name], rtol=1e-4, err_msg=name)


def test_ci_builds_the_site():
    assert re.search(r"(?m)^make docs\b", (ROOT / ".ci" / "run").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_download_runs_in_an_empty_folder(path, tmp_path):
    """The script alone, without the sources beside it; its temporary files are its own."""
    if "mitsuba" in imported(path):
        pytest.importorskip("mitsuba")
    (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "temporary").mkdir()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"MPLBACKEND": "agg", "TMPDIR": str(tmp_path / "temporary")}
    environment["PYTHONPATH"] = str(Path(matcam.__file__).parents[1])
    command = [sys.executable, "-W", "error", "-W", "ignore:FigureCanvasAgg", path.name]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
