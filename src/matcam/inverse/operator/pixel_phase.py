"""Phase of the pixel grid from which a table was read, estimated from the table (docs/correct.md, *Cells on real pixels*).

Cells that were read from the nearest pixel have exactly the value of this pixel, so a border between values is a border of a
pixel. Near the highlight, neighbouring cells are a twentieth of a pixel apart. The borders in a few slices therefore determine
the phase of the grid to a few thousandths of a pixel, for any material and noise.

Cells that are means of the pixels inside are mostly too small to contain a pixel, and then have the value of the nearest
pixel. A cell that contains one pixel has the value of this pixel, although this pixel may not be the nearest. The borders
of such cells therefore differ from those of cells that were read from the nearest pixel.

Cells that were interpolated are linear functions of the values of a few pixels. With the correct phase, a few dozen values
explain hundreds of cells exactly.
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
    shown_positions,
)
from matcam.inverse.operator.sample_view import rig_behind, sample_view
from matcam.rigs import ON_REAL_PIXELS, UNKNOWN, CellValue, PixelPhase, Rig

_LEAST_REPEATS = 0.3
"""Smallest share of neighbouring cells near the highlight that have the same value if they were read from pixels."""
_COMMON = 0.02
"""Largest share of borders that a phase common to all images may leave unexplained. Above it each image has its own phase."""
_MOST_OF_A_SLICE = 0.5
"""Share of the cells of a slice that must have a value. A slice with fewer values is not used."""
_COARSE, _FINE = 0.0625, 5e-4
"""First and last step of the search for a phase, px. The last step is below the accuracy of a phase, a few 1e-3 px."""
_MOST_WRONG = 0.1
"""Largest share of the borders between values that a grid may leave unexplained."""
_FEW_RINGS, _FEW_AZIMUTHS = 7, 6
"""Number of rings, and step in azimuths, of the cells that determine the phase of an interpolated table."""
_SIGN_RINGS, _SIGN_AZIMUTHS = 11, 4
"""Number of rings, and step in azimuths, of the cells that decide between a phase and its mirror image."""
_FIRST_TRIES, _TRIES = 25, 90
"""Largest number of phases that are tried to detect a grid of pixels, and to determine its phase."""
_LARGEST_RESIDUAL = 1e-6
"""Largest share of the variance of interpolated cells that a grid may leave unexplained. The correct grid is exact."""
READ_FROM: dict[CellValue, str] = {
    "nearest": "read from the nearest pixel",
    "bilinear": "interpolated between pixels",
    "mean": "means of the pixels inside them, or read from the nearest pixel if they contain none",
}
"""Description of each rule by which cells are read from pixels, for messages."""


class FoundPhase(NamedTuple):
    """Phase of the pixel grid from which the cells of a table were read.

    Attributes:
        phase: phase of the grid in x and y, px, or one such pair for each slice.
        std: standard deviation of the phase in x and in y, px.
        unexplained: share of the borders between values, or of the variance of the table, that the grid does not explain.
    """

    phase: PixelPhase
    std: float
    unexplained: float

    def remark(self, rule: CellValue) -> Remark:
        how = READ_FROM[rule]
        return Remark(
            "real-pixels-found", f"the table shows that cells were {how}; the centres of the pixels {self.words}"
        )

    @property
    def words(self) -> str:
        phases = np.atleast_2d(self.phase)
        if len(phases) == 1:
            return (
                f"lie at ({phases[0, 0]:+.3f}, {phases[0, 1]:+.3f}) ± {self.std:.1g} px from the centre of the sphere"
            )
        return f"differ between the images, and are known to {self.std:.1g} px (standard deviation) in each"


class LocatedRig(NamedTuple):
    """Rig with a known cell rule.

    Attributes:
        rig: the rig, with the phase of the pixels if cells were read from real pixels.
        std: standard deviation of a phase that was estimated from the table, px. Default: 0, no phase was estimated.
        remarks: remarks on the table. Default: none.
        unexplained: True if cells have equal values that no grid of pixels explains. Default: False.
    """

    rig: Rig
    std: float = 0.0
    remarks: tuple[Remark, ...] = ()
    unexplained: bool = False


def located_rig(rig: Rig, table: xr.DataArray) -> LocatedRig:
    """Determine the cell rule, the lamp azimuth and the pixel phase of a rig.

    The values of the rig are used if it specifies them. Otherwise they are determined from the table.

    Raises:
        FitError: the cells contradict the rig.
        ArgumentError: rig and table specify different azimuths or samples, or the table is already corrected.
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
        f"{repeated:.0%} of the neighbouring cells near the highlight have equal values, as if read from the nearest pixel, "
        f"but no grid of pixels on a sphere of radius {radius:g} px explains them: specify the sphere's radius; cells are "
        "assumed to be centred on their pixels",
    )


def nearest_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    """Estimate the phase for cells that were read from the nearest pixel.

    If no common phase fits all images, each image has its own phase. In that case the sphere or the lamp was not exactly at
    its nominal position.
    """
    shown = repeats(table)
    if shown.share < _LEAST_REPEATS:
        raise FitError(
            f"only {shown.share:.0%} of the neighbouring cells near the highlight have equal values, too few for cells that "
            "were read from the nearest pixel: specify pixel_phase, or another cell_value"
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
            f"no grid of pixels on a sphere of radius {radius:g} px explains the borders between the values of the table "
            f"({unexplained:.0%} of them are unexplained): specify the sphere's radius, or another cell_value"
        )
    known = [j for j, found in own.items() if found.unexplained <= _MOST_WRONG]
    nearest = [min(known, key=lambda k: abs(k - j)) for j in every]
    std = float(np.median([own[j].std for j in known]))
    return FoundPhase(tuple(own[j].phase for j in nearest), std, unexplained)  # type: ignore[misc]


def mean_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    shown = repeats(table)
    found = _common_phase("mean", table, radius, shown)
    if shown.share < _LEAST_REPEATS or found.unexplained > _COMMON:
        raise FitError(
            f"no grid of pixels on a sphere of radius {radius:g} px, averaged in cells, explains the borders between "
            f"values ({found.unexplained:.0%} of them are unexplained): specify pixel_phase and the sphere's radius, or "
            "another cell_value"
        )
    return found


def _common_phase(rule: CellValue, table: xr.DataArray, radius: float, shown: Repeats) -> FoundPhase:
    azimuth = azimuth_of(table) or 0.0
    found = _best_phase(_BORDERS[rule](radius, sampling_of(table), SLICES, shown, azimuth))
    return _upright(found, _near_cells(table, radius, SLICES[::3], _SIGN_RINGS, _SIGN_AZIMUTHS), azimuth)


_BORDERS: dict[CellValue, type[Borders]] = {"nearest": Borders, "mean": MeanBorders}
"""Model of the borders between values for each rule with repeated values."""


def _best_phase(borders: Borders) -> FoundPhase:
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
    """Choose between a phase and its mirror image across the plane of camera and lamp.

    The choice depends on the values of cells, because both phases have the same borders. A cell is the mean of two positions
    on opposite sides of the plane. Means of a few pixels explain all cells only for the correct phase. If the plane is not
    parallel to the rows, columns or diagonals of the pixels, the mirror image of a grid is not a grid of the same
    orientation, and the phase is returned unchanged.
    """
    if abs(np.sin(4 * azimuth)) > 1e-6:  # the azimuth is no multiple of 45 degrees, up to rounding errors
        return found
    (x, y), cos, sin = found.phase, np.round(np.cos(2 * azimuth)), np.round(np.sin(2 * azimuth))
    mirrored = float(x * cos + y * sin), float(x * sin - y * cos)  # type: ignore[operator]
    if _residual("nearest", mirrored, cells) < _residual("nearest", (x, y), cells):  # type: ignore[arg-type]
        return found._replace(phase=mirrored)
    return found


class _NearCells(NamedTuple):
    """Cells near the highlight of a slice.

    Attributes:
        x: the two positions of each cell along the rows of the pixels, px, (cells, 2).
        y: the two positions of each cell along the columns of the pixels, px, (cells, 2).
        values: values of the cells, (cells,).
    """

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray


def _near_cells(table: xr.DataArray, radius: float, slices: np.ndarray, rings: int, every: int) -> list[_NearCells]:
    """Select the cells in the first `rings` rings about the highlight in the brightest channel, at every `every`-th azimuth.

    Slices are omitted if half of these cells or more have no value.
    """
    positions = shown_positions(radius, sampling_of(table), slices, np.arange(rings), every, azimuth_of(table) or 0.0)
    values = table.values[:rings][:, slices, ::every].transpose(1, 0, 2, 3)
    channel = int(np.argmax(np.nan_to_num(values).max(axis=(0, 1, 2))))
    found = []
    for x, y, one in zip(*positions, values[..., channel], strict=True):
        known = np.isfinite(one)
        if known.mean() > _MOST_OF_A_SLICE:
            found.append(_NearCells(x[known], y[known], one[known]))
    return found


def _residual(rule: CellValue, phase: tuple[float, float], cells: list[_NearCells]) -> float:
    """Compute the share of the variance in a slice that a grid does not explain, averaged over slices.

    The result is 1 without cells.
    """
    return float(np.mean([_interpolation_residual(rule, one, phase) for one in cells])) if cells else 1.0


def bilinear_phase(table: xr.DataArray, radius: float) -> FoundPhase:
    cells = _near_cells(table, radius, SLICES[::3], _FEW_RINGS, _FEW_AZIMUTHS)

    def log_residual(phase: Sequence[float], cells: list[_NearCells] = cells) -> float:
        return float(np.log(_residual("bilinear", (phase[0], phase[1]), cells) + 1e-30))

    def descended(corners: np.ndarray, tries: int) -> OptimizeResult:
        options = {"initial_simplex": corners, "xatol": 1e-5, "maxfev": tries}
        return minimize(log_residual, corners[0], method="Nelder-Mead", options=options)

    def followed(before: float, u: float, v: float) -> OptimizeResult:
        """Refine a starting point, unless the first tries do not reduce the residual to a fifth, and so detect no grid.

        before: ln of the residual at the starting point.
        """
        # the first simplex is smaller than half the distance between starting points
        first = descended(np.add([[0.0, 0.0], [0.04, 0.0], [0.0, 0.04]], [u, v]), _FIRST_TRIES)
        return first if first.fun > before + np.log(0.2) else descended(first.final_simplex[0], _TRIES)

    line = np.arange(-0.5, 0.5, 0.1)
    # two of the five slices suffice for starting points, because all slices have the same phase
    starts = sorted((log_residual((u, v), cells[::3]), u, v) for u in line for v in line)[:3]
    found = min((followed(log_residual((u, v)), u, v) for _, u, v in starts), key=lambda one: one.fun)
    unexplained = float(np.exp(found.fun))
    if unexplained > _LARGEST_RESIDUAL:
        raise FitError(
            f"no grid of pixels on a sphere of radius {radius:g} px explains the cells near the highlight by interpolation "
            f"({unexplained:.1g} of their variance is unexplained): specify the sphere's radius, or another cell_value"
        )
    return FoundPhase(_wrapped((found.x[0], found.x[1])), 1e-3, unexplained)


def _interpolation_residual(rule: CellValue, cells: _NearCells, phase: tuple[float, float]) -> float:
    values = cells.values
    found = looked_up(rule, np.asarray(phase), cells.x, cells.y)
    column, row = (np.rint(at - start).astype(int) for at, start in ((found.x, phase[0]), (found.y, phase[1])))
    row -= row.min()
    number = (column - column.min()) * (row.max() + 1) + row
    seen = np.bincount(number.ravel()) > 0  # far faster than np.unique
    index, shape = (np.cumsum(seen) - 1)[number], (len(values), int(seen.sum()))
    entry = index.reshape(len(values), -1) + np.arange(len(values))[:, None] * shape[1]
    matrix = np.bincount(entry.ravel(), found.weight.ravel() / 2, shape[0] * shape[1]).reshape(shape)
    best, *_ = lstsq(matrix, values, cond=1e-10, lapack_driver="gelsy", check_finite=False)
    left, own = values - matrix @ best, values - values.mean()
    if (own**2).mean() <= 1e-10 * values.mean() ** 2:  # interpolation from any grid gives a constant
        return 1.0
    return float((left**2).sum() / (own**2).sum())


def _wrapped(phase: tuple[float, float]) -> tuple[float, float]:
    x, y = (float(np.round(p - np.rint(p), 6)) for p in phase)
    return x, y


class CellRule(NamedTuple):
    """Rule by which the cells of a table were read from pixels.

    Attributes:
        rule: "nearest", "bilinear" or "mean"; None: there is no evidence that cells share pixels.
        found: phase of the pixels; None: no grid on a sphere of this radius explains the cells.
        repeated: share of neighbouring cells near the highlight that have equal values.
        values: number of distinct values near the highlight, mean over slices. For "nearest" it is the number of distinct
            pairs of pixels.
    """

    rule: CellValue | None
    found: FoundPhase | None
    repeated: float
    values: float


def cell_rule(table: xr.DataArray, radius: float) -> CellRule:
    """Determine the rule by which cells were read from real pixels.

    radius: radius of the sphere, px.
    """
    repeated, values = repeats(table).share, _distinct(table)
    if repeated > 0.95:  # a constant has no highlight
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
"""Function that estimates the phase for each rule."""


def _distinct(table: xr.DataArray) -> float:
    values = table.values[:RINGS][:, SLICES, :, 0].transpose(1, 0, 2).reshape(SLICES.size, -1)
    counts = [np.unique(np.round(np.log(row[row > 0]), 9)).size for row in values]
    return float(np.mean([count for count in counts if count] or [0]))
