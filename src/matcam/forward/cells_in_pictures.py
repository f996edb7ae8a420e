"""Positions of the cells of a table in the images of a sphere, and the pixels behind each entry (docs/model.md 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, Sampling, cosines, merl_grid, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.forward.integral.plan import RecordPlaces
from matcam.forward.pixel_grid import phase_of_slices, slice_pixels, turned
from matcam.lamp.lamps import closeness
from matcam.rigs import ON_REAL_PIXELS, CellValue, PixelPhase
from matcam.sample.shape import Curved

_POINTS: dict[CellValue, tuple[float, ...]] = {
    "centre": (0.5,),
    "edge": (0.0,),
    "unknown": (0.5,),
    "mean": (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)),  # two Gauss-Legendre points along theta_h and phi_d
}
"""Evaluation points in a cell, as shares of its sides."""


def cell_sampling(cell_value: CellValue) -> Sampling:
    """Find the position in its cell at which a table is sampled: "centre" or "edge"."""
    return "edge" if cell_value == "edge" else "centre"


class CellChoice(NamedTuple):
    """Choice of the pixels behind the cells of a table.

    Attributes:
        cell_value: meaning of a cell's value.
        crop: (height, width) of the sensor, px; None: unlimited.
        azimuth: azimuth of the lamp in all pictures, rad.
        elongation: elongation of the material's lobe, no unit.
        pixel_phase: phase of the real pixels that are looked up, px; None: every cell has its own pixels.
        even: True if images through the lens are symmetric above and below.
        shift: shift of the images, (right, up), px.
    """

    cell_value: CellValue
    crop: tuple[int, int] | None = None
    azimuth: float = 0.0
    elongation: float = 1.0
    pixel_phase: PixelPhase | None = None
    even: bool = True
    shift: tuple[float, float] = (0.0, 0.0)

    def cells(self, sample: Curved, lamp_nearness: jax.Array | None = None) -> TableCells | RealCells:
        """Return the cells of a table of this sample."""
        cells = self._unshifted(sample, lamp_nearness)
        # a pixel of a shifted image corresponds to another position of the unshifted one
        x, y = (at - by for at, by in zip(cells.places[:2], self.shift, strict=True))
        return cells._replace(places=cells.places._replace(x=x, y=y))

    def _unshifted(self, sample: Curved, lamp_nearness: jax.Array | None) -> TableCells | RealCells:
        if self.pixel_phase is None and self.cell_value not in ON_REAL_PIXELS:
            return table_cells(sample, self.cell_value, self.crop, self.azimuth, lamp_nearness, self.even)
        if not sample.distant or lamp_nearness is not None:
            raise ArgumentError(
                "a real pixel grid needs a distant camera and lamp: with near ones each cell has its own picture"
            )
        if self.pixel_phase is None:
            raise ArgumentError(
                f"cells of '{self.cell_value}' need the rig's pixel_phase (x, y), px, which gives the positions "
                "of the pixels"
            )
        return _real_cells(float(sample.radius), self, self.pixel_phase)


class TableCells(NamedTuple):
    """Cells of a table in one of the two directions: arrays over (theta_d, theta_h, phi_d, point, point).

    With the lamp in the x direction of the sensor, the image at phi_d + pi mirrors that at pi - phi_d. Reversing phi_d,
    and the points along it, therefore gives the other direction. With any other lamp, or through a lens that is not
    even, phi_d covers the full turn.

    Attributes:
        places: positions of the visible points.
        flat_index: indices of the visible points in the flattened arrays.
        irradiance: cosine of the light at each cell, times the irradiance of a near lamp relative to the centre.
        weight: share of each point in the value of its cell; 0 for invisible points.
        pixels: pixels behind the cells, (theta_h, theta_d, phi_d).
        mirrored: True where reversing phi_d gives the other direction.
    """

    places: RecordPlaces
    flat_index: np.ndarray
    irradiance: np.ndarray
    weight: np.ndarray
    pixels: np.ndarray
    mirrored: bool


def table_cells(
    sample: Curved,
    cell_value: CellValue,
    crop: tuple[int, int] | None,
    azimuth: float = 0.0,
    lamp_nearness: jax.Array | None = None,
    even: bool = True,
) -> TableCells:
    """Find the cells of a table in the images of a sphere.

    The sensor covers `crop`, (height, width), px; None: unlimited.
    """
    n_h, n_d, n_p = GRID_SHAPE
    mirrored = azimuth == 0 and even
    points = np.array(_POINTS[cell_value])
    share = (np.arange(n_h)[:, None] + points) / n_h
    theta_h = (share**2 * np.pi / 2)[None, :, None, :, None]
    theta_d = merl_grid(cell_sampling(cell_value)).theta_d[:, None, None, None, None]
    # sampling 0 requires sampling pi, its mirror image
    columns = np.arange(n_p + (cell_value == "edge") if mirrored else 2 * n_p)
    phi_d = ((columns[:, None] + points) / n_p * np.pi)[None, None, :, None, :]
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    place = jax.jit(lambda sample, *angles: sample.place(*angles))(sample, theta_h, theta_d, phi_d, lamp_nearness)
    x, y, lamp_angle = (np.asarray(a) for a in place)
    if azimuth:
        x, y = x * np.cos(azimuth) - y * np.sin(azimuth), x * np.sin(azimuth) + y * np.cos(azimuth)
    seen = (cos_i > 0) & (cos_o > 0)
    if crop is not None:
        height, width = crop
        seen &= (np.abs(x) <= width / 2) & (np.abs(y) <= height / 2)
    index = np.flatnonzero(seen)
    picture = np.broadcast_to(np.arange(n_d, dtype=np.int32)[:, None, None, None, None], seen.shape)
    places = RecordPlaces(*(a.ravel()[index] for a in (x, y, lamp_angle, picture)))
    if azimuth:
        places = places._replace(azimuth=np.full(index.size, azimuth))

    # pixels per point: distant camera, r^2 cos_o sin theta_h dtheta_h dphi_d (docs/model.md 8)
    edges = theta_h_edges()
    solid = (np.sin(edges[:-1] + np.diff(edges) / 2) * np.diff(edges) * np.pi / n_p)[None, :, None, None, None]
    content = np.where(seen, cos_o * solid, 0.0) * float(sample.radius) ** 2 / points.size**2
    pixels = (content + _other_way(content, mirrored)).sum(axis=(3, 4))[:, :, :n_p].transpose(1, 0, 2)
    # equal shares of sqrt(theta_h) contain unequal numbers of pixels
    weight = content * share[None, :, None, :, None] * np.sin(theta_h) if cell_value == "mean" else seen * 1.0
    irradiance = cos_i * np.asarray(closeness(lamp_nearness, jnp.asarray(cos_i))) ** 2
    return TableCells(places, index, irradiance, weight, pixels, mirrored)


class RealCells(NamedTuple):
    """Cells of a table that are looked up in real pixels.

    Attributes:
        places: the pixels, of all slices.
        irradiance: (pixels,), cosine of the light at each.
        cell: (entries,), index of a cell in the flattened (theta_d, theta_h, phi_d).
        pixel: (entries,), index of a pixel behind it.
        share: (entries,), share of the pixel in the value of the cell.
        pixels: pixels behind the cells, (theta_h, theta_d, phi_d).
    """

    places: RecordPlaces
    irradiance: np.ndarray
    cell: np.ndarray
    pixel: np.ndarray
    share: np.ndarray
    pixels: np.ndarray


def _real_cells(radius: float, chosen: CellChoice, phase: PixelPhase) -> RealCells:
    """Find the pixels behind all cells, slice by slice."""
    n_h, n_d, n_p = GRID_SHAPE
    theta_d = merl_grid("centre").theta_d
    columns: list[tuple[np.ndarray, ...]] = []
    counts = np.zeros((n_d, n_h * n_p))
    before = 0
    phases = phase_of_slices(phase)
    for j in range(n_d):
        one = slice_pixels(chosen.cell_value, phases[j], radius, theta_d[j], chosen.crop, chosen.azimuth)
        x, y = turned(one.x, one.y, chosen.azimuth)
        counts[j] = np.diff(one.share.indptr)
        cell = j * n_h * n_p + np.repeat(np.arange(n_h * n_p), np.diff(one.share.indptr))
        picture = np.full(x.size, j, dtype=np.int32)
        columns.append((x, y, picture, one.cos_i, cell, before + one.share.indices, one.share.data))
        before += x.size
    x, y, picture, cos_i, cell, pixel, share = (np.concatenate(c) for c in zip(*columns, strict=True))
    turns = np.full(x.size, chosen.azimuth) if chosen.azimuth else None
    places = RecordPlaces(x, y, 2 * theta_d[picture], picture, turns)
    pixels = counts.reshape(n_d, n_h, n_p).transpose(1, 0, 2)
    return RealCells(places, cos_i, cell, pixel, share, pixels)


def cell_means(radiance: jax.Array, cells: TableCells | RealCells) -> jax.Array:
    """Average the BRDF over the positions of each cell, both directions.

    The mean is NaN where no position is visible.
    """
    channels = radiance.shape[-1]
    if isinstance(cells, RealCells):
        n_h, n_d, n_p = GRID_SHAPE
        parts = (radiance / cells.irradiance[:, None])[cells.pixel] * cells.share[:, None]
        summed = jnp.zeros((n_d * n_h * n_p, channels)).at[cells.cell].add(parts)
        summed = summed.reshape(n_d, n_h, n_p, channels).transpose(1, 0, 2, 3)
        return jnp.where((cells.pixels > 0)[..., None], summed, jnp.nan)
    spread = jnp.zeros((cells.irradiance.size, channels)).at[cells.flat_index].set(radiance)
    spread = spread.reshape(*cells.irradiance.shape, channels)
    weighted = spread * (cells.weight / np.where(cells.weight > 0, cells.irradiance, 1.0))[..., None]
    total = jnp.sum(weighted + _other_way(weighted, cells.mirrored), axis=(3, 4))
    weight = np.sum(cells.weight + _other_way(cells.weight, cells.mirrored), axis=(3, 4))[..., None]
    mean = jnp.where(weight > 0, total / np.where(weight > 0, weight, 1.0), jnp.nan)
    return mean[:, :, : GRID_SHAPE[2]].transpose(1, 0, 2, 3)


def _other_way(one_way, mirrored):  # type: ignore[no-untyped-def]
    if mirrored:
        return one_way[:, :, ::-1, :, ::-1]
    half = one_way.shape[2] // 2
    join = np.concatenate if isinstance(one_way, np.ndarray) else jnp.concatenate
    return join([one_way[:, :, half:], one_way[:, :, :half]], axis=2)
