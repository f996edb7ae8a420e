"""Limits of a correction: no entry changes by more than the data determine, or beyond what a surface can reflect.

- The ratio of true over recorded lobe shrinks to 1 by its own variance: the logarithm L, of standard deviation s, becomes
  L (1 - s^2 / L^2), and 0 where s exceeds |L| (the positive part of James & Stein's estimate). Well determined
  corrections stay.
- Where rig and data contradict each other the ratio is 1, and the change that the rig predicts is its standard deviation.
- The light that leaves a surface in all directions is at most the light that falls on it (albedo, docs/model.md 1). Where a
  correction would break that, its additions are lowered within their standard deviation.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.remark import Remark
from matcam.inverse.normalised_fresnel import NO_CAMERA
from matcam.numerics.fit_budget import VariancePart, scaled_parts

ROWS = tuple(slice(start, start + 10) for start in range(0, GRID_SHAPE[0], 10))
"""Rows of a table that are processed at a time, to limit memory."""
PEAK = (0, slice(None), GRID_SHAPE[2] // 2)
"""Index of the peak of every slice across the plane of incidence, for which sources of uncertainty are kept."""
_AZIMUTHS = 72
_MOST_STEPS = 2.0
"""Standard deviations by which the energy limit lowers an entry at most: the 95 % bound. Beyond it the absolute scale
of the table is a more likely cause of an albedo above 1.
"""
_TRIED_STEPS = np.linspace(0, _MOST_STEPS, 41)[1:]
_DIRECTIONS = np.radians(np.arange(90) + 0.5)


class LobeRatio(NamedTuple):
    """Ratio of true to recorded lobe; arrays over the angles of a table, (90, 90, 180).

    Attributes:
        log: ln(true / recorded).
        std: relative standard deviation of the ratio: fitted parameters, shape, rig and alternatives.
        recorded: recorded lobe over the largest one of its slice (no unit): where it is below the noise, a ratio that
            multiplies the data is meaningless. Default: None, not known.
        parts: sources of the variance `std`^2 at the peak of each slice, (90,). Default: none.
    """

    log: np.ndarray
    std: np.ndarray
    recorded: np.ndarray | None = None
    parts: tuple[VariancePart, ...] = ()

    def parts_with(self, name: str, added: np.ndarray, factor: np.ndarray | float = 1.0) -> tuple[VariancePart, ...]:
        """Update the sources after a change of the variance.

        name: name of the added source. added: variance of the added source, (90, 90, 180). factor: factor of the variances of
        the other sources.
        """
        if not self.parts:
            return ()
        factor = factor if isinstance(factor, float) else factor[PEAK]
        return (*scaled_parts(self.parts, factor), VariancePart(name, "B", added[PEAK]))


def withheld(ratio: LobeRatio) -> LobeRatio:
    """Set the correction to none, with its size as uncertainty."""
    change, factor = np.expm1(ratio.log), np.maximum(np.exp(ratio.log), 1)
    return ratio._replace(
        log=np.zeros_like(ratio.log),
        std=np.hypot(change, factor * ratio.std),
        parts=ratio.parts_with("correction that is withheld", change**2, factor**2),
    )


def shrunk(ratio: LobeRatio, no_camera: float) -> LobeRatio:
    """Average the ratio and no correction, and shrink the mean to 1. no_camera: probability that no correction is needed."""
    mean = (1 - no_camera) * ratio.log
    variance = (1 - no_camera) * ratio.std**2 + no_camera * (1 - no_camera) * ratio.log**2
    known = ~(variance >= mean**2)  # missing values stay missing
    share = 1 - np.divide(variance, mean**2, out=np.ones_like(mean), where=known)
    lost = np.expm1(mean * (1 - share))
    parts = ratio.parts_with(NO_CAMERA, no_camera * (1 - no_camera) * ratio.log**2, 1 - no_camera)
    parts = ratio._replace(parts=parts).parts_with("correction that its error does not support", lost**2)
    return ratio._replace(log=mean * share, std=np.sqrt(variance + lost**2), parts=parts)


def above_noise(ratio: LobeRatio, floor: np.ndarray) -> LobeRatio:
    """Limit a ratio to entries whose recorded lobe exceeds the noise.

    A recorded value is the lobe m plus noise n. The linear estimate of least error multiplies the logarithm of the
    ratio by m^2 / (m^2 + n^2) (Wiener's weight). The removed part is added to the standard deviation.

    floor: (90,), noise floor of a pixel over the largest recorded lobe of each slice, no unit.
    """
    assert ratio.recorded is not None
    share = ratio.recorded**2 / (ratio.recorded**2 + floor[:, None] ** 2)
    log = share * ratio.log
    lost = np.expm1(ratio.log - log)
    parts = ratio.parts_with("correction of what is below the noise", lost**2)
    return ratio._replace(log=log, std=np.hypot(ratio.std, np.abs(lost)), parts=parts)


class EnergyLimit(NamedTuple):
    """Reduction of the additions of a correction, symmetric in light and view, so that reciprocity is kept.

    Attributes:
        steps: (directions, channels), standard deviations of the correction by which additions are lowered.
        excess: (directions, channels), albedo above the limit that remains.
        light: (90, 90, 180), index of the direction of each entry's light.
        view: (90, 90, 180), index of the direction of each entry's view.
    """

    steps: np.ndarray
    excess: np.ndarray
    light: np.ndarray
    view: np.ndarray

    @property
    def acts(self) -> bool:
        """Check whether any entry is lowered."""
        return bool((self.steps > 0).any())

    @property
    def remark(self) -> Remark:
        """State size and extent of the reduction."""
        limited = int((self.steps > 0).any(axis=1).sum())
        text = (
            f"the corrected table would reflect more light than it receives in {limited} of {len(self.steps)} directions: "
            f"the entries there were lowered by up to {self.steps.max():.1f} standard deviations of the correction"
        )
        if self.excess.max() > 0:
            text += (
                f"; an excess of up to {self.excess.max():.1%} remains, because the correction is better known than that: "
                "check the absolute scale of the table"
            )
        return Remark("energy-limit", text)

    def of(self, rows: slice, recorded: np.ndarray, corrected: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Lower some rows of a corrected table, (rows, 90, 180, channels), not below the recorded values."""
        steps = np.maximum(self.steps[self.light[rows]], self.steps[self.view[rows]])
        return np.where(corrected > recorded, np.maximum(corrected - steps * std, recorded), corrected)


def energy_limit(recorded: np.ndarray, corrected: np.ndarray, std: np.ndarray, sampling: Sampling) -> EnergyLimit:
    """Compute the reduction that keeps the albedo of each direction and channel at 1, or at the recorded one if larger.

    The errors of a correction are correlated over a direction, because one fit made them. The projection on the limit
    then moves every entry of the direction by the same number of its own standard deviations, at most `_MOST_STEPS`:
    determined entries stay. Negative noise must not be clipped beforehand, as clipping adds light.

    recorded, corrected: tables, (90, 90, 180, channels), 1/sr; missing entries are treated as 0. std: standard deviation of
    the correction, 1/sr; NaN for an uncorrected entry, which may be as low as 0.
    """
    cells, weight = _albedo_rule()
    before, after, error = (table.reshape(-1, table.shape[-1])[cells] for table in (recorded, corrected, std))
    known = np.isfinite(after) & np.isfinite(error)
    sent = weight @ np.nan_to_num(before)
    before, after, error = (np.where(known, part, 0.0) for part in (before, after, error))
    excess = weight @ after - np.maximum(1.0, sent)
    added = np.maximum(after - before, 0)
    steps, left = np.zeros_like(excess), np.maximum(excess, 0)
    for tried in _TRIED_STEPS if (excess > 0).any() else ():
        now = excess - weight @ np.minimum(tried * error, added)
        better = left > 0
        steps[better], left[better] = tried, np.maximum(now, 0)[better]
    # an entry lies between two directions: the larger reduction applies
    steps = np.maximum(steps, np.maximum(np.r_[steps[1:], steps[-1:]], np.r_[steps[:1], steps[:-1]]))
    return EnergyLimit(steps, left, *_directions(sampling))


def albedo(table: np.ndarray) -> np.ndarray:
    """Compute the directional albedo of a table, (directions, channels).

    Directions are 0.5, 1.5 ... 89.5 degrees from the normal. The integral goes over half vectors, where a lobe's cells are:
    4 brdf cos_o (light . half) over their solid angle.
    """
    cells, weight = _albedo_rule()
    return weight @ np.nan_to_num(table.reshape(-1, table.shape[-1])[cells])


@cache
def _albedo_rule() -> tuple[np.ndarray, csr_matrix]:
    """Return the cells that the integrals use, and their weights for each direction, (directions, cells)."""
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
    cells, position = np.unique(np.concatenate([index for index, _ in rows]), return_inverse=True)
    counts = np.cumsum([0, *(index.size for index, _ in rows)])
    weights = np.concatenate([weight for _, weight in rows])
    return cells, csr_matrix((weights, position, counts), shape=(len(rows), cells.size))


@cache
def _directions(sampling: Sampling) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices among the directions of each cell's light and view."""
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    return tuple(
        np.clip(np.degrees(np.arccos(np.clip(cos, 0, 1))).astype(int), 0, 89) for cos in (mean - half, mean + half)
    )
