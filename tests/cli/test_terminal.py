"""Nothing of a file reaches the terminal but text; output that cannot be written costs no file."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from matcam import BoxPixel, Camera, GaussianOptics
from matcam.camera import Provenance
from matcam.cli import _run, show
from matcam.core import io
from matcam.core.errors import OutputError
from tests.conftest import REPOSITORY

HOSTILE = "\x1b[31mred\x1b]0;title\x07 \x9b2J \u202eback [/bold] [link=x]\r\x7f"


@pytest.fixture
def profile(tmp_path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5), provenance=Provenance(HOSTILE, "2026", HOSTILE, HOSTILE)).save(
        tmp_path / "camera.json"
    )
    return tmp_path / "camera.json"


def plain(text):
    return all(line.isprintable() for line in text.split("\n"))


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_texts_of_a_file(profile, capsys, options):
    assert _run(["inspect", str(profile), *options]) == 0
    said = capsys.readouterr().out
    assert plain(said)
    assert "[/bold]" in said
    if options:
        assert json.loads(said)["provenance"]["notes"] == HOSTILE


@pytest.mark.parametrize("text", [HOSTILE, "[/bold]", "[red]", "\\[", "a\udcff"])
def test_tables_remarks_and_errors(capsys, text):
    show.table([text, text], [[text, text]], text)
    show.say(text)
    show.remark(text)
    assert _run(["inspect", f"{text}.nc"]) == 2
    said = capsys.readouterr()
    assert plain(said.out.encode(errors="backslashreplace").decode())
    assert plain(said.err)
    assert (text if text.isprintable() else "red" if "red" in text else "udcff") in said.out


def test_a_name_like_a_title(tmp_path, capsys):
    """A table's title, and a file that is named in it, are no markup."""
    with show.counting("[/red]") as update, show.tallying("[/red]") as tally:
        update(1, 2)
        tally(1, 2)
    with show.working("[/red]"):
        pass
    assert "1 of 2" in capsys.readouterr().err


def command(arguments, **options):
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY / "src"), **options.pop("env", {})}
    process = subprocess.Popen(
        [sys.executable, "-m", "matcam", *map(str, arguments)], env=environment, stderr=subprocess.PIPE, **options
    )
    said = process.communicate()[1].decode()
    return process.returncode, said


def test_a_reader_that_has_gone(tmp_path):
    """The files are there, and it is no failure."""
    read, write = os.pipe()
    os.close(read)
    code, said = command(["chart", "squares", "-o", tmp_path / "a.svg"], stdout=write)
    os.close(write)
    assert (code, said) == (0, "")
    assert sorted(os.listdir(tmp_path)) == ["a.json", "a.svg"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
def test_a_full_standard_output(tmp_path):
    with Path("/dev/full").open("wb") as full:
        code, said = command(["chart", "squares", "-o", tmp_path / "a.svg"], stdout=full)
        assert (code, said) == (2, "matcam: standard output cannot be written: No space left on device\n")
        assert sorted(os.listdir(tmp_path)) == ["a.json", "a.svg"]
        code, said = command(["--help"], stdout=full)
        assert (code, said) == (2, "matcam: standard output cannot be written: No space left on device\n")


def test_a_poor_locale_and_no_streams(tmp_path):
    """The signs of the help and of a table are not ASCII."""
    poor = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    assert command(["predict", "--help"], env=poor, stdout=subprocess.DEVNULL) == (0, "")
    closed = f"exec {sys.executable} -m matcam data merl --list >&-"
    done = subprocess.run(["sh", "-c", closed], env=os.environ | {"PYTHONPATH": str(REPOSITORY / "src")}, check=False)
    assert done.returncode == 0


def test_no_home(monkeypatch):
    import pooch

    def homeless(name):
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("XDG_CACHE_HOME")
    for answer in (homeless, lambda name: io.Path("~/.cache") / name):
        monkeypatch.setattr(pooch, "os_cache", answer)
        monkeypatch.setattr(Path, "home", lambda answer=answer: answer("matcam"))
        folder = io.user_cache_folder()
        assert folder.is_absolute()
        with pytest.raises(OutputError), io.replacing(folder / "a") as temporary:
            temporary.write_text("never")


@pytest.mark.parametrize("error", [KeyboardInterrupt, OutputError("output x cannot be written: full")])
def test_a_command_whose_last_file_fails_writes_none(tmp_path, monkeypatch, error, capsys):
    from matcam.calibration.chart import chart_file

    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(chart_file, "write_json", fail)
    assert _run(["chart", "squares", "-o", str(tmp_path / "a.svg")]) == (130 if error is KeyboardInterrupt else 2)
    assert os.listdir(tmp_path) == []


def test_too_small_a_limit_of_address_space_is_said():
    """OpenBLAS would wait for its buffer without end: `chart` did for 15 minutes under 0.66 GB."""
    pytest.importorskip("resource")
    for limit in (0.25e9, 0.66e9, 1.3e9):
        limited = (
            f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({int(limit)},) * 2);"
            "from matcam.cli import main; main(['predict'])"
        )
        ran = subprocess.run(
            [sys.executable, "-c", limited], capture_output=True, text=True, timeout=60,
            env={**os.environ, "PYTHONPATH": str(REPOSITORY / "src")},
        )  # fmt: skip
        assert ran.returncode == 2
        assert ran.stderr.startswith(f"matcam: this process may use {limit / 1e9:.2f} GB of address space (ulimit -v)")


@pytest.mark.parametrize("columns", ["0", "1", "19", "none"])
def test_a_width_that_nothing_fits_into(monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", columns)
    show.table(["metal", "F"], [["Cr", "0.55"]])
    assert "0.55" in capsys.readouterr().out


def test_a_warning_is_one_line():
    code = "import sys, warnings\nfrom matcam import cli\ncli._run = lambda a: warnings.warn('two\\nlines', stacklevel=1)\n"
    done = subprocess.run([sys.executable, "-c", code + "cli.main([])"], capture_output=True, text=True, check=False)
    assert done.stderr == "matcam: two lines\n"
