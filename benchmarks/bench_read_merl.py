"""Reading a MERL file against the least that could be done: numpy.fromfile(...) * scale."""

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from matcam import read_merl, write_merl
from matcam.files.merl import SCALE
from matcam.forward.measurement import simulated_chromium
from results import record


def bare(path: Path) -> np.ndarray:
    return np.fromfile(path, "<f8", offset=12).reshape(3, 90, 90, 180) * SCALE[:, None, None, None]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chromium.binary"
        write_merl(path, simulated_chromium().clip(min=0))
        ratios = []
        for _ in range(21):
            start = time.perf_counter()
            bare(path)
            middle = time.perf_counter()
            read_merl(path)
            ratios.append((time.perf_counter() - middle) / (middle - start))
    measured = f"{statistics.median(ratios):.2f} (worst of 21: {max(ratios):.2f})"
    record("bench_read_merl.py", [("`read_merl` / `numpy.fromfile(...) * scale`", "≤ 3", measured)])
    print(
        f"read_merl / (fromfile * scale): median {statistics.median(ratios):.2f}, worst {max(ratios):.2f} of 21 (asked for: 3)"
    )


if __name__ == "__main__":
    main()
