"""Record of a sphere under the lamp of a rig: the mean over the points of a source disc (docs/model.md 3)."""

from __future__ import annotations

import numpy as np

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Imaging
from matcam.forward.integral.discs import disc_fineness, nearer
from matcam.forward.sampler.plan import RecordPlaces, record_plan
from matcam.forward.sampler.record import record
from matcam.lamp.lamps import disc_of, lamp_points
from matcam.material.material import Material
from matcam.rigs import Rig

_LEAST_FINENESS = 0.25
"""Ratio of the radius of the image of a lamp to its blur below which the smallest number of points is used."""


def record_under_lamp(
    material: Material, rig: Rig, imaging: Imaging, places: RecordPlaces, turning: jax.Array | float = 0.0
) -> jax.Array:
    """Record a material at positions in images of a sphere.

    Places whose lamps require a similar number of points are recorded together, one point of the disc at a time.

    Args:
        material: the material.
        rig: the rig; its lamp may be a disc.
        imaging: imaging of the rig under a point lamp.
        places: the positions.
        turning: small angle by which the lamps are turned away from the optical axis, rad. Default: 0.

    Returns:
        Radiance under unit irradiance, 1/sr, (places, channels).
    """
    finest = checks.outside_jit(material.finest, "the material's parameters")
    if disc_of(rig.lamp) == 0:
        return record(material, imaging, record_plan(imaging, places, finest, material.elongation), turning)
    lamps, which = np.unique(places.lamp_angle, return_inverse=True)
    fineness = np.maximum(disc_fineness(rig, imaging, lamps, material), _LEAST_FINENESS)
    levels = np.exp2(np.ceil(2 * np.log2(fineness)) / 2)[which]
    total: jax.Array | float = 0.0
    for level in np.unique(levels):
        index = np.flatnonzero(levels == level)
        own = places.at(index)
        azimuth = np.zeros(index.size) if own.azimuth is None else own.azimuth
        recorded: jax.Array | float = 0.0
        for point in lamp_points(rig.lamp, own.lamp_angle, azimuth, float(level)):
            one = own._replace(lamp_angle=np.asarray(point.angle), azimuth=np.asarray(point.azimuth))
            near = nearer(imaging, point.distance)
            recorded += point.weight * record(
                material, near, record_plan(near, one, finest, material.elongation), turning
            )
        recorded = jnp.asarray(recorded)
        total += jnp.zeros((places.x.size, recorded.shape[1])).at[index].set(recorded)
    return jnp.asarray(total)
