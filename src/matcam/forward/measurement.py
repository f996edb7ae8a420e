"""Where a rig's pictures show the cells of a table, and how their records become the table.

A table of one rig after the other's materials asks the same of geometry every time: the last rig's answer is kept.

The table that a rig records of a material: every cell of the MERL grid as its pixels see it (MODEL 3).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError
from matcam.core.grid import (
    CHANNELS,
    GRID_SHAPE,
    Sampling,
    below_horizon,
    brdf_table,
    cosines,
    merl_grid,
    theta_h_edges,
)
from matcam.core.jax import is_concrete, jax, jnp
from matcam.core.workspace import Keyed
from matcam.forward.integral.blur import Blur, blur_of, kernel_error
from matcam.forward.integral.plan import Plan, Targets, planned
from matcam.forward.integral.recording import record
from matcam.material.material import Material
from matcam.rigs import CellValue, Rig, merl
from matcam.sample.shape import Flat
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


def measure(material: Material, rig: Rig) -> xr.DataArray:
    """The BRDF table that `rig` records of `material`: 1/sr on the MERL grid, NaN where nothing is recorded.

    Each cell is the pixel centred on the rig's `cell_value` point ("mean": the mean over the pixels inside), divided by
    the cosine of the light at its centre, and averaged over the two places that show it (reciprocity). Coordinate
    `pixels` (theta_h, theta_d, phi_d): how many pixels stand behind a cell, both places together; 0 where it is not seen.
    A flat sample's light is the same all over: nothing is lost. ArgumentError for a cylinder, which shows normals of one
    plane only, and inside jax.jit; for the differentiable values alone see `measured_values`.

    Source: MODEL 2, 3; error below 1e-4 of the value or 1e-7 of the peak for Gaussian optics (tests). Lenses that are no
    Gaussians are sums of them: attribute `kernel_error` is the largest error of their MTF.
    """
    recorded, pixels = measured_values(material, rig)
    if recorded.shape[-1] not in (1, len(CHANNELS)):
        raise ArgumentError(f"a table has {len(CHANNELS)} channels or a grey material's one, got {recorded.shape[-1]}")
    values = np.broadcast_to(np.asarray(recorded), (*GRID_SHAPE, len(CHANNELS))).copy()
    attrs = {"cell_value": rig.cell_value, "rig": repr(rig), "kernel_error": kernel_error(rig)}
    table = brdf_table(values, sampling_of(rig.cell_value), **attrs)
    return table.assign_coords(pixels=(("theta_h", "theta_d", "phi_d"), pixels))


def true_table(material: Material, sampling: Sampling = "centre") -> xr.DataArray:
    """The table of a material itself, at each cell's centre or edge: what any camera measures of a flat sample."""
    return measure(material, Rig(merl().camera, Flat(), cell_value=sampling))


def measured_values(material: Material, rig: Rig) -> tuple[jax.Array, np.ndarray]:
    """(values, pixels) of `measure` as arrays, (90, 90, 180, channels) and (90, 90, 180): differentiable in the numbers
    of the material and the camera."""
    sphere = _checked_sample(material, rig)
    if not isinstance(sphere, Sphere):
        return _of_flat(material, rig), np.zeros(GRID_SHAPE)
    blur = blur_of(rig)
    cells, plan = tabulation(sphere, blur, rig.cell_value, rig.crop)
    return folded(record(material, sphere, blur, plan), cells), cells.pixels


def _of_flat(material: Material, rig: Rig) -> jax.Array:
    """A flat sample, tilted so that each cell is seen, both ways: no blur of even light changes it. Centre and edge only."""
    if rig.cell_value == "mean":
        raise ArgumentError("a flat sample's pixels all show one cell: cell_value must be 'centre' or 'edge'")
    sampling = sampling_of(rig.cell_value)
    theta_h, theta_d, phi_d = np.meshgrid(*merl_grid(sampling), indexing="ij")
    values = (material.brdf(theta_h, theta_d, phi_d) + material.brdf(theta_h, theta_d, phi_d + np.pi)) / 2
    values = values if values.ndim == 4 else values[..., None]
    return jnp.where(below_horizon(sampling)[..., None], jnp.nan, values)


def _checked_sample(material: Material, rig: Rig) -> Sphere | Flat:
    if not isinstance(material, Material):
        raise ArgumentError(
            f"material must be a Material such as Microfacet(GGX(0.1), 0.9), got {type(material).__name__}"
        )
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere | Flat):
        raise ArgumentError(
            f"a table needs normals all round the half vector: a Sphere or Flat sample, not a {type(rig.sample).__name__}"
        )
    return rig.sample
