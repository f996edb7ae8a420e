"""Record of the cells of a table on a cylinder, whose normals lie in one plane (docs/model.md 3).

In general, the normal of a cell lies outside the plane of camera and lamp. A sphere has such a normal. A cylinder has
such a normal only if the lamp is rotated about the optical axis until the normal is perpendicular to the axis of the
cylinder. Each cell therefore has a separate lamp azimuth. The cell is recorded on the line through the optical axis,
perpendicular to the axis of the cylinder. In a near rig, the angles of the cell occur only on that line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines, merl_grid
from matcam.core.jax import jax, jnp
from matcam.core.workspace import Workspace
from matcam.forward.cells_in_pictures import cell_sampling
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions
from matcam.forward.sampler.under_lamp import record_under_lamp
from matcam.lamp.lamps import closeness
from matcam.material.material import Material
from matcam.rigs import UNKNOWN, Rig
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.positions import positions_of

_TURN = 1e-9
"""Largest |sin(azimuth / 2)| for which an azimuth counts as a multiple of a full turn, up to rounding errors."""

_AT_ONCE = 1 << 17
"""Largest number of positions that are recorded at once. In a near rig, their plan takes up to 1 GiB."""


class CylinderCells(NamedTuple):
    """Cells of a table on a cylinder.

    `irradiance` and `seen` have the shape (theta_h, theta_d, phi_d, reciprocal directions).

    Attributes:
        positions: positions of the visible cells.
        flat_index: indices of the visible cells in the flattened `seen`.
        irradiance: irradiance at each cell divided by the irradiance of a surface that faces the lamp at the centre of
            the sample, no unit.
        seen: True for visible cells.
    """

    positions: RecordPositions
    flat_index: np.ndarray
    irradiance: np.ndarray
    seen: np.ndarray


def check_cylinder(rig: Rig, azimuth: float = 0.0) -> None:
    """Raise ArgumentError if a rig with a cylinder cannot record a table.

    `azimuth` is the requested azimuth of the lamp, rad. Default: 0.
    """
    if any(abs(np.sin((turned or 0.0) / 2)) > _TURN for turned in (azimuth, rig.lamp_azimuth)):
        raise ArgumentError("each cell of a table of a cylinder has its own lamp azimuth: omit the azimuth of the lamp")
    if rig.cell_value not in ("centre", "edge", UNKNOWN):
        raise ArgumentError(
            f"cell_value '{rig.cell_value}' needs a sphere, because on a cylinder each cell has its own image: specify "
            "'centre' or 'edge'"
        )


def cylinder_table(material: Material, rig: Rig, workspace: Workspace) -> tuple[jax.Array, np.ndarray]:
    """Compute the table of a material on a cylinder.

    The table is differentiable in the parameters of material and camera.

    Returns:
        The table, (90, 90, 180, channels), 1/sr, NaN where a cell is not visible; and the pixel count of each cell, the
        number of its visible directions, 0 to 2.
    """
    sample, near = rig.sample, rig.lamp.nearness
    assert isinstance(sample, Cylinder)
    numbers = [jax.lax.stop_gradient(a) for a in (sample.radius, sample.distance, 0.0 if near is None else near)]
    key = *map(float, numbers), rig.cell_value, rig.crop
    cells = workspace.remember("cylinder cells", key, lambda: cylinder_cells(rig), most=1)
    radiance = record_cells(material, rig, cells.positions)
    flat = jnp.zeros((cells.seen.size, radiance.shape[1])).at[cells.flat_index].set(radiance)
    directions = flat.reshape(*cells.seen.shape, -1) / np.where(cells.seen, cells.irradiance, 1.0)[..., None]
    count = cells.seen.sum(-1)[..., None]
    return jnp.where(count > 0, directions.sum(3) / np.maximum(count, 1), jnp.nan), 1.0 * count[..., 0]


def record_cells(material: Material, rig: Rig, positions: RecordPositions) -> jax.Array:
    """Compute the record of a material at positions on a cylinder, 1/sr, (positions, channels).

    The positions are on the line through the optical axis, perpendicular to the axis of the cylinder.
    """
    parts = (
        positions.at(np.arange(begin, min(begin + _AT_ONCE, positions.x.size)))
        for begin in range(0, positions.x.size, _AT_ONCE)
    )
    return jnp.concatenate([record_under_lamp(material, rig, imaging_of(rig), part) for part in parts])


def cylinder_cells(rig: Rig) -> CylinderCells:
    grid = merl_grid(cell_sampling(rig.cell_value))
    angles = np.meshgrid(*grid, [0.0, np.pi], indexing="ij")
    theta_h, theta_d, phi_d = angles[0], angles[1], angles[2] + angles[3]
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    seen = (cos_i > 0) & (cos_o > 0)
    positions = line_positions(rig, theta_h, theta_d, phi_d)
    if rig.crop is not None:
        seen &= np.abs(positions.x) <= rig.crop[1] / 2
    index = np.flatnonzero(seen)
    irradiance = cos_i * np.asarray(closeness(rig.lamp.nearness, jnp.asarray(np.where(seen, cos_i, 1.0)))) ** 2
    return CylinderCells(positions.at(seen), index, irradiance, seen)


def line_positions(rig: Rig, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> RecordPositions:
    """Compute the image positions and the lamp azimuths of cells on the cylinder of a rig.

    The angles of the cells are in rad. The lamp angle, and the distance of a position from the
    optical axis, are those on a sphere whose radius equals that of the cylinder.
    """
    sample: Cylinder = rig.sample  # type: ignore[assignment]
    sphere = Sphere(float(sample.radius), float(sample.distance))
    x, y, lamp_angle = positions_of(sphere, theta_h, theta_d, phi_d, rig.lamp.nearness)
    off = np.hypot(x, y)
    return RecordPositions(off, np.zeros_like(off), lamp_angle, np.where(off > 0, np.arctan2(-y, x), 0.0))
