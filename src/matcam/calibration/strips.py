"""Strips along edges: regions whose rows begin where the edge does, so that an edge may lie at any angle in the picture.

A row of a strip is a row of the picture, or a column where that crosses the edge more squarely; nothing is resampled. Strips of
one picture have one shape, so that one compiled program measures them all: what a shorter or narrower one lacks is NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge_search import FoundEdges
from matcam.calibration.region import Frame, Region, turns_for

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
