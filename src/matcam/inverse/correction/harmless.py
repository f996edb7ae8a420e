"""Doing no harm: no entry of a table is moved further than the data determine, nor beyond what a surface can reflect.

- The ratio of true over recorded lobe shrinks to 1 by its own variance: the logarithm L, of standard deviation s, becomes
  L (1 - s^2 / L^2), and 0 where s exceeds |L| (the positive part of James & Stein's estimate). What is well known stays.
- Where rig and data contradict each other the ratio is 1, and what it would have been is its standard deviation.
- The light that leaves a surface in all directions is at most the light that falls on it (albedo, docs/model.md 1): what the
  correction adds is cut down where it would break that. A table that breaks it by itself does not get worse.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid

ROWS = tuple(slice(start, start + 10) for start in range(0, GRID_SHAPE[0], 10))
"""Rows of a table that are worked on at a time: all at once would need several times the table's memory."""
_AZIMUTHS = 72
_DIRECTIONS = np.radians(np.arange(90) + 0.5)


class LobeRatio(NamedTuple):
    """Hold true over recorded lobe; arrays over a table's angles, (90, 90, 180).

    Attributes:
        log: ln(true / recorded).
        std: standard deviation of the ratio over its value: fitted parameters, shape, rig and doubts.
    """

    log: np.ndarray
    std: np.ndarray


def withheld(ratio: LobeRatio) -> LobeRatio:
    """Return no correction: what it would have been is uncertainty."""
    return LobeRatio(
        np.zeros_like(ratio.log), np.hypot(np.expm1(ratio.log), np.maximum(np.exp(ratio.log), 1) * ratio.std)
    )


def shrunk(ratio: LobeRatio, no_camera: float) -> LobeRatio:
    """Return the mean of a ratio and of none at all, shrunk to 1. no_camera: probability that none is needed."""
    mean = (1 - no_camera) * ratio.log
    variance = (1 - no_camera) * ratio.std**2 + no_camera * (1 - no_camera) * ratio.log**2
    known = ~(variance >= mean**2)  # what is missing stays missing
    share = 1 - np.divide(variance, mean**2, out=np.ones_like(mean), where=known)
    lost = np.expm1(mean * (1 - share))
    return LobeRatio(mean * share, np.sqrt(variance + lost**2))


class EnergyLimit(NamedTuple):
    """Hold by how much what a correction adds is cut down, for light and view alike: the result is as reciprocal as it was.

    Attributes:
        share: (directions, channels), share that stays of what is added in directions beside the normal.
        light: (90, 90, 180), direction of each entry's light.
        view: the same of its view.
    """

    share: np.ndarray
    light: np.ndarray
    view: np.ndarray

    @property
    def none(self) -> bool:
        """Say whether nothing is cut down."""
        return bool((self.share == 1).all())

    def of(self, rows: slice, recorded: np.ndarray, corrected: np.ndarray) -> np.ndarray:
        """Return some rows of a corrected table as far as energy allows, (rows, 90, 180, channels)."""
        change = corrected - recorded
        allowed = np.minimum(self.share[self.light[rows]], self.share[self.view[rows]])
        return np.where(change > 0, recorded + change * allowed, corrected)


def energy_limit(recorded: np.ndarray, corrected: np.ndarray, sampling: Sampling) -> EnergyLimit:
    """Return what keeps the albedo of a corrected table at 1 at most, or the recorded one's, in each direction and channel.

    Both are (90, 90, 180, channels), 1/sr; missing entries send nothing.
    """
    cells, weight = _albedo_rule()
    there = [table.reshape(-1, table.shape[-1])[cells] for table in (recorded, corrected)]
    change = np.nan_to_num(there[1] - there[0])
    before = albedo(recorded)
    added, taken = (weight @ np.maximum(side * change, 0) for side in (1, -1))
    room = np.maximum(1.0, before) - before + taken
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(added > room, room / added, 1.0)
    # of the directions on either side of an entry's own, the stricter
    share = np.minimum(share, np.minimum(np.r_[share[1:], share[-1:]], np.r_[share[:1], share[:-1]]))
    return EnergyLimit(share, *_directions(sampling))


def within_energy(recorded: np.ndarray, corrected: np.ndarray, sampling: Sampling) -> np.ndarray:
    """Return a corrected table as far as energy allows (`energy_limit`)."""
    limit = energy_limit(recorded, corrected, sampling)
    if limit.none:
        return corrected
    limited = np.empty_like(corrected)
    for rows in ROWS:
        limited[rows] = limit.of(rows, recorded[rows], corrected[rows])
    return limited


def albedo(table: np.ndarray) -> np.ndarray:
    """Return the light that a table sends into all directions, per light that falls on it; (directions, channels).

    Directions are 0.5, 1.5 ... 89.5 degrees from the normal. The integral goes over half vectors, where a lobe's cells are:
    4 brdf cos_o (light . half) over their solid angle.
    """
    cells, weight = _albedo_rule()
    return weight @ np.nan_to_num(table.reshape(-1, table.shape[-1])[cells])


@cache
def _albedo_rule() -> tuple[np.ndarray, csr_matrix]:
    """Return the cells that the integrals read, and the weight of each in each direction's, (directions, cells)."""
    edges = np.pi / 2 * (np.arange(GRID_SHAPE[0] + 1) / GRID_SHAPE[0]) ** 2
    ring = -np.diff(np.cos(edges))
    theta = ((edges[:-1] + edges[1:]) / 2)[:, None]
    turn = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    rows = []
    for direction in _DIRECTIONS:
        cos_d = np.cos(direction) * np.cos(theta) + np.sin(direction) * np.sin(theta) * np.cos(turn)
        cos_o = 2 * cos_d * np.cos(theta) - np.cos(direction)
        x = np.cos(theta) * np.sin(direction) * np.cos(turn) - np.sin(theta) * np.cos(direction)
        phi_d = np.arctan2(-np.sin(direction) * np.sin(turn) + 0 * theta, x) % np.pi
        seen = (cos_d > 0) & (cos_o > 0)
        theta_d = np.arccos(np.clip(cos_d, 0, 1))
        at = merl_grid("centre").index(theta_h=theta + 0 * turn, theta_d=theta_d, phi_d=phi_d)
        index = np.ravel_multi_index(at, GRID_SHAPE)
        weight = 4 * cos_d * cos_o * ring[:, None] * (2 * np.pi / _AZIMUTHS)
        rows.append((index[seen], weight[seen]))
    cells, place = np.unique(np.concatenate([index for index, _ in rows]), return_inverse=True)
    counts = np.cumsum([0, *(index.size for index, _ in rows)])
    weights = np.concatenate([weight for _, weight in rows])
    return cells, csr_matrix((weights, place, counts), shape=(len(rows), cells.size))


@cache
def _directions(sampling: Sampling) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices among the directions of each cell's light and view."""
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    return tuple(
        np.clip(np.degrees(np.arccos(np.clip(cos, 0, 1))).astype(int), 0, 89) for cos in (mean - half, mean + half)
    )
