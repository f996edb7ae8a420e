"""Kill commands at random moments, run them again, and write down what was left and what it cost.

    MATCAM_KILLS_SEED=0 PYTHONPATH=. python -m tests.batch.kills 200 [COMMAND ...]

prints one JSON line for each kill, then a summary.

What must hold after each kill: an output is there whole or not at all, a rerun succeeds, and what was finished is untouched.
Inputs are small. Processor time counts all processes, those that outlive a killed parent too (Linux).
"""

import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile

from tests.batch.tables import write_database
from tests.conftest import REPOSITORY

_PROGRAM = """
import functools, sys
from matcam.core.memory import check_address_space
check_address_space()  # as a command does before it loads anything
from matcam.batch import recipe, run
from matcam.cli import main
from tests.batch import simple

run.correct_all = functools.partial(run.correct_all, corrector=simple.brighter)
if "--workers" not in sys.argv:  # workers look for the class under its name
    recipe.Recipe = functools.partial(recipe.Recipe, corrector=simple.brighter)
if __name__ == "__main__":
    main()
"""
_MATERIALS = "abcdefghijkl"
COMMANDS = {
    "correct": ["correct", "in/a.binary", "-o", "out/a.binary"],
    "run": ["correct", "in", "-o", "out", "--workers", "2"],
    "simulate": ["simulate", "--size", "200", "200", "--radius", "50", "-o", "out/a.exr"],
    "chart": ["chart", "squares", "star", "-o", "out/a.svg"],
    "capture": ["simulate", "--capture", "out/shots", "--radius", "30", "--roughness", "0.05", "--lamp-positions", "2"],
    "calibrate": ["calibrate", "chart.tif", "--tone", "linear", "-o", "out/camera.json"],
    "init": ["capture", "init", "out/shots", "--from", "in"],
    "reconstruct": ["reconstruct", "shots", "--ndf", "ggx", "-o", "out/a.binary"],
}
ENDS = ["SIGKILL", "SIGTERM", "SIGINT", "full disk", "memory"]


@dataclass
class Tally:
    """What became of a command's kills. Processor times in s; `again` counts those runs that were ended by a signal."""

    whole: float = 0.0
    again: list = field(default_factory=list)
    ended: dict = field(default_factory=lambda: dict.fromkeys(ENDS, 0))
    faults: list = field(default_factory=list)

    @property
    def ratio(self):
        """Processor time of what was killed and of its rerun over that of an undisturbed run."""
        return float(np.mean(self.again)) / self.whole if self.again else float("nan")


class Ran(NamedTuple):
    code: int
    said: str
    seconds: float
    cpu: float


def prepare(name, folder):
    """Write a command's inputs into a folder."""
    (folder / "program.py").write_text(_PROGRAM)
    if name in ("correct", "run"):
        write_database(folder / "in", _MATERIALS if name == "run" else "a")
    if name == "init":
        (folder / "in").mkdir()
        for number in range(6):
            tifffile.imwrite(folder / "in" / f"{number}.tif", np.zeros((1000, 1500), np.uint16))
    if name == "calibrate":
        from tests.oracle import slanted_squares

        picture, _ = slanted_squares.field((420, 440), 140, 74, 5, 0.5, dark=0.25)
        counts = np.random.default_rng(1).poisson(picture * 3600)
        tifffile.imwrite(folder / "chart.tif", (10 * counts).astype(np.uint16))
    if name == "reconstruct":
        from tests.oracle.capture import METALS, Sensor, draw
        from tests.oracle.sphere_picture import Surface, View

        view = View(radius=80.0, column=109.6, row=110.3, shape=(220, 220))
        surface = Surface("ggx", 0.05, 1.0, *METALS["Cr"], (0.0,))
        draw(surface, view, np.radians([10, 30, 50]), azimuth=0.4, sensor=Sensor(), seed=5).write(folder / "shots")


def visible(folder):
    """The outputs that bear their names, with their sizes, bytes."""
    return {
        str(path.relative_to(folder)): path.stat().st_size
        for path in (folder / "out").rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def run(folder, command, *, limit=None, end=None, after=None):
    """Run a command; `end` it by a signal after so many seconds, the whole group where it is Ctrl-C."""
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)]),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }  # fmt: skip
    before, begin = _cpu(), time.monotonic()
    process = subprocess.Popen(
        [sys.executable, folder / "program.py", *command], cwd=folder, env=environment, stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, start_new_session=True, preexec_fn=limit,
    )  # fmt: skip
    try:
        _, said = process.communicate(timeout=after or 600)
    except subprocess.TimeoutExpired:
        if after is None:
            os.killpg(process.pid, signal.SIGKILL)
            return Ran(0, "hangs", time.monotonic() - begin, _cpu() - before)
        (os.killpg if end == "SIGINT" else os.kill)(process.pid, getattr(signal, end))
        _, said = process.communicate(timeout=120)
    seconds = time.monotonic() - begin
    _reap(process.pid)
    return Ran(process.returncode, said.decode(errors="replace"), seconds, _cpu() - before)


def _cpu():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def adopt_orphans():
    """Let processes whose parent dies become this one's, so that their time is counted."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def _reap(group):
    """Wait for what a killed process has left running, of its own session."""
    end = time.monotonic() + 30
    while time.monotonic() < end:
        try:
            found, _ = os.waitpid(-group, os.WNOHANG)
        except ChildProcessError:
            return
        if not found:
            time.sleep(0.02)


def _limiting(kind, size):
    return lambda: resource.setrlimit(kind, (size, size))


def kill_at_random(name, folder, kills, seed=0, note=lambda line: None):
    """Kill a command so many times, and tell what became of it."""
    random = np.random.default_rng([seed, list(COMMANDS).index(name)])
    command, tally = COMMANDS[name], Tally()
    prepare(name, folder)
    for _ in range(2):  # the first one compiles
        _clean(folder)
        whole = run(folder, command)
        assert whole.code == 0, (name, whole.said)
    tally.whole, expected = whole.cpu, visible(folder)
    largest = max(expected.values())
    for k in range(kills):
        _clean(folder)
        how, limit = ENDS[k % len(ENDS)], None
        if how == "full disk":
            limit = _limiting(resource.RLIMIT_FSIZE, int(random.uniform(0, 1.1) * largest))
        elif how == "memory":
            limit = _limiting(resource.RLIMIT_AS, int(random.uniform(0.3e9, 2.5e9)))
        first = run(
            folder, command, limit=limit, end=how, after=None if limit else random.uniform(0.05, 1.0) * whole.seconds
        )
        left, times = visible(folder), _times(folder)
        faults = [f"{fault} is half-written" for fault in _half_written(name, left, expected)]
        faults += ["it hangs"] if first.said == "hangs" else []
        again = run(folder, [*command, *(["--force"] if left and name != "run" else [])])
        faults += [f"the rerun failed: {again.said[-300:]}"] if again.code else []
        faults += [f"{path} is missing" for path in expected if not (folder / path).exists()]
        done = {
            path for path in left if name == "run" and f"out/{Path(path).stem}.json" in left and _is_of_a_material(path)
        }
        faults += [f"{path} was finished, and written again" for path in done if _times(folder)[path] != times[path]]
        hidden = {path.name for path in (folder / "out").rglob(".*")} - {".lock"}
        faults += [f"{sorted(hidden)} stayed"] if hidden and name == "run" else []
        tally.ended[how] += first.code != 0
        if first.code != 0 and limit is None:
            tally.again.append(first.cpu + again.cpu)
        tally.faults += [(k, how, fault) for fault in faults]
        note({"command": name, "kill": k, "how": how, "code": first.code, "left": len(left), "of": len(expected),
              "cpu_killed_s": round(first.cpu, 2), "cpu_again_s": round(again.cpu, 2), "cpu_whole_s": round(whole.cpu, 2),
              "faults": faults})  # fmt: skip
    return tally


def _is_of_a_material(path):
    return Path(path).stem in _MATERIALS


def _half_written(name, left, expected):
    """The outputs that are not what a finished command leaves."""
    if name != "run":
        return [] if left.keys() in (set(), expected.keys()) else sorted(expected.keys() - left.keys())
    whole = {stem for stem in _MATERIALS if f"out/{stem}.json" in left}
    return [
        path for path, size in left.items()
        if _is_of_a_material(path) and Path(path).stem in whole and path.endswith((".binary", ".nc"))
        and size != expected[path]
    ]  # fmt: skip


def _clean(folder):
    for path in sorted((folder / "out").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()


def _times(folder):
    return {path: (folder / path).stat().st_mtime_ns for path in visible(folder)}


def main(arguments):
    kills, names = int(arguments[0]), arguments[1:] or list(COMMANDS)
    seed = int(os.environ.get("MATCAM_KILLS_SEED", "0"))
    adopt_orphans()
    tallies = {}
    for position, name in enumerate(names):
        count = kills // len(names) + (position < kills % len(names))
        with tempfile.TemporaryDirectory() as folder:
            tallies[name] = kill_at_random(
                name, Path(folder), count, seed, note=lambda line: print(json.dumps(line), flush=True)
            )
    for name, tally in tallies.items():
        print(
            f"{name}: ended {tally.ended}, killed and run again {tally.ratio:.3f} of {tally.whole:.1f} s, {tally.faults}"
        )
    return sum(len(tally.faults) for tally in tallies.values())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
