"""Quadrature nodes on arcs of circles on the unit sphere of normals."""

from __future__ import annotations

from typing import NamedTuple

from matcam.core.arrays.elementary import sine
from matcam.core.jax import AnyArray, jax, jnp
from matcam.sample.curved import Sphere
from matcam.sample.shape import Element

_Direction = tuple[jax.Array, jax.Array]
"""Sine and cosine of an angle."""


class CircleArcs(NamedTuple):
    """Arcs of circles on the unit sphere of normals. All arrays have the same shape.

    Attributes:
        frame: axis of the circle, and the directions of azimuth 0 and pi/2, three arrays each.
        angle: angle of the circle from its axis, rad.
        weight: weight in the integral over normals, including half the length of the arc, no unit.
        middle: azimuth of the middle of the arc, rad.
        half: half the length of the arc, rad.
    """

    frame: tuple[tuple[AnyArray, ...], ...]
    angle: AnyArray
    weight: AnyArray
    middle: AnyArray
    half: AnyArray

    def directions(self) -> tuple[_Direction, _Direction]:
        """Compute sine and cosine of the azimuth of the middle, and of the angle from the axis."""
        middle, angle = ((jnp.sin(a), jnp.cos(a)) for a in (self.middle, self.angle))
        return middle, angle

    def element(
        self, sample: Sphere, node: jax.Array, directions: tuple[_Direction, _Direction]
    ) -> tuple[Element, AnyArray]:
        """Compute the surface element at a node in [-1, 1] on each arc, and the weight of its radiance."""
        (sine_m, cosine_m), (radius, up) = directions
        off = jnp.asarray(self.half) * node
        chord = sine(off / 2)
        sine_off, versine = 2 * chord * jnp.sqrt(1 - chord**2), 2 * chord**2
        along = radius * (cosine_m - sine_m * sine_off - cosine_m * versine)
        across = radius * (sine_m + cosine_m * sine_off - sine_m * versine)
        x, y, z = (up * a + along * b + across * c for a, b, c in zip(*self.frame, strict=True))
        return sample.facing((x, y, z)), self.weight
