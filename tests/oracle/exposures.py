"""Frames of a simulated sensor, one formula a line (EMVA Standard 1288): the truth of tests/calibration/test_sensor.py."""

from pathlib import Path

import numpy as np
import tifffile

GAIN, READ_NOISE, BLACK, WELL, PRNU, DSNU, CURRENT, RATE = 0.25, 9.0, 40.0, 14_000.0, 0.012, 3.0, 400.0, 300_000.0
"""DN per e-, e-, DN, e-, 1, e-, e-/s, and e-/s from the lamp."""
TIMES = np.round(np.linspace(0.0035, 0.056, 16), 6)
"""Exposure times, s: the last ones are beyond the converter's 4095 DN (16,220 e-) and the well."""


def frames(random, seconds, count, light=1.0, shape=(90, 120), bits=12):
    """`count` frames, uint16. The same sensor for every call: its patterns have a seed of their own."""
    own = np.random.default_rng(11)
    sensitivity = 1 + PRNU * own.standard_normal(shape)
    offset = DSNU * own.standard_normal(shape)
    electrons = RATE * light * seconds * sensitivity + CURRENT * seconds
    charge = np.minimum(random.poisson(electrons, (count, *shape)), WELL)
    read = charge + offset + READ_NOISE * random.standard_normal((count, *shape))
    return np.clip(np.round(GAIN * read + BLACK), 0, 2**bits - 1).astype(np.uint16)


def write_folder(folder, seed=0, stack=16, times=TIMES, light=None):
    """A folder of flat and dark frames by their names. `light`: relative light by exposure time, where the lamp erred."""
    random = np.random.default_rng(seed)
    Path(folder).mkdir(parents=True, exist_ok=True)
    for seconds in times:
        for kind, lit in (("flat", (light or {}).get(seconds, 1.0)), ("dark", 0.0)):
            count = stack if np.isclose(seconds, TIMES[7]) else 2
            for number, frame in enumerate(frames(random, seconds, count, lit)):
                tifffile.imwrite(Path(folder) / f"{kind}_{1e3 * seconds:g}ms_{number}.tif", frame)


def write_descriptor(folder, seed=0):
    """The same as a data set of the EMVA 1288 working group: photons stand in the descriptor, two frames each, and a stack."""
    random = np.random.default_rng(seed)
    (Path(folder) / "images").mkdir(parents=True)
    lines = ["# a comment", "v 3.0", "n 12 120 90"]
    for number, (seconds, count) in enumerate([*((t, 2) for t in TIMES), (TIMES[7] + 1e-6, 20)]):
        for kind, lit in (("b", 1.0), ("d", 0.0)):
            photons = f" {2 * RATE * seconds:.3f}" if lit else ""
            lines.append(f"{kind} {1e9 * seconds:.1f}{photons}")
            for index, frame in enumerate(frames(random, seconds, count, lit)):
                tifffile.imwrite(Path(folder) / "images" / f"{kind}_{number:03d}_{index}.tif", frame)
                lines.append(f"i images\\{kind}_{number:03d}_{index}.tif")
    path = Path(folder) / "EMVA1288_Data.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
