"""One slanted edge, both estimators, against a plain NumPy 4x-binned e-SFR of the same region; and a stack of 1,000."""

import statistics
import time

import numpy as np
from tests.oracle import slanted_edge as oracle

from matcam import edge_mtf, edge_mtf_stack
from results import record

REPEATS, EDGES = 200, 1000


def e_sfr(picture: np.ndarray) -> float:
    """ISO 12233 with straight fit, as everybody writes it: centroids, four bins to a pixel, derivative, window, FFT."""
    rows, columns = picture.shape
    x, y = np.arange(columns), np.arange(rows)
    slope = np.zeros_like(picture)
    slope[:, 1:-1] = (picture[:, 2:] - picture[:, :-2]) / 2
    position = np.full(rows, columns / 2)
    for _ in range(2):
        window = 0.54 + 0.46 * np.cos(np.clip((x - position[:, None]) / columns, -0.5, 0.5) * 2 * np.pi)
        weighted = slope * window
        line = np.polyfit(y, (weighted * x).sum(1) / weighted.sum(1), 1)
        position = np.polyval(line, y)
    distance = (x - line[0] * y[:, None]).ravel()
    bins = np.floor(4 * (distance - distance.min())).astype(int)
    esf = np.bincount(bins, picture.ravel()) / np.maximum(np.bincount(bins), 1)
    lsf = np.convolve(esf, (0.5, 0, -0.5), "same")[1:-1]
    at = np.arange(lsf.size) - np.argmax(np.abs(lsf))
    lsf = lsf * (0.54 + 0.46 * np.cos(np.clip(at / lsf.size, -0.5, 0.5) * 2 * np.pi))
    mtf = np.abs(np.fft.rfft(lsf))
    f = np.fft.rfftfreq(lsf.size, 0.25)
    mtf = mtf / mtf[0] / np.maximum(np.sinc(f / 2), 0.1)
    f = f / np.cos(np.arctan(line[0]))
    i = int(np.argmax(mtf < 0.5))
    return float(f[i - 1] + (mtf[i - 1] - 0.5) / (mtf[i - 1] - mtf[i]) * (f[i] - f[i - 1]))


def seconds(function, *arguments) -> float:
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def main() -> None:
    pictures = oracle.photographs(oracle.gaussian(0.5), 100, EDGES, 1)
    one = pictures[0]
    truth = oracle.gaussian_half(0.5)
    found = edge_mtf(one)
    edge_mtf_stack(pictures[:10])
    print(f"MTF50: true {truth:.4f}, ours {found.mtf50:.4f}, binned {e_sfr(one):.4f} cycles/px")
    ours, binned = zip(*((seconds(edge_mtf, one), seconds(e_sfr, one)) for _ in range(REPEATS)), strict=True)
    ratios = [a / b for a, b in zip(ours, binned, strict=True)]
    print(
        f"one edge: {1e3 * statistics.median(ours):.2f} ms, e-SFR {1e3 * statistics.median(binned):.2f} ms, "
        f"ratio: median {statistics.median(ratios):.2f} (asked for: <= 4)"
    )
    gains = []
    for _ in range(3):
        alone = statistics.median(seconds(edge_mtf, one) for _ in range(REPEATS))
        together = seconds(edge_mtf_stack, pictures) / EDGES
        gains.append(alone / together)
        print(
            f"stack of {EDGES}: {1e3 * together:.2f} ms an edge, {gains[-1]:.1f} times faster than {1e3 * alone:.2f} ms"
        )
    times = f"{1e3 * statistics.median(ours):.1f} ms / {1e3 * statistics.median(binned):.2f} ms"
    one_edge = f"{statistics.median(ratios):.1f} ({times})"
    record(
        "bench_edge.py",
        [
            ("`edge_mtf`, both estimators / plain NumPy e-SFR in 4 bins per px, 160 x 80 px", "≤ 4", one_edge),
            (
                "`edge_mtf`, one edge at a time / `edge_mtf_stack` of 1,000, per edge",
                "≥ 3",
                f"{statistics.median(gains):.1f}",
            ),
        ],
    )
    print(f"stack: median {statistics.median(gains):.2f} times faster per edge (asked for: >= 3)")


if __name__ == "__main__":
    main()
