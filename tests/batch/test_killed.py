"""Commands that are killed at random moments: nothing half-written, a rerun succeeds, finished work is untouched."""

import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest

from tests.batch.tables import write_database
from tests.conftest import REPOSITORY

_PROGRAM = """
import functools, sys
from matcam.batch import recipe, run
from matcam.cli import main
from tests.batch import simple

run.correct_all = functools.partial(run.correct_all, corrector=simple.brighter)
if "--workers" not in sys.argv:  # workers look for the class under its name
    recipe.Recipe = functools.partial(recipe.Recipe, corrector=simple.brighter)
if __name__ == "__main__":
    main()
"""
COMMANDS = {
    "correct": ["correct", "in/a.binary", "-o", "out/a.binary"],
    "run": ["correct", "in", "-o", "out", "--workers", "2"],
    "simulate": ["simulate", "--size", "200", "200", "--radius", "50", "-o", "out/a.exr"],
    "chart": ["chart", "squares", "star", "-o", "out/a.svg"],
}
ENDS = ["SIGKILL", "SIGTERM", "SIGINT", "full disk", "memory"]


def start(folder, command, limit=None):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])}
    return subprocess.Popen(
        [sys.executable, folder / "program.py", *command], cwd=folder, env=environment, stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, start_new_session=True, preexec_fn=limit,
    )  # fmt: skip


def visible(folder):
    return {path.name: path.read_bytes() for path in (folder / "out").glob("[!.]*") if path.is_file()}


def limiting(kind, size):
    return lambda: resource.setrlimit(kind, (size, size))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_a_random_moment(tmp_path, name):
    """50 times each, 200 in all; MATCAM_TEST_KILLS says how many of each instead."""
    random = np.random.default_rng(list(COMMANDS).index(name))
    (tmp_path / "program.py").write_text(_PROGRAM)
    write_database(tmp_path / "in", ["a", "b"])
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = start(tmp_path, COMMANDS[name])
    _, said = process.communicate()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole_time = (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)
    assert process.returncode == 0, said
    expected = visible(tmp_path)
    ended = dict.fromkeys(ENDS, 0)
    for k in range(int(os.environ.get("MATCAM_TEST_KILLS", "50"))):
        for path in sorted((tmp_path / "out").rglob("*"), reverse=True):
            path.unlink()
        how = ENDS[k % len(ENDS)]
        limit = None
        if how == "full disk":
            limit = limiting(resource.RLIMIT_FSIZE, int(random.uniform(0, 1.1) * max(map(len, expected.values()))))
        elif how == "memory":
            limit = limiting(resource.RLIMIT_AS, int(random.uniform(0.3e9, 2.5e9)))
        process = start(tmp_path, COMMANDS[name], limit)
        try:
            _, said = process.communicate(timeout=120 if limit else random.uniform(0.3, 1.3) * whole_time)
        except subprocess.TimeoutExpired:
            (os.killpg if how == "SIGINT" else os.kill)(process.pid, getattr(signal, how))
            _, said = process.communicate(timeout=60)
        ended[how] += process.returncode != 0
        left = visible(tmp_path)
        if name == "run":  # settings and the like may be there; a material is whole where its record is
            assert {key for key in left if key[0] in "ab"} <= set(expected)
            done = {material for material in "ab" if f"{material}.json" in left}
            for key in left:
                if key[0] in "ab" and key[1:] != ".json" and key[0] in done:
                    assert len(left[key]) == len(expected[key]), (k, how, key)
        else:
            assert left.keys() in (set(), expected.keys()), (k, how, left.keys(), said)
            done = set()
        times = {path: path.stat().st_mtime_ns for m in done for path in (tmp_path / "out").glob(f"{m}.*")}
        again = start(tmp_path, [*COMMANDS[name], *(["--force"] if left and name != "run" else [])])
        _, said = again.communicate(timeout=300)
        assert again.returncode == 0, (k, how, said)
        assert visible(tmp_path).keys() == expected.keys()
        assert all(path.stat().st_mtime_ns == at for path, at in times.items())
        if name == "run":
            assert [p.name for p in (tmp_path / "out").glob(".*")] == [".lock"]
    print(name, ended)
