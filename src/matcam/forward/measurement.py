"""The table that a rig records of a material: every cell of the MERL grid as its pixels see it (MODEL 3)."""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam._jax import jax, jnp
from matcam.angles import GRID_SHAPE, Sampling, below_horizon, merl_grid
from matcam.errors import ArgumentError
from matcam.forward.blur import blur_of, kernel_error
from matcam.forward.recording import record
from matcam.forward.tabulation import folded, sampling_of, tabulation
from matcam.material.material import Material
from matcam.rigs import Rig, merl
from matcam.sample.flat import Flat
from matcam.sample.sphere import Sphere
from matcam.table import CHANNELS, brdf_table


def measure(material: Material, rig: Rig) -> xr.DataArray:
    """The BRDF table that `rig` records of `material`: 1/sr on the MERL grid, NaN where nothing is recorded.

    Each cell is the pixel centred on the rig's `cell_value` point ("mean": the mean over the pixels inside), divided by
    the cosine of the light at its centre, and averaged over the two places that show it (reciprocity). Coordinate
    `pixels` (theta_h, theta_d, phi_d): how many pixels stand behind a cell, both places together; 0 where it is not seen.
    A flat sample's light is the same all over: nothing is lost. ArgumentError for a cylinder, which shows normals of one
    plane only, and inside jax.jit; for the differentiable values alone see `measured_values`.

    Source: MODEL 2, 3; error below 1e-4 of the value or 1e-7 of the peak for Gaussian optics (tests). Lenses that are no
    Gaussians are sums of them: attribute `kernel_error` is the largest error of their MTF.
    """
    recorded, pixels = measured_values(material, rig)
    if recorded.shape[-1] not in (1, len(CHANNELS)):
        raise ArgumentError(f"a table has {len(CHANNELS)} channels or a grey material's one, got {recorded.shape[-1]}")
    values = np.broadcast_to(np.asarray(recorded), (*GRID_SHAPE, len(CHANNELS))).copy()
    attrs = {"cell_value": rig.cell_value, "rig": repr(rig), "kernel_error": kernel_error(rig)}
    table = brdf_table(values, sampling_of(rig.cell_value), **attrs)
    return table.assign_coords(pixels=(("theta_h", "theta_d", "phi_d"), pixels))


def true_table(material: Material, sampling: Sampling = "centre") -> xr.DataArray:
    """The table of a material itself, at each cell's centre or edge: what any camera measures of a flat sample."""
    return measure(material, Rig(merl().camera, Flat(), cell_value=sampling))


def measured_values(material: Material, rig: Rig) -> tuple[jax.Array, np.ndarray]:
    """(values, pixels) of `measure` as arrays, (90, 90, 180, channels) and (90, 90, 180): differentiable in the numbers
    of the material and the camera."""
    sphere = _checked_sample(material, rig)
    if not isinstance(sphere, Sphere):
        return _of_flat(material, rig), np.zeros(GRID_SHAPE)
    blur = blur_of(rig)
    cells, plan = tabulation(sphere, blur, rig.cell_value, rig.crop)
    return folded(record(material, sphere, blur, plan), cells), cells.pixels


def _of_flat(material: Material, rig: Rig) -> jax.Array:
    """A flat sample, tilted so that each cell is seen, both ways: no blur of even light changes it. Centre and edge only."""
    if rig.cell_value == "mean":
        raise ArgumentError("a flat sample's pixels all show one cell: cell_value must be 'centre' or 'edge'")
    sampling = sampling_of(rig.cell_value)
    theta_h, theta_d, phi_d = np.meshgrid(*merl_grid(sampling), indexing="ij")
    values = (material.brdf(theta_h, theta_d, phi_d) + material.brdf(theta_h, theta_d, phi_d + np.pi)) / 2
    values = values if values.ndim == 4 else values[..., None]
    return jnp.where(below_horizon(sampling)[..., None], jnp.nan, values)


def _checked_sample(material: Material, rig: Rig) -> Sphere | Flat:
    if not isinstance(material, Material):
        raise ArgumentError(
            f"material must be a Material such as Microfacet(GGX(0.1), 0.9), got {type(material).__name__}"
        )
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere | Flat):
        raise ArgumentError(
            f"a table needs normals all round the half vector: a Sphere or Flat sample, not a {type(rig.sample).__name__}"
        )
    return rig.sample
