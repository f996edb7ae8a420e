"""Recorded tables and truth of cases. Imports nothing of the package under test."""

import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmarks.recovery import records
from tests.oracle import whole_tables
from tests.oracle.merl_lobe import THETA_D

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "recovery"
EDGE = 5.0
"""Distance from limb and terminator, px, of the pixels whose cells are judged: the kernel is below 1e-10 there."""


class Table(NamedTuple):
    """Tables (90, 90, 180, 3), 1/sr, NaN below the horizon: recorded with noise, recorded without, and the material's own.

    judged: (90, 90, 180), cells whose pixels lie at least EDGE px inside the lit part of the sphere.
    """

    recorded: np.ndarray
    clean: np.ndarray
    true: np.ndarray
    judged: np.ndarray


def table(case, folder=FOLDER):
    """Table of a case; its records are read from the folder, or made and kept there."""
    return assemble(case, records.kept(case, folder))


def assemble(case, kept):
    """Table of a case from its records."""
    recorded, clean = _of_cells(case.table, kept["cells"]) if case.rule == "centre" else _of_pixels(case, kept)
    return Table(recorded, clean, whole_tables.truth(case.table), judged_cells())


def _of_cells(case, terms):
    """Recorded and clean table, of cells with a pixel at each of their positions."""
    factors = np.array([term.factor(THETA_D) for term in case.terms])
    pairs = np.einsum("thdpw,tdc->hdpwc", terms, factors)
    return whole_tables.noisy(case, pairs), pairs.mean(-2)


def _of_pixels(case, kept):
    """Recorded and clean table, of cells that are looked up in photographs; NaN in slices without records."""
    recorded, clean = np.full((90, 90, 180, 3), np.nan), np.full((90, 90, 180, 3), np.nan)
    random = np.random.default_rng(zlib.crc32(case.name.encode()))
    factors = [term.factor(THETA_D) for term in case.table.terms]
    for j in (j for j in range(90) if f"pixels-{j}" in kept):
        share, number, _ = records.pixels(case, j)
        own = sum(terms[:, None] * factor[j] for terms, factor in zip(kept[f"pixels-{j}"], factors, strict=True))
        e = random.standard_normal((2, *own.shape))
        noisy = own * (1 + case.table.relative * e[0]) + case.table.floor * own.max(0) * e[1]
        noisy = noisy * (1 + case.table.gain * random.standard_normal(3))
        _, _, cos_i, cos_o = whole_tables.positions(THETA_D[j])
        lit = share.any(1).reshape(90, 180) & ((cos_i > 0) & (cos_o > 0)).all(-1)
        for target, values in ((recorded, noisy), (clean, own)):
            cells = np.einsum("cn,cnk->ck", share, values[number]).reshape(90, 180, 3)
            target[:, j] = np.where(lit[..., None], cells, np.nan)
    return recorded, clean


def judged_cells():
    """Cells (90, 90, 180) whose pixels in both reciprocal configurations lie EDGE px inside limb and terminator."""
    out = np.zeros((90, 90, 180), bool)
    for j, theta_d in enumerate(THETA_D):
        x, y, cos_i, cos_o = whole_tables.positions(theta_d)
        dark = -np.cos(2 * theta_d) * np.sqrt(np.maximum(256.0**2 - y**2, 0))
        inside = np.minimum(256.0 - np.hypot(x, y), x - dark)
        out[:, j] = ((cos_i > 0) & (cos_o > 0) & (inside > EDGE)).all(-1)
    return out
