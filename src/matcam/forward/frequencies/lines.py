"""Rows and columns of the sensor: half circles on a sphere in front of a distant camera, each with one lit arc."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.frequencies.regions import horizon
from matcam.forward.integral.scene import Scene

_LEAST = 1e-12


class Lines(NamedTuple):
    """Lines of the sensor.

    A position on a line is an angle from the optical axis about the axis of the line, rad: 0 is the middle and pi / 2
    the right or upper end of the line.

    Attributes:
        scene: the scene.
        upright: True for columns, False for rows.
        fixed: position of each line across its direction, px.
    """

    scene: Scene
    upright: bool
    fixed: jax.Array

    @property
    def radius(self) -> jax.Array:
        """Return half the length of each line within the limb, px."""
        sphere = self.scene.sample.radius
        return jnp.sqrt(jnp.maximum(sphere**2 - self.fixed**2, _LEAST * sphere**2))

    def normal(self, angle: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Compute the normals at positions, (lines, positions) each, in the axes of the scene."""
        sphere = self.scene.sample.radius
        share, across = self.radius[:, None] / sphere, self.fixed[:, None] / sphere
        along, across = share * jnp.sin(angle), jnp.broadcast_to(across, angle.shape)
        x, y = self.scene.from_sensor(*self.ordered(along, across))
        return x, y, share * jnp.cos(angle)

    def ordered(self, along: jax.Array, across: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return x and y of vectors along the lines and across them."""
        return (across, along) if self.upright else (along, across)

    def lamp(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the direction to the lamp: along the lines, across them, and along the optical axis."""
        angle = self.scene.lamp_angle
        x, y = self.scene.on_sensor(jnp.sin(angle), jnp.zeros(()))
        return *self.ordered(x, y), jnp.cos(angle)

    def lit(self) -> tuple[jax.Array, jax.Array]:
        """Compute middle, in [-pi, pi], and half length of the lit arc of each line's whole circle, rad, (lines,)."""
        along, across, axis = self.lamp()
        sphere = self.scene.sample.radius
        needed = (horizon(self.scene) - across * self.fixed / sphere) * sphere / self.radius
        reach = jnp.maximum(jnp.hypot(along, axis), _LEAST)
        # where the lamp is perpendicular to all lines, its direction along them has no derivative
        middle = jnp.arctan2(along, jnp.where((along == 0) & (axis == 0), _LEAST, axis))
        cosine = jnp.clip(needed / reach, -1, 1)
        ends = jnp.abs(cosine) < 1
        half = jnp.where(ends, jnp.arccos(jnp.where(ends, cosine, 0.0)), jnp.where(cosine > 0, 0.0, np.pi))
        return jnp.broadcast_to(middle, half.shape), half
