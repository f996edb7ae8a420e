"""Records of the materials of cases, by the independent quadrature of tests/oracle. Imports nothing of the package under test.

Records are kept in a folder, because those of one table take 15 to 80 s of processor time.
"""

import hashlib
import os
from pathlib import Path

import numpy as np
from tests.oracle import merl_lobe, real_pixels, sphere_cells, sphere_slice, whole_tables
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H

_SOURCES = merl_lobe, real_pixels, sphere_cells, sphere_slice, whole_tables


def kept(case, folder):
    """Records of a case, read from the folder, or computed and kept there."""
    path = Path(folder) / "records" / f"{fingerprint(case)}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.partial.npz")
        np.savez(temporary, **records(case))
        temporary.replace(path)
    with np.load(path) as file:
        return dict(file)


def fingerprint(case):
    """Hash of everything that records depend on: material, lens, cell rule, and sources. Noise is added later."""
    digest = hashlib.sha256(repr((case.table.terms, case.table.setup, case.rule, case.phase)).encode())
    for path in [Path(module.__file__) for module in _SOURCES] + [Path(__file__)]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def records(case, slices=None):
    """Records of each term at a factor of 1, 1/sr: of cells (rule "centre"), or of the pixels of each slice."""
    if case.rule == "centre":
        return {"cells": whole_tables.records(case.table, slices)}
    rules = _rules(case)
    chosen = range(90) if slices is None else slices
    return {f"pixels-{j}": _pixel_records(case, rules, j) for j in chosen}


def _rules(case):
    def light(s2, cos_i, cos_o):
        return np.stack([term.light(s2, cos_i, cos_o) for term in case.table.terms])

    return sphere_slice.Slices(case.table.setup, light, whole_tables.finest(case.table))


def _pixel_records(case, rules, j):
    """Records (terms, pixels) of the pixels that the cells of slice j are looked up in, 1/sr."""
    position = pixels(case, j)[2]
    both = rules.records(THETA_D[j], position[:, 0], np.abs(position[:, 1]))
    at = np.where(position[:, 1] >= 0, both[..., 0], both[..., 1])
    return at / real_pixels.light_cosine(position, THETA_D[j])


def pixels(case, j):
    """Shares (cells, n) and numbers (cells, n) of the pixels behind the cells of slice j, and positions (pixels, 2), px.

    Only pixels with a share are numbered.
    """
    th, ph = (a.ravel() for a in np.broadcast_arrays(THETA_H[:, None], PHI_D))
    found = real_pixels.behind(case.rule, np.array(case.phase), th, THETA_D[j], ph)
    used = found.share > 0
    whole = np.rint(found.position[used] - case.phase).astype(int)
    positions, index = np.unique(whole, axis=0, return_inverse=True)
    number = np.zeros(found.share.shape, int)
    number[used] = index.ravel()
    return found.share, number, positions + np.array(case.phase)
