"""Record of a sample under the lamp of a rig: the mean over the points of a source disc (docs/model.md 3)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby, islice

import numpy as np

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Imaging
from matcam.forward.integral.discs import disc_fineness, nearer
from matcam.forward.sampler.plan import RecordPositions
from matcam.forward.sampler.planned_blocks import PlannedBlocks
from matcam.lamp.lamps import LampPoint, disc_of, lamp_points
from matcam.material.material import Material
from matcam.rigs import Rig

_PLACES = 1 << 18
"""Largest number of pixels times points of a lamp that are computed at once. Their arrays fit into 1 GiB."""


def record_under_lamp(material: Material, rig: Rig, imaging: Imaging, positions: RecordPositions) -> jax.Array:
    """Compute the record of a material at positions in images of a sample.

    Positions whose lamps require a similar number of points are computed together.

    Args:
        material: the material.
        rig: the rig; its lamp may be a disc.
        imaging: imaging of the rig under a point lamp.
        positions: the positions.

    Returns:
        Radiance under unit irradiance, 1/sr, (positions, channels).
    """
    levels = np.zeros(positions.x.size)
    if disc_of(rig.lamp) > 0:
        turns = 0.0 if positions.azimuth is None else positions.azimuth
        # at smaller values the number of points is the smallest one
        fineness = np.maximum(disc_fineness(rig, imaging, positions.lamp_angle, material, turns), 0.25)
        levels = np.exp2(np.ceil(2 * np.log2(fineness)) / 2)
    parts, order = [], []
    for level in np.unique(levels):
        index = np.flatnonzero(levels == level)
        own = positions.at(index)
        azimuth = np.zeros(index.size) if own.azimuth is None else own.azimuth
        points = lamp_points(rig.lamp, own.lamp_angle, azimuth, float(level))
        parts.append(record_under_points(material, imaging, own, points))
        order.append(index)
    return jnp.concatenate(parts)[np.argsort(np.concatenate(order))]


def record_under_points(
    material: Material,
    imaging: Imaging,
    positions: RecordPositions,
    points: list[LampPoint],
    turning: jax.Array | float = 0.0,
) -> jax.Array:
    """Compute the record of a material under a lamp: the weighted sum of the records under its points.

    Args:
        material: the material.
        imaging: imaging of the rig under a point lamp.
        positions: the positions; their lamp angles and azimuths are not used.
        points: points of the lamp; angle and azimuth are scalars, or have the shape (positions,).
        turning: small offset of all lamp angles, rad. Default: 0.

    Returns:
        Radiance under unit irradiance, 1/sr, (positions, channels).
    """
    finest, count = checks.outside_jit(material.finest, "the material's parameters"), positions.x.size
    total: jax.Array | float = 0.0
    for some in _rings(points, max(1, _PLACES // max(count, 1))):
        angle, azimuth = (
            np.concatenate([np.broadcast_to(getattr(point, name), count) for point in some])
            for name in ("angle", "azimuth")
        )
        x, y = (np.tile(a, len(some)) for a in (positions.x, positions.y))
        every = RecordPositions(x, y, angle, azimuth if np.any(azimuth) else None)
        near = nearer(imaging, some[0].distance)
        values = PlannedBlocks(near, every, finest, material.elongation, kept=False).record(material, near, turning)
        weights = np.array([point.weight for point in some])
        total += jnp.tensordot(weights, values.reshape(len(some), count, -1), axes=1)
    return jnp.asarray(total)


def _rings(points: list[LampPoint], most: int) -> Iterator[list[LampPoint]]:
    for _, ring in groupby(points, lambda point: point.distance):
        while some := list(islice(ring, most)):
            yield some
