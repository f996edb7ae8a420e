"""`matcam correct` over many materials: two workers against one, a killed run taken up again, memory, and the cost model.

Usage: bench_batch.py [MATERIALS] [--cluster]. Stand-ins of MERL's materials from shared/tools beside the checkout, 20 by
default, one more cut short. One warm-up, then three runs of all: one worker, two workers, two workers killed after a third
and resumed; with --cluster a fourth, on two local Dask workers. About 1.5 minutes of a core for each material.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil

from matcam.core.readers.texts import read_json
from matcam.io import read_netcdf
from results import record

SHARED = Path(__file__).resolve().parents[2] / "shared"
NOT_MATERIALS = {"settings", "failed", "camera"}


class Watched:
    """A run of the command as a process: when each material was finished, and its workers' memory."""

    def __init__(self, *arguments: str, out: Path, cache: Path):
        self.out, self.started = out, time.monotonic()
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "matcam", "correct", *arguments, "-o", str(out)], env=environment
        )
        self.finished: dict[str, float] = {}
        self.memory: dict[int, list[tuple[float, float]]] = {}
        self.processor: dict[int, float] = {}
        self.seconds = np.nan
        self.thread = threading.Thread(target=self._watch)
        self.thread.start()

    def _watch(self) -> None:
        parent = psutil.Process(self.process.pid)
        while self.process.poll() is None:
            now = self._look()
            try:
                for child in (parent, *parent.children(recursive=True)):
                    self.processor[child.pid] = sum(child.cpu_times()[:2])
                    self.memory.setdefault(child.pid, []).append((now, child.memory_info().rss / 2**30))
            except psutil.Error:
                pass
            time.sleep(0.1)
        self._look()

    def _look(self) -> float:
        """Note what is finished; seconds since the start."""
        now = time.monotonic() - self.started
        for path in self.out.glob("*.json"):
            if path.stem not in NOT_MATERIALS and not path.name.startswith("."):
                self.finished.setdefault(path.stem, now)
        return now

    def end(self) -> int:
        """Wait for its end; its exit code."""
        code = self.process.wait()
        assert code in (0, 1, -signal.SIGKILL), f"exit code {code}"
        self.seconds = time.monotonic() - self.started
        self.thread.join()
        return code

    def wait_for(self, count: int) -> None:
        """Until so many materials are finished."""
        while len(self.finished) < count and self.process.poll() is None:
            time.sleep(0.05)

    def work(self) -> float:
        """Seconds that workers spent on what is finished."""
        return sum(read_json(self.out / f"{name}.json", "a record")["run"]["seconds"] for name in self.finished)

    def print_memory(self) -> None:
        """Of each worker: its peak, and whether it grows."""
        for pid, seen in self.memory.items():
            peak = max(rss for _, rss in seen)
            if pid == self.process.pid or peak < 0.5:  # no worker: the parent, Python's resource tracker
                continue
            third = len(seen) // 3
            early, late = (max(rss for _, rss in part) for part in (seen[third : 2 * third], seen[2 * third :]))
            print(f"  worker {pid}: peak {peak:.2f} GiB; in the middle third {early:.2f}, in the last {late:.2f}")


def stand_ins(folder: Path, count: int) -> None:
    names = (SHARED / "data" / "merl_npf" / "materials.txt").read_text().split()
    for position in np.linspace(0, len(names) - 1, count).astype(int):
        tool = SHARED / "tools" / "npf_to_merl.py"
        subprocess.run([sys.executable, tool, names[position], folder / f"{names[position]}.binary"], check=True)
    whole = next(folder.glob("*.binary")).read_bytes()
    (folder / "cut-short.binary").write_bytes(whole[:-1000])


def difference(a: Path, b: Path) -> float:
    """Largest relative difference of all values of all tables."""
    worst = 0.0
    assert {p.name for p in a.glob("*.nc")} == {p.name for p in b.glob("*.nc")}
    for path in a.glob("*.nc"):
        one, two = read_netcdf(path), read_netcdf(b / path.name)
        for name in ("brdf", "brdf_std", "response"):
            x, y = one[name].values, two[name].values
            assert np.array_equal(np.isnan(x), np.isnan(y))
            worst = max(worst, float(np.nanmax(np.abs(x - y) / np.maximum(np.abs(x), 1e-300), initial=0)))
    return worst


def main() -> None:
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    count = numbers[0] if numbers else 20
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache, database = folder / "cache", folder / "in"
        database.mkdir()
        stand_ins(database, count)
        first = min(path for path in database.glob("*.binary") if path.stem != "cut-short")
        warm = Watched(str(first), "--workers", "1", out=folder / "warm", cache=cache)
        warm.end()
        print(f"nothing compiled yet, {first.stem}: {warm.seconds:.0f} s")

        runs = {}
        for workers in (1, 2):
            run = runs[workers] = Watched(
                str(database), "--workers", str(workers), out=folder / f"w{workers}", cache=cache
            )
            code = run.end()
            overhead = 1 - run.work() / (workers * run.seconds)
            print(
                f"{workers} worker(s): {run.seconds:.0f} s, {run.work() / count:.1f} s a material, "
                f"{len(run.finished)} of {count + 1} corrected, exit code {code}, not spent on materials {overhead:.1%}"
            )
            run.print_memory()
        print(f"two workers / one: {runs[1].seconds / runs[2].seconds:.2f} (asked for: >= 1.7)")
        print(f"largest relative difference of their results: {difference(folder / 'w1', folder / 'w2'):.1e}")

        times = sorted(runs[1].finished.values())
        done = len(times)
        slopes = {n: times[n - 1] / n for n in sorted({max(done // 4, 1), max(done // 2, 1), done})}
        print("seconds a material, one worker: " + ", ".join(f"{s:.1f} over {n}" for n, s in slopes.items()))
        size = sum(p.stat().st_size for p in (folder / "w1").iterdir() if p.stem in runs[1].finished) / count
        print(f"bytes a material: {size / 1e6:.1f} MB")

        out = folder / "killed"
        killed = Watched(str(database), "--workers", "2", out=out, cache=cache)
        killed.wait_for(count // 3 + 1)
        os.kill(killed.process.pid, signal.SIGKILL)
        killed.end()
        before = {p: p.stat().st_mtime_ns for stem in killed.finished for p in out.glob(f"{stem}.*")}
        resumed = Watched(str(database), "--workers", "2", out=out, cache=cache)
        code = resumed.end()
        untouched = all(p.stat().st_mtime_ns == time_ for p, time_ in before.items())
        total = (killed.seconds + resumed.seconds) / runs[2].seconds
        work = sum(sum(run.processor.values()) for run in (killed, resumed)) / sum(runs[2].processor.values())
        print(
            f"killed after {len(killed.finished)}, resumed: exit code {code}, finished ones untouched: {untouched}, "
            f"processor time of both / of one that is not killed: {work:.2f} (asked for: <= 1.1), time {total:.2f}"
        )
        print(f"difference to the run that was not killed: {difference(folder / 'w2', out):.1e}")

        rows = [
            ("two workers / one, throughput", "≥ 1.7", f"{runs[1].seconds / runs[2].seconds:.2f}"),
            ("a killed run and the resumed one / an uninterrupted run, processor time", "≤ 1.1", f"{work:.2f}"),
            ("seconds per material, one worker", "≤ 4 s of one core", f"{slopes[done]:.1f}"),
        ]
        record("bench_batch.py", rows)
        if "--cluster" in sys.argv:
            dask = Watched(str(database), "--cluster", "local:2", out=folder / "dask", cache=cache)
            dask.end()
            print(
                f"Dask, two workers: {dask.seconds:.0f} s, not spent on materials {1 - dask.work() / (2 * dask.seconds):.1%}, "
                f"difference {difference(folder / 'w2', folder / 'dask'):.1e}"
            )
            dask.print_memory()


if __name__ == "__main__":
    main()
