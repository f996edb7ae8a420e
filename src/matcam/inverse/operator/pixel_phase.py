"""Positions of the pixels behind a table, estimated from the table alone (docs/correct.md, *Cells on real pixels*).

Cells that were read from the nearest pixel repeat its value, to the last digit. A border between values is a border of
a pixel. Near the highlight cells lie a twentieth of a pixel apart, so the borders in few slices give the phase of the
grid to some thousandths of a pixel, for any material and noise.

Cells that are means of the pixels inside are mostly too small to contain one, and repeat the nearest pixel as well. A
cell that contains one pixel has its value, on either side, and therefore other borders.

Cells that were interpolated are linear in the values of few pixels: a grid of the right phase explains hundreds of
cells by a few dozen values exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.linalg import lstsq
from scipy.optimize import OptimizeResult, minimize

from matcam.core.errors import FitError
from matcam.core.grid import GRID_SHAPE, azimuth_of, sampling_of
from matcam.core.remark import Remark
from matcam.forward.pixel_grid import looked_up
from matcam.inverse.operator.pixel_borders import (
    RINGS,
    SLICES,
    Borders,
    MeanBorders,
    Repeats,
    repeats,
    shown_places,
)
from matcam.inverse.operator.sample_view import rig_behind, sample_view
from matcam.rigs import ON_REAL_PIXELS, UNKNOWN, CellValue, PixelPhase, Rig

_DIAGONAL = 1e-6
"""Sine of four times an azimuth below which it is a multiple of 45 degrees."""
_LEAST_REPEATS = 0.3
"""Share of neighbouring cells in these rings that repeat a value if cells were read from the nearest pixel."""
_COMMON = 0.02
"""Share of borders that a phase common to all images may miss; otherwise each image has its own."""
_MOST_OF_A_SLICE = 0.5
_COARSE, _FINE = 0.0625, 5e-4
"""First and last step of the search, px."""
_MOST_REPEATS = 0.95
_MOST_WRONG = 0.1
"""Share of the borders between values that a grid may miss."""
_STRIDE = 1 << 16
_FEW_RINGS, _FEW_AZIMUTHS = 7, 6
_SIGN_RINGS, _SIGN_AZIMUTHS = 11, 4
_FLAT = 1e-10
_CORNERS = np.array([[0.0, 0.0], [0.04, 0.0], [0.0, 0.04]])
_FIRST_TRIES, _TRIES = 25, 90
"""Number of phases that are tried to detect a grid of pixels, and to locate it."""
_FALLS = 0.2
"""Ratio of residuals after the first tries and at the start, below which a grid is detected."""
_MOST_REST = 1e-6
"""Share of the variance of interpolated cells that a grid may leave unexplained."""
READ_FROM: dict[CellValue, str] = {
    "nearest": "read from the nearest pixel",
    "bilinear": "interpolated between pixels",
    "mean": "the means of the pixels inside, of the nearest where none is",
}


class FoundPhase(NamedTuple):
    """Position of the pixels behind a table.

    Attributes:
        phase: (x, y), px, or a pair for each slice.
        std: standard deviation of either, px.
        unexplained: share of the table's borders between values, or of its variance, that the grid does not explain.
    """

    phase: PixelPhase
    std: float
    unexplained: float

    def remark(self, rule: CellValue) -> Remark:
        """Return the remarks for the user."""
        how = READ_FROM[rule]
        return Remark("real-pixels-found", f"cells were {how}, whose centres {self.words}, as the cells indicate")

    @property
    def words(self) -> str:
        """Describe the position of the pixels' centres."""
        phases = np.atleast_2d(self.phase)
        if len(phases) == 1:
            return f"lie at ({phases[0, 0]:+.3f}, {phases[0, 1]:+.3f}) +- {self.std:.1g} px from the sphere's"
        return f"lie elsewhere in each picture, known to {self.std:.1g} px"


class LocatedRig(NamedTuple):
    """Rig with a known cell rule.

    Attributes:
        rig: with the pixels' phase, where cells were looked up in real pixels.
        std: standard deviation of a phase that was estimated from the table, px; 0 where it was specified.
        remarks: findings from the table.
        unexplained: whether cells repeat values in a way that no grid of pixels explains.
    """

    rig: Rig
    std: float = 0.0
    remarks: tuple[Remark, ...] = ()
    unexplained: bool = False


def located_rig(rig: Rig, table: xr.DataArray) -> LocatedRig:
    """Determine the cell rule and the lamp azimuth of a rig, as specified or from the table.

    FitError where the cells contradict the rig; ArgumentError where rig and table specify different azimuths.
    """
    rig = rig_behind(table, rig)
    table = table.assign_attrs(lamp_azimuth=rig.lamp_azimuth or 0.0)
    if rig.pixel_phase is not None or rig.cell_value not in (*ON_REAL_PIXELS, "mean", UNKNOWN):
        return LocatedRig(rig)
    if rig.cell_value == "mean" and repeats(table).share < _LEAST_REPEATS:  # pixels of any phase
        return LocatedRig(rig)
    if not sample_view(rig).one_picture:  # each cell has its own image
        return LocatedRig(_with_cells(rig, sampling_of(table), None))
    radius = float(rig.sample.radius)  # type: ignore[attr-defined]
    rule = rig.cell_value
    if rule == UNKNOWN:
        shown, found, repeated, _ = cell_rule(table, radius)
        if shown is None or found is None:
            remarks = () if shown is None else (_repeats_remark(repeated, radius),)
            return LocatedRig(_with_cells(rig, sampling_of(table), None), 0.0, remarks, bool(remarks))
        rule = shown
    else:
        found = _PHASES[rule](table, radius)
    return LocatedRig(_with_cells(rig, rule, found.phase), found.std, (found.remark(rule),))


def _with_cells(rig: Rig, rule: CellValue, phase: PixelPhase | None) -> Rig:
    return replace(rig, cell_value=rule, pixel_phase=phase)


def _repeats_remark(repeated: float, radius: float) -> Remark:
    return Remark(
        "cells-repeat",
        f"{repeated:.0%} of the neighbours near the highlight hold one value, as if read from the nearest pixel, but no grid "
        f"of pixels on a sphere of radius {radius:g} px fits: state the sphere's radius; cells are taken as centred on their "
        "pixels",
    )


def nearest_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    """Estimate the phase of a table whose cells were read from the nearest pixel.

    If no phase fits all images, each gets its own, because sphere or lamp were not exactly at their nominal positions.
    """
    shown = repeats(table)
    if shown.share < _LEAST_REPEATS:
        raise FitError(
            f"cells that are read from the nearest pixel repeat its value, and {shown.share:.0%} of the neighbours near the "
            "highlight do: state pixel_phase, or another cell_value"
        )
    sampling = sampling_of(table)
    common = _common_phase("nearest", table, radius, shown)
    if common.unexplained <= _COMMON:
        return common
    every, azimuth = np.arange(GRID_SHAPE[1]), azimuth_of(table) or 0.0
    shown = repeats(table, every)
    own: dict[int, FoundPhase] = {}
    for j in every:
        one = Repeats(shown.outwards[j : j + 1], shown.around[j : j + 1])
        if (one.around >= 0).mean() > _MOST_OF_A_SLICE:
            found = _best_phase(Borders(radius, sampling, every[j : j + 1], one, azimuth))
            near = _near_cells(table, radius, every[j : j + 1], _SIGN_RINGS, _SIGN_AZIMUTHS)
            own[int(j)] = _upright(found, near, azimuth)
    unexplained = float(np.median([found.unexplained for found in own.values()])) if own else 1.0
    if unexplained > _MOST_WRONG:
        raise FitError(
            f"no grid of pixels on a sphere of radius {radius:g} px has the borders that the table's values show "
            f"({unexplained:.0%} of them differ): state the sphere's radius, or another cell_value"
        )
    known = [j for j, found in own.items() if found.unexplained <= _MOST_WRONG]
    nearest = [min(known, key=lambda k: abs(k - j)) for j in every]
    std = float(np.median([own[j].std for j in known]))
    return FoundPhase(tuple(own[j].phase for j in nearest), std, unexplained)  # type: ignore[misc]


def mean_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    """Estimate the phase of a table whose cells are means of the pixels inside; one for all images."""
    shown = repeats(table)
    found = _common_phase("mean", table, radius, shown)
    if shown.share < _LEAST_REPEATS or found.unexplained > _COMMON:
        raise FitError(
            f"no grid of pixels on a sphere of radius {radius:g} px, averaged in cells, has the borders that the values show "
            f"({found.unexplained:.0%} of them differ): state pixel_phase and the sphere's radius, or another cell_value"
        )
    return found


def _common_phase(rule: CellValue, table: xr.DataArray, radius: float, shown: Repeats) -> FoundPhase:
    """Find the phase that fits all images best."""
    azimuth = azimuth_of(table) or 0.0
    found = _best_phase(_BORDERS[rule](radius, sampling_of(table), SLICES, shown, azimuth))
    return _upright(found, _near_cells(table, radius, SLICES[::3], _SIGN_RINGS, _SIGN_AZIMUTHS), azimuth)


_BORDERS: dict[CellValue, type[Borders]] = {"nearest": Borders, "mean": MeanBorders}


def _best_phase(borders: Borders) -> FoundPhase:
    """Find the phase that misses fewest borders: on a coarse grid, then in finer steps about the best."""
    line = np.arange(-8, 8) * _COARSE
    fewest, *best = min((borders.wrong(u, v), u, v) for u in line for v in line)
    step = _COARSE
    while step > _FINE:
        step /= 2
        turns = [(a * step, b * step) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        fewest, *best = min((borders.wrong(best[0] + u, best[1] + v), best[0] + u, best[1] + v) for u, v in turns)
    at = best[0], best[1]
    return FoundPhase(_wrapped(at), borders.width(at, fewest, step), fewest / max(borders.count, 1))


def _upright(found: FoundPhase, cells: list[_NearCells], azimuth: float) -> FoundPhase:
    """Choose by the values between a phase and its mirror image across the plane of light, which have the same borders.

    A cell is the mean of two positions on either side of that plane. Only one of the two makes all cells the means of
    few pixels. Unless that plane lies along the pixels' rows, columns or diagonals, no grid is the mirror image of
    another.
    """
    if abs(np.sin(4 * azimuth)) > _DIAGONAL:
        return found
    (x, y), cos, sin = found.phase, np.round(np.cos(2 * azimuth)), np.round(np.sin(2 * azimuth))
    mirrored = float(x * cos + y * sin), float(x * sin - y * cos)  # type: ignore[operator]
    if _rest("nearest", mirrored, cells) < _rest("nearest", (x, y), cells):  # type: ignore[arg-type]
        return found._replace(phase=mirrored)
    return found


class _NearCells(NamedTuple):
    """Cells near the highlight of a slice: both positions of each (cells, 2) along the pixels' axes, px, and values."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray


def _near_cells(table: xr.DataArray, radius: float, slices: np.ndarray, rings: int, every: int) -> list[_NearCells]:
    """Return cells of the slices that show most of them, in the brightest channel."""
    places = shown_places(radius, sampling_of(table), slices, np.arange(rings), every, azimuth_of(table) or 0.0)
    values = table.values[:rings][:, slices, ::every].transpose(1, 0, 2, 3)
    channel = int(np.argmax(np.nan_to_num(values).max(axis=(0, 1, 2))))
    found = []
    for x, y, one in zip(*places, values[..., channel], strict=True):
        known = np.isfinite(one)
        if known.mean() > _MOST_OF_A_SLICE:
            found.append(_NearCells(x[known], y[known], one[known]))
    return found


def _rest(rule: CellValue, phase: tuple[float, float], cells: list[_NearCells]) -> float:
    """Compute the share of the variance of cells that the values of the pixels of a grid leave, mean over slices."""
    return float(np.mean([_interpolation_rest(rule, one, phase) for one in cells])) if cells else 1.0


def bilinear_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    """Estimate the phase of a table whose cells were interpolated between pixels."""
    cells = _near_cells(table, radius, SLICES[::3], _FEW_RINGS, _FEW_AZIMUTHS)

    def log_rest(phase: Sequence[float]) -> float:
        return float(np.log(_rest("bilinear", (phase[0], phase[1]), cells) + 1e-30))

    def descended(corners: np.ndarray, tries: int) -> OptimizeResult:
        options = {"initial_simplex": corners, "xatol": 1e-5, "maxfev": tries}
        return minimize(log_rest, corners[0], method="Nelder-Mead", options=options)

    def followed(before: float, u: float, v: float) -> OptimizeResult:
        """Refine a start, unless the first steps detect no grid. before: residual of the start."""
        first = descended(np.array([u, v]) + _CORNERS, _FIRST_TRIES)
        return first if first.fun > before + np.log(_FALLS) else descended(first.final_simplex[0], _TRIES)

    line = np.arange(-0.5, 0.5, 0.1)
    starts = sorted((log_rest((u, v)), u, v) for u in line for v in line)[:3]
    found = min((followed(*start) for start in starts), key=lambda one: one.fun)
    unexplained = float(np.exp(found.fun))
    if unexplained > _MOST_REST:
        raise FitError(
            f"no grid of pixels on a sphere of radius {radius:g} px interpolates to the cells near the highlight "
            f"({unexplained:.1g} of their variance is unexplained): state the sphere's radius, or another cell_value"
        )
    return FoundPhase(_wrapped((found.x[0], found.x[1])), 1e-3, unexplained)


def _interpolation_rest(rule: CellValue, cells: _NearCells, phase: tuple[float, float]) -> float:
    """Compute the smallest share of the variance of a slice that the values of the pixels of a grid leave."""
    values = cells.values
    found = looked_up(rule, np.asarray(phase), cells.x, cells.y)
    number = np.rint(found.x - phase[0]) * _STRIDE + np.rint(found.y - phase[1])
    pixels, index = np.unique(number, return_inverse=True)
    shape = len(values), pixels.size
    entry = index.reshape(len(values), -1) + np.arange(len(values))[:, None] * pixels.size
    matrix = np.bincount(entry.ravel(), found.weight.ravel() / 2, shape[0] * shape[1]).reshape(shape)
    best, *_ = lstsq(matrix, values, cond=1e-10, lapack_driver="gelsy", check_finite=False)
    left, own = values - matrix @ best, values - values.mean()
    if (own**2).mean() <= _FLAT * values.mean() ** 2:  # interpolation from any grid gives a constant
        return 1.0
    return float((left**2).sum() / (own**2).sum())


def _wrapped(phase: tuple[float, float]) -> tuple[float, float]:
    """Wrap the phase of a grid to [-0.5, 0.5] px."""
    x, y = (float(np.round(p - np.rint(p), 6)) for p in phase)
    return x, y


class CellRule(NamedTuple):
    """Rule by which the cells of a table were read from pixels.

    Attributes:
        rule: "nearest", "bilinear" or "mean"; None: there is no evidence that cells share pixels.
        found: the pixels' phase; None: no grid on a sphere of that radius fits.
        repeated: share of neighbouring cells near the highlight that hold one value.
        values: distinct values near the highlight, mean over slices; for the nearest pixel, pairs of pixels.
    """

    rule: CellValue | None
    found: FoundPhase | None
    repeated: float
    values: float


def cell_rule(table: xr.DataArray, radius: float) -> CellRule:
    """Determine from the values the rule by which the cells of a table were read from real pixels.

    radius: of the sphere, px.
    """
    repeated, values = repeats(table).share, _distinct(table)
    if repeated > _MOST_REPEATS:  # a constant has no highlight
        return CellRule(None, None, repeated, values)
    rules: tuple[CellValue, ...] = ("bilinear",) if repeated < _LEAST_REPEATS else ("mean", "nearest")
    if repeated >= _LEAST_REPEATS and _common_phase("nearest", table, radius, repeats(table)).unexplained <= _COMMON:
        rules = ("nearest",)
    for rule in rules:
        try:
            return CellRule(rule, _PHASES[rule](table, radius), repeated, values)
        except FitError:
            continue
    # repeated values come from pixels for any radius of the sphere
    return CellRule("nearest" if "nearest" in rules else None, None, repeated, values)


_PHASES: dict[CellValue, Callable[[xr.DataArray, float], FoundPhase]] = {
    "nearest": nearest_phase, "bilinear": bilinear_phase, "mean": mean_phase,
}  # fmt: skip


def _distinct(table: xr.DataArray) -> float:
    """Count the distinct values near the highlight, mean over the slices that have any."""
    values = table.values[:RINGS][:, SLICES, :, 0].transpose(1, 0, 2).reshape(SLICES.size, -1)
    counts = [np.unique(np.round(np.log(row[row > 0]), 9)).size for row in values]
    return float(np.mean([count for count in counts if count] or [0]))
