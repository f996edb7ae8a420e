"""A 24-megapixel chart with about 4,000 edges: `calibrate`, and the whole command, beside MTF Mapper's command in turn.

MTF Mapper (C++; van den Bergh) is looked for as `mtf_mapper` on the PATH, or where the environment variable MTF_MAPPER
points. It writes the edges' MTF50s and curves, and draws nothing. Without it there is nothing to compare with. Arguments: the
kinds of file, `png` and `tif` if none is given.
"""

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from bench_calibrate import DEGREES, SIGMA, draw

PITCH, SIDE, ROUNDS = 148, 74, 3
NEAR = SIDE / 4  # px: what is measured further from every side's middle is no edge of the chart


def true_mtf50() -> float:
    """Of the drawn lens and pixel, which is alike for all sides of squares; cycles/px."""
    c, s = np.cos(np.radians(DEGREES)), np.sin(np.radians(DEGREES))
    passed = lambda f: np.exp(-2 * (np.pi * SIGMA * f) ** 2) * np.sinc(f * c) * np.sinc(f * s)  # noqa: E731
    return float(brentq(lambda f: passed(f) - 0.5, 0.01, 0.9))


def of_process(command: list[str], folder: Path) -> tuple[float, float]:
    """Wall and processor seconds of a process."""
    start = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{command[0]} failed with status {status}: {' '.join(command)}")
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime


def of_call(function, *arguments, **more) -> tuple[float, float]:
    """Wall and processor seconds of a call, all its threads together."""
    start = time.perf_counter(), time.process_time()
    function(*arguments, **more)
    return time.perf_counter() - start[0], time.process_time() - start[1]


def said(name: str, positions: np.ndarray, mtf50: np.ndarray, sides: np.ndarray) -> str:
    """How many of the drawn sides were measured, and how well."""
    distance, side = cKDTree(sides).query(positions)
    near = distance < NEAR
    error = (mtf50[near] / true_mtf50() - 1) * 100
    return (
        f"  {name}: {np.unique(side[near]).size} of {len(sides)} sides, {np.sum(~near)} elsewhere; error of MTF50: "
        f"median {np.median(error):+.2f} %, rms {np.sqrt(np.mean(error**2)):.2f} %, "
        f"median of sizes {np.median(np.abs(error)):.2f} %"
    )


def main() -> None:
    rival = os.environ.get("MTF_MAPPER") or shutil.which("mtf_mapper")
    if not rival:
        print("bench_rival: MTF Mapper is absent: put mtf_mapper on the PATH or name it in MTF_MAPPER")
        return
    from matcam import calibrate

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # in a process of its own, because drawing takes more memory than what is measured here
        subprocess.run([sys.executable, __file__, "--draw", name], check=True)
        sides = np.load(folder / "sides.npy")
        for path in (folder / f"chart.{kind}" for kind in sys.argv[1:] or ("png", "tif")):
            theirs = [rival, str(path), name, "-q", "-l", "-v", "2"]
            ours = [
                sys.executable,
                "-m",
                "matcam",
                "calibrate",
                str(path),
                "--tone",
                "linear",
                "-o",
                "c.json",
                "--force",
            ]
            found = calibrate([path], tone="linear").channels["grey"].edges
            of_process(ours, folder)  # from now on the command's compiled programs are kept
            rounds = []
            for _ in range(ROUNDS):
                rounds.append(
                    (of_process(theirs, folder), of_call(calibrate, [path], tone="linear"), of_process(ours, folder))
                )
                print(
                    "   ",
                    *(f"{wall:.1f} s ({used:.1f} s)" for wall, used in rounds[-1]),
                    f"load {os.getloadavg()[0]:.1f}",
                )
            read = np.loadtxt(folder / "edge_mtf_values.txt")
            print(
                f"{path.name}, true MTF50 {true_mtf50():.4f} cycles/px; seconds on the clock (of processor time), medians:"
            )
            print(said("MTF Mapper", read[:, 1:3], read[:, 3], sides))
            print(said("matcam", np.column_stack([found.x, found.y]), found.mtf50, sides))
            for which, what in enumerate(("MTF Mapper", "calibrate, warm", "matcam calibrate")):
                wall, used = (statistics.median(one[which][k] for one in rounds) for k in (0, 1))
                line = f"  {what}: {wall:.1f} s ({used:.1f} s)"
                for k, unit in enumerate(("on the clock", "of processor time") if which else ()):
                    ratios = [one[which][k] / one[0][k] for one in rounds]
                    line += f"; / MTF Mapper's {unit}: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
                print(line, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--draw"]:
        np.save(Path(sys.argv[2]) / "sides.npy", draw(Path(sys.argv[2]), PITCH, SIDE))
    else:
        main()
