"""The cells of a table that a material is fitted to: few, far and near, and no two of them read from one pixel.

Near the peak about 75 cells of a MERL table come from one pixel and share its noise; elsewhere a cell is a pixel. A fit wants
data whose errors are independent, so of each pixel one cell is chosen. The likelihood of the chosen cells is then exact, slice
by slice, with nothing counted twice. Two kinds of cells are left out. Neighbours in one pixel say the same again. On the
smooth flanks hundreds of pixels would only tell better what is known to a fraction of a per cent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid
from matcam.forward.pixel_grid import PixelGrid, looked_up, pixel_angles
from matcam.inverse.operator.sphere_view import BOTH_WAYS, SphereView
from matcam.rigs import CellValue

NEAR_RINGS = 12
NEAR_COSINE, FAR_COSINE = 0.06, 0.17
"""Smallest cosine of light and view that is used, in the rings about the highlight and beyond them: closer to the ends of the
light a cell hangs on the sphere's last pixels."""

_CELLS = 112
"""Most cells of a slice: one shape for all."""
_RINGS = np.concatenate([np.arange(12), np.arange(12, 26, 2), np.arange(26, 90, 5)])
_MOST_IN_RING = 4
_STRIDE = 1 << 16
"""Pixels per row in a pixel's number."""


class RealPixels(NamedTuple):
    """Hold what real pixels show, whose centres are not the cells' places. Shapes: s slices, n cells, w pixels of a cell.

    Attributes:
        theta: (s, n, w), angle of each pixel's centre from the half vector, rad.
        psi: (s, n, w), its azimuth about it, rad.
        weight: (s, n, w), share of each pixel in its cell.
        noise_share: (s, n), variance of a cell over that of a pixel.
    """

    theta: np.ndarray
    psi: np.ndarray
    weight: np.ndarray
    noise_share: np.ndarray


class ChosenCells(NamedTuple):
    """Hold cells of some theta_d slices and the two pixels behind each. Shapes: s slices, n cells; the last axis is the way.

    Attributes:
        slices: (s,), indices of theta_d.
        theta_d: (s,), rad.
        i_theta_h: (s, n), indices of theta_h.
        i_phi_d: (s, n), indices of phi_d.
        theta_h: (s, n), rad.
        phi_d: (s, n), rad.
        valid: (s, n), False where a slice has fewer cells.
        x: (s, n, 2), the pixels' centres, px from the optical axis, the lamp towards +x.
        y: (s, n, 2), the same across.
        cos_i: (s, n, 2), cosine of the light at each place.
        cos_o: (s, n, 2), cosine of the view.
        one_pixel: (s, n), whether both ways fall into the same pixel.
        real: where cells are looked up in real pixels, what these show; x, y and the cosines are the pixels' then, and their
            last axis is over all pixels of a cell. None: each way is a pixel at the cell's place.
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

    @property
    def weight(self) -> np.ndarray:
        """Return the share of each pixel in its cell, (s, n, pixels)."""
        return np.full(self.x.shape, 0.5) if self.real is None else self.real.weight

    @property
    def noise_share(self) -> np.ndarray:
        """Return the variance of each cell over that of a pixel, (s, n): half, unless both ways are one pixel."""
        return np.where(self.one_pixel, 1.0, 0.5) if self.real is None else self.real.noise_share


class CellPlaces(NamedTuple):
    """Hold the two places of a sphere that show a cell, on a last axis.

    Attributes:
        x: px from the optical axis, the lamp towards +x.
        y: the same across.
        cos_i: cosine of the light.
        cos_o: cosine of the view.
    """

    x: np.ndarray
    y: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray


def chosen_cells(view: SphereView, sampling: Sampling, every: int = 1, pixels: PixelGrid | None = None) -> ChosenCells:
    """Choose cells in every `every`-th slice of a table recorded from a sphere.

    pixels: the real grid that the cells are looked up in; None: each has pixels of its own.
    """
    grid = merl_grid(sampling)
    slices = np.arange(every // 2, GRID_SHAPE[1], every)
    columns: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for j in slices:
        one = None if pixels is None else pixels._replace(phase=tuple(pixels.of_slices(slices)[len(columns)].tolist()))
        columns.append(_slice_cells(view, grid.theta_h, grid.theta_d[j], grid.phi_d, one))
    i, k, valid = (np.stack(part) for part in zip(*columns, strict=True))
    theta_h, phi_d = grid.theta_h[i], grid.phi_d[k]
    x, y, cos_i, cos_o = places_in(view, theta_h, grid.theta_d[slices, None], phi_d)
    shift = np.zeros(2) if pixels is None else pixels.of_slices(slices)[:, None, None]
    numbers = _pixel_numbers(x, y, shift)
    one_pixel = numbers[..., 0] == numbers[..., 1]
    real = None
    if pixels is not None:
        real, x, y, cos_i, cos_o = _in_pixels(view.radius, grid.theta_d[slices, None], x, y, pixels.rule, shift)
        for cosine in (cos_i, cos_o):  # of cells that only fill up a slice
            cosine[~valid] = 1.0
    return ChosenCells(slices, grid.theta_d[slices], i, k, theta_h, phi_d, valid, x, y, cos_i, cos_o, one_pixel, real)


def noise_shares(view: SphereView, sampling: Sampling) -> np.ndarray:
    """Return the variance of every cell of a table over that of a pixel, (90, 90, 180).

    It is half where the cell's two ways, on either side of their picture's highlight, are surely seen by two pixels.
    """
    grid = merl_grid(sampling)
    x, y = view.from_highlight(grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d)
    return np.where(2 * np.maximum(np.abs(x), np.abs(y)) >= 1, 0.5, 1.0)


def _pixel_numbers(x: np.ndarray, y: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return numbers of the pixels in which places fall."""
    return np.rint(x - phase[..., 0]) * _STRIDE + np.rint(y - phase[..., 1])


def _in_pixels(
    radius: float, theta_d: np.ndarray, x: np.ndarray, y: np.ndarray, rule: CellValue, phase: np.ndarray
) -> tuple[RealPixels, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels that two places of each cell are looked up in, and their x, y, cos_i, cos_o."""
    found = looked_up(rule, phase, x, y)
    x, y, weight = (a.reshape(*a.shape[:-2], -1) for a in (found.x, found.y, found.weight / 2))
    at = pixel_angles(radius, theta_d[..., None], x, y)
    numbers = _pixel_numbers(x, y, phase)
    same = numbers[..., :, None] == numbers[..., None, :]
    noise_share = np.einsum("...a,...ab,...b->...", weight, same, weight)
    return RealPixels(at.theta_h, at.psi, weight, noise_share), x, y, at.cos_i, at.cos_o


def places_in(view: SphereView, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> CellPlaces:
    """Return the two places that show each cell, each in the picture whose lamp does (docs/model.md 10)."""
    far = cell_places(view.radius, theta_h, theta_d, phi_d)
    if view.distant:
        return far
    near = view.place(theta_h[..., None], theta_d[..., None], phi_d[..., None] + BOTH_WAYS)
    return far._replace(x=near.x, y=near.y)  # type: ignore[arg-type]


def cell_places(radius: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> CellPlaces:
    """Return the two places where a distant camera and lamp show each cell (docs/model.md 3)."""
    psi = np.pi - phi_d[..., None] + np.array([0.0, np.pi])
    th, td = theta_h[..., None], theta_d[..., None]
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(psi)
    x = radius * (np.cos(th) * np.sin(td) + np.sin(th) * np.cos(psi) * np.cos(td))
    return CellPlaces(x, radius * np.sin(th) * np.sin(psi), mean + half, mean - half)


def _slice_cells(
    view: SphereView, theta_h: np.ndarray, theta_d: float, phi_d: np.ndarray, grid: PixelGrid | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (i, k, valid) of one slice, rings from the highlight outwards.

    A cell is refused if one of its pixels belongs to another cell.
    """
    shift = np.zeros(2) if grid is None else np.asarray(grid.phase)
    radius = view.radius
    rings = [_ring_azimuths(ring, radius * theta_h[ring], theta_d, phi_d.size) for ring in _RINGS]
    i, k = np.repeat(_RINGS, [one.size for one in rings]), np.concatenate(rings)
    x, y, cos_i, cos_o = places_in(view, theta_h[i], np.full(k.size, theta_d), phi_d[k])
    seen = np.minimum(cos_i, cos_o).min(axis=-1) > np.where(i < NEAR_RINGS, NEAR_COSINE, FAR_COSINE)
    if grid is not None:  # the pixels themselves must be there, too
        _, _, _, cos_i, cos_o = _in_pixels(radius, np.full(k.size, theta_d), x, y, grid.rule, shift)
        seen &= (np.minimum(cos_i, cos_o) > NEAR_COSINE).all(axis=-1)
    numbers = _pixel_numbers(x, y, shift).tolist()
    occupied: set[float] = set()
    chosen: list[tuple[int, int]] = []
    first = 0
    for ring, azimuths in zip(_RINGS, rings, strict=True):
        wanted = 5 if ring < NEAR_RINGS else _MOST_IN_RING if ring < 26 else 3
        # in an order that spreads over the ring even where not all cells fit
        for n in first + np.argsort((np.arange(azimuths.size) * 0.618) % 1):
            pixels = set(numbers[n])
            if wanted and seen[n] and not pixels & occupied and len(chosen) < _CELLS:
                occupied |= pixels
                chosen.append((int(ring), int(k[n])))
                wanted -= 1
        first += azimuths.size
    valid = np.arange(_CELLS) < len(chosen)
    padded = np.array(chosen + [(0, 0)] * (_CELLS - len(chosen)))
    return padded[:, 0], padded[:, 1], valid


def _ring_azimuths(ring: int, radius: float, theta_d: float, count: int) -> np.ndarray:
    """Return the indices of phi_d, of `count`, that are looked at in a ring of `radius` px."""
    # its half circumference in px, foreshortened in one direction
    length = np.pi * radius * np.sqrt((1 + np.cos(theta_d) ** 2) / 2)
    places = int(np.clip(np.ceil(2 * length), 1, 24)) if ring < NEAR_RINGS else _MOST_IN_RING
    share = (np.arange(places) + (0.5 if ring % 2 else 0.2)) / places
    return np.unique((share * count).astype(int))
