"""Small databases of MERL files, made quickly."""

import numpy as np

from matcam.angles import GRID_SHAPE, below_horizon
from matcam.files.merl import SCALE

HIDDEN = below_horizon("centre")


def write_table(path, seed):
    """A MERL file of random values, missing below the horizon."""
    values = np.random.default_rng(seed).random((3, *GRID_SHAPE), dtype=np.float64) / SCALE[:, None, None, None]
    values[:, HIDDEN] = -1.0
    with path.open("wb") as file:
        np.array(GRID_SHAPE, dtype="<i4").tofile(file)
        values.tofile(file)
    return path


def write_database(folder, names):
    """One table for each name."""
    folder.mkdir(exist_ok=True)
    for seed, name in enumerate(names):
        write_table(folder / f"{name}.binary", seed)
    return folder
