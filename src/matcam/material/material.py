"""What a material is to a rig: light in, light out.

How much light a material sends back in all.

A measured table as a material.
"""

from __future__ import annotations

from abc import abstractmethod
from itertools import product

import equinox as eqx
import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.grid import GRID_SHAPE, checked_table, cosines, sampling_of, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, local_shading, vector


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


_NODES, _AZIMUTHS = 720, 64


def albedo(material: Material, theta: ArrayLike) -> np.ndarray:
    """Directional-hemispherical reflectance, the integral of BRDF cos theta_i over the light's directions, for views at theta
    (rad, [0, pi/2), shape (n,)), azimuth 0: shape (n, channels). What is missing counts as 0.

    By the midpoint rule over half vectors, even in sqrt(theta_h), where d omega_i = 4 cos theta_d d omega_h: lobes as narrow
    as 1e-4 rad are resolved.
    """
    angles = np.atleast_1d(np.asarray(checks.viewing_angle("theta", theta)))
    u = ((np.arange(_NODES) + 0.5) / _NODES)[:, None]
    phi = ((np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS * 2 * np.pi)[None, :]
    theta_h = u**2 * np.pi / 2
    half = np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h) + 0 * phi
    solid = np.sin(theta_h) * np.pi * u / _NODES * 2 * np.pi / _AZIMUTHS
    found = []
    for angle in angles:
        view = np.sin(angle), 0.0, np.cos(angle)
        towards = half[0] * view[0] + half[2] * view[2]
        light = vector(*(2 * towards * h - v for h, v in zip(half, view, strict=True)))
        reflected = material.reflected(local_shading(light, vector(*view)))
        values = np.asarray(reflected).reshape(_NODES, _AZIMUTHS, -1)
        weight = np.where(towards > 0, 4 * towards * solid, 0.0) / view[2]
        found.append(np.nansum(values * weight[..., None], axis=(0, 1)))
    return np.stack(found)


class Tabulated(Material):
    """A BRDF on the MERL grid, as from `read_merl`, interpolated linearly in (sqrt theta_h, theta_d, phi_d).

    - Values sit at the centre or the edge of their cells, as the table's `sampling` says.
    - phi_d + pi is phi_d (reciprocity), so the last phi_d and the first are neighbours.
    - Below the first theta_h the first value holds: through theta_h = 0 the table continues at phi_d + pi, which is the
      same. Beyond the last theta_h and theta_d the last value holds.
    - A cell that is missing (NaN) stays missing: NaN wherever the nearest sampling point is. Elsewhere missing neighbours
      are left out and the weights of the others made up to 1.
    """

    values: jax.Array
    """(90, 90, 180, channels), 1/sr."""
    shift: float = eqx.field(static=True)
    """Where a value sits in its cell, in cells."""

    def __init__(self, table: xr.DataArray):
        checked = checked_table(table)
        self.values = jnp.asarray(checked.values, dtype=jnp.float64)
        self.shift = {"centre": 0.5, "edge": 0.0}[sampling_of(checked)]

    @eqx.filter_jit
    def reflected(self, seen: Shading) -> jax.Array:
        """The interpolated BRDF times both cosines."""
        seen, above = above_horizon(seen)
        brdf = self._interpolated(theta_h_of(seen), jnp.asarray(seen.theta_d), jnp.asarray(seen.phi_d))
        return jnp.where(above[..., None], brdf * (seen.cos_i * seen.cos_o)[..., None], 0.0)

    @property
    def finest(self) -> jax.Array:
        """Width of the first theta_h cell."""
        return jnp.asarray(theta_h_edges()[1])

    def _interpolated(self, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> jax.Array:
        n_h, n_d, n_p = GRID_SHAPE
        peak = theta_h == 0
        root = jnp.where(peak, 0.0, jnp.sqrt(jnp.where(peak, 1.0, theta_h / (np.pi / 2))))
        place_h = jnp.clip(root * n_h - self.shift, 0, n_h - 1)
        place_d = jnp.clip(theta_d * n_d / (np.pi / 2) - self.shift, 0, n_d - 1)
        place_p = jnp.mod(phi_d / np.pi, 1.0) * n_p - self.shift
        low = [jnp.floor(place) for place in (place_h, place_d, place_p)]
        rest = [place - floor for place, floor in zip((place_h, place_d, place_p), low, strict=True)]
        i_h, i_d, i_p = (floor.astype(int) for floor in low)

        total = weights = missing = jnp.zeros(())
        for up in product((0, 1), repeat=3):
            # out-of-range neighbours weigh 0; any entry will do
            at = jnp.minimum(i_h + up[0], n_h - 1), jnp.minimum(i_d + up[1], n_d - 1), jnp.mod(i_p + up[2], n_p)
            value = self.values[at]
            share = jnp.ones(())
            nearest = jnp.ones((), dtype=bool)
            for fraction, above in zip(rest, up, strict=True):
                share = share * (fraction if above else 1 - fraction)
                nearest = nearest & ((fraction > 0.5) if above else (fraction <= 0.5))
            known = jnp.isfinite(value)
            share = jnp.where(known, share[..., None], 0.0)
            total = total + share * jnp.where(known, value, 0.0)
            weights = weights + share
            missing = missing + jnp.where(nearest[..., None] & ~known, 1.0, 0.0)
        return jnp.where(missing > 0, jnp.nan, total / jnp.where(weights > 0, weights, 1.0))

    def __repr__(self) -> str:
        sampling = "edge" if self.shift == 0 else "centre"
        return f"Tabulated({' x '.join(map(str, self.values.shape))}, sampling={sampling!r})"
