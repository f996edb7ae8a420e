"""What a material is to a rig: light in, light out."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.angles import cosines
from matcam.shading import Shading


class Material(eqx.Module):
    """An opaque surface with a BRDF. Channels, where it has them, are the last axis of every result."""

    @abstractmethod
    def reflected(self, seen: Shading) -> jax.Array:
        """BRDF cos_i cos_o, 1/sr, for all that a surface sees: shape of `seen` broadcast, and (channels,) behind it if
        there are any. Finite up to the horizon and at it; 0 where light or view lies below. NaN is missing."""

    @property
    @abstractmethod
    def finest(self) -> jax.Array:
        """Narrowest angular scale of its lobe, rad, shape (): the scale on which quadrature has to be graded."""

    def brdf(self, theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike, phi_h: ArrayLike = 0.0) -> jax.Array:
        """BRDF, 1/sr, shape of the broadcast angles and (channels,) behind it if there are any; NaN below the horizon.

        phi_h: azimuth of the half vector about the normal, from the first tangent, rad: matters to an anisotropic
        material only.
        """
        seen = seen_at(theta_h, theta_d, phi_d, phi_h)
        reflected = self.reflected(seen)
        above = (seen.cos_i > 0) & (seen.cos_o > 0)
        foreshortening = jnp.where(above, seen.cos_i * seen.cos_o, 1.0)
        if reflected.ndim > above.ndim:
            above, foreshortening = above[..., None], foreshortening[..., None]
        return jnp.where(above, reflected / foreshortening, jnp.nan)


def seen_at(theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike, phi_h: ArrayLike = 0.0) -> Shading:
    """What a surface sees at half and difference angles, rad. Angles broadcast; ArgumentError where one is not finite."""
    theta_h, theta_d, phi_d, phi_h = (
        checks.number(name, angle)
        for name, angle in (("theta_h", theta_h), ("theta_d", theta_d), ("phi_d", phi_d), ("phi_h", phi_h))
    )
    cos_i, cos_o = cosines(theta_h, theta_d, phi_d)
    slope = jnp.tan(theta_h)
    along, across = jnp.broadcast_arrays(slope * jnp.cos(phi_h), slope * jnp.sin(phi_h), cos_i)[:2]
    return Shading(cos_i, cos_o, along, across, theta_d, phi_d)


def above_horizon(seen: Shading) -> tuple[Shading, jax.Array]:
    """`seen` with harmless numbers where light or view lies below the horizon, so that no derivative is poisoned; and
    where neither does."""
    above = (seen.cos_i > 0) & (seen.cos_o > 0)
    cos_i, cos_o = (jnp.where(above, c, 0.5) for c in (seen.cos_i, seen.cos_o))
    along, across = (jnp.where(above, s, 0.0) for s in (seen.slope_along, seen.slope_across))
    return seen._replace(cos_i=cos_i, cos_o=cos_o, slope_along=along, slope_across=across), above


def theta_h_of(seen: Shading) -> jax.Array:
    """The half vector's angle to the normal, rad."""
    slope2 = seen.slope_along**2 + seen.slope_across**2
    mirror = slope2 == 0  # the root's slope is infinite there
    return jnp.where(mirror, 0.0, jnp.arctan(jnp.sqrt(jnp.where(mirror, 1.0, slope2))))
