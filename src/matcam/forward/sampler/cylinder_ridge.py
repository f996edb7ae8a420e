"""Geometry of one row in the image of a cylinder: ends of the lit part, and the normal closest to the half vector.

Limb and terminator are straight, so the lit part ends at the same angle in every row. The highlight is found as in a plane,
because a ray that a cylinder reflects has a constant slope along the axis of the cylinder (docs/model.md 3).
"""

from __future__ import annotations

from typing import NamedTuple

from jax.typing import ArrayLike

from matcam.core.jax import AnyArray, jax, jnp
from matcam.core.shading import Vector, towards_source
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Element
from matcam.sample.sight import highlight_between


class PlacedLamps(NamedTuple):
    """Directions and distances of lamps, as arrays that broadcast.

    Attributes:
        towards: direction to the lamp, seen from the centre of the cylinder.
        nearness: inverse of the lamp's distance, 1/radii; None: a distant lamp.
    """

    towards: Vector
    nearness: AnyArray | None

    def beside(self, axes: int) -> PlacedLamps:
        """Reshape the lamps to broadcast against `axes` further axes of nodes."""
        return jax.tree.map(lambda a: jnp.asarray(a).reshape(*a.shape, *[1] * axes), self)


def towards(lamp_angle: ArrayLike, azimuth: ArrayLike) -> Vector:
    """Compute the unit vectors towards lamps. lamp_angle: angle to the optical axis, rad. azimuth: azimuth about it, rad."""
    sine = jnp.sin(lamp_angle)
    return sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), jnp.cos(lamp_angle)


def ends_of_light(cylinder: Cylinder, light: PlacedLamps) -> tuple[jax.Array, jax.Array]:
    """Compute the range of the angle u of the normal, rad, in which the cylinder is visible and lit."""
    across = jnp.hypot(light.towards[0], light.towards[2])
    # a lamp along the axis lights no surface
    near = None if light.nearness is None else light.nearness / jnp.maximum(across, 1e-12)
    return cylinder.lit(jnp.zeros_like(across), jnp.arctan2(light.towards[0], light.towards[2]), near)


def mirror_row(cylinder: Cylinder, light: PlacedLamps, low: jax.Array, high: jax.Array) -> jax.Array:
    """Compute the row of the highlight, px; 0 if the highlight extends over all rows, or if there is none.

    low, high: range of the angle u of the normal in which the cylinder is visible and lit, rad.
    """
    x, y, z = light.towards
    if light.nearness is None and cylinder.distant:
        return jnp.zeros_like(x)
    across = jnp.maximum(jnp.hypot(x, z), 1e-12)
    q, w = cylinder.nearness, jnp.zeros_like(across) if light.nearness is None else light.nearness / across
    angle = jnp.arctan2(x, z)
    u = jnp.clip(highlight_between(angle, q, w), low, high)
    # lengths of the paths from the highlight to lamp and camera in the cross section, over the distances of lamp and camera
    to_lamp, to_camera = (jnp.sqrt(1 - 2 * r * jnp.cos(u - a) + r**2) for r, a in ((w, angle), (q, 0.0)))
    climb = w + q * to_lamp / to_camera
    height = jnp.where(climb > 0, y / across / jnp.where(climb > 0, climb, 1.0), 0.0)
    return cylinder.surface(u, height).y


def seen_at(
    cylinder: Cylinder, light: PlacedLamps, u: jax.Array, row: jax.Array
) -> tuple[Element, Vector, jax.Array | None]:
    """Compute surface elements, directions to the lamp, and squared distances of the lamp.

    The squared distance is relative to that from the centre, no unit; None: it is 1 everywhere. u: angle of the normal,
    rad. row: row of the image, px.
    """
    element = cylinder.surface(u, row / cylinder.stretch * (1 - cylinder.nearness * jnp.cos(u)))
    if light.nearness is None:
        return element, light.towards, None
    return element, *towards_source(light.towards, cylinder.point(element), light.nearness)


def ridge_of(
    cylinder: Cylinder, light: PlacedLamps, row: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the angle u, rad, at which the normal in a row is closest to the half vector.

    Returns:
        u in [low, high]; and the angle between the half vector and the plane of the normals, rad.
    """
    angle = jnp.arctan2(light.towards[0], light.towards[2] + 1)

    def newton(_: int, u: jax.Array) -> jax.Array:
        element, lamp, square = seen_at(cylinder, light, u, row)
        tangent, normal, view = element.tangent, element.normal, element.view
        aside = [tangent[0] * one[0] + tangent[2] * one[2] for one in (lamp, view)]
        slope = normal[0] * (lamp[0] + view[0]) + normal[2] * (lamp[2] + view[2])
        if light.nearness is not None and square is not None:  # the direction to a near lamp varies, too
            slope += light.nearness * (1 - aside[0] ** 2) / jnp.sqrt(square)
        if not cylinder.distant:
            slope += cylinder.nearness * (1 - aside[1] ** 2)
        return jnp.clip(u + (aside[0] + aside[1]) / jnp.maximum(slope, 0.05), low, high)

    line = light.nearness is None and cylinder.distant
    start = jnp.clip(angle, low, high) + 0 * row
    # each step reduces the error to a few per cent
    u = start if line else jax.lax.fori_loop(0, 6, newton, start)
    element, lamp, _ = seen_at(cylinder, light, u, row)
    half = [a + b for a, b in zip(lamp, element.view, strict=True)]
    return u, jnp.arctan2(jnp.abs(half[1]), jnp.hypot(half[0], half[2]))


def turn_along(cylinder: Cylinder, light: PlacedLamps, u: jax.Array, row: jax.Array) -> jax.Array:
    """Compute an upper bound of the rotation of the half vector along the axis of the cylinder, rad/px."""
    if light.nearness is None and cylinder.distant:
        return jnp.zeros_like(u)
    element, lamp, square = seen_at(cylinder, light, u, row)
    turn = cylinder.nearness + jnp.zeros_like(u)
    if light.nearness is not None and square is not None:
        turn += light.nearness / jnp.sqrt(square)
    total = sum((a + b) ** 2 for a, b in zip(lamp, element.view, strict=True))
    return turn / jnp.sqrt(jnp.maximum(total, 1e-12)) * (1 - cylinder.nearness * jnp.cos(u)) / cylinder.stretch
