"""The flat sample: one normal, and a texture."""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.sample.shape import Sample


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
