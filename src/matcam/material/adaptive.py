"""BRDFs in RGL's adaptive parameterisation as materials (Dupuy & Jakob 2018; files/rgl.py has the fields).

The half vector m, as a point u of the unit square (theta = u^2 pi / 2, phi = (2 v - 1) pi; azimuth from that of the light
where the material is isotropic), is carried by the map that flattens `vndf` to the point s where `rgb` is tabulated:

    BRDF cos theta_o = rgb(s) ndf(u_m) / (4 sigma(u_i))           with `jacobian`; rgb(s) alone without.

"i" is the light, "o" the view. A measured file need not be reciprocal, and its tables go below zero here and there.
"""

from __future__ import annotations

import equinox as eqx
import numpy as np
import xarray as xr

from matcam._jax import jax, jnp
from matcam.errors import ArgumentError
from matcam.material.material import Material, above_horizon
from matcam.material.warp import Warp, bilinear, blend
from matcam.shading import Shading

_HALF_PI = np.pi / 2


class Adaptive(Material):
    """A BRDF of the Dataset that `read_rgl` reads or `adaptive_grid` makes, interpolated as Mitsuba's `measured` does.

    Channels: R, G, B, or the file's wavelengths. Differentiable almost everywhere.
    """

    azimuths: jax.Array
    """Of the light, rad, (P,)."""
    angles: jax.Array
    """Of the light to the normal, rad, (T,)."""
    ndf: jax.Array
    sigma: jax.Array
    warp: Warp
    values: jax.Array
    """(P T, N, N, channels)."""
    jacobian: bool = eqx.field(static=True)
    mirrored: int = eqx.field(static=True)
    """How many times the light's azimuths fit into a whole turn, 1, 2 or 4; the rest follows by symmetry. 0: isotropic."""

    def __init__(self, fields: xr.Dataset):
        if not isinstance(fields, xr.Dataset) or "vndf" not in fields:
            raise ArgumentError(f"fields must be a Dataset such as read_rgl's, got {type(fields).__name__}")
        numbers = lambda name: fields[name].values.astype(np.float64)  # noqa: E731
        self.azimuths, self.angles = jnp.asarray(numbers("phi_i")), jnp.asarray(numbers("theta_i"))
        self.ndf, self.sigma = jnp.asarray(numbers("ndf")), jnp.asarray(numbers("sigma"))
        vndf, values = numbers("vndf"), numbers("spectra" if "spectra" in fields else "rgb")
        self.warp = Warp(vndf.reshape(-1, *vndf.shape[2:]))
        self.values = jnp.moveaxis(jnp.asarray(values.reshape(-1, *values.shape[2:])), 1, -1)
        self.jacobian = bool(fields["jacobian"].values[0])
        span = float(self.azimuths[-1] - self.azimuths[0])
        self.mirrored = 0 if self.azimuths.size <= 2 else round(2 * np.pi / span)
        if self.mirrored not in (0, 1, 2, 4):
            raise ArgumentError(
                f"field phi_i must span a whole turn, a half or a quarter: the rest follows by symmetry; got {span:.4g} rad"
            )

    @eqx.filter_jit
    def reflected(self, seen: Shading) -> jax.Array:
        """The interpolated BRDF times both cosines."""
        seen, above = above_horizon(seen)
        shape = above.shape
        flat = Shading(*(jnp.broadcast_to(jnp.asarray(a, dtype=jnp.float64), shape).ravel() for a in seen))
        theta_i, phi_i, theta_m, phi_m = self._directions(flat)
        turned = phi_m if self.mirrored else phi_m - phi_i
        place = (turned + np.pi) / (2 * np.pi)
        u, v = jnp.sqrt(theta_m / _HALF_PI), place - jnp.floor(place)
        light = blend((self.azimuths, self.angles), phi_i, theta_i)
        outgoing = bilinear(self.values, light, *self.warp.flattened(light, u, v))
        if self.jacobian:
            facets = bilinear(self.ndf, None, u, v)
            area = bilinear(self.sigma, None, jnp.sqrt(theta_i / _HALF_PI), (phi_i + np.pi) / (2 * np.pi))
            outgoing = outgoing * (facets / (4 * jnp.where(area > 0, area, 1.0)))[:, None]
        outgoing = (outgoing * flat.cos_i[:, None]).reshape(*shape, -1)
        return jnp.where(above[..., None], outgoing, 0.0)

    def _directions(self, seen: Shading) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Angles and azimuths of light and half vector, within the range that is tabulated."""
        slope = jnp.hypot(seen.slope_along, seen.slope_across)
        none = slope == 0
        safe = jnp.where(none, 1.0, slope)
        c, s = jnp.where(none, 1.0, seen.slope_along / safe), jnp.where(none, 0.0, seen.slope_across / safe)
        theta_m = jnp.arctan(slope)
        # the light, first with the half vector in the x-z plane (angles.azimuth_difference), then turned to its azimuth
        x = jnp.cos(theta_m) * jnp.sin(seen.theta_d) * jnp.cos(seen.phi_d) + jnp.sin(theta_m) * jnp.cos(seen.theta_d)
        y = jnp.sin(seen.theta_d) * jnp.sin(seen.phi_d)
        i_x, i_y, m_x, m_y = c * x - s * y, s * x + c * y, c, s
        if self.mirrored >= 2:
            flip_y = jnp.where(i_y < 0, 1.0, -1.0)
            flip_x = jnp.where(i_x < 0, 1.0, -1.0) if self.mirrored == 4 else flip_y
            i_x, i_y, m_x, m_y = i_x * flip_x, i_y * flip_y, m_x * flip_x, m_y * flip_y
        theta_i = jnp.arctan2(jnp.hypot(i_x, i_y), seen.cos_i)
        return theta_i, jnp.arctan2(i_y, i_x), theta_m, jnp.arctan2(m_y, m_x)

    @property
    def finest(self) -> jax.Array:
        """Where the mean normal distribution has fallen to half its peak, or the grid's first step where that is wider."""
        profile = jnp.mean(self.ndf, axis=0)
        below = jnp.argmax(jnp.append(profile, 0.0) < profile.max() / 2)
        return jnp.maximum(below / (profile.size - 1), 1 / (profile.size - 1)) ** 2 * _HALF_PI

    def __repr__(self) -> str:
        p, t = self.azimuths.size, self.angles.size
        return f"Adaptive({p} x {t} directions of light, {' x '.join(map(str, self.values.shape[1:]))})"
