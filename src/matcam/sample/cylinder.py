"""The cylinder: normals of one plane, each along a whole line."""

from __future__ import annotations

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import AnyArray, jax, jnp
from matcam.sample.shape import Curved, Element, Place, checked_distance, constructor_call, depth_of, is_infinite


class Cylinder(Curved):
    """Describe a cylinder seen across its axis, which is the y axis.

    It reaches beyond the picture. v is the place along the axis, in radii. An anisotropic material's first direction runs
    around it.

    Args:
        radius: half the width of its picture, px, positive.
        distance: of the camera from its axis, in radii of the cylinder, above 1. Default: infinite, an orthographic camera.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        docs/model.md 3.

    Example:
        >>> cylinder = matcam.Cylinder(radius=200.0)
        >>> float(cylinder.px_per_rad(np.array(0.0))[1])
        inf
    """

    radius: jax.Array
    distance: jax.Array
    distant: bool = eqx.field(static=True)

    def __init__(self, radius: ArrayLike, distance: ArrayLike = np.inf):
        self.radius = checks.scalar("radius", checks.positive("radius", radius, "px"))
        self.distance = checked_distance(distance)
        self.distant = is_infinite(distance)

    def surface(self, u: jax.Array, v: jax.Array) -> Element:
        """Return the surface: the sphere's equator across the axis, constant along it."""
        element, _ = self._element(jnp.sin(u), jnp.cos(u), v)
        return element

    def at(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """Return the point at which the line of sight meets the cylinder."""
        n_z, hits = depth_of(x / self.stretch, self.nearness)
        depth = 1 - self.nearness * n_z
        element, cos_o = self._element(x / self.stretch * depth, n_z, y / self.stretch * depth)
        visible = hits & (cos_o > 0)
        return element._replace(x=x, y=y, area=1 / jnp.where(visible, cos_o, 1.0)), visible

    def coordinates(self, element: Element) -> tuple[jax.Array, jax.Array]:
        """Return the normal's angle, rad, and the place along the axis, radii."""
        u = jnp.arctan2(element.normal[0], element.normal[2])
        return u, element.y / self.stretch * (1 - self.nearness * element.normal[2])

    def place(self, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray) -> Place:
        """Return the position and the lamp that show half and difference angles.

        Only normals in the plane of camera and lamp are seen at v = 0: phi_d must be 0 or pi, and the position is NaN
        elsewhere.
        """
        theta_h, theta_d, phi_d = (jnp.asarray(a, dtype=jnp.float64) for a in (theta_h, theta_d, phi_d))
        side = -jnp.cos(phi_d)
        in_plane = jnp.abs(jnp.sin(phi_d)) * jnp.sin(theta_h) < 1e-12
        theta_o = theta_d + side * theta_h
        u = theta_o - jnp.arcsin(self.nearness * jnp.sin(theta_o))
        x = jnp.where(in_plane, self.surface(u, jnp.zeros(())).x, jnp.nan)
        return Place(x=x, y=jnp.zeros_like(x), lamp_angle=u + theta_d - side * theta_h)

    def section(self, v: jax.Array) -> jax.Array:
        """Return 1: the section is the same all along."""
        return jnp.ones_like(v)

    def window(self, low: jax.Array, high: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the interval along the axis between two rows, in radii.

        A near camera's scale varies, for which a twentieth is added.
        """
        scale = self.stretch / (1 - self.nearness * jnp.cos(u))
        middle, half = (low + high) / 2, (high - low) / 2 * jnp.where(self.nearness > 0, 1.05, 1.0)
        return (middle - half) / scale, (middle + half) / scale

    def rows(self, x: jax.Array, y: jax.Array, reach: ArrayLike) -> tuple[jax.Array, jax.Array]:
        """Return the interval along the axis close to a place."""
        return self.window(y - reach, y + reach, self.across(x, jnp.zeros_like(x)))

    def _element(self, n_x: jax.Array, n_z: jax.Array, v: jax.Array) -> tuple[Element, jax.Array]:
        zero = jnp.zeros(())
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
        # the normal does not turn along the axis, but the half vector of a near camera does; a distant one's neither:
        # moving along it turns nothing, and 1 / 0 is the infinity that px_per_rad promises
        return half_vector

    def __repr__(self) -> str:
        return constructor_call(self)
