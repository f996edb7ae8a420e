"""Processor and wall seconds and peak memory of whole commands: the very first on a machine, and with what it has kept.

This process must stay small: a child's peak begins at what its parent has held. So the table is simulated by another one.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from results import record

_SIMULATED = """
import sys
from matcam import write_merl
from matcam.forward.measurement import simulated_chromium
write_merl(sys.argv[1], simulated_chromium().clip(min=0))
"""
REQUIRED = {"predict": "≤ 1.5 s", "fresnel": "≤ 4 s", "correct": "≤ 8 s"}
COMMANDS = {
    "predict": ["predict", "0.001", "0.01", "0.1"],
    "fresnel": ["fresnel", "TABLE", "--metal", "Cr", "-o", "f.png", "--force"],
    "correct": ["correct", "TABLE", "-o", "c.binary", "--force"],
}
WARM = 3


def run(command: list[str], folder: str, cache: str) -> tuple[float, float, float]:
    """Processor seconds, wall seconds and peak memory (GiB) of a process."""
    start = time.perf_counter()
    process = subprocess.Popen(
        command, cwd=folder, env={**os.environ, "XDG_CACHE_HOME": cache}, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0
    return usage.ru_utime + usage.ru_stime, time.perf_counter() - start, usage.ru_maxrss / 2**20


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        table = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else Path(folder, "chromium.binary")
        if len(sys.argv) == 1:
            subprocess.run([sys.executable, "-c", _SIMULATED, table], check=True)
        rows = []
        for name, words in COMMANDS.items():
            command = [sys.executable, "-m", "matcam", *(str(table) if word == "TABLE" else word for word in words)]
            runs = [run(command, folder, f"{folder}/cache-{name}") for _ in range(1 + WARM)]
            (first, first_wall, first_peak), best = runs[0], min(runs[1:])
            print(
                f"{name}: first {first:.1f} s of processor time ({first_wall:.1f} s), {first_peak:.2f} GiB; "
                f"again {best[0]:.1f} s ({best[1]:.1f} s), {best[2]:.2f} GiB; load {os.getloadavg()[0]:.1f}",
                flush=True,
            )
            required = REQUIRED.get(name, "-")
            rows.append(
                (f"`{name}`, warm, wall time", required, f"{best[1]:.1f} s ({best[0]:.1f} s of processor time)")
            )
            rows.append((f"first `{name}` on a machine, wall time", "-", f"{first_wall:.1f} s"))
            rows.append(
                (f"peak memory of `{name}`, first and warm", "≤ 1.2 GiB", f"{first_peak:.2f} and {best[2]:.2f} GiB")
            )
        record("bench_commands.py", rows)


if __name__ == "__main__":
    main()
