"""Positions and pixels of table cells in images of a sphere (docs/model.md 3)."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.arrays import xp
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, Sampling, cosines, merl_grid, theta_h_edges
from matcam.core.jax import AnyArray, computes_on_gpu, is_concrete, jax, jnp
from matcam.forward.cylinder_cells import line_positions
from matcam.forward.pixel_grid import phase_of_slices, slice_pixels, turned
from matcam.forward.sampler.cell_rings import Rings, rings_of
from matcam.forward.sampler.plan import RecordPositions
from matcam.lamp.lamps import closeness
from matcam.rigs import ON_REAL_PIXELS, CellValue, PixelPhase
from matcam.sample.curved import Cylinder
from matcam.sample.positions import positions_of
from matcam.sample.shape import Curved

_POINTS: dict[CellValue, tuple[float, ...]] = {
    "centre": (0.5,),
    "edge": (0.0,),
    "unknown": (0.5,),
    "mean": (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)),  # two Gauss-Legendre points along theta_h and phi_d
}
"""Evaluation points in a cell for each `cell_value`, as shares of the sides of the cell."""


def cell_sampling(cell_value: CellValue) -> Sampling:
    return "edge" if cell_value == "edge" else "centre"


class CellChoice(NamedTuple):
    """Parameters that determine the pixels of each table cell.

    Attributes:
        cell_value: origin of the value of a cell, as in `Rig`.
        crop: (height, width) of the sensor, px; None: the sensor is unlimited.
        azimuth: azimuth of the lamp in all images, rad.
        pixel_phase: phase of the real pixel grid that provides the values of the cells, px; None: every cell has its own
            pixel.
        even: True if the kernel of the lens is symmetric about the x axis.
        shift: shift of the images, (right, up), px.
        finest: standard deviation of the narrowest Gaussian of the lens, px. It determines how many positions suffice to
            interpolate the cells around a highlight. None: every cell is recorded.
    """

    cell_value: CellValue
    crop: tuple[int, int] | None = None
    azimuth: float = 0.0
    pixel_phase: PixelPhase | None = None
    even: bool = True
    shift: tuple[float, float] = (0.0, 0.0)
    finest: float | None = None

    def cells(self, sample: Curved, lamp_nearness: jax.Array | None = None) -> TableCells | RealCells:
        """Compute the table cells on a sample.

        `lamp_nearness` is the inverse of the distance of the lamp, 1/radii. Default: None, a distant lamp.
        """
        cells = self._unshifted(sample, lamp_nearness)
        # a pixel of a shifted image corresponds to another position in the unshifted image
        x, y = (at - by for at, by in zip(cells.positions[:2], self.shift, strict=True))
        return cells._replace(positions=cells.positions._replace(x=x, y=y))

    def _unshifted(self, sample: Curved, lamp_nearness: jax.Array | None) -> TableCells | RealCells:
        if self.pixel_phase is None and self.cell_value not in ON_REAL_PIXELS:
            return _table_cells(sample, self, lamp_nearness)
        if not sample.distant or lamp_nearness is not None:
            raise ArgumentError(
                "a real pixel grid needs a distant camera and lamp, because in a near rig each cell has its own image: "
                "specify cell_value 'centre' or 'edge', without pixel_phase"
            )
        if self.pixel_phase is None:
            raise ArgumentError(
                f"cell_value '{self.cell_value}' requires the positions of the pixels: give the rig's pixel_phase (x, y), px"
            )
        return _real_cells(float(sample.radius), self, self.pixel_phase)


class TableCells(NamedTuple):
    """Cells of a table in one of the two reciprocal directions.

    `irradiance` and `weight` have the shape (theta_d, theta_h, phi_d, points along theta_h, points along phi_d).

    If the lamp is in the x direction of the sensor, or if the sample is a cylinder, the positions at phi_d + pi are mirror
    images of the positions at pi - phi_d. Reversing the order of phi_d, and of the points along phi_d, therefore yields the
    other direction. For any other azimuth of the lamp, or if the kernel of the lens is not symmetric, phi_d covers the full
    turn.

    Attributes:
        positions: positions of the visible points that are not on rings, followed by the positions from which rings are
            interpolated.
        flat_index: indices, in the flattened `irradiance`, of the visible points that are not on rings.
        rings: rings of cells that are interpolated.
        irradiance: irradiance at each point divided by the irradiance of a surface that faces the lamp at the centre of
            the sample, no unit.
        weight: weight of each point in the value of its cell, no unit; 0 for invisible points.
        pixels: number of pixels of each cell in both directions, no unit, (theta_h, theta_d, phi_d).
        mirrored: True if reversing the order of phi_d yields the other direction.
    """

    positions: RecordPositions
    flat_index: np.ndarray
    rings: tuple[Rings, ...]
    irradiance: np.ndarray
    weight: np.ndarray
    pixels: np.ndarray
    mirrored: bool


def _table_cells(sample: Curved, choice: CellChoice, lamp_nearness: jax.Array | None) -> TableCells:
    n_h, n_d, n_p = GRID_SHAPE
    cell_value, azimuth = choice.cell_value, choice.azimuth
    mirrored = azimuth == 0 and choice.even
    points = np.array(_POINTS[cell_value])
    share = (np.arange(n_h)[:, None] + points) / n_h
    theta_h = (share**2 * np.pi / 2)[None, :, None, :, None]
    theta_d = merl_grid(cell_sampling(cell_value)).theta_d[:, None, None, None, None]
    # the mirror image of phi_d = 0 is phi_d = pi, which therefore has to be sampled, too
    columns = np.arange(n_p + (cell_value == "edge") if mirrored else 2 * n_p)
    phi_d = ((columns[:, None] + points) / n_p * np.pi)[None, None, :, None, :]
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    seen = (cos_i > 0) & (cos_o > 0)

    def placed(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> RecordPositions:
        if isinstance(sample, Cylinder):
            return line_positions(sample, theta_h, theta_d, phi_d, lamp_nearness)
        x, y, lamp_angle = positions_of(sample, theta_h, theta_d, phi_d, lamp_nearness)
        return RecordPositions(*turned(x, y, azimuth), lamp_angle, np.full(x.shape, azimuth) if azimuth else None)

    every = placed(theta_h, theta_d, phi_d)
    if choice.crop is not None:
        height, width = choice.crop
        seen &= (np.abs(every.x) <= width / 2) & (np.abs(every.y) <= height / 2)
    # in a distant rig, a normal that is not visible has a position on the sensor, too
    whole = np.ones(seen.shape, dtype=bool) if sample.distant and lamp_nearness is None else seen
    rings, samples = rings_of(theta_h, theta_d, phi_d, whole, _per_radian(sample, choice.finest), mirrored)
    on_ring = np.zeros(seen.size, dtype=bool)
    for ring in rings:
        on_ring[ring.cells] = True
    index = np.flatnonzero(seen & ~on_ring.reshape(seen.shape))
    picture = np.broadcast_to(np.arange(n_d)[:, None, None, None, None], seen.shape)
    slices = np.searchsorted(merl_grid(cell_sampling(cell_value)).theta_d, samples[1] - 1e-9)
    positions = jax.tree.map(
        lambda cells, of_rings: np.concatenate([cells.ravel()[index], of_rings]),
        every._replace(picture=picture),
        placed(*samples)._replace(picture=slices),
    )

    if isinstance(sample, Cylinder):  # each direction of a cell has its own image and pixel
        content = seen * 1.0
    else:  # number of pixels per point, for a distant camera: r^2 cos_o sin theta_h dtheta_h dphi_d (docs/model.md 8)
        edges = theta_h_edges()
        solid = (np.sin(edges[:-1] + np.diff(edges) / 2) * np.diff(edges) * np.pi / n_p)[None, :, None, None, None]
        content = np.where(seen, cos_o * solid, 0.0) * float(sample.radius) ** 2 / points.size**2
    pixels = (content + _other_way(content, mirrored)).sum(axis=(3, 4))[:, :, :n_p].transpose(1, 0, 2)
    # equal intervals of sqrt(theta_h) contain unequal numbers of pixels
    weight = content * share[None, :, None, :, None] * np.sin(theta_h) if cell_value == "mean" else seen * 1.0
    irradiance = cos_i * np.asarray(closeness(lamp_nearness, jnp.asarray(cos_i))) ** 2
    return TableCells(positions, index, rings, irradiance, weight, pixels, mirrored)


def _per_radian(sample: Curved, finest: float | None) -> float:
    """Compute the largest shift of the image per rotation of the normal.

    The unit is the standard deviation of the lens, `finest`, per rad. The result is 0 if `finest` is None.
    """
    return 0.0 if finest is None else float(sample.stretch / (1 - sample.nearness)) / finest


class RealCells(NamedTuple):
    """Cells of a table whose values come from real pixels.

    Attributes:
        positions: centres of the pixels of all slices.
        irradiance: cosine of the angle of incidence at the centre of each pixel, (pixels,).
        cell: index of a cell in the flattened (theta_d, theta_h, phi_d), (entries,).
        pixel: index in `positions` of a pixel of this cell, (entries,).
        share: share of this pixel in the value of the cell, no unit, (entries,).
        pixels: number of pixels of each cell, no unit, (theta_h, theta_d, phi_d).
    """

    positions: RecordPositions
    irradiance: np.ndarray
    cell: np.ndarray
    pixel: np.ndarray
    share: np.ndarray
    pixels: np.ndarray


def _real_cells(radius: float, chosen: CellChoice, phase: PixelPhase) -> RealCells:
    """Find the real pixels of all cells, slice by slice.

    `radius` is the radius of the limb, px.
    """
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
    positions = RecordPositions(x, y, 2 * theta_d[picture], turns, picture)
    pixels = counts.reshape(n_d, n_h, n_p).transpose(1, 0, 2)
    return RealCells(positions, cos_i, cell, pixel, share, pixels)


def cell_means(radiance: jax.Array, cells: TableCells | RealCells) -> AnyArray:
    """Average the BRDF over the positions of each cell in both directions.

    The means have the shape (theta_h, theta_d, phi_d, channels) and the unit 1/sr. They are NaN where no position is
    visible. `radiance` contains the radiance at the positions of the cells, 1/sr, (positions, channels).
    """
    # concrete values are averaged by NumPy, because JAX would compile a program for every shape
    if not is_concrete(radiance):
        return _means(radiance, cells)
    return _means_on_gpu(radiance, cells) if computes_on_gpu() else _means(np.asarray(radiance), cells)


def _means(known: AnyArray, cells: TableCells | RealCells) -> AnyArray:
    channels = known.shape[-1]
    if isinstance(cells, RealCells):
        n_h, n_d, n_p = GRID_SHAPE
        parts = (known / cells.irradiance[:, None])[cells.pixel] * cells.share[:, None]
        summed = _summed(n_d * n_h * n_p, cells.cell, parts)
        summed = summed.reshape(n_d, n_h, n_p, channels).transpose(1, 0, 2, 3)
        return xp.where((cells.pixels > 0)[..., None], summed, np.nan)
    direct = cells.flat_index.size
    index = _joined([cells.flat_index, *(ring.cells for ring in cells.rings)])
    values = [known[:direct], *(ring.interpolated(known[direct:]) for ring in cells.rings)]
    spread = _summed(cells.irradiance.size, index, _joined(values)).reshape(*cells.irradiance.shape, channels)
    weighted = spread * (cells.weight / xp.where(cells.weight > 0, cells.irradiance, 1.0))[..., None]
    total = (weighted + _other_way(weighted, cells.mirrored)).sum(axis=(3, 4))
    weight = (cells.weight + _other_way(cells.weight, cells.mirrored)).sum(axis=(3, 4))[..., None]
    mean = xp.where(weight > 0, total / xp.where(weight > 0, weight, 1.0), np.nan)
    return mean[:, :, : GRID_SHAPE[2]].transpose(1, 0, 2, 3)


_means_on_gpu = eqx.filter_jit(_means)


def _joined(parts: list[AnyArray], axis: int = 0) -> AnyArray:
    in_numpy = all(isinstance(part, np.ndarray) for part in parts)
    return np.concatenate(parts, axis) if in_numpy else jnp.concatenate(parts, axis)


def _summed(size: int, index: AnyArray, values: AnyArray) -> AnyArray:
    if not isinstance(values, np.ndarray):
        return jnp.zeros((size, values.shape[1])).at[index].add(values)
    return np.stack([np.bincount(index, column, size) for column in values.T], axis=-1)


def _other_way(one_way, mirrored):  # type: ignore[no-untyped-def]
    if mirrored:
        return one_way[:, :, ::-1, :, ::-1]
    half = one_way.shape[2] // 2
    return _joined([one_way[:, :, half:], one_way[:, :, :half]], axis=2)
