"""The table that a rig records of a material: every cell of the MERL grid, as one pixel sees it (MODEL 3)."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam._jax import jax, jnp
from matcam.angles import GRID_SHAPE, cosines, merl_grid
from matcam.forward.blur import Blur
from matcam.forward.recording import Sorted, Targets, record_table
from matcam.forward.regions import away_from_ends, crowded, scale_of, towards_a_pole
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.table import brdf_table


def plan(sample, sampling, scale):
    grid = merl_grid(sampling)
    phi = grid.phi_d if sampling == "centre" else np.append(grid.phi_d, np.pi)
    theta_d, theta_h, phi_d = (a.ravel() for a in np.meshgrid(grid.theta_d, grid.theta_h, phi, indexing="ij"))
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    above = np.flatnonzero((cos_i > 0) & (cos_o > 0))
    theta_d, theta_h, phi_d, cos_i = (a[above] for a in (theta_d, theta_h, phi_d, cos_i))
    picture = (above // (theta_h.size and GRID_SHAPE[0] * phi.size)).astype(np.int32)
    place = jax.jit(type(sample).place)(sample, theta_h, theta_d, phi_d)
    x, y, lamp = (np.asarray(a) for a in place)
    lamps = np.asarray(sample.lamp_angle(jnp.asarray(grid.theta_d)))
    peak = np.asarray(jax.jit(lambda l: sample.surface(sample.highlight(l), jnp.zeros(())).x)(lamp))
    near = (np.abs(x - peak) < scale.near) & (np.abs(y) < scale.near)
    away = np.asarray(away_from_ends(sample, x, y, lamp, scale.margin))
    ridge = np.asarray(crowded(sample, x, y, lamp, scale.reach)) & ~near
    pole = np.asarray(towards_a_pole(sample, x, y, scale.reach)) & ~near & ~away
    ridge &= ~pole
    rest = ~near & ~ridge & ~pole
    kinds = Sorted(*(np.flatnonzero(kind) for kind in (near, ridge, pole, rest & ~away, rest & away)))
    return Targets(x, y, lamp, picture), kinds, lamps, above, cos_i, phi.size
