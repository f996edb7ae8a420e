"""A shape that is photographed: how it lays its surface normals out on the sensor (MODEL 3).

x runs on the sensor in the plane of camera and lamp, y across it; both in px from the optical axis, on which the sample's
centre lies. The lamp is far away, in the plane of x and the axis, towards +x. Distances are in radii of the sample.

The flat sample: one normal, and a texture.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.shading import Vector


class Element(NamedTuple):
    """A piece of surface in the picture; arrays that broadcast."""

    normal: Vector
    tangent: Vector
    """First tangent, in the plane of x and the axis."""
    view: Vector
    """Direction to the camera."""
    x: jax.Array
    y: jax.Array
    """Where it lies in the picture, px."""
    area: jax.Array
    """Its area in the picture, divided by the cosine of the view: that cosine cancels in what a surface sends to the
    camera, so nothing is singular at the limb. px^2 per du dv where it is given by (u, v), per px^2 where by (x, y)."""


class Place(NamedTuple):
    """Where a picture shows a pair of half and difference angles."""

    x: jax.Array
    y: jax.Array
    """Position, px."""
    lamp_angle: jax.Array
    """Angle between lamp and optical axis, rad, at which it does."""


class Sample(eqx.Module):
    """A shape that is photographed."""

    @abstractmethod
    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """How far the picture moves when the normal turns by one radian away from the half vector, px/rad, for a
        highlight seen at angle theta_o from the normal: towards the limb, and across. Infinite in a direction in which
        the normal does not turn."""


class Curved(Sample):
    """A sample whose one picture shows many normals.

    The surface has two coordinates: u, the angle of its normal from the optical axis in the plane of camera and lamp,
    and v, out of that plane. What is visible and lit is, at every v, one interval of u: its ends are sharp, and what lies
    between them is smooth.

    radius: of the limb in the picture, px. distance: from the sample's centre to the camera, in its own radii; infinite
    for a distant camera (orthographic).
    """

    radius: eqx.AbstractVar[jax.Array]
    distance: eqx.AbstractVar[jax.Array]
    distant: eqx.AbstractVar[bool]
    """Whether the distance is infinite: then every piece of surface is seen from one direction, once and for all."""

    @abstractmethod
    def surface(self, u: jax.Array, v: jax.Array) -> Element:
        """The piece of surface at (u, v), which broadcast."""

    @abstractmethod
    def at(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """The piece of surface that the picture shows at (x, y) px, and whether it shows any."""

    @abstractmethod
    def coordinates(self, element: Element) -> tuple[jax.Array, jax.Array]:
        """(u, v) of a piece of surface."""

    @abstractmethod
    def place(self, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray) -> Place:
        """The position and the lamp that show these half and difference angles, rad; meaningless below the horizon."""

    @abstractmethod
    def section(self, v: jax.Array) -> jax.Array:
        """Radius of the surface's section at v, in radii of the sample."""

    @abstractmethod
    def window(self, low: jax.Array, high: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Interval of v that holds all that the picture shows between y = low and y = high px, around u."""

    @abstractmethod
    def rows(self, x: jax.Array, y: jax.Array, reach: ArrayLike) -> tuple[jax.Array, jax.Array]:
        """Interval of v that holds all that the picture shows within `reach` px of (x, y) in both directions."""

    @property
    def nearness(self) -> jax.Array:
        """1 / distance; 0 for a distant camera."""
        return 1 / self.distance

    @property
    def stretch(self) -> jax.Array:
        """px per radius of the sample at the depth of its centre: radius sqrt(1 - 1 / d^2) (MODEL 3)."""
        return self.radius * jnp.sqrt(1 - self.nearness**2)

    def visible(self, v: jax.Array) -> jax.Array:
        """The largest |u| that the camera sees at v, rad; 0 where it sees none."""
        section = self.section(v)
        cosine = self.nearness / jnp.where(section > 0, section, 1.0)
        return jnp.where(cosine < 1, jnp.arccos(jnp.where(cosine < 1, cosine, 0.0)), 0.0)

    def lit(self, v: jax.Array, lamp_angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The interval of u, rad, that is visible and lit at v; empty (low = high) where there is none."""
        high = self.visible(v)
        low = jnp.maximum(-high, lamp_angle - jnp.pi / 2)
        high = jnp.minimum(high, lamp_angle + jnp.pi / 2)
        return jnp.minimum(low, high), high

    def across(self, x: jax.Array, v: jax.Array) -> jax.Array:
        """The visible u at v that lies at picture position x, rad; the nearest visible one where none does."""
        section, q = self.section(v), self.nearness
        slope = x / (self.stretch * jnp.where(section > 0, section, 1.0))
        u = angle_on_circle(slope, slope * section * q)
        end = self.visible(v)
        return jnp.clip(u, -end, end)

    def highlight(self, lamp_angle: jax.Array) -> jax.Array:
        """The u, at v = 0, whose normal is the half vector: half of lamp_angle if the camera is far."""
        if self.distant:
            return jnp.asarray(lamp_angle, dtype=jnp.float64) / 2
        q = self.nearness

        def newton(_: int, u: jax.Array) -> jax.Array:
            gamma = jnp.arctan2(q * jnp.sin(u), 1 - q * jnp.cos(u))
            slope = q * (jnp.cos(u) - q) / (1 + q**2 - 2 * q * jnp.cos(u))
            return u - (2 * u + gamma - lamp_angle) / (2 + slope)

        return jax.lax.fori_loop(0, 12, newton, jnp.asarray(lamp_angle, dtype=jnp.float64) / 2)

    def lamp_angle(self, theta_d: jax.Array) -> jax.Array:
        """Angle between lamp and optical axis, rad, at which the highlight's normal sees both at theta_d."""
        return 2 * theta_d - jnp.arcsin(self.nearness * jnp.sin(theta_d))

    def theta_d(self, lamp_angle: jax.Array) -> jax.Array:
        """Half the angle between lamp and camera as the highlight sees it, rad: the inverse of `lamp_angle`."""
        return lamp_angle - self.highlight(lamp_angle)

    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(radius cos theta_o, radius) with a distant camera: x = radius sin theta_o (paper (5)). Before a near one the
        half vector turns too, by half of what the line of sight does."""
        q = self.nearness
        if self.distant:
            across = self.radius / self._turn_across(jnp.zeros(()))
            return self.radius * jnp.cos(theta_o), across + jnp.zeros_like(theta_o)
        t = theta_o - jnp.arcsin(q * jnp.sin(theta_o))
        depth, length = 1 - q * jnp.cos(t), jnp.sqrt(1 + q**2 - 2 * q * jnp.cos(t))
        turn_along = q * (jnp.cos(t) - q) / length**2 / 2
        along = self.stretch * (jnp.cos(t) - q) / depth**2 / (1 + turn_along)
        return along, self.stretch / depth / self._turn_across(q / length / (2 * jnp.cos(theta_o)))

    @abstractmethod
    def _turn_across(self, half_vector: jax.Array) -> jax.Array:
        """Angle between normal and half vector per radius moved along y, given the half vector's share."""

    def line_of_sight(self, normal: Vector, y: jax.Array) -> tuple[Vector, jax.Array, jax.Array]:
        """(direction to the camera, its length, depth) from a point with this normal, y radii from the plane of x and
        the axis; length and depth (along the axis) over the camera's distance. Scalars if the camera is distant."""
        zero, one = jnp.zeros(()), jnp.ones(())
        if self.distant:
            return (zero, zero, one), one, one
        q = self.nearness
        depth = 1 - q * normal[2]
        length = jnp.sqrt((q * normal[0]) ** 2 + (q * y) ** 2 + depth**2)
        return (-q * normal[0] / length, -q * y / length, depth / length), length, depth


def angle_on_circle(slope: jax.Array, tilt: jax.Array) -> jax.Array:
    """The u with sin u + tilt cos u = slope, nearest to 0: where a line of sight meets a circle; +-pi/2 if it misses."""
    lean = jnp.arctan(tilt)
    sine = slope * jnp.cos(lean)
    inside = jnp.abs(sine) < 1
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, sine, 0.0)) - lean, jnp.sign(slope) * jnp.pi / 2)


def depth_of(slope: jax.Array, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """cos t of the visible point with sin t = slope (1 - q cos t), and whether the line of sight meets the shape."""
    square = slope**2
    root = 1 + square * (q**2 - 1)
    hits = root > 0
    return (square * q + jnp.sqrt(jnp.where(hits, root, 1.0))) / (1 + square * q**2), hits


def checked_distance(distance: ArrayLike) -> jax.Array:
    """A distance from the sample's centre in its radii: above 1, infinity allowed."""
    what = "radii of the sample (the camera is outside it)"
    return checks.scalar("distance", checks.within("distance", distance, 1, np.inf, what, open_low=True))


def is_infinite(distance: ArrayLike) -> bool:
    """Whether a distance is a concrete infinity."""
    return is_concrete(distance) and bool(np.isinf(np.asarray(distance, dtype=np.float64)))


def shown(shape: Curved) -> str:
    """Constructor call that makes the shape."""
    far = "" if shape.distant else f", distance={shape.distance!s}"
    return f"{type(shape).__name__}(radius={shape.radius!s}{far})"


class Flat(Sample):
    """A flat sample, tilted away from the camera. Its normal is the same everywhere: the camera cannot blur its
    reflectance, only its texture."""

    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Infinite in both directions."""
        return jnp.full_like(theta_o, jnp.inf), jnp.full_like(theta_o, jnp.inf)

    def frequency_on_sensor(self, frequency: ArrayLike, theta_o: ArrayLike) -> jax.Array:
        """Cycles/px at which a texture of `frequency` cycles/px (seen head-on) arrives, varying along the tilt (paper (4))."""
        return checks.number("frequency", frequency) / jnp.cos(checks.viewing_angle("theta_o", theta_o))

    def __repr__(self) -> str:
        return "Flat()"
