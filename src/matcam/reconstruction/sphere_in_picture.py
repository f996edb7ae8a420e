"""Lines of sight in an image of a sphere: normal, light and view, and radiance of a lobe (docs/model.md 10).

All quantities are functions of the position p = (p_x, p_y) on the unit disc of the outline: x right, y up. The sphere
has radius 1, the camera is at 1 / camera_nearness on the z axis, and the lamp at 1 / lamp_nearness in direction `lamp`.
Both inverse distances may be 0.
"""

from __future__ import annotations

from matcam.core.arrays.elementary import inverse_root
from matcam.core.grid import azimuth_difference
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, Vector, shading, towards_source
from matcam.material.diffuse_shape import departure
from matcam.material.masking import Masking, g2
from matcam.material.material import theta_h_of
from matcam.material.ndf.distribution import NDF, SlopeDistribution
from matcam.material.tabulated_masking import quick_lambda
from matcam.sample.sight import depth_from

_LEAST = 1e-9  # smallest cosine of the angles of incidence and view: on the outline itself there is no surface


def normal_at(p_x: jax.Array, p_y: jax.Array, depth: jax.Array, camera_nearness: jax.Array) -> Vector:
    """Compute the normal at the point where a line of sight meets the sphere.

    The line through p has the lateral slope m = |p| / sqrt(1 - w^2), where w is `camera_nearness`. It meets the sphere at
    z = (m^2 w + depth) / (1 + m^2 w^2).

    Args:
        p_x: position on the disc of the outline, to the right, no unit.
        p_y: position on the disc of the outline, upwards, no unit.
        depth: sqrt(1 - p_x^2 - p_y^2), a separate argument because its computation from p_x and p_y loses digits near the
            outline.
        camera_nearness: inverse of the distance of the camera, 1/radii, [0, 1).
    """
    w = camera_nearness
    slope2 = (p_x**2 + p_y**2) / (1 - w**2)
    z = depth_from(slope2, depth, w)
    scale = (1 - w * z) / jnp.sqrt(1 - w**2)
    return scale * p_x, scale * p_y, z


def light_and_view(
    point: Vector, lamp: Vector, camera_nearness: jax.Array, lamp_nearness: jax.Array
) -> tuple[Vector, Vector, jax.Array]:
    """Compute the directions of light and view at points of the sample, and the relative irradiance.

    The relative irradiance is the squared ratio of the distance of the lamp from the centre to its distance from the point.

    Args:
        point: points of the sample, radii; those of a sphere equal their normals.
        lamp: direction from the centre to the lamp, of length 1.
        camera_nearness: inverse of the distance of the camera from the centre, 1/radii.
        lamp_nearness: inverse of the distance of the lamp from the centre, 1/radii.
    """
    light, square = towards_source(lamp, point, lamp_nearness)
    zero = jnp.zeros(())
    view, _ = towards_source((zero, zero, jnp.ones(())), point, camera_nearness)
    return light, view, 1 / square


def surface_shading(
    normal: Vector, tangent: Vector, point: Vector, lamp: Vector, camera_nearness: jax.Array, lamp_nearness: jax.Array
) -> tuple[Shading, jax.Array]:
    """Compute the shading at points of the sample, and their relative irradiance.

    `normal` and `tangent` are the normal and the x axis of the material at each point. The other arguments and the
    relative irradiance are those of `light_and_view`.
    """
    light, view, closeness = light_and_view(point, lamp, camera_nearness, lamp_nearness)
    return shading(normal, tangent, light, view), closeness


def theta_d_at(point: Vector, lamp: Vector, camera_nearness: jax.Array, lamp_nearness: jax.Array) -> jax.Array:
    """Compute the difference angle at points of the sample, rad. The arguments are those of `light_and_view`."""
    light, view, _ = light_and_view(point, lamp, camera_nearness, lamp_nearness)
    cos2 = sum(s * t for s, t in zip(light, view, strict=True))
    return jnp.arccos(jnp.clip(cos2, -1 + 1e-12, 1 - 1e-12)) / 2


def sphere_tangent(normal: Vector) -> Vector:
    """Compute the horizontal tangents, of length 1, at points of the sphere."""
    x, _, z = normal
    # visible points have z > 0, or lie at the start of a row, so x and z are never both 0
    per_length = inverse_root(x**2 + z**2)
    return z * per_length, jnp.zeros(()), -x * per_length


def radiance(
    slopes: SlopeDistribution,
    masking: Masking,
    shape: jax.Array,
    at: Shading,
    closeness: jax.Array,
    table: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Compute the radiance of a lobe with F = 1 and of a diffuse surface of albedo 1, 1/sr.

    The irradiance is 1 on a surface that is at the centre of the sample and faces the lamp. The radiance of the lobe is
    `Microfacet.reflected` divided by cos_o. Without a closed form, Smith's Lambda is interpolated in a small table.

    Args:
        slopes: distribution of the slopes of the facets.
        masking: model of the masking of the lobe.
        shape: coefficients of the departure of the diffuse part from Lambert's law.
        at: shading of the points.
        closeness: relative irradiance of the points, as for `light_and_view`.
        table: table of Lambda. Default: None, the table is computed if it is required.
    """
    seen = (at.cos_o > _LEAST) & (at.cos_i > _LEAST)
    cos_i, cos_o = jnp.where(seen, at.cos_i, 1.0), jnp.where(seen, at.cos_o, 1.0)
    lobe = (
        slopes.density(at.slope_along, at.slope_across)
        * (1 + at.slope_along**2 + at.slope_across**2) ** 2
        / (4 * cos_o)
    )
    if masking is not None:
        azimuth = azimuth_difference(theta_h_of(at), at.theta_d, at.phi_d)
        if isinstance(slopes, NDF):
            lambdas = quick_lambda(slopes, cos_i, table), quick_lambda(slopes, cos_o, table)
        else:
            lambdas = slopes.lambdas(at._replace(cos_i=cos_i, cos_o=cos_o))
        lobe *= g2(masking, *lambdas, azimuth)
    diffuse = jnp.maximum(at.cos_i, 0.0) / jnp.pi * departure(shape, at.cos_i, at.cos_o, at.theta_d)
    return jnp.where(seen, lobe * closeness, 0.0), jnp.where(at.cos_o > _LEAST, diffuse * closeness, 0.0)
