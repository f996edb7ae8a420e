"""`matcam fresnel FILE` as a whole process, against a bare process that imports jax, xarray and matplotlib."""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from matcam import write_merl
from matcam.forward.measurement import simulated_chromium
from results import record

RUNS = 9


def run(command: list[str], folder: str, cache: str) -> tuple[float, float]:
    """Wall seconds and peak memory (GiB) of a process."""
    environment = {**os.environ, "XDG_CACHE_HOME": cache}
    start = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0
    return time.perf_counter() - start, usage.ru_maxrss / 2**20


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        table = sys.argv[1] if len(sys.argv) > 1 else f"{folder}/chromium.binary"
        if len(sys.argv) == 1:
            write_merl(table, simulated_chromium().clip(min=0))
        ours = [sys.executable, "-m", "matcam", "fresnel", str(Path(table).resolve()), "--force"]
        bare = {
            name: [sys.executable, "-c", f"import jax, xarray, {name}"] for name in ("matplotlib", "matplotlib.pyplot")
        }
        first, _ = run(ours, folder, folder)
        print(f"first run, nothing compiled yet: {first:.1f} s")
        ratios: dict[str, list[float]] = {name: [] for name in bare}
        memory = []
        for _ in range(RUNS):
            seconds, peak = run(ours, folder, folder)
            memory.append(peak)
            for name, command in bare.items():
                ratios[name].append(seconds / run(command, folder, folder)[0])
        for name, values in ratios.items():
            low, high = min(values), max(values)
            print(
                f"fresnel / import jax, xarray, {name}: median {statistics.median(values):.2f} ({low:.2f} to {high:.2f})"
            )
        values = ratios["matplotlib.pyplot"]
        shown = f"{statistics.median(values):.1f} ({min(values):.1f} to {max(values):.1f})"
        quantity = "`matcam fresnel FILE` / bare `import jax, xarray, matplotlib.pyplot`"
        used = ("peak memory of `matcam fresnel`", "< 1.5 GB", f"{max(memory):.2f} GiB")
        record("bench_fresnel_command.py", [(quantity, "≤ 3", shown), used])
        print(f"peak memory: {max(memory):.2f} GiB (asked for: ratio <= 3, < 1.5 GB)")


if __name__ == "__main__":
    main()
