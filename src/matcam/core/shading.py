"""Shading geometry: computation of the arguments of a BRDF from vectors."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from matcam.core.arrays import xp
from matcam.core.arrays.elementary import arcsine, inverse_root

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

Vector = tuple["jax.Array", "jax.Array", "jax.Array"]
"""Cartesian components, each of any shape that broadcasts with the others."""


class Shading(NamedTuple):
    """Arguments of a BRDF, as arrays that broadcast.

    Attributes:
        cos_i: cosine of the angle of incidence.
        cos_o: cosine of the viewing angle.
        slope_along: slope of the half vector along the first tangent of the surface, no unit. This is the
            component of the half vector along this tangent, divided by the component along the normal.
        slope_across: slope of the half vector along the second tangent (normal x first tangent), no unit.
        theta_d: difference angle, rad.
        phi_d: azimuth of the light about the half vector, rad, in (-pi, pi]. It is relative to the azimuth of the half
            vector, or to the first tangent if the half vector is the normal.
    """

    cos_i: jax.Array
    cos_o: jax.Array
    slope_along: jax.Array
    slope_across: jax.Array
    theta_d: jax.Array
    phi_d: jax.Array


def shading(normal: Vector, tangent: Vector, light: Vector, view: Vector) -> Shading:
    """Compute the arguments of a BRDF from unit vectors.

    `light` and `view` point away from the surface. `tangent` is the first tangent, perpendicular to the normal.

    Slopes remain accurate near the mirror direction, unlike an angle that is computed from its cosine.
    """
    total = _combined(light, view, 1)
    difference = _combined(light, view, -1)
    second = _cross(normal, tangent)
    along, across, up = _dot(total, tangent), _dot(total, second), _dot(total, normal)
    slopes = xp.divide(along, up), xp.divide(across, up)
    per_length = inverse_root(_dot(total, total))
    along, across, cos_h = along * per_length, across * per_length, up * per_length
    # azimuth of the light about the half vector, in the frame of the surface after the shortest rotation to the half
    # vector: it is well determined where the half vector is the normal, unlike the azimuth of the half vector
    carried = (along * _dot(light, tangent) + across * _dot(light, second)) / (1 + cos_h) + _dot(light, normal)
    azimuth = xp.arctan2(_dot(light, second) - across * carried, _dot(light, tangent) - along * carried)
    phi_d = azimuth - xp.arctan2(across, along)
    return Shading(
        cos_i=_dot(light, normal),
        cos_o=_dot(view, normal),
        slope_along=slopes[0],
        slope_across=slopes[1],
        theta_d=arcsine(xp.minimum(xp.sqrt(_dot(difference, difference)) / 2, 1.0)),
        phi_d=xp.pi - xp.mod(xp.pi - phi_d, 2 * xp.pi),
    )


def local_shading(light: Vector, view: Vector) -> Shading:
    """Compute the `shading` of directions in the frame of the surface.

    The normal is the z axis, and the first tangent is the x axis.
    """
    zero, one = xp.zeros(()), xp.ones(())
    return shading((zero, zero, one), (one, zero, zero), light, view)


def towards_source(source: Vector, point: Vector, nearness: ArrayLike) -> tuple[Vector, jax.Array]:
    """Compute the directions from points to a source, and the squared distances of the source.

    The distances are relative to the distance of the source from the centre of the sample.

    Args:
        source: direction from the centre to the source, of length 1.
        point: points, relative to the centre, in radii of the sample.
        nearness: inverse of the distance of the source from the centre, 1/radii.
    """
    x, y, z = (s - nearness * p for s, p in zip(source, point, strict=True))
    square = x**2 + y**2 + z**2
    per_length = inverse_root(square)
    return (x * per_length, y * per_length, z * per_length), square


def vector(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Vector:
    return xp.asarray(x), xp.asarray(y), xp.asarray(z)


def _combined(a: Vector, b: Vector, sign: int) -> Vector:
    return a[0] + sign * b[0], a[1] + sign * b[1], a[2] + sign * b[2]


def _dot(a: Vector, b: Vector) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
