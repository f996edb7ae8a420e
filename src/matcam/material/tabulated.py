"""A measured table on the MERL grid as a material: linear interpolation that leaves missing cells missing."""

from __future__ import annotations

from itertools import product

import equinox as eqx
import numpy as np
import xarray as xr

from matcam.core.grid import GRID_SHAPE, checked_table, sampling_of, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading
from matcam.material.material import Material, above_horizon, theta_h_of


class Tabulated(Material):
    """Interpolate a BRDF table on the MERL grid.

    It is linear in (sqrt theta_h, theta_d, phi_d).

    - Values sit at the centre or the edge of their cells, as the table's `sampling` says.
    - phi_d + pi is phi_d (reciprocity), so the last phi_d and the first are neighbours.
    - Below the first theta_h the first value holds: through theta_h = 0 the table continues at phi_d + pi, which is the
      same. Beyond the last theta_h and theta_d the last value holds.
    - A missing cell (NaN) stays missing: the result is NaN wherever the nearest sampling point is. Elsewhere missing
      neighbours are left out, and the weights of the others are scaled up to 1.

    Args:
        table: BRDF, 1/sr, dims (theta_h, theta_d, phi_d, channel), shape (90, 90, 180, channels), such as `read_merl` reads.

    Attributes:
        values: the table, 1/sr, shape (90, 90, 180, channels).
        shift: place of a value in its cell, in cells: 0.5 for "centre", 0 for "edge".

    Raises:
        ArgumentError: the table has other dimensions or another shape.

    Source:
        Matusik et al. (2003), "A Data-Driven Reflectance Model": the grid.

    Example:
        >>> from matcam.core.grid import brdf_table
        >>> grey = matcam.material.Tabulated(brdf_table(np.full((90, 90, 180, 3), 0.25), "centre"))
        >>> np.asarray(grey.brdf(0.1, 0.5, 1.0))
        array([0.25, 0.25, 0.25])
    """

    values: jax.Array
    shift: float = eqx.field(static=True)

    def __init__(self, table: xr.DataArray):
        checked = checked_table(table)
        self.values = jnp.asarray(checked.values, dtype=jnp.float64)
        self.shift = {"centre": 0.5, "edge": 0.0}[sampling_of(checked)]

    @eqx.filter_jit
    def reflected(self, shading: Shading) -> jax.Array:
        """Return the interpolated BRDF times both cosines, 1/sr."""
        shading, above = above_horizon(shading)
        brdf = self._interpolate(theta_h_of(shading), jnp.asarray(shading.theta_d), jnp.asarray(shading.phi_d))
        return jnp.where(above[..., None], brdf * (shading.cos_i * shading.cos_o)[..., None], 0.0)

    @property
    def finest(self) -> jax.Array:
        """Width of the first theta_h cell, rad."""
        return jnp.asarray(theta_h_edges()[1])

    def _interpolate(self, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> jax.Array:
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
