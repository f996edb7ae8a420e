"""Limits of a correction: uncertain corrections are reduced, and the albedo remains physically possible.

- The logarithm L of the ratio of true to recorded lobe has the standard deviation s. It is reduced to L (1 - s^2 / L^2), or to
  0 if s exceeds |L| (the positive-part estimator of James and Stein). Well determined corrections hardly change.
- If rig and data contradict each other, the ratio is 1. Its standard deviation is the change that the rig predicts.
- The directional albedo of a surface is at most 1 (docs/model.md 1). If a corrected table would exceed this limit, the
  increases of the values are reduced by at most two standard deviations of the correction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.core.remark import Remark
from matcam.inverse.normalised_fresnel import CHANNELS, NO_CAMERA
from matcam.material.material import albedo_remarks
from matcam.numerics.fit_budget import VariancePart, scaled_parts

ROWS = tuple(slice(start, start + 10) for start in range(0, GRID_SHAPE[0], 10))
"""Blocks of rows of a table that are processed one after the other, to limit memory."""
PEAK = (0, slice(None), GRID_SHAPE[2] // 2)
"""Index of the peak of every slice at phi_d = 90 degrees. The sources of uncertainty are stored for these entries only."""
_AZIMUTHS = 72
_MOST_STEPS = 2.0
"""Largest reduction of an entry by the energy limit, in standard deviations: the 95 % bound. If the albedo is still above 1, a
wrong absolute scale of the table is the more likely cause.
"""
_TRIED_STEPS = np.linspace(0, _MOST_STEPS, 41)[1:]
_HALF_CELL = np.radians(0.5)
"""Half of a cell in theta_d and phi_d, rad."""
BEFORE_LIMB = np.radians(80.5)
"""Largest angle to the normal, rad, up to which the albedo of a recorded table is judged. At larger angles its pixels contain
the limb, and the albedo may exceed 1 for this reason.
"""


class LobeRatio(NamedTuple):
    """Ratio of true to recorded lobe for all entries of a table, (90, 90, 180, colours).

    There is one colour if the lens is achromatic.

    Attributes:
        log: ln(true / recorded).
        std: relative standard deviation of the ratio, due to fitted parameters, shape, rig and alternatives.
        seen: True for entries that are corrected.
        recorded: recorded lobe for F = 1, 1/sr. A correction by the ratio is meaningless for
            entries whose lobe is below the noise.
        base: recorded / true value of the rough base under the lobe (no unit).
        mixing: derivative of `log` with respect to a relative change of the lobe that depends on theta_h (no unit), from 0
            to 1. It is 0 for entries that contain only light of their own theta_h.
        parts: sources of the variance `std`^2 at the peak of each slice, (90, colours). Default: none.
    """

    log: np.ndarray
    std: np.ndarray
    seen: np.ndarray
    recorded: np.ndarray
    base: np.ndarray
    mixing: np.ndarray
    parts: tuple[VariancePart, ...] = ()

    @classmethod
    def of_colours(cls, ratios: Sequence[LobeRatio]) -> LobeRatio:
        """Combine the ratios of the colours, whose arrays have no axis of the colours."""

        def stacked(arrays: Iterable[Any]) -> np.ndarray:
            return np.stack(list(arrays), axis=-1)

        log, std, seen, recorded, base, mixing = (
            stacked(arrays) for arrays in zip(*(one[:6] for one in ratios), strict=True)
        )
        sources = zip(*(one.parts for one in ratios), strict=True)
        parts = tuple(own[0]._replace(variance=stacked(part.variance for part in own)) for own in sources)
        return cls(log, std, seen, recorded, base, mixing, parts)

    def parts_with(self, name: str, added: np.ndarray, factor: np.ndarray | float = 1.0) -> tuple[VariancePart, ...]:
        """Add a source of variance, and scale the variances of the other sources.

        Args:
            name: name of the added source.
            added: variance of the added source, (90, 90, 180, colours).
            factor: factor of the variances of the other sources, in the shape of `added`, or a number. Default: 1.
        """
        if not self.parts:
            return ()
        factor = factor if isinstance(factor, float) else factor[PEAK]
        return (*scaled_parts(self.parts, factor), VariancePart(name, "B", added[PEAK]))


def with_channel_misfit(ratio: LobeRatio, misfit: float) -> LobeRatio:
    """Add the difference between the lobes of the channels to the standard deviation.

    Neighbouring cells have similar differences, so the error of a channel is that of one cell. It is at most the correction.

    misfit: difference between the lobes of the channels that noise does not explain, relative to the lobe (no unit).
    """
    added = np.minimum(misfit, np.abs(ratio.log)) ** 2
    parts = ratio.parts_with(CHANNELS, added)
    return ratio._replace(std=np.sqrt(ratio.std**2 + added), parts=parts)


def withheld(ratio: LobeRatio) -> LobeRatio:
    """Set the ratio to 1, and include the withheld change in the standard deviation."""
    change, factor = np.expm1(ratio.log), np.maximum(np.exp(ratio.log), 1)
    return ratio._replace(
        log=np.zeros_like(ratio.log),
        std=np.hypot(change, factor * ratio.std),
        base=np.ones_like(ratio.log),
        parts=ratio.parts_with("withheld correction", change**2, factor**2),
    )


def shrunk(ratio: LobeRatio, no_camera: float) -> LobeRatio:
    """Average the ratio with a ratio of 1, and shrink the mean towards 1.

    The logarithms of the ratios are averaged.

    no_camera: probability that no correction is required, which is the weight of the ratio 1.
    """
    mean = (1 - no_camera) * ratio.log
    variance = (1 - no_camera) * ratio.std**2 + no_camera * (1 - no_camera) * ratio.log**2
    known = ~(variance >= mean**2)  # missing values stay missing
    share = 1 - np.divide(variance, mean**2, out=np.ones_like(mean), where=known)
    lost = np.expm1(mean * (1 - share))
    parts = ratio.parts_with(NO_CAMERA, no_camera * (1 - no_camera) * ratio.log**2, 1 - no_camera)
    parts = ratio._replace(parts=parts).parts_with("reduction of an uncertain correction", lost**2)
    base = ratio.base ** (1 - no_camera)
    return ratio._replace(log=mean * share, std=np.sqrt(variance + lost**2), base=base, parts=parts)


def above_noise(ratio: LobeRatio, floor: np.ndarray) -> LobeRatio:
    """Reduce the correction of entries whose recorded lobe is below the noise.

    A recorded value is the sum of the lobe m and noise of standard deviation n. The linear estimator with the least error
    multiplies the logarithm of the ratio by m^2 / (m^2 + n^2) (Wiener's weight). The removed part is added to the standard
    deviation.

    floor: noise floor of a pixel divided by the peak of the recorded lobe of each slice (no unit), (90,).
    """
    noise = floor[:, None, None] * ratio.recorded.max(axis=(0, 2), keepdims=True)
    share = ratio.recorded**2 / (ratio.recorded**2 + noise**2)
    log = share * ratio.log
    lost = np.expm1(ratio.log - log)
    parts = ratio.parts_with("omitted correction below the noise", lost**2)
    return ratio._replace(log=log, std=np.hypot(ratio.std, np.abs(lost)), parts=parts)


class EnergyLimit(NamedTuple):
    """Reduction of the entries that a correction increases, so that the albedo is physically possible.

    The reduction is symmetric in light and view, so it preserves reciprocity.

    Attributes:
        steps: reduction for each direction, in standard deviations of the correction, (directions, channels).
        excess: albedo above its limit that remains after the reduction, (directions, channels).
        sampling: sampling of the table.
        recorded: largest albedo of the recorded table up to 80 degrees, no unit.
    """

    steps: np.ndarray
    excess: np.ndarray
    sampling: Sampling
    recorded: float

    @property
    def acts(self) -> bool:
        return bool((self.steps > 0).any())

    @property
    def remarks(self) -> tuple[Remark, ...]:
        return (*albedo_remarks(self.recorded), *((self._limited,) if self.acts else ()))

    @property
    def _limited(self) -> Remark:
        limited = int((self.steps > 0).any(axis=1).sum())
        most = "it receives" if self.recorded <= 1 else "it receives, and more than the recorded table,"
        text = (
            f"the corrected table would reflect more light than {most} in {limited} of {len(self.steps)} directions: "
            f"entries in these directions were reduced by up to {self.steps.max():.1f} standard deviations of the correction"
        )
        if self.excess.max() > 0:
            text += (
                f"; an excess of up to {self.excess.max():.1%} remains, which exceeds the uncertainty of the correction: "
                "check the absolute scale of the table"
            )
        return Remark("energy-limit", text)

    def of(self, rows: slice, recorded: np.ndarray, corrected: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Reduce the entries in some rows of a corrected table, but not below the recorded values.

        Args:
            rows: rows of the table.
            recorded: recorded values in these rows, 1/sr, (rows, 90, 180, channels).
            corrected: corrected values in these rows, 1/sr, (rows, 90, 180, channels).
            std: standard deviation of the correction, 1/sr, (rows, 90, 180, channels).
        """
        light, view = _directions(self.sampling)
        steps = np.maximum(self.steps[light[rows]], self.steps[view[rows]])
        return np.where(corrected > recorded, np.maximum(corrected - steps * std, recorded), corrected)


def energy_limit(recorded: np.ndarray, corrected: np.ndarray, std: np.ndarray, sampling: Sampling) -> EnergyLimit:
    """Compute the reduction that limits the albedo of a corrected table.

    The limit of each direction and channel is 1, or the albedo of the recorded table if that is larger. The errors of a
    correction are correlated within a direction, because they result from one fit. The projection on the limit therefore
    reduces every entry of the direction by the same multiple of its standard deviation, at most `_MOST_STEPS`. Well determined
    entries hardly change. Negative values must not be clipped beforehand, because clipping increases the albedo.

    Args:
        recorded: table before the correction, 1/sr, (90, 90, 180, channels); missing entries are treated as 0.
        corrected: corrected table, 1/sr, (90, 90, 180, channels); missing entries are treated as 0.
        std: standard deviation of the correction, 1/sr; NaN for entries that are not corrected, which are treated as 0.
        sampling: sampling of the tables.
    """
    cells, weight = _albedo_rule(sampling)
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
    # an entry lies between two directions, and the larger reduction of both is used
    steps = np.maximum(steps, np.maximum(np.r_[steps[1:], steps[-1:]], np.r_[steps[:1], steps[:-1]]))
    judged = sent[merl_grid(sampling).theta_d < BEFORE_LIMB]
    return EnergyLimit(steps, left, sampling, float(judged.max()))


def albedo(table: np.ndarray, sampling: Sampling = "centre") -> np.ndarray:
    """Compute the directional albedo of a table, (directions, channels).

    The angles of the directions to the normal are the theta_d of the cells. The integration variable is the half vector,
    because the cells of a table are dense about its peak. The integrand over the solid angle of half vectors is
    4 brdf cos_o cos(theta_d).

    Args:
        table: BRDF, 1/sr, (90, 90, 180, channels); missing entries are treated as 0.
        sampling: point of each cell at which the BRDF is given. Default: "centre".
    """
    cells, weight = _albedo_rule(sampling)
    return weight @ np.nan_to_num(table.reshape(-1, table.shape[-1])[cells])


@cache
def _albedo_rule(sampling: Sampling) -> tuple[np.ndarray, csr_matrix]:
    """Compute the indices of the cells in the albedo integrals, and their weights, (directions, cells).

    The theta_h of the cells are equally spaced in sqrt(theta_h), so the trapezoidal rule in this variable is accurate.
    """
    grid = merl_grid(sampling)
    theta = grid.theta_h[:, None]
    ring = np.sin(theta) * np.sqrt(2 * np.pi * theta) / GRID_SHAPE[0]
    turn = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    to_nearest = _HALF_CELL - grid.theta_d[0]  # `index` rounds down, but values may be at the edges of cells
    rows = []
    for direction in grid.theta_d:
        cos_d = np.cos(direction) * np.cos(theta) + np.sin(direction) * np.sin(theta) * np.cos(turn)
        cos_o = 2 * cos_d * np.cos(theta) - np.cos(direction)
        x = np.cos(theta) * np.sin(direction) * np.cos(turn) - np.sin(theta) * np.cos(direction)
        phi_d = np.arctan2(-np.sin(direction) * np.sin(turn) + 0 * theta, x) % np.pi
        seen = (cos_d > 0) & (cos_o > 0)
        theta_d = np.arccos(np.clip(cos_d, 0, 1))
        at = grid.index(
            theta_h=theta + 0 * turn,
            theta_d=np.minimum(theta_d + to_nearest, np.pi / 2),
            phi_d=(phi_d + to_nearest) % np.pi,
        )
        index = np.ravel_multi_index(at, GRID_SHAPE)
        weight = 4 * cos_d * cos_o * ring * (2 * np.pi / _AZIMUTHS)
        rows.append((index[seen], weight[seen]))
    cells, position = np.unique(np.concatenate([index for index, _ in rows]), return_inverse=True)
    counts = np.cumsum([0, *(index.size for index, _ in rows)])
    weights = np.concatenate([weight for _, weight in rows])
    return cells, csr_matrix((weights, position, counts), shape=(len(rows), cells.size))


@cache
def _directions(sampling: Sampling) -> tuple[np.ndarray, np.ndarray]:
    """Compute the indices of the directions of light and view of all cells, (90, 90, 180) each.

    A direction is an interval of 1 degree of the angle from the normal.
    """
    grid = merl_grid(sampling)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    return tuple(
        np.clip(np.degrees(np.arccos(np.clip(cos, 0, 1))).astype(int), 0, 89) for cos in (mean - half, mean + half)
    )
