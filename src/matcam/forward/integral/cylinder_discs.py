"""Source disc in front of a cylinder: the record is the mean over its points (docs/model.md 3).

Across the cylinder, lens and lobe blur the image of the disc. Along it light is nearly constant, so only the lobe does.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur, imaging_of
from matcam.forward.integral.cylinder_record import CylinderPlaces, record_cylinder, towards
from matcam.forward.integral.discs import LOBE
from matcam.lamp.lamps import LampPoint, disc_of, lamp_points
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder

_PLACES = 1 << 20
"""Number of positions times points of a lamp that are recorded at once. They fit into 1 GiB."""
_LEAST_FINENESS = 0.25
"""Ratio of the radius of the image of a lamp to its blur below which the smallest number of points is used."""


class LinePlaces(NamedTuple):
    """Positions on the line of a cylinder at height 0, arrays of one shape; each has its own lamp.

    Attributes:
        x: px from the axis.
        lamp_angle: angle between lamp and optical axis, rad.
        azimuth: azimuth of the lamp about that axis, rad.
    """

    x: np.ndarray
    lamp_angle: np.ndarray
    azimuth: np.ndarray


def cylinder_fineness(
    rig: Rig, blur: Blur, lamp_angle: np.ndarray, azimuth: np.ndarray | float, material: Material
) -> np.ndarray:
    """Compute the radius of the image of a lamp over the standard deviation of its blur on a cylinder, no unit.

    Args:
        rig: the rig.
        blur: blur of the rig.
        lamp_angle: angle between lamp and optical axis, rad, any shape.
        azimuth: azimuth of the lamp about the optical axis, rad; broadcasts with lamp_angle.
        material: the material.
    """
    disc = disc_of(rig.lamp)
    if disc == 0:
        return np.zeros(np.broadcast_shapes(np.shape(lamp_angle), np.shape(azimuth)))
    rig, blur = jax.lax.stop_gradient((rig, blur))
    std = float(np.min(np.asarray(blur.stds)))
    lobe = LOBE * checks.outside_jit(material.finest, "the material's parameters")
    theta_d = np.asarray(rig.sample.theta_d(jnp.asarray(lamp_angle), rig.lamp.nearness))  # type: ignore[attr-defined]
    larger = 1.0 if rig.lamp.nearness is None else 1 / (1 - float(rig.lamp.nearness))
    aslant, turn = np.maximum(np.cos(theta_d), disc), (np.cos(azimuth), np.sin(azimuth))
    _, along = rig.px_per_rad(jnp.asarray(theta_d))
    u = np.arctan2(np.sin(theta_d) * turn[0], np.cos(theta_d))
    across = float(rig.sample.radius) * np.cos(u)  # type: ignore[attr-defined]
    sizes = np.hypot(turn[0], turn[1] / aslant), np.hypot(turn[1], turn[0] / aslant)
    blurs = (np.hypot(std / scale, lobe) for scale in (across, np.asarray(along)))
    return np.maximum(*(disc * larger / 2 * size / blur for size, blur in zip(sizes, blurs, strict=True)))


def record_cylinder_under_points(
    material: Material,
    cylinder: Cylinder,
    blur: Blur,
    at: tuple[np.ndarray, np.ndarray],
    points: list[LampPoint],
    nearness: jax.Array | None,
    one_picture: bool = False,
) -> jax.Array:
    """Compute the radiance that positions on a cylinder record under a lamp, 1/sr, (positions, channels).

    Args:
        material: the material.
        cylinder: the cylinder.
        blur: under a lamp without a disc.
        at: x and y of the positions, (positions,), px.
        points: points of the lamp; their angle and azimuth are of one lamp, or of shape (places,).
        nearness: inverse of the lamp's distance, 1/radii; None: a distant lamp.
        one_picture: True if all positions are in one image. If its rows are equal, each column is recorded once.
            Default: False.
    """
    total: jax.Array | float = 0.0
    (x, y), which = at, None
    if one_picture and nearness is None and cylinder.distant:
        x, which = np.unique(x, return_inverse=True)
        y = np.zeros_like(x)
    left = iter(points)
    while some := list(islice(left, max(1, _PLACES // max(x.size, 1)))):
        parts = [places_under(x, y, point, nearness) for point in some]
        places: CylinderPlaces = jax.tree.map(lambda *a: np.concatenate(a), *parts)
        values = record_cylinder(material, cylinder, blur, places)
        weights = np.array([point.weight for point in some])
        total += jnp.tensordot(weights, values.reshape(len(some), x.size, -1), axes=1)
    total = jnp.asarray(total)
    return total if which is None else total[which]


def line_record(material: Material, rig: Rig, places: LinePlaces) -> jax.Array:
    """Compute the radiance that positions on a cylinder record, 1/sr, (positions, channels).

    The irradiance is 1 at the cylinder's centre, on a surface that faces the lamp. Positions whose lamps require a
    similar number of points are recorded together.
    """
    cylinder, blur, nearness = imaging_of(rig)
    assert isinstance(cylinder, Cylinder)
    fineness = cylinder_fineness(rig, blur, places.lamp_angle, places.azimuth, material)
    levels = np.where(fineness > 0, np.exp2(np.ceil(2 * np.log2(np.maximum(fineness, _LEAST_FINENESS))) / 2), 0.0)
    parts, order = [], []
    for level in np.unique(levels):
        index = np.flatnonzero(levels == level)
        x, angle, azimuth = (a[index] for a in places)
        points = lamp_points(rig.lamp, angle, azimuth, float(level))
        parts.append(record_cylinder_under_points(material, cylinder, blur, (x, np.zeros_like(x)), points, nearness))
        order.append(index)
    return jnp.concatenate(parts)[np.argsort(np.concatenate(order))]


def places_under(x: np.ndarray, y: np.ndarray, point: LampPoint, nearness: jax.Array | None) -> CylinderPlaces:
    """Return positions under one point of a lamp. nearness: inverse of the lamp's distance; None: distant."""
    lamp = tuple(np.broadcast_to(a, x.shape) for a in towards(point.angle, point.azimuth))
    near = None if nearness is None else np.full(x.shape, float(jax.lax.stop_gradient(nearness)) / point.distance)
    return CylinderPlaces(x, y, lamp, near)  # type: ignore[arg-type]
