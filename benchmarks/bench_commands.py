"""Processor and wall seconds and peak memory of whole commands: the very first on a machine, and with what it has kept.

The processor time with what was kept is also given over that of the imports which the command cannot do without.

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
_EDGE = """
import sys
import numpy as np
import tifffile
y, x = np.mgrid[-80:80, -40:40]
edge = 5000 + 40000 / (1 + np.exp(-2 * (x - 0.1 * y)))
tifffile.imwrite(sys.argv[1], np.random.default_rng(1).poisson(edge).astype(np.uint16))
"""
_SMALL, _LARGE = "import numpy, scipy.special, scipy.optimize, typer", "import jax, xarray, scipy.optimize, typer"
COMMANDS = {
    "predict": (_SMALL, ["predict", "0.001", "0.01", "0.1"]),
    "edge": (_SMALL, ["edge", "EDGE"]),
    "fresnel": (_LARGE, ["fresnel", "TABLE", "--metal", "Cr", "-o", "f.png", "--force"]),
    "correct": (_LARGE, ["correct", "TABLE", "-o", "c.binary", "--force"]),
}
"""What each command must import, and its words."""
REQUIRED = {"predict": "≤ 2", "edge": "≤ 2.5", "fresnel": "≤ 3", "correct": "≤ 5"}
"""Processor time of a warm command over that of its imports."""
WARM = 4


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
        edge = Path(folder, "edge.tif")
        subprocess.run([sys.executable, "-c", _EDGE, edge], check=True)
        given = {"TABLE": str(table), "EDGE": str(edge)}
        rows = []
        for name, (imports, words) in COMMANDS.items():
            cache = f"{folder}/cache-{name}"
            command = [sys.executable, "-m", "matcam", *(given.get(word, word) for word in words)]
            first, first_wall, first_peak = run(command, folder, cache)
            # in turns, so that what else the machine does weighs on both
            pairs = [
                (run([sys.executable, "-c", imports], folder, cache), run(command, folder, cache)) for _ in range(WARM)
            ]
            base, best = min(base for base, _ in pairs), min(one for _, one in pairs)
            print(
                f"{name}: first {first:.1f} s of processor time ({first_wall:.1f} s), {first_peak:.2f} GiB; "
                f"again {best[0]:.2f} s ({best[1]:.1f} s), {best[2]:.2f} GiB, {best[0] / base[0]:.2f} times its imports; "
                f"load {os.getloadavg()[0]:.1f}",
                flush=True,
            )
            ratio = f"{best[0] / base[0]:.2f} ({best[0]:.2f} s)"
            rows.append((f"`{name}`, warm: processor time over that of its imports", REQUIRED[name], ratio))
            rows.append((f"first `{name}` on a machine, wall time", "-", f"{first_wall:.1f} s"))
            rows.append(
                (f"peak memory of `{name}`, first and warm", "≤ 1.2 GiB", f"{first_peak:.2f} and {best[2]:.2f} GiB")
            )
        record("bench_commands.py", rows)


if __name__ == "__main__":
    main()
