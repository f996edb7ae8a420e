"""Samples: how a shape lays surface normals out on the sensor (MODEL 3). Distant camera and lamp, orthographic.

x runs on the sensor in the plane of camera and lamp, y across it; both in px from the optical axis. A normal's place is
given by its angle theta_h to the half vector, its azimuth psi about it, and half the angle between lamp and camera,
theta_d.
"""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp


class Sample(eqx.Module):
    """A shape that is photographed."""

    @abstractmethod
    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """How far the picture moves when the normal turns by one radian, px/rad, at viewing angle theta_o: towards the
        limb, and across. Infinite in a direction in which the normal does not turn."""


class Sphere(Sample):
    """A sphere. radius: of its limb in the picture, px, positive."""

    radius: jax.Array

    def __init__(self, radius: ArrayLike):
        self.radius = checks.scalar("radius", checks.positive("radius", radius, "px"))

    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(radius cos theta_o, radius): x = radius sin theta_o is foreshortened towards the limb only (paper (5))."""
        return self.radius * jnp.cos(theta_o), self.radius + jnp.zeros_like(theta_o)

    def position(self, theta_h: ArrayLike, theta_d: ArrayLike, psi: ArrayLike) -> tuple[jax.Array, jax.Array]:
        """Where the normal at (theta_h, psi) about the half vector lies in the picture, px from the axis."""
        theta_h, theta_d, psi = (jnp.asarray(a, dtype=jnp.float64) for a in (theta_h, theta_d, psi))
        radial = jnp.sin(theta_h)
        x = jnp.cos(theta_h) * jnp.sin(theta_d) + radial * jnp.cos(psi) * jnp.cos(theta_d)
        return self.radius * x, self.radius * radial * jnp.sin(psi)

    def __repr__(self) -> str:
        return f"Sphere(radius={self.radius!s})"


class Cylinder(Sample):
    """A cylinder seen across its axis. radius: half the width of its picture, px, positive."""

    radius: jax.Array

    def __init__(self, radius: ArrayLike):
        self.radius = checks.scalar("radius", checks.positive("radius", radius, "px"))

    def px_per_rad(self, theta_o: jax.Array) -> tuple[jax.Array, jax.Array]:
        """As the sphere across the axis; along it the normal does not turn."""
        return self.radius * jnp.cos(theta_o), jnp.full_like(theta_o, jnp.inf)

    def __repr__(self) -> str:
        return f"Cylinder(radius={self.radius!s})"


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
