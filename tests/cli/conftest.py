"""Commands, run as users run them but in this process: a program that one test has traced serves the next."""

from typing import NamedTuple

import pytest

from matcam.cli import _run


class Finished(NamedTuple):
    """What a command left: its exit code, and what it wrote."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def matcam(tmp_path, monkeypatch, capfd):
    """matcam(*arguments, code=0) runs the command in an empty folder, wide lines, and returns what it left."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")

    def run(*arguments, code=0):
        capfd.readouterr()
        got = _run([str(argument) for argument in arguments])
        done = Finished(got, *capfd.readouterr())
        assert got == code, done.stderr
        return done

    return run
