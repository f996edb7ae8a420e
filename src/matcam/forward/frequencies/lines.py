"""Rows and columns of the sensor, as half circles on a sphere in front of a distant camera.

Each half circle has at most one lit arc.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.frequencies.regions import horizon
from matcam.forward.integral.scene import Scene

_LEAST = 1e-12
"""Smallest value of quantities that must not be 0, relative to 1."""


class Lines(NamedTuple):
    """Rows or columns (lines) of the sensor.

    Each line shows half a circle on the sphere. A position on a line is the angle on this circle, rad. The angle is 0
    in the middle of the line, and pi / 2 at the right or upper end.

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
        """Half the length of each line within the limb, px."""
        sphere = self.scene.sample.radius
        return jnp.sqrt(jnp.maximum(sphere**2 - self.fixed**2, _LEAST * sphere**2))

    def normal(self, angle: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Compute the normals in the axes of the scene.

        `angle` contains the angles on the lines, (lines, positions), rad.
        """
        sphere = self.scene.sample.radius
        share, across = self.radius[:, None] / sphere, self.fixed[:, None] / sphere
        along, across = share * jnp.sin(angle), jnp.broadcast_to(across, angle.shape)
        x, y = self.scene.from_sensor(*self.ordered(along, across))
        return x, y, share * jnp.cos(angle)

    def ordered(self, along: jax.Array, across: jax.Array) -> tuple[jax.Array, jax.Array]:
        return (across, along) if self.upright else (along, across)

    def lamp(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Compute the components of the direction to the lamp: along the lines, across the lines, along the optical axis."""
        angle = self.scene.lamp_angle
        x, y = self.scene.on_sensor(jnp.sin(angle), jnp.zeros(()))
        return *self.ordered(x, y), jnp.cos(angle)

    def lit(self) -> tuple[jax.Array, jax.Array]:
        """Compute the lit arc on the circle of each line.

        The result is the middle of the arc, in [-pi, pi], and half the length of the arc, rad.
        """
        along, across, axis = self.lamp()
        sphere = self.scene.sample.radius
        needed = (horizon(self.scene) - across * self.fixed / sphere) * sphere / self.radius
        reach = jnp.maximum(jnp.hypot(along, axis), _LEAST)
        # arctan2(0, 0), for a lamp in the direction across the lines, has no derivative
        middle = jnp.arctan2(along, jnp.where((along == 0) & (axis == 0), _LEAST, axis))
        cosine = jnp.clip(needed / reach, -1, 1)
        ends = jnp.abs(cosine) < 1
        half = jnp.where(ends, jnp.arccos(jnp.where(ends, cosine, 0.0)), jnp.where(cosine > 0, 0.0, np.pi))
        return jnp.broadcast_to(middle, half.shape), half
