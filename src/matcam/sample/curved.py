"""Sphere and cylinder.

The image of a sphere contains all visible normals. The image of a cylinder contains only normals in one plane.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.core.arrays import xp
from matcam.core.arrays.elementary import cosine, inverse_root, plane_length, sine
from matcam.core.shading import Vector
from matcam.sample.shape import Curved, Element, Position, checked_distance, checked_radius, is_infinite
from matcam.sample.sight import depth_of

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax


class Sphere(Curved):
    """Sphere, whose image contains all visible normals.

    The surface coordinates u and v are the longitude and latitude of the normal about the y axis, rad.

    Args:
        radius: radius of the limb in the image, in (0, 1e100] px.
        distance: distance of the camera from the centre, in radii of the sphere, above 1. Default: infinite, an
            orthographic camera. Specify the distance if it is below a few hundred radii, because less than half of the
            sphere is visible from a near camera.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        Holzschuch & Pacanowski (2017), (5); docs/model.md 3.

    Example:
        >>> sphere = matcam.Sphere(radius=256.0)
        >>> [round(float(shift), 3) for shift in sphere.px_per_rad(np.array(np.pi / 3))]
        [128.0, 256.0]
    """

    def __init__(self, radius: ArrayLike, distance: ArrayLike = np.inf):
        self.radius, self.distance = checked_radius(radius), checked_distance(distance)
        self.distant = is_infinite(distance)

    def surface(self, u: jax.Array, v: jax.Array) -> Element:
        """Compute the surface element at longitude u and latitude v.

        The image position is x = radius sqrt(d^2 - 1) n_x / (d - n_z), and y follows in the same way from n_y (docs/model.md
        3). d is the distance of the camera in radii, and (n_x, n_y, n_z) is the normal.
        """
        cos_v, sin_u = xp.cos(v), sine(u)
        cos_u = xp.sqrt((1 - sin_u) * (1 + sin_u))  # visible points have |u| < pi / 2; a cosine takes much longer
        element = self.facing((cos_v * sin_u, xp.sin(v), cos_v * cos_u))
        return element._replace(tangent=(cos_u, xp.zeros(()), -sin_u), area=element.area * cos_v)

    def facing(self, normal: Vector) -> Element:
        """Compute the surface element that faces a direction.

        The area of the element is per solid angle of the normal, px^2/sr.

        Args:
            normal: components of the unit vector in this direction; arrays that broadcast.
        """
        view, length, depth = self.line_of_sight(normal, normal[1])
        scale = self.stretch / depth
        return Element(
            normal=normal,
            tangent=self._tangent(normal),
            view=view,
            x=scale * normal[0],
            y=scale * normal[1],
            area=scale**2 * length / depth,
        )

    def at(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """Compute the surface elements at positions in the image.

        The result also contains a mask, True for lines of sight that meet the sphere.
        """
        q = self.nearness
        n_z, hits = depth_of(plane_length(x, y) / self.stretch, q)
        depth = 1 - q * n_z
        normal = x / self.stretch * depth, y / self.stretch * depth, n_z
        view, length, _ = self.line_of_sight(normal, normal[1])
        cos_o = (n_z - q) / length
        visible = hits & (cos_o > 0)
        return Element(
            normal=normal,
            tangent=self._tangent(normal),
            view=view,
            x=x,
            y=y,
            area=1 / xp.where(visible, cos_o, 1.0),
        ), visible

    def _tangent(self, normal: Vector) -> Vector:
        """Compute the first tangent, along the circle of latitude."""
        square = normal[0] ** 2 + normal[2] ** 2
        per_section = inverse_root(xp.where(square > 0, square, 1.0))
        return normal[2] * per_section, xp.zeros(()), -normal[0] * per_section

    def coordinates(self, element: Element) -> tuple[jax.Array, jax.Array]:
        """Compute the longitude and latitude about the y axis, rad."""
        n_x, n_y, n_z = element.normal
        return xp.arctan2(n_x, n_z), xp.arcsin(xp.clip(n_y, -1, 1))

    def position(
        self, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray, lamp_nearness: ArrayLike | None = None
    ) -> Position:
        """Compute image position and lamp angle for half and difference angles.

        The azimuth of the normal about the half vector, from the side of the lamp, is pi - phi_d (docs/model.md 3). If the
        camera is near, the angles refer to the line of sight.
        """
        theta_h, theta_d, phi_d = (xp.asarray(a, dtype=xp.float64) for a in (theta_h, theta_d, phi_d))
        # light, view and normal about the half vector, which is the z axis; light at +x
        normal = xp.stack(
            xp.broadcast_arrays(
                -xp.sin(theta_h) * xp.cos(phi_d), xp.sin(theta_h) * xp.sin(phi_d), xp.cos(theta_h) + 0 * theta_d
            )
        )
        light = xp.stack(xp.broadcast_arrays(xp.sin(theta_d), 0 * theta_d, xp.cos(theta_d)))
        view = light * xp.array([-1.0, 1.0, 1.0]).reshape(3, *([1] * (light.ndim - 1)))
        shape = xp.broadcast_shapes(normal.shape, light.shape)
        normal, light, view = (xp.broadcast_to(a, shape) for a in (normal, light, view))
        # optical axis = view + q (normal - along view): from the sample's centre to the camera
        cos_o = xp.sum(normal * view, axis=0)
        q = self.nearness
        length = xp.sqrt(xp.maximum(1 - q**2 * (1 - cos_o**2), 0.0)) - q * cos_o
        axis = q * normal + length * view
        if lamp_nearness is not None:  # from the centre of the sample to the lamp, along the light from this normal
            w, cos_i = xp.asarray(lamp_nearness), xp.sum(normal * light, axis=0)
            light = w * normal + (xp.sqrt(xp.maximum(1 - w**2 * (1 - cos_i**2), 0.0)) - w * cos_i) * light
        # x axis: direction of the lamp perpendicular to the optical axis; if both coincide, the x axis of the frame
        frame = xp.stack([view[2], 0 * view[2], -view[0]])
        x_axis = light - xp.sum(light * axis, axis=0) * axis
        size = xp.sqrt(xp.sum(x_axis**2, axis=0))
        x_axis = xp.where(size > 1e-12, x_axis / xp.where(size > 1e-12, size, 1.0), frame)
        y_axis = xp.stack(
            [
                axis[1] * x_axis[2] - axis[2] * x_axis[1],
                axis[2] * x_axis[0] - axis[0] * x_axis[2],
                axis[0] * x_axis[1] - axis[1] * x_axis[0],
            ]
        )
        scale = self.stretch / (1 - q * xp.sum(normal * axis, axis=0))
        return Position(
            x=scale * xp.sum(normal * x_axis, axis=0),
            y=scale * xp.sum(normal * y_axis, axis=0),
            lamp_angle=xp.arctan2(xp.sum(light * x_axis, axis=0), xp.sum(light * axis, axis=0)),
        )

    def height(self, element: Element) -> jax.Array:
        """Compute the height, radii, which equals the y component of the normal."""
        return element.normal[1]

    def section(self, v: jax.Array) -> jax.Array:
        """Compute the radius of the section at v, cos v, radii."""
        return xp.cos(v)

    def _turn_across(self, half_vector: jax.Array) -> jax.Array:
        return 1 + half_vector


class Cylinder(Curved):
    """Cylinder about the y axis, seen perpendicular to its axis.

    The cylinder extends beyond the image. The surface coordinates are u, the angle of the normal about the axis, rad, and
    v, the position along the axis, radii. The first tangent of an anisotropic material points around the cylinder.

    Args:
        radius: half the width of the image of the cylinder, in (0, 1e100] px.
        distance: distance of the camera from the axis, in radii of the cylinder, above 1. Default: infinite, an
            orthographic camera.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        docs/model.md 3.

    Example:
        >>> cylinder = matcam.Cylinder(radius=200.0)
        >>> float(cylinder.px_per_rad(np.array(0.0))[1])
        inf
    """

    def __init__(self, radius: ArrayLike, distance: ArrayLike = np.inf):
        self.radius, self.distance = checked_radius(radius), checked_distance(distance)
        self.distant = is_infinite(distance)

    def surface(self, u: jax.Array, v: jax.Array) -> Element:
        """Compute the surface element at angle u and axial position v.

        u is in rad, and v in radii.
        """
        element, _ = self._element(sine(u), cosine(xp.abs(u)), v)
        return element

    def at(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """Compute the surface elements at positions in the image.

        The result also contains a mask, True for lines of sight that meet the cylinder.
        """
        n_z, hits = depth_of(x / self.stretch, self.nearness)
        depth = 1 - self.nearness * n_z
        element, cos_o = self._element(x / self.stretch * depth, n_z, y / self.stretch * depth)
        visible = hits & (cos_o > 0)
        return element._replace(x=x, y=y, area=1 / xp.where(visible, cos_o, 1.0)), visible

    def coordinates(self, element: Element) -> tuple[jax.Array, jax.Array]:
        """Compute the angle of the normal, rad, and the axial position, radii."""
        return xp.arctan2(element.normal[0], element.normal[2]), self.height(element)

    def height(self, element: Element) -> jax.Array:
        """Compute the position along the axis, radii."""
        return element.y / self.stretch * (1 - self.nearness * element.normal[2])

    def position(
        self, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray, lamp_nearness: ArrayLike | None = None
    ) -> Position:
        """Compute image position and lamp angle for half and difference angles.

        All normals of a cylinder lie in the plane of camera and lamp at v = 0. Therefore the position is NaN unless phi_d is
        0 or pi, or theta_h is 0.
        """
        theta_h, theta_d, phi_d = (xp.asarray(a, dtype=xp.float64) for a in (theta_h, theta_d, phi_d))
        side = -xp.cos(phi_d)
        in_plane = xp.abs(xp.sin(phi_d)) * xp.sin(theta_h) < 1e-12
        theta_o = theta_d + side * theta_h
        u = theta_o - xp.arcsin(self.nearness * xp.sin(theta_o))
        x = xp.where(in_plane, self.surface(u, xp.zeros(())).x, xp.nan)
        aside = theta_d - side * theta_h
        seen = aside if lamp_nearness is None else aside - xp.arcsin(lamp_nearness * xp.sin(aside))
        return Position(x=x, y=xp.zeros_like(x), lamp_angle=u + seen)

    def section(self, v: jax.Array) -> jax.Array:
        """Return 1, the radius of the section at every v, radii."""
        return xp.ones_like(v)

    def _element(self, n_x: jax.Array, n_z: jax.Array, v: jax.Array) -> tuple[Element, jax.Array]:
        zero = xp.zeros(())
        normal = n_x, zero, n_z
        view, length, depth = self.line_of_sight(normal, v)
        scale = self.stretch / depth
        return Element(
            normal=normal,
            tangent=(n_z, zero, -n_x),
            view=view,
            x=scale * n_x,
            y=scale * v,
            area=scale**2 * length / depth,
        ), (n_z - self.nearness) / length

    def _turn_across(self, half_vector: jax.Array) -> jax.Array:
        # the normal is constant along the axis, but the half vector of a near camera is not; for a distant camera both
        # are constant, and 1 / 0 is the infinity that px_per_rad returns
        return half_vector
