"""A 24-megapixel chart with 1,000 edges, from file to camera; reading the file and 1,000 single-edge fits in a batch."""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
from tests.oracle import slanted_edge, slanted_squares

from matcam import calibrate, edge_mtf_stack
from matcam.files.photographs import open_photograph
from results import record

HEIGHT, WIDTH, DEGREES, SIGMA, SNR, ROUNDS = 4000, 6000, 5, 0.6, 60, 5


def draw(folder: Path, pitch: int = 290, side: int = 140) -> np.ndarray:
    """The chart as files of 16 bits, and the places of its squares' sides."""
    picture, sides = slanted_squares.field((HEIGHT, WIDTH), pitch, side, DEGREES, SIGMA, dark=0.25, light=0.3)
    counts = np.random.default_rng(1).poisson(picture * SNR**2)
    codes = np.clip(14 * counts, 0, 65535).astype(np.uint16)
    (folder / "chart.png").write_bytes(imagecodecs.png_encode(codes, level=1))
    tifffile.imwrite(folder / "chart.tif", codes)
    return sides[:, :2]


def seconds(function, *arguments, **more) -> float:
    start = time.perf_counter()
    function(*arguments, **more)
    return time.perf_counter() - start


def main() -> None:
    regions = slanted_edge.photographs(slanted_edge.gaussian(SIGMA, height=128, width=48), SNR, 1000, 1)
    with tempfile.TemporaryDirectory() as folder:
        # in a process of its own, because drawing takes more memory than what is measured here
        subprocess.run([sys.executable, __file__, folder], check=True)
        rows = []
        for path in sorted(Path(folder).iterdir()):
            found = calibrate([path], tone="linear").channels["grey"]
            edge_mtf_stack(regions)
            ratios, ours, reads, fits = [], [], [], []
            for _ in range(ROUNDS):
                reads.append(seconds(open_photograph, path))
                fits.append(seconds(edge_mtf_stack, regions))
                ours.append(seconds(calibrate, [path], tone="linear"))
                ratios.append(ours[-1] / (reads[-1] + fits[-1]))
            print(
                f"{path.name}: {found.edges.x.size} edges measured, sigma {found.values[0]:.4f} +- {found.std[0]:.4f} "
                f"(true {SIGMA}); calibrate {statistics.median(ours):.2f} s, reading {statistics.median(reads):.2f} s, "
                f"1,000 fits {statistics.median(fits):.2f} s; ratio: median {statistics.median(ratios):.2f} "
                f"({min(ratios):.2f} to {max(ratios):.2f}; asked for: <= 2)"
            )
            shown = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f} in {ROUNDS} rounds)"
            rows.append((f"{path.name} with 1,044 edges, file to camera / reading and 1,000 fits", "≤ 2", shown))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    record("bench_calibrate.py", [*rows, ("peak memory", "< 2 GB", f"{peak:.2f} GiB")])
    print(f"peak memory: {peak:.2f} GiB (asked for: < 2 GB)")


if __name__ == "__main__":
    draw(Path(sys.argv[1])) if len(sys.argv) > 1 else main()
