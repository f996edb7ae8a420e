"""Whole tables of the oracle, stored under build/whole-tables because a simulation takes 20 to 60 s."""

import hashlib
import os
from pathlib import Path

import numpy as np

from tests.oracle import merl_lobe, sphere_cells, sphere_slice, whole_tables

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "build" / "whole-tables"
_SOURCES = merl_lobe, sphere_cells, sphere_slice, whole_tables


def stored(case, seed=0):
    """Whole table of a case, simulated where no file holds it. Noise is added after loading."""
    path = FOLDER / f"{case.name.replace(' ', '-')}-{_fingerprint(case)}.npz"
    if path.exists():
        with np.load(path) as file:
            terms = file["terms"]
    else:
        terms = whole_tables.records(case)
        FOLDER.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.partial.npz")
        np.savez(temporary, terms=terms)
        temporary.replace(path)
    return whole_tables.assemble(case, terms, seed)


def _fingerprint(case):
    """Hash of a case and of the sources that simulate it."""
    digest = hashlib.sha256(repr(case).encode())
    for module in _SOURCES:
        digest.update(Path(module.__file__).read_bytes())
    return digest.hexdigest()[:16]
