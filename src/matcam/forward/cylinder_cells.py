"""What a rig records of the cells of a table on a cylinder, which shows the normals of one line (docs/model.md 3).

A cell asks for a normal beside the plane of camera and lamp. A sphere shows it there; a cylinder shows it when the lamp is
turned about the optical axis, until the normal lies across the cylinder's axis. So each cell has a lamp of its own, and is
read on the line across the axis at which the camera looks squarely. Before a near camera, or under a near lamp, that line
alone shows the cell at its angles: beside it light comes from elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines, merl_grid
from matcam.core.jax import jax, jnp
from matcam.core.workspace import Workspace
from matcam.forward.cells_in_pictures import cell_sampling
from matcam.forward.integral.cylinder_discs import LinePlaces, line_record
from matcam.lamp.lamps import closeness
from matcam.material.material import Material
from matcam.rigs import UNKNOWN, Rig
from matcam.sample.curved import Cylinder, Sphere

_TURN = 1e-9
"""Sine of half an azimuth up to which it is a whole turn, and none."""


class CylinderCells(NamedTuple):
    """Cells of a table on a cylinder. Arrays over (theta_h, theta_d, phi_d, way).

    Attributes:
        places: those that are seen.
        flat_index: their positions in the flattened arrays.
        irradiance: of the surface at each cell, over that at the centre of a surface that faces the lamp.
        seen: whether a cell is seen.
    """

    places: LinePlaces
    flat_index: np.ndarray
    irradiance: np.ndarray
    seen: np.ndarray


def check_cylinder(rig: Rig, azimuth: float = 0.0) -> None:
    """Raise ArgumentError for a rig whose cylinder no table can be recorded of.

    rig: with a cylinder. azimuth: of the lamp that was asked for, rad.
    """
    if any(abs(np.sin((turned or 0.0) / 2)) > _TURN for turned in (azimuth, rig.lamp_azimuth)):
        raise ArgumentError(
            "a cylinder's table has a lamp of its own for every cell: the lamp's azimuth must be left out"
        )
    if rig.cell_value not in ("centre", "edge", UNKNOWN):
        raise ArgumentError(
            f"cells of '{rig.cell_value}' need a sphere: on a cylinder each cell has a picture of its own; cell_value must be "
            "'centre' or 'edge'"
        )


def cylinder_table(material: Material, rig: Rig, workspace: Workspace) -> tuple[jax.Array, np.ndarray]:
    """Return the table that a rig records of a material on a cylinder, (90, 90, 180, channels), 1/sr, and its pixels' counts.

    Differentiable in material and camera. NaN where no way shows a cell. Each way that shows one is a pixel.
    """
    sample, near = rig.sample, rig.lamp.nearness
    assert isinstance(sample, Cylinder)
    numbers = [jax.lax.stop_gradient(a) for a in (sample.radius, sample.distance, 0.0 if near is None else near)]
    key = *map(float, numbers), rig.cell_value, rig.crop
    cells = workspace.remember("cylinder cells", key, lambda: cylinder_cells(rig), most=1)
    radiance = line_record(material, rig, cells.places)
    flat = jnp.zeros((cells.seen.size, radiance.shape[1])).at[cells.flat_index].set(radiance)
    ways = flat.reshape(*cells.seen.shape, -1) / np.where(cells.seen, cells.irradiance, 1.0)[..., None]
    count = cells.seen.sum(-1)[..., None]
    return jnp.where(count > 0, ways.sum(3) / np.maximum(count, 1), jnp.nan), 1.0 * count[..., 0]


def cylinder_cells(rig: Rig) -> CylinderCells:
    """Return where a rig's cylinder shows the cells of a table."""
    grid = merl_grid(cell_sampling(rig.cell_value))
    angles = np.meshgrid(*grid, [0.0, np.pi], indexing="ij")
    theta_h, theta_d, phi_d = angles[0], angles[1], angles[2] + angles[3]
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    seen = (cos_i > 0) & (cos_o > 0)
    places = line_places(rig, theta_h, theta_d, phi_d)
    if rig.crop is not None:
        seen &= np.abs(places.x) <= rig.crop[1] / 2
    index = np.flatnonzero(seen)
    irradiance = cos_i * np.asarray(closeness(rig.lamp.nearness, jnp.asarray(np.where(seen, cos_i, 1.0)))) ** 2
    return CylinderCells(LinePlaces(*(a.ravel()[index] for a in places)), index, irradiance, seen)


def line_places(rig: Rig, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> LinePlaces:
    """Return where a rig's cylinder shows half and difference angles, and under which lamps.

    A sphere of its size shows them at the same distance from the optical axis, under a lamp at the same angle from it.
    """
    sample: Cylinder = rig.sample  # type: ignore[assignment]
    sphere = Sphere(float(sample.radius), float(sample.distance))
    near = None if rig.lamp.nearness is None else float(rig.lamp.nearness)
    place = jax.jit(lambda h, d, p: sphere.place(h, d, p, near))(theta_h, theta_d, phi_d)
    x, y, lamp_angle = (np.asarray(a) for a in place)
    off = np.hypot(x, y)
    return LinePlaces(off, lamp_angle, np.where(off > 0, np.arctan2(-y, x), 0.0))
