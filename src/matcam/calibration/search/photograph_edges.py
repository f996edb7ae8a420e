"""Strips along edges: regions whose rows begin where the edge does, so that an edge may lie at any angle in the picture.

A row of a strip is a row of the picture, or a column where that crosses the edge more squarely; nothing is resampled. Strips of
one picture have one shape, so that one compiled program measures them all: what a shorter or narrower one lacks is NaN.

All slanted edges of a photograph, found and measured, colour by colour; and what they tell of the picture as a whole.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge import edge as stack
from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.edge.maximum_likelihood import Noise
from matcam.calibration.edge.profiles import Gaussian
from matcam.calibration.photograph import region
from matcam.calibration.photograph.light import evened
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.calibration.photograph.region import Frame, Region, turns_for
from matcam.calibration.search.edge_search import FoundEdges
from matcam.core.errors import FitError
from matcam.core.remark import Remark

_ROWS = (48, 64, 96, 128, 192)
_COLUMNS = (32, 48)
_USUAL = 0.8  # of the edges are no longer than the rows that are chosen
_LEAST_ROWS, _LEAST_WIDTH = 20, 16
_MARGIN = 1.0  # px: how well a search knows where an edge lies


class Strips(NamedTuple):
    """n strips in a turned picture: u along its rows, v across them. Whole px of the picture, but for `tilt`."""

    transposed: np.ndarray
    """(n,) u is the picture's y, and v its x."""
    mirrored: np.ndarray
    """(n,) the bright side lies at smaller u."""
    u: np.ndarray
    v: np.ndarray
    """(n,) px, the edge's middle (not whole)."""
    tilt: np.ndarray
    """(n,) du/dv of the edge."""
    rows: np.ndarray
    """(n,) how many there are, px."""
    width: np.ndarray
    """(n,) px, even."""


def strips_along(edges: FoundEdges, shape: tuple[int, int]) -> Strips:
    """Strips along the edges of a picture of a shape (height, width), long edges in pieces; edges without room for one are
    left out."""
    c, s = np.cos(edges.angle), np.sin(edges.angle)
    transposed = np.abs(s) > np.abs(c)
    across, along = np.where(transposed, s, c), np.where(transposed, c, s)
    u, v = np.where(transposed, edges.y, edges.x), np.where(transposed, edges.x, edges.y)
    tilt, steep = -along / across, np.abs(across)
    half = np.minimum(np.floor(edges.clear / steep - _MARGIN), _COLUMNS[-1] // 2)
    # a row's ends stand beside places further along the edge than its middle
    rows = np.floor(edges.length * steep - 2 * half * np.abs(along) * steep)
    usual = np.quantile(rows, _USUAL) if rows.size else 0.0
    longest = next((n for n in _ROWS if n >= usual), _ROWS[-1])
    pieces = np.maximum(np.ceil(rows / longest), 1).astype(int)
    which = np.repeat(np.arange(rows.size), pieces)
    number = np.arange(which.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    size = np.floor(rows / pieces)[which]
    offset = (number - (pieces[which] - 1) / 2) * size
    strips = Strips(
        transposed[which], (across < 0)[which], u[which] + tilt[which] * offset, v[which] + offset, tilt[which],
        size.astype(int), 2 * half[which].astype(int),
    )  # fmt: skip
    return _kept(strips, _inside(strips, shape) & (strips.rows >= _LEAST_ROWS) & (strips.width >= _LEAST_WIDTH))


def regions_of(
    strips: Strips, read: Callable[[np.ndarray, np.ndarray], np.ndarray], sites: np.ndarray, at_once: int
) -> Iterator[Region]:
    """Regions of at most `at_once` strips each, all of one shape.

    read: values at whole px (y, x), arrays of one shape. sites: (2, 2) bool, where the colour stands in the first 2 x 2 px
    of the picture; all True if it has every pixel.
    """
    step = 1 if sites.all() else 2
    rows = next((n for n in _ROWS if n >= strips.rows.max(initial=0)), _ROWS[-1])
    columns = next(n for n in _COLUMNS if n >= np.median(strips.width))
    by_row = step if (sites.sum(1) == 0).any() else 1  # red and blue have sites in every other row
    for i in range(0, strips.u.size, at_once):
        yield _region(_kept(strips, slice(i, i + at_once)), read, sites, step, by_row, rows // by_row, columns // step)


def _region(
    strips: Strips, read: Callable[[np.ndarray, np.ndarray], np.ndarray], sites: np.ndarray, step: int, by_row: int,
    rows: int, columns: int,
) -> Region:  # fmt: skip
    first = np.ceil(strips.v - strips.rows / 2).astype(int)
    v = first[:, None] + by_row * np.arange(rows)
    left = np.rint(strips.u[:, None] + strips.tilt[:, None] * (v - strips.v[:, None])).astype(int)
    width = np.minimum(strips.width, columns * step)
    left -= width[:, None] // 2
    if step == 2:
        first_row: np.ndarray = np.where(strips.transposed[:, None], sites.any(0), sites.any(1))
        if by_row == 2:  # begin on a row that has sites
            v = v + ~np.take_along_axis(first_row, v[:, :1] % 2, 1)
        turned = np.where(strips.transposed[:, None, None], sites.T, sites)
        left = left + ~turned[np.arange(strips.u.size)[:, None], v % 2, left % 2]
    u = left[..., None] + step * np.arange(columns)
    there = (v < first[:, None] + strips.rows[:, None])[..., None] & (np.arange(columns) * step < width[:, None, None])
    u, full_v = np.where(there, u, left[:, :1, None]), np.where(there, v[..., None], first[:, None, None])
    turned = strips.transposed[:, None, None]
    value = np.where(there, read(np.where(turned, u, full_v), np.where(turned, full_v, u)), np.nan)
    mirrored = strips.mirrored
    last = (there.any(1).sum(1) - 1)[:, None]
    # mirrored rows are read from their last sample to their first: what is missing stays behind
    back = np.where(mirrored[:, None], last - np.arange(columns), np.arange(columns)) % columns
    value = np.take_along_axis(value, back[:, None, :], 2)
    middle = first + (strips.rows - 1) / 2
    start = np.where(mirrored[:, None], strips.u[:, None] - left - step * last, left - strips.u[:, None])
    x, y = (np.where(strips.transposed, *pair) for pair in ((middle, strips.u), (strips.u, middle)))
    turns = turns_for(float((strips.rows * np.abs(strips.tilt)).min()) / step)
    frame = Frame(x, y, strips.transposed, mirrored, (strips.rows - 1).astype(float))
    return Region(value, v - middle[:, None], start.astype(float), step, frame, turns)


def _inside(strips: Strips, shape: tuple[int, int]) -> np.ndarray:
    """Whether strips, and 2 px around them, lie in the picture."""
    reach = strips.width / 2 + np.abs(strips.tilt) * strips.rows / 2 + 2
    across, along = (np.where(strips.transposed, *pair) for pair in (shape[:2], shape[1::-1]))
    long = strips.rows / 2 + 2
    return (strips.u >= reach) & (strips.u + reach < across) & (strips.v >= long) & (strips.v + long < along)


def _kept(strips: Strips, which: np.ndarray | slice) -> Strips:
    return Strips(*(column[which] for column in strips))


_SATURATED = 0.02  # share of a strip's samples
_CONTRAST = 0.2  # (bright - dark) / (bright + dark), below which it is said
_DIRECTIONAL, _SIGNIFICANT = 0.15, 5.0  # of the blur's variance; standard deviations
_FEW = 6  # edges, below which nothing is said of directions


def measured_edges(plane: LinearImage, edges: FoundEdges, half_width: float, *, accept_sharpened: bool) -> EdgeMTF:
    """The edges of one plane as a stack; long ones in pieces. FitError where there is none that could be measured, with the
    commonest reason."""
    strips = strips_along(edges, plane.shape)
    if not strips.u.size:
        raise FitError(
            f"no slanted edge was found ({edges.x.size} edges without room round them): photograph a chart of slanted squares "
            "(matcam chart)"
        )
    unknown = Noise(np.float64(np.nan), np.float64(np.nan))

    full: list[np.ndarray] = []

    def read(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        full.append(np.zeros(len(y)) if plane.saturated is None else plane.saturated[y, x].mean((1, 2)))
        return plane.values[y, x]

    regions = list(regions_of(strips, read, plane.sites, stack.AT_ONCE))
    looked_at = []
    for rows, even, shares in zip(regions, evened(regions), full, strict=True):
        flaws = [
            f"saturated: {share:.0%} of its samples" if share > _SATURATED else flaw
            for share, flaw in zip(shares, region.flaws(rows.value), strict=True)
        ]
        looked_at.append((even, flaws))
    result = stack.measured(looked_at, "gaussian", Gaussian(), unknown, half_width, accept_sharpened=accept_sharpened)
    reasons = Counter(problem for problem in result.problems if problem)
    if len(reasons) and sum(reasons.values()) == len(result):
        kinds = Counter(problem.split(":")[0] for problem in result.problems)
        kind, count = kinds.most_common(1)[0]
        example = next(p for p in result.problems if p.startswith(kind))
        raise FitError(f"none of its {len(result)} edges can be measured; {count} of them because: {example}")
    return result


def edge_remarks(result: EdgeMTF, channel: str) -> list[Remark]:
    """Return what a photographer should know of a picture, from its edges in one channel."""
    good = np.array([not problem for problem in result.problems])
    remarks = []

    def add(code: str, text: str) -> None:
        remarks.append(Remark(code, f"{channel}: {text}"))

    saturated = sum("saturated" in problem for problem in result.problems)
    sharpened = sum("sharpened" in problem for problem in result.problems)
    if saturated:
        add("saturated-edges", f"{saturated} of {len(result)} edges are saturated, and left out: expose less")
    if sharpened:
        add("sharpened-edges", f"{sharpened} of {len(result)} edges overshoot as sharpened ones do, and are left out")
    contrast = float(np.median(((result.bright - result.dark) / (np.abs(result.bright) + np.abs(result.dark)))[good]))
    if contrast < _CONTRAST:
        add(
            "low-contrast",
            f"contrast is only {contrast:.0%}: errors are large; use a darker print or less stray light",
        )
    if directional := _direction(result, good):
        add("directional-blur", directional)
    return remarks


def _direction(result: EdgeMTF, good: np.ndarray) -> str:
    """Whether the blur depends on direction all over the picture, as motion makes it: its variance's second harmonic."""
    if good.sum() < _FEW:
        return ""
    sigma, angle = result.parametric.values[good, 0], result.angle[good]
    weight = 1 / (4 * sigma**2 * result.parametric.covariance[good, 0, 0])
    design = np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)], 1)
    normal = design.T @ (weight[:, None] * design)
    # squares have two directions only, which leave one combination of the harmonics open: that is taken for 0
    inverse = np.linalg.pinv(normal, rcond=1e-3, hermitian=True)
    found = inverse @ (design.T @ (weight * sigma**2))
    left = weight * (sigma**2 - design @ found) ** 2
    covariance = inverse * max(1.0, left.sum() / max(good.sum() - 3, 1))
    size = float(np.hypot(found[1], found[2]))
    std = float(np.sqrt(found[1:] @ covariance[1:, 1:] @ found[1:]) / max(size, 1e-30))
    if size < _DIRECTIONAL * found[0] or size < _SIGNIFICANT * std:
        return ""
    most, least = np.sqrt(found[0] + size), np.sqrt(max(found[0] - size, 0.0))
    along = np.degrees(np.arctan2(found[2], found[1]) / 2) % 180
    blur = f"blur is {most:.2f} px along {along:.0f} degrees and {least:.2f} px across"
    return f"{blur}: the camera moved, or the lens is astigmatic"
