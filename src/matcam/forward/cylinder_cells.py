"""Record of the cells of a table on a cylinder, whose normals lie in one plane (docs/model.md 3).

In general, the normal of a cell lies outside the plane of camera and lamp. A sphere has such a normal. A cylinder has
such a normal only if the lamp is rotated about the optical axis until the normal is perpendicular to the axis of the
cylinder. Each cell therefore has a separate lamp azimuth. The cell is recorded on the line through the optical axis,
perpendicular to the axis of the cylinder. In a near rig, the angles of the cell occur only on that line.
"""

from __future__ import annotations

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions
from matcam.forward.sampler.under_lamp import record_under_lamp
from matcam.material.material import Material
from matcam.rigs import UNKNOWN, Rig
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.positions import positions_of

_AT_ONCE = 1 << 17
"""Largest number of positions that are recorded at once. In a near rig, their plan takes up to 1 GiB."""


def check_cylinder(rig: Rig, azimuth: float = 0.0) -> None:
    """Raise ArgumentError if a rig with a cylinder cannot record a table.

    `azimuth` is the requested azimuth of the lamp, rad. Default: 0.
    """
    # a multiple of a full turn, up to rounding errors, is no azimuth
    if any(abs(np.sin((turned or 0.0) / 2)) > 1e-9 for turned in (azimuth, rig.lamp_azimuth)):
        raise ArgumentError("each cell of a table of a cylinder has its own lamp azimuth: omit the azimuth of the lamp")
    if rig.cell_value not in ("centre", "edge", UNKNOWN):
        raise ArgumentError(
            f"cell_value '{rig.cell_value}' needs a sphere, because on a cylinder each cell has its own image: specify "
            "'centre' or 'edge'"
        )


def record_cells(material: Material, rig: Rig, positions: RecordPositions) -> jax.Array:
    """Compute the record of a material at positions on a cylinder, 1/sr, (positions, channels).

    The positions are on the line through the optical axis, perpendicular to the axis of the cylinder.
    """
    parts = (
        positions.at(np.arange(begin, min(begin + _AT_ONCE, positions.x.size)))
        for begin in range(0, positions.x.size, _AT_ONCE)
    )
    return jnp.concatenate([record_under_lamp(material, rig, imaging_of(rig), part) for part in parts])


def line_positions(
    cylinder: Cylinder,
    theta_h: np.ndarray,
    theta_d: np.ndarray,
    phi_d: np.ndarray,
    lamp_nearness: jax.Array | None = None,
) -> RecordPositions:
    """Compute the image positions and the lamp azimuths of cells on a cylinder.

    The angles of the cells are in rad. The lamp angle, and the distance of a position from the
    optical axis, are those on a sphere whose radius equals that of the cylinder. `lamp_nearness` is the inverse of the
    distance of the lamp, 1/radii. Default: None, a distant lamp.
    """
    sphere = Sphere(float(cylinder.radius), float(cylinder.distance))
    x, y, lamp_angle = positions_of(sphere, theta_h, theta_d, phi_d, lamp_nearness)
    off = np.hypot(x, y)
    return RecordPositions(off, np.zeros_like(off), lamp_angle, np.where(off > 0, np.arctan2(-y, x), 0.0))
