"""Small databases of MERL files, made quickly."""

import numpy as np

from matcam.core.grid import GRID_SHAPE, below_horizon
from matcam.files.merl import SCALE

HIDDEN = below_horizon("centre")


def write_table(path, seed):
    """A MERL file of a few random values, which are compressed quickly; missing below the horizon."""
    few = np.random.default_rng(seed).integers(1, 200, (3, 90, 90, 1)) / 64
    values = np.broadcast_to(few, (3, *GRID_SHAPE)) / SCALE[:, None, None, None]
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
