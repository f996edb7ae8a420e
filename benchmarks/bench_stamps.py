"""10,000 stamps of 16 x 16 px of Gaussian highlights through a Gaussian lens and a box pixel: throughput against GalSim.

GalSim draws a part of them, one by one as it must: with its default accuracy, and with one that reaches 5e-7 of the peak,
as ours must. Errors are against GalSim at its tightest.
"""

import os
import statistics
import time

import galsim
import numpy as np

from matcam import Camera, GaussianOptics
from matcam.forward import Highlights, highlight_stamps
from results import record

STAMPS, SIZE, SIGMA, DRAWN, CHECKED, ROUNDS = 10_000, 16, 0.5, 200, 60, 9
TIGHT = galsim.GSParams(
    folding_threshold=1e-9, maxk_threshold=1e-10, kvalue_accuracy=1e-12, xvalue_accuracy=1e-12, maximum_fft_size=32768
)
EQUAL = galsim.GSParams(folding_threshold=1e-7, maxk_threshold=1e-6, kvalue_accuracy=1e-8, xvalue_accuracy=1e-8)


def draw(flux, x, y, along, across, angle, accuracy):
    highlight = galsim.Gaussian(sigma=np.sqrt(along * across), flux=flux, gsparams=accuracy)
    if angle is None:
        highlight = highlight.transform(np.sqrt(along / across), 0, 0, np.sqrt(across / along))
    else:
        highlight = highlight.shear(q=across / along, beta=angle * galsim.radians)
    lens, pixel = galsim.Gaussian(sigma=SIGMA, gsparams=accuracy), galsim.Pixel(1)
    profile = galsim.Convolve([highlight, lens, pixel], gsparams=accuracy)
    image = profile.drawImage(nx=SIZE, ny=SIZE, scale=1, method="no_pixel", offset=(x, y), dtype=float)
    return image.array[::-1]


def main() -> None:
    random = np.random.default_rng(0)
    highlights = [random.uniform(0.5, 2, STAMPS), *random.uniform(-1, 1, (2, STAMPS))]
    highlights += [random.uniform(0.5, 1.5, STAMPS), random.uniform(0.1, 0.5, STAMPS)]
    angles = random.uniform(0, np.pi, STAMPS)
    camera = Camera(GaussianOptics(SIGMA))
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    rows = []
    for name, angle, asked in (("aligned", None, 200), ("any orientation", angles, 50)):
        numbers = [*highlights] if angle is None else [*highlights, angle]

        def drawn(count, accuracy, numbers=numbers):
            return [draw(*([*(a[k] for a in numbers), None][:6]), accuracy) for k in range(count)]

        ours = np.asarray(highlight_stamps(camera, SIZE, Highlights(*numbers)))
        truth = drawn(CHECKED, TIGHT)
        print(f"{name}: our error {worst(ours, truth):.1e} of the peak (asked for 5e-7)")
        for words, accuracy in (("its default accuracy", None), ("an accuracy like ours must be", EQUAL)):
            ratios = []
            for _ in range(ROUNDS):
                start = time.perf_counter()
                highlight_stamps(camera, SIZE, Highlights(*numbers)).block_until_ready()
                middle = time.perf_counter()
                theirs = drawn(DRAWN, accuracy)
                ratios.append((time.perf_counter() - middle) / DRAWN * STAMPS / (middle - start))
            quantity = f"10,000 stamps of 16 x 16 px, {name}: throughput / GalSim's at {words}"
            shown = f"{statistics.median(ratios):.0f} ({min(ratios):.0f} to {max(ratios):.0f} in {ROUNDS} rounds)"
            rows.append((quantity, f"≥ {asked}", shown))
            print(
                f"  {statistics.median(ratios):.0f} x GalSim's throughput at {words} (error {worst(theirs, truth):.1e}); "
                f"{min(ratios):.0f} to {max(ratios):.0f} in {ROUNDS} rounds, asked for {asked}"
            )
    record("bench_stamps.py", rows)


def worst(stamps, truth):
    return max(np.abs(a - b).max() / b.max() for a, b in zip(stamps, truth, strict=False))


if __name__ == "__main__":
    main()
