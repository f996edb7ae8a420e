"""A run over many tables: what it does, leaves alone, survives and refuses. The work itself costs nothing here."""

import base64
import functools
import html.parser
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from typer.testing import CliRunner

from matcam import Flat, Rig, read_merl, rigs
from matcam.batch import job, run
from matcam.batch.executors import local
from matcam.batch.executors.local import ProcessExecutor, WorkerError
from matcam.batch.folder import RunFolder
from matcam.batch.job import Job, attempt
from matcam.batch.recipe import Options, Recipe
from matcam.batch.run import correct_all
from matcam.cli.app import app
from matcam.core.errors import ArgumentError, OutputError
from matcam.core.grid import brdf_table
from matcam.core.workspace import Workspace
from matcam.io import read_netcdf, write_netcdf
from tests.batch import simple
from tests.batch.tables import write_database, write_table
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """Tables a, b, one cut short and one that kills its worker."""
    folder = write_database(tmp_path_factory.mktemp("database"), ["a", "b", "poison"])
    (folder / "short.binary").write_bytes((folder / "a.binary").read_bytes()[:-8])
    return folder


@pytest.fixture
def here(monkeypatch):
    simple.work_in_this_process(monkeypatch)


def times(folder, *names):
    return [path.stat().st_mtime_ns for name in names for path in sorted(folder.glob(f"{name}.*"))]


def reasons(done):
    return {failure.source.stem: failure.reason for failure in done.failures}


def test_a_table_of_one_channel_is_written_as_netcdf_only(tmp_path):
    """A MERL file needs three channels: it is refused before any work."""
    one = brdf_table(np.full((90, 90, 180, 3), 0.1), "centre").isel(channel=[1])
    write_netcdf(tmp_path / "one.nc", one.to_dataset(name="brdf"))

    def made(name, corrector):
        return Job(tmp_path / "one.nc", tmp_path / name, Recipe(rigs.merl(), Options(), corrector=corrector))

    refused = attempt(made("out.binary", lambda *of: pytest.fail("has begun to work")))
    assert refused.reason.endswith("requires the channels R, G, B, but this table has 1: write a .nc file")
    job = made("out.nc", simple.brighter)
    assert attempt(job).reason is None
    assert sorted(path.name for path in tmp_path.glob("out.*")) == ["out.html", "out.json", "out.nc"]
    assert {path.name for path in job.files} == {"out.html", "out.json", "out.nc"}


def test_what_fails_stops_nothing_else(database, tmp_path, monkeypatch):
    """Two workers, one of which is killed by its material; then again: what is finished is not touched."""
    out, heard = tmp_path / "out", []
    done = correct_all([database], rigs.merl(), out, workers=2, corrector=simple.deadly, watch=heard.append)
    assert sorted(path.stem for path in done.corrected) == ["a", "b"]
    assert set(reasons(done)) == {"poison", "short"}
    assert "killed by SIGKILL" in reasons(done)["poison"]
    assert "truncated: 34992004 bytes" in reasons(done)["short"]
    listed = json.loads((out / "failed.json").read_text())["failed"]
    assert {entry["file"]: entry["reason"] for entry in listed} == {str(f.source): f.reason for f in done.failures}
    assert [p.corrected + p.failed for p in heard] == [0, 1, 2, 3, 4]
    assert heard[-1].total == 4
    before = read_merl(database / "a.binary").values
    np.testing.assert_allclose(read_merl(out / "a.binary").values, before * simple.GAIN, rtol=1e-14)
    assert set(read_netcdf(out / "a.nc")) == {
        "brdf",
        "brdf_std",
        "correction_std",
        "noise_std",
        "supported",
        "response",
    }
    assert not list(out.glob("poison.*"))
    assert not list(out.glob("short.*"))
    assert {p.name for p in out.iterdir() if p.name.startswith(".")} <= {".lock"}

    old = times(out, "a", "b")
    simple.work_in_this_process(monkeypatch)
    again = correct_all(
        [database / f"{n}.binary" for n in ("a", "b")], rigs.merl(), out, corrector=simple.deadly
    )  # fmt: skip
    assert (len(again.kept), again.corrected, again.failures) == (2, (), ())
    assert times(out, "a", "b") == old
    assert not (out / "failed.json").exists()


_SCRIPT = """
import sys
from matcam import rigs
from matcam.batch.run import correct_all
from tests.batch import simple

if __name__ == "__main__":
    correct_all(sys.argv[2:], rigs.merl(), sys.argv[1], workers=1, corrector=simple.slowly)
"""


def alive(pid):
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat")
        return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_killed_run_goes_on(tmp_path, monkeypatch, here):
    """SIGKILL in the middle: the next run does what was not finished and nothing else, and no half file stays."""
    names = ["a", "b", "c"]
    database = write_database(tmp_path / "in", names)
    out, log, script = tmp_path / "out", tmp_path / "log", tmp_path / "killed.py"
    monkeypatch.setenv("MATCAM_TEST_LOG", str(log))
    script.write_text(_SCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])}
    process = subprocess.Popen([sys.executable, script, out, database], env=environment)
    while not (out / "a.json").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    worker = int(log.read_text().split()[1])
    while alive(worker):
        time.sleep(0.02)  # a worker does not outlive its parent
    finished = {path.stem for path in out.glob("?.json")}
    old = times(out, *finished)
    (out / ".b-abcd1234.nc").write_text("left by a killed process")
    begun = len(log.read_text().splitlines())
    done = correct_all([database], rigs.merl(), out, corrector=simple.slowly)
    assert {path.stem for path in done.kept} == finished
    assert {path.stem for path in done.corrected} == set(names) - finished
    assert len(log.read_text().splitlines()) - begun == len(names) - len(finished)
    assert times(out, *finished) == old
    assert sorted(p.name for p in out.iterdir() if p.name.startswith(".")) == [".lock"]


@pytest.mark.slow
def test_an_interrupted_run_leaves_nothing_behind(tmp_path, monkeypatch):
    """Ctrl-C reaches parent and workers: all end at once, exit code 130, and there is no half file."""
    database, out, log = write_database(tmp_path / "in", ["a", "b", "c", "d"]), tmp_path / "out", tmp_path / "log"
    program = tmp_path / "program.py"
    program.write_text(_PROGRAM)
    paths = os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])
    process = subprocess.Popen(
        [sys.executable, program, "correct", database, "-o", out, "--workers", "2"],
        env={**os.environ, "PYTHONPATH": paths, "MATCAM_TEST_LOG": str(log)}, start_new_session=True,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not log.exists():
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(0.1)  # while files are written
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate()[1]
    assert process.returncode == 130
    assert said.splitlines()[-1] == "matcam: interrupted; no incomplete file was left"
    assert "Traceback" not in said
    for line in log.read_text().splitlines():
        assert not alive(int(line.split()[1]))
    assert {p.name for p in out.iterdir() if p.name.startswith(".")} == {".lock"}
    for path in out.glob("*.binary"):
        assert path.stat().st_size == 34992012


_PROGRAM = """
import functools
from matcam.batch import run
from matcam.cli import main
from tests.batch import simple

run.correct_all = functools.partial(run.correct_all, corrector=simple.noted_then_slowly)
if __name__ == "__main__":
    main()
"""


def test_other_settings_and_changed_inputs(tmp_path, here):
    database = write_database(tmp_path / "in", ["a"])
    out = tmp_path / "out"
    again = functools.partial(correct_all, [database], rigs.merl(), out, corrector=simple.brighter)
    assert len(again().corrected) == 1
    before = times(out, "a")
    for change, words in (
        ({"glare": 2e-3}, "whose glare is 0.001 instead of 0.002"),
        ({"masking": None}, 'whose masking is "smith" instead of "none"'),
        ({"pages": False}, "whose pages is true"),
        ({"compress": False}, "whose compress is true"),
        ({"corrector": simple.deadly}, "whose corrector is"),
    ):
        with pytest.raises(OutputError, match=words):
            again(**change)
    with pytest.raises(OutputError, match=r"whose rig\.sample\.radius_px is 256\.0 instead of 300\.0"):
        correct_all(
            [database], Rig(rigs.merl().camera, type(rigs.merl().sample)(300.0)), out, corrector=simple.brighter
        )
    os.utime(database / "a.binary")  # touched, not changed
    assert len(again().kept) == 1
    assert times(out, "a") == before
    write_table(database / "a.binary", 9)
    assert len(again().corrected) == 1
    np.testing.assert_allclose(
        read_merl(out / "a.binary").values[0, 0],
        read_merl(database / "a.binary").values[0, 0] * simple.GAIN,
        rtol=1e-14,
    )
    (out / "a.nc").write_bytes(b"damaged")
    assert len(again().corrected) == 1
    (database / "a.binary").write_bytes(b"no table any more")
    assert len(again().failures) == 1
    assert "0 corrected materials" in (out / "index.html").read_text()


def test_one_run_at_a_time(tmp_path, here):
    database = write_database(tmp_path / "in", ["a"])
    with RunFolder(tmp_path / "out").locked(), pytest.raises(OutputError, match="in use by another run"):
        correct_all([database], rigs.merl(), tmp_path / "out", corrector=simple.brighter)


def test_names(tmp_path, here):
    """Two inputs with one name, and names that the run needs itself: each is said, neither overwritten; a file given twice is
    one."""
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "Same.binary").write_bytes(b"no table")
    (tmp_path / "y" / "Index.binary").write_bytes(b"no table")
    (tmp_path / "y" / "other.binary").write_bytes(b"no table")
    paths = [tmp_path / "x", tmp_path / "y", tmp_path / "x" / "Same.binary", tmp_path / "y" / "none.binary"]
    done = correct_all(paths, rigs.merl(), tmp_path / "out", corrector=simple.brighter)
    said = sorted(failure.reason for failure in done.failures)
    assert len(said) == 5
    assert sum("has the same name as" in reason for reason in said) == 2
    assert sum("Index is the name of a file of the run" in reason for reason in said) == 1
    assert any("other.binary: the file has only 8 bytes" in reason for reason in said)
    assert any("none.binary: no such file" in reason for reason in said)


def test_refused_before_any_work(tmp_path, database, here):
    out = tmp_path / "out"
    start = functools.partial(correct_all, [database], rigs.merl(), out, corrector=simple.brighter)
    for call, words in (
        (lambda: start(ndf="phong"), "ndf must be one of"),
        (lambda: start(workers=0), "workers must be"),
        (lambda: start(glare=2), "glare must lie in"),
        (lambda: start(sampling="corner"), "sampling must be one of"),
        (lambda: start(corrector=lambda *_: None), "top level of a module"),
        (lambda: correct_all([tmp_path], rigs.merl(), out), r"there is no \*\.binary file"),
        (lambda: correct_all([], rigs.merl(), out), "no path"),
        (lambda: correct_all([database], Rig(rigs.merl().camera, Flat()), out), "must be a Sphere or a Cylinder"),
    ):
        with pytest.raises(ArgumentError, match=words):
            call()
    with pytest.raises(OutputError, match="is the input itself"):
        correct_all([database], rigs.merl(), database)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.html").write_text("mine")
    with pytest.raises(OutputError, match="force=True"):
        correct_all([database], rigs.merl(), tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir() if path.name[0] != "."] == ["a.html"]
    (tmp_path / "mine" / "a.html").unlink()
    (tmp_path / "mine" / "settings.json").write_text('{"volume": 11}')
    with pytest.raises(OutputError, match="does not contain the settings of a run"):
        correct_all([database], rigs.merl(), tmp_path / "mine")
    with pytest.raises(OutputError, match="cannot be written"):
        correct_all([database], rigs.merl(), database / "a.binary" / "out")


def one(database, tmp_path, **more):
    recipe = Recipe(rigs.merl(), Options(), corrector=simple.brighter, **more)
    return Job(database / "a.binary", tmp_path / "a.binary", recipe, key="k")


def test_a_file_that_changes_while_it_is_read(tmp_path, monkeypatch):
    database = write_database(tmp_path / "in", ["a"])

    def read_slowly(path, sampling):
        table = read_merl(path, sampling)
        with path.open("r+b") as file:  # one value, in place
            file.seek(1000)
            file.write(b"\0" * 8)
        return table

    monkeypatch.setattr(job, "read_recorded_table", read_slowly)
    assert "changed while it was read" in attempt(one(database, tmp_path)).reason
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.parametrize("limit", [20 << 20, 60 << 20], ids=["MERL", "NetCDF"])
def test_a_full_disk(tmp_path, database, limit):
    """No file may grow beyond the limit, as on a disk that is full: said, and nothing half-written stays."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        outcome = attempt(one(database, tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert outcome.trace is None
    assert "cannot be written" in outcome.reason
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_ours_is_traced(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    write_table(tmp_path / "in" / "odd.binary", 1)
    recipe = Recipe(rigs.merl(), Options(), corrector=simple.faulty)
    outcome = attempt(Job(tmp_path / "in" / "odd.binary", tmp_path / "odd.binary", recipe))
    assert "a fault of matcam" in outcome.reason
    assert "ZeroDivisionError: a bug" in outcome.reason
    assert "in faulty" in outcome.trace


def test_a_worker_of_another_version(tmp_path, database):
    outcome = attempt(one(database, tmp_path, version="9.9"))
    assert "the run was started by matcam 9.9" in outcome.reason


def test_a_worker_that_hangs_is_killed(database, tmp_path):
    """After the time limit; the other material is corrected by the worker that takes its place."""
    recipe = Recipe(rigs.merl(), Options(), corrector=simple.hanging)
    jobs = [Job(database / f"{name}.binary", tmp_path / f"{name}.binary", recipe) for name in ("poison", "a")]
    ended = {outcome.source.stem: outcome.reason for outcome in ProcessExecutor(1, time_limit=8.0).outcomes(jobs)}
    assert ended == {"poison": f"{jobs[0].source}: the worker died (no result after 8 s)", "a": None}
    assert (tmp_path / "a.json").exists()


def test_a_run_has_a_time_limit(database, tmp_path, monkeypatch):
    asked = []

    def outcomes(executor, jobs):
        asked.append(executor.time_limit)
        yield from ()

    monkeypatch.setattr(ProcessExecutor, "outcomes", outcomes)
    for limit in ({}, {"time_limit": 7.5}):
        correct_all([database], rigs.merl(), tmp_path / "out", corrector=simple.brighter, **limit)
    assert asked == [3600.0, 7.5]
    with pytest.raises(ArgumentError, match="time_limit must lie in"):
        correct_all([database], rigs.merl(), tmp_path / "out", time_limit=0)


def test_a_worker_that_hangs_before_its_first_job(database, tmp_path, monkeypatch):
    monkeypatch.setattr(local, "_START_LIMIT", 0.05)
    with pytest.raises(WorkerError, match=r"no result after 0\.05 s"):
        correct_all([database], rigs.merl(), tmp_path / "out", workers=1, corrector=simple.brighter)


@pytest.mark.parametrize("name", ["a\udcff", "a\nb", "a\x1b[31m"])
def test_a_name_that_is_no_text_fails_alone(tmp_path, here, name):
    database = write_database(tmp_path / "in", ["a"])
    os.link(database / "a.binary", os.fsencode(database / f"{name}.binary"))
    done = correct_all([database], rigs.merl(), tmp_path / "out", corrector=simple.brighter)
    assert [path.name for path in done.corrected] == ["a.binary"]
    (reason,) = [failure.reason for failure in done.failures]
    assert reason.endswith("its name is not plain text: rename it")
    assert reason.isprintable()
    assert len(json.loads((tmp_path / "out" / "failed.json").read_text())["failed"]) == 1
    assert "rename it" in (tmp_path / "out" / "index.html").read_text()


_ENDED = """
import functools, os, signal, sys
from matcam.batch import job, recipe
from matcam.cli import main
from tests.batch import simple

write = job.write_netcdf
def write_and_end(*arguments, **options):
    write(*arguments, **options)
    os.kill(os.getpid(), signal.SIGTERM)
job.write_netcdf = write_and_end
recipe.Recipe = functools.partial(recipe.Recipe, corrector=simple.brighter)
main()
"""


def test_a_correction_that_is_ended_leaves_nothing(database, tmp_path):
    """SIGTERM between two files of a single table: none of them stays, and the exit code says why."""
    done = subprocess.run(
        [sys.executable, "-c", _ENDED, "correct", database / "a.binary", "-o", tmp_path / "a.binary"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])},
        stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    assert done.stderr.splitlines()[-1] == "matcam: interrupted; no incomplete file was left"
    assert done.returncode == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


def test_workers_that_cannot_start(tmp_path, database, monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "none such")
    with pytest.raises(WorkerError, match="could not be started: RuntimeError: Unable to init"):
        correct_all([database], rigs.merl(), tmp_path / "out", workers=1, corrector=simple.brighter)


def test_the_index(tmp_path, here):
    """Well-formed, in order, and whole without a network; names of files cannot inject anything."""
    database = write_database(tmp_path / "in", ["b", "<i>&'a"])
    (database / "bad.binary").write_bytes(b"<script>")
    out = tmp_path / "out"
    correct_all([database], rigs.merl(), out, corrector=simple.brighter)
    page = (out / "index.html").read_text()
    found = Page()
    found.feed(page)
    assert found.open == []
    assert [row[1] for row in found.rows] == ["<i>&'a", "b"]
    assert [name for name, _ in found.links] == ["%3Ci%3E%26%27a.html", "b.html"]
    assert len(found.images) == 2
    for image in found.images:
        assert image.startswith("data:image/png;base64,")
        assert imagecodecs.png_decode(base64.b64decode(image.partition(",")[2])).shape == (64, 128, 3)
    assert "bad.binary: the file has only 8 bytes" in page
    assert (
        "camera: assumed lens blur 0.50 ± 0.50 px; measure it with matcam calibrate; source of the camera: Holz" in page
    )
    assert not re.search(r"(src|href)='?http", page)
    sorted_by = [row[found.heads.index("roughness(slope)")] for row in found.rows]
    assert sorted_by == ["0.01", "0.01"]
    assert found.rows[0][found.heads.index("at 45°")] == ""


class Page(html.parser.HTMLParser):
    """What a browser would find in an index; HTML's void elements need no end."""

    def __init__(self):
        super().__init__()
        self.open, self.rows, self.links, self.images, self.heads = [], [], [], [], []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in ("meta", "img", "input", "br", "li", "tr", "td", "th"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag == "td":
            self.rows[-1].append(attributes.get("data-v"))
        elif tag == "th":
            self.heads.append("")
        elif tag == "a":
            self.links.append((attributes["href"], None))
        elif tag == "img":
            self.images.append(attributes["src"])

    def handle_endtag(self, tag):
        if self.open and self.open[-1] == tag:
            self.open.pop()
        if tag == "thead":
            self.rows.clear()

    def handle_data(self, data):
        if self.open and "thead" in self.open:
            self.heads[-1] += data


def command(monkeypatch, *arguments):
    monkeypatch.setattr(run, "correct_all", functools.partial(correct_all, corrector=simple.brighter))
    return CliRunner().invoke(app, ["correct", *(str(a) for a in arguments)])


def test_every_option_reaches_the_run(database, tmp_path, monkeypatch):
    def record(paths, rig, output, **options):
        asked.update(options, radius=float(rig.sample.radius), paths=paths, output=output)
        return run.Run(tmp_path, (), (), ())

    asked = {}
    monkeypatch.setattr(run, "correct_all", record)
    options = (
        "--ndf epd --glare 0.01 --masking none --radius 100 --sampling edge --workers 3 --device cpu --no-pages --zarr "
        "--fit-camera --force-correction --time-limit 60 --compress"
    )
    done = CliRunner().invoke(app, ["correct", str(database), "-o", "x", "--force", *options.split()])
    assert done.exit_code == 0, done.output
    asked.pop("watch")
    assert asked.pop("workspace") is Workspace.user()
    assert asked == {
        "paths": [database], "output": Path("x"), "ndf": "epd", "glare": 0.01, "force_correction": True, "masking": None,
        "radius": 100.0, "sampling": "edge", "workers": 3, "cluster": None, "pages": False, "zarr": True, "fit_camera": True,
        "time_limit": 60.0, "force": True, "compress": True,
    }  # fmt: skip


def test_the_command(database, tmp_path, monkeypatch, here):
    """One table in order and one cut short: exit code 1, both said; none in order: 2."""
    out = tmp_path / "out"
    done = command(monkeypatch, database / "a.binary", database / "short.binary", "-o", out, "--json")
    assert done.exit_code == 1, done.output
    document = json.loads(done.stdout)
    assert document["corrected"] == [str(database / "a.binary")]
    assert "truncated" in document["failed"][0]["reason"]
    assert "2 of 2" in done.stderr
    again = command(monkeypatch, database / "a.binary", "-o", out)
    assert again.exit_code == 0
    assert "0 corrected, 1 finished before, 0 failed" in again.stdout
    none = command(monkeypatch, database / "short.binary", "-o", tmp_path / "none")
    assert none.exit_code == 2
    assert "failed: " in none.stdout
    other = command(monkeypatch, database / "a.binary", "-o", out, "--glare", 0.01)
    assert "whose glare is 0.001 instead of 0.01" in str(other.exception)
    assert "-o FOLDER" in str(command(monkeypatch, database).exception)
    assert "-o FOLDER" in str(command(monkeypatch, database, "-o", "x.binary").exception)
    assert "give an output folder" in str(command(monkeypatch, database / "a.binary", "--workers", 2).exception)


def test_a_run_on_a_gpu_is_refused(database, tmp_path, monkeypatch):
    refused = command(monkeypatch, database, "-o", tmp_path / "out", "--device", "gpu")
    assert "--device gpu is for one table" in str(refused.exception)
    assert not (tmp_path / "out").exists()
