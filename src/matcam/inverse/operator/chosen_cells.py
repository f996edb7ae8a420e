"""Choice of the cells of a table to which a material is fitted. No two cells come from one pixel.

Near the peak about 75 cells of a MERL table come from one pixel and share its noise. Far from it a cell has about the size of
a pixel. A fit requires data with independent errors, so one cell is chosen per pixel. The likelihood of the chosen cells is
then exact in each slice. Two kinds of cells are omitted. Neighbours in one pixel are redundant. Most cells on the smooth
flanks of a lobe would only improve values that are known to a fraction of a per cent without them.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.forward.pixel_grid import (
    CellPositions,
    PixelGrid,
    cell_positions,
    grid_of,
    pixel_angles,
    pixel_numbers,
    turned,
)
from matcam.inverse.operator.pixels_behind import PixelsBehind, pixel_counts, pixels_behind
from matcam.inverse.operator.sample_view import BOTH_DIRECTIONS, SampleView, sample_view
from matcam.rigs import Rig

NEAR_RINGS = 12
NEAR_COSINE, FAR_COSINE = 0.06, 0.17
"""Smallest cosines of incidence and viewing angle of chosen cells, in the `NEAR_RINGS` rings about the highlight and beyond
them. Cells with smaller cosines depend on the pixels at the limb.
"""

SLICE_CELLS = 112
"""Largest number of cells of a slice. The arrays of all slices are padded to this length."""
_RINGS = np.concatenate([np.arange(12), np.arange(12, 26, 2), np.arange(26, 90, 5)])
_MOST_NEAR, _MOST_IN_RING = 24, 4
"""Largest number of azimuths that are considered in a ring, within `NEAR_RINGS` and beyond."""


class RealPixels(NamedTuple):
    """Real pixels from which cells are read, and which are not centred on the cells.

    In the shapes, s is the number of slices, n of cells in a slice, and w of pixels of a cell.

    Attributes:
        theta: (s, n, w), angle between the half vector and the normal at each pixel's centre, rad.
        psi: (s, n, w), azimuth of this normal about the half vector, rad.
        weight: (s, n, w), share of each pixel in its cell, no unit.
        noise_share: (s, n), ratio of the variance of a cell to that of a pixel, no unit.
    """

    theta: np.ndarray
    psi: np.ndarray
    weight: np.ndarray
    noise_share: np.ndarray


class ChosenCells(NamedTuple):
    """Cells of some slices, and the two pixels that show each cell.

    In the shapes, s is the number of slices, and n of cells in a slice. A last axis of length 2 is that of the two directions
    of a cell, phi_d and phi_d + pi.

    Attributes:
        slices: (s,), indices of theta_d.
        theta_d: (s,), difference angles, rad.
        i_theta_h: (s, n), indices of theta_h.
        i_phi_d: (s, n), indices of phi_d.
        theta_h: (s, n), half angles, rad.
        phi_d: (s, n), azimuths of the difference, rad.
        valid: (s, n), False where a slice has fewer cells.
        x: (s, n, 2), distance of the pixel centres from the optical axis, towards the lamp, px.
        y: (s, n, 2), distance of the pixel centres from the optical axis, perpendicular to x, px.
        cos_i: (s, n, 2), cosine of the angle of incidence at each position.
        cos_o: (s, n, 2), cosine of the viewing angle at each position.
        one_pixel: (s, n), True if both directions lie in the same pixel.
        real: real pixels from which cells are read. x, y and the cosines are then those of the real pixels, and their last
            axis is over all pixels of a cell. None: for each direction there is a pixel at the position of the cell.
    """

    slices: np.ndarray
    theta_d: np.ndarray
    i_theta_h: np.ndarray
    i_phi_d: np.ndarray
    theta_h: np.ndarray
    phi_d: np.ndarray
    valid: np.ndarray
    x: np.ndarray
    y: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    one_pixel: np.ndarray
    real: RealPixels | None = None

    def in_slices(self, part: slice) -> ChosenCells:
        own = {name: a[part] for name, a in zip(self._fields, self, strict=True) if isinstance(a, np.ndarray)}
        return self._replace(**own, real=self.real and RealPixels(*(a[part] for a in self.real)))

    @property
    def weight(self) -> np.ndarray:
        """Share of each pixel in its cell, (s, n, pixels)."""
        return np.full(self.x.shape, 0.5) if self.real is None else self.real.weight

    @property
    def noise_share(self) -> np.ndarray:
        """Ratio of the variance of each cell to that of a pixel, (s, n).

        Without real pixels it is one half, or 1 if both directions share a pixel.
        """
        return np.where(self.one_pixel, 1.0, 0.5) if self.real is None else self.real.noise_share


def chosen_cells(
    view: SampleView, sampling: Sampling, slice_step: int = 1, pixels: PixelGrid | None = None
) -> ChosenCells:
    """Choose cells in every `slice_step`-th slice of a table.

    pixels: grid of real pixels from which cells are read; None: each cell has its own pixels.
    """
    grid = merl_grid(sampling)
    slices = np.arange(slice_step // 2, GRID_SHAPE[1], slice_step)
    columns = [_slice_cells(view, sampling, int(j), pixels) for j in slices]
    i, k, valid = (np.stack([getattr(column, name) for column in columns]) for name in ("i", "k", "valid"))
    theta_h, phi_d = grid.theta_h[i], grid.phi_d[k]
    theta_d = grid.theta_d[slices]
    x, y, cos_i, cos_o = positions_in(view, theta_h, theta_d[:, None], phi_d)
    shift = np.zeros((slices.size, 2)) if pixels is None else pixels.of_slices(slices)
    numbers = pixel_numbers(x, y, shift[:, None, None], _azimuth(view, pixels))
    one_pixel = (numbers[..., 0] == numbers[..., 1]) & (not view.line)
    real = None
    if pixels is not None:
        x, y, weight, noise_share = (np.stack(parts) for parts in zip(*(c.behind for c in columns), strict=True))
        at = pixel_angles(view.radius, theta_d[:, None, None], x, y)
        real = RealPixels(at.theta_h, at.psi, weight, noise_share)
        # padding of slices and of cells
        cos_i, cos_o = (np.where(valid[..., None] & (weight > 0), c, 1.0) for c in (at.cos_i, at.cos_o))
    return ChosenCells(slices, theta_d, i, k, theta_h, phi_d, valid, x, y, cos_i, cos_o, one_pixel, real)


def peak_cells(view: SampleView, theta_d: np.ndarray) -> ChosenCells:
    """Choose the cell at the highlight of each slice.

    theta_d: theta_d of the slices, rad, (s,).
    """
    none = np.zeros((theta_d.size, 1), dtype=int)
    positions = positions_in(view, 0.0 * none, theta_d[:, None], 0.0 * none)
    there = np.ones(none.shape, dtype=bool)
    return ChosenCells(np.arange(theta_d.size), theta_d, none, none, 0.0 * none, 0.0 * none, there, *positions, there)


def noise_shares(rig: Rig, sampling: Sampling) -> np.ndarray:
    """Compute the ratio of the variance of each cell to that of a pixel.

    The result has shape (90, 90, 180). The ratio is one half if the two positions of a cell, on opposite sides of the
    highlight, certainly lie in different pixels, and otherwise 1. On a cylinder the ratio is always one half, because the two
    positions belong to different images. For a mean of n pixels the ratio is at most 1 / n. For interpolation on a grid of
    known phase the ratio is multiplied by the sum of the squared weights.
    """
    grid, view = merl_grid(sampling), sample_view(rig)
    directions = [
        turned(*view.from_highlight(grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d + way), view.azimuth)
        for way in BOTH_DIRECTIONS
    ]
    apart = 4 if rig.cell_value == "bilinear" else 1  # two interpolations share no pixel
    x, y = directions[0]
    shares = np.where((2 * np.maximum(np.abs(x), np.abs(y)) >= apart) | view.line, 0.5, 1.0)
    if rig.cell_value == "mean":
        shares = np.minimum(shares, 1 / np.maximum(pixel_counts(view.radius, grid.theta_d), 1.0))
    pixels = grid_of(rig)
    if pixels is not None and pixels.rule == "bilinear":
        at = np.stack(turned(view.radius * np.sin(grid.theta_d), np.zeros(grid.theta_d.size), pixels.azimuth), -1)
        off = (at - pixels.of_slices(np.arange(grid.theta_d.size)))[:, None]
        parts = [np.mod(np.stack(np.broadcast_arrays(*way), -1) + off, 1.0) for way in directions]
        shares = shares * np.mean([np.prod(part**2 + (1 - part) ** 2, axis=-1) for part in parts], axis=0)
    return shares


def positions_in(view: SampleView, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> CellPositions:
    """Compute the two image positions that show each cell.

    In a near rig the two positions belong to different lamp positions, and thus to different images (docs/model.md 10).
    """
    far = cell_positions(view.radius, theta_h, theta_d, phi_d)
    if view.distant:
        return far
    near = view.position(theta_h[..., None], theta_d[..., None], phi_d[..., None] + BOTH_DIRECTIONS)
    return far._replace(x=near.x, y=near.y)  # type: ignore[arg-type]


def _azimuth(view: SampleView, pixels: PixelGrid | None) -> float:
    return view.azimuth if pixels is None else pixels.azimuth


class _SliceCells(NamedTuple):
    """Chosen cells of a slice, padded to one length.

    Attributes:
        i: indices of theta_h.
        k: indices of phi_d.
        valid: False for padding.
        behind: real pixels from which each cell is read; None: no real pixels.
    """

    i: np.ndarray
    k: np.ndarray
    valid: np.ndarray
    behind: PixelsBehind | None


def _slice_cells(view: SampleView, sampling: Sampling, slice_: int, pixels: PixelGrid | None) -> _SliceCells:
    """Choose the cells of one slice, ring by ring from the highlight outwards.

    A cell is rejected if one of its pixels belongs to a cell that is already chosen.
    """
    theta_h, theta_d, phi_d = merl_grid(sampling)
    td, radius = theta_d[slice_], view.radius
    # half the circumference of each ring, px, foreshortened in one direction
    lengths = np.pi * radius * theta_h[_RINGS] * np.sqrt((1 + np.cos(td) ** 2) / 2)
    positions = np.where(_RINGS < NEAR_RINGS, np.clip(np.ceil(2 * lengths), 1, _MOST_NEAR), _MOST_IN_RING)
    rings = [_ring_azimuths(int(p), bool(ring % 2), phi_d.size) for p, ring in zip(positions, _RINGS, strict=True)]
    i, k = np.repeat(_RINGS, [one.size for one in rings]), np.concatenate(rings)
    x, y, cos_i, cos_o = positions_in(view, theta_h[i], np.full(k.size, td), phi_d[k])
    seen = np.minimum(cos_i, cos_o).min(axis=-1) > np.where(i < NEAR_RINGS, NEAR_COSINE, FAR_COSINE)
    shift, behind = np.zeros(2), None
    if pixels is not None:  # the real pixels must also be lit and visible
        shift = pixels.of_slices(np.array([slice_]))[0]
        behind = pixels_behind(pixels, radius, td, slice_, i, k)
        at = pixel_angles(radius, td, behind.x, behind.y)
        seen &= ((np.minimum(at.cos_i, at.cos_o) > NEAR_COSINE) | (behind.weight == 0)).all(axis=-1)
        if pixels.rule == "mean":  # the pixels inside, which differ from those of the two positions of the cell
            x, y = behind.x, behind.y
    numbers = pixel_numbers(x, y, shift, _azimuth(view, pixels)).tolist()
    occupied: set[float] = set()
    chosen: list[int] = []
    first = 0
    for ring, azimuths in zip(_RINGS, rings, strict=True):
        wanted = 5 if ring < NEAR_RINGS else _MOST_IN_RING if ring < 26 else 3
        for n in range(first, first + azimuths.size):
            own = set(numbers[n])
            if wanted and seen[n] and not own & occupied and len(chosen) < SLICE_CELLS:
                occupied |= own
                chosen.append(n)
                wanted -= 1
        first += azimuths.size
    valid = np.arange(SLICE_CELLS) < len(chosen)
    rows = np.array(chosen + [0] * (SLICE_CELLS - len(chosen)))
    if behind is not None:
        behind = PixelsBehind(*(part[rows] for part in behind))
    return _SliceCells(np.where(valid, i[rows], 0), np.where(valid, k[rows], 0), valid, behind)


@cache
def _ring_azimuths(positions: int, odd: bool, count: int) -> np.ndarray:
    """Choose the indices of phi_d that are considered in a ring, in an order in which any first few are spread over the ring.

    Odd and even rings have different azimuths. `count` is the number of values of phi_d in a table.
    """
    share = (np.arange(positions) + (0.5 if odd else 0.2)) / positions
    azimuths = np.unique((share * count).astype(int))
    return azimuths[np.argsort((np.arange(azimuths.size) * 0.618) % 1)]
