"""Where a rig's pictures show the cells of a table, and how their records become the table.

A table of one rig after the other's materials asks the same of geometry every time: the last rig's answer is kept.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from matcam._jax import is_concrete, jax, jnp
from matcam.angles import GRID_SHAPE, Sampling, cosines, merl_grid, theta_h_edges
from matcam.errors import ArgumentError
from matcam.forward.blur import Blur
from matcam.forward.plan import Plan, Targets, planned
from matcam.keyed import Keyed
from matcam.rigs import CellValue
from matcam.sample.sphere import Sphere

_POINTS: dict[CellValue, tuple[float, ...]] = {
    "centre": (0.5,),
    "edge": (0.0,),
    "mean": (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)),  # two Gauss-Legendre points along theta_h and phi_d
}
"""Where in a cell it is looked at, as shares of its sides."""


class Cells(NamedTuple):
    """The cells as seen one way: arrays over (theta_d, theta_h, phi_d, point, point); phi_d + pi is seen where pi - phi_d
    is, mirrored, so that reversing phi_d (and the points along it) gives the other way."""

    targets: Targets
    """Those that are seen."""
    numbers: np.ndarray
    """Their places in the flattened arrays."""
    cos_i: np.ndarray
    weight: np.ndarray
    """How much of the cell's value each place makes; 0 where it is not seen."""
    pixels: np.ndarray
    """Of the cells, (theta_h, theta_d, phi_d)."""


class Tabulation(NamedTuple):
    """How a rig fills a table."""

    cells: Cells
    plan: Plan


def tabulation(sphere: Sphere, blur: Blur, cell_value: CellValue, crop: tuple[int, int] | None) -> Tabulation:
    """The cells and the plan of their record. Needs numbers: ArgumentError inside jax.jit."""
    rig = jax.lax.stop_gradient((sphere, blur))
    numbers, tree = jax.tree.flatten(rig)
    if not all(is_concrete(number) for number in numbers):
        raise ArgumentError("the rig's numbers set which pixels make up a table: call this outside of jax.jit and vmap")
    key = tree, tuple(np.asarray(number).tobytes() for number in numbers)
    return _tabulation(Keyed(key, rig), cell_value, crop)


@lru_cache(maxsize=1)
def _tabulation(rig: Keyed[tuple[Sphere, Blur]], cell_value: CellValue, crop: tuple[int, int] | None) -> Tabulation:
    sphere, blur = rig.thing
    cells = _cells(sphere, cell_value, crop)
    theta_d = merl_grid(sampling_of(cell_value)).theta_d
    return Tabulation(cells, planned(sphere, blur, np.asarray(sphere.lamp_angle(jnp.asarray(theta_d))), cells.targets))


def sampling_of(cell_value: CellValue) -> Sampling:
    """Where the cells of a table of this kind are sampled."""
    return "edge" if cell_value == "edge" else "centre"


def _cells(sample: Sphere, cell_value: CellValue, crop: tuple[int, int] | None) -> Cells:
    n_h, n_d, n_p = GRID_SHAPE
    points = np.array(_POINTS[cell_value])
    share = (np.arange(n_h)[:, None] + points) / n_h
    theta_h = (share**2 * np.pi / 2)[None, :, None, :, None]
    theta_d = merl_grid(sampling_of(cell_value)).theta_d[:, None, None, None, None]
    # where 0 is sampled, pi has to be, too: its mirror image
    columns = np.arange(n_p + 1 if cell_value == "edge" else n_p)
    phi_d = ((columns[:, None] + points) / n_p * np.pi)[None, None, :, None, :]
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    place = jax.jit(lambda sample, *angles: sample.place(*angles))(sample, theta_h, theta_d, phi_d)
    x, y, lamp_angle = (np.asarray(a) for a in place)
    seen = (cos_i > 0) & (cos_o > 0)
    if crop is not None:
        height, width = crop
        seen &= (np.abs(x) <= width / 2) & (np.abs(y) <= height / 2)
    index = np.flatnonzero(seen)
    picture = np.broadcast_to(np.arange(n_d, dtype=np.int32)[:, None, None, None, None], seen.shape)
    targets = Targets(*(a.ravel()[index] for a in (x, y, lamp_angle, picture)))

    # pixels per point: distant camera, r^2 cos_o sin theta_h dtheta_h dphi_d (MODEL 8)
    edges = theta_h_edges()
    solid = (np.sin(edges[:-1] + np.diff(edges) / 2) * np.diff(edges) * np.pi / n_p)[None, :, None, None, None]
    content = np.where(seen, cos_o * solid, 0.0) * float(sample.radius) ** 2 / points.size**2
    pixels = (content + _other_way(content)).sum(axis=(3, 4))[:, :, :n_p].transpose(1, 0, 2)
    # equal shares of sqrt(theta_h) hold unequal numbers of pixels
    weight = content * share[None, :, None, :, None] * np.sin(theta_h) if cell_value == "mean" else seen * 1.0
    return Cells(targets, index, cos_i, weight, pixels)


def _other_way(one_way):  # type: ignore[no-untyped-def]
    return one_way[:, :, ::-1, :, ::-1]


def folded(radiance: jax.Array, cells: Cells) -> jax.Array:
    """Mean over the places of each cell, both ways; NaN where none is seen."""
    channels = radiance.shape[-1]
    spread = jnp.zeros((cells.cos_i.size, channels)).at[cells.numbers].set(radiance)
    spread = spread.reshape(*cells.cos_i.shape, channels)
    weighted = spread * (cells.weight / np.where(cells.weight > 0, cells.cos_i, 1.0))[..., None]
    total = jnp.sum(weighted + _other_way(weighted), axis=(3, 4))
    weight = np.sum(cells.weight + _other_way(cells.weight), axis=(3, 4))[..., None]
    mean = jnp.where(weight > 0, total / np.where(weight > 0, weight, 1.0), jnp.nan)
    return mean[:, :, : GRID_SHAPE[2]].transpose(1, 0, 2, 3)
