"""Which pixels stand behind the cells of a table (MODEL 3, 8).

A picture of a sphere with lamp and camera 2 theta_d apart is one theta_d slice of the table, and holds each cell twice:
at azimuth psi = pi - phi_d about the half vector, and opposite. The recorded value is the mean of the two.

The table that a rig records of a single specular lobe, in the tangent plane, with the noise of its pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNELS, GRID_SHAPE, Sampling, below_horizon, brdf_table, merl_grid, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.forward.peaks.lobe import lobe_record, tangent_offsets
from matcam.material.material import seen_at
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import MixtureNDF
from matcam.rigs import Rig
from matcam.sample.shape import Place
from matcam.sample.sphere import Sphere

PICTURE_STRIDE = 1 << 13
"""Pixels per picture row in a pixel's number; a picture is never that wide."""


class CellSet(NamedTuple):
    """Some (theta_h, phi_d) cells, the same in every theta_d slice. Indices have shape (cells,)."""

    i_theta_h: np.ndarray
    i_phi_d: np.ndarray
    share: np.ndarray
    """How many cells of the table each one stands for."""


class CellPixels(NamedTuple):
    """Where a `CellSet` lies in the pictures; arrays of shape (slices, cells)."""

    content: np.ndarray
    """Pixels that the cells stand for, both ways counted: 2 r^2 cos(theta_o) sin(theta_h) dtheta_h dphi_d."""
    first: np.ndarray
    """Number of the pixel that holds the cell one way, unique within its slice (sphere's axis on a pixel centre)."""
    second: np.ndarray
    """The same the other way."""


def cell_pixels(sphere: Sphere, sampling: Sampling, cells: CellSet) -> CellPixels:
    """Pixels behind `cells` in every theta_d slice of a table that the picture of `sphere` fills."""
    grid = merl_grid(sampling)
    radius = float(sphere.radius)
    theta_h = grid.theta_h[cells.i_theta_h]
    phi_d = grid.phi_d[cells.i_phi_d]
    theta_d = grid.theta_d[:, None]
    height = np.diff(theta_h_edges())[cells.i_theta_h]
    # the cell's own size, not sin(theta_h) at its sampling point, which is 0 at the edge of the first
    middle = (theta_h_edges()[:-1] + np.diff(theta_h_edges()) / 2)[cells.i_theta_h]
    solid_angle = np.sin(middle) * height * np.pi / grid.phi_d.size * cells.share
    first, second = (_pixel_number(sphere.place(theta_h, theta_d, phi_d + turn)) for turn in (0, np.pi))
    return CellPixels(
        content=2 * radius**2 * np.cos(theta_d) * solid_angle,
        first=first,
        second=second,
    )


def _pixel_number(place: Place) -> np.ndarray:
    x, y = (np.rint(np.asarray(a)).astype(np.int64) for a in (place.x, place.y))
    return x * PICTURE_STRIDE + y


def lobe_table(material: Microfacet, rig: Rig, sampling: Sampling = "centre") -> xr.DataArray:
    """BRDF table of `material` as `rig` records it around its highlight: F D(0) G / (4 cos_i cos_o) times the record of
    the lobe (MODEL 4), plus the diffuse part; 1/sr, NaN below the horizon.

    Tangent plane: right around the peak, where the camera matters; far from it a broad lobe's record is its own value.
    Each value is one pixel centred on the cell's sampling point.
    """
    _sphere_of(rig)
    ndf = material.ndf
    if not isinstance(ndf, MixtureNDF):
        raise ArgumentError(f"lobe_table needs a mixture of Gaussians such as GGX(0.1), got {type(ndf).__name__}")
    checks.choice("sampling", sampling, ("centre", "edge"))
    grid = merl_grid(sampling)
    theta_h, phi_d = (jnp.asarray(a.ravel()) for a in np.meshgrid(grid.theta_h, grid.phi_d, indexing="ij"))
    peak = ndf.d(0.0)
    flattening = ndf.flattening(theta_h)

    def one_slice(theta_d: jax.Array) -> jax.Array:
        x, y = tangent_offsets(rig, ndf, theta_h, theta_d, phi_d)
        recorded = peak * flattening * lobe_record(rig, ndf, theta_d[None], x[None], y[None])[0]
        specular = material.smooth_part(seen_at(theta_h, theta_d, phi_d))
        per_channel = specular if specular.ndim == 2 else specular[:, None]
        return per_channel * recorded[:, None] + jnp.asarray(material.diffuse) / jnp.pi

    values = np.array(jax.lax.map(jax.jit(one_slice), jnp.asarray(grid.theta_d)))
    values = np.broadcast_to(values, (*values.shape[:2], len(CHANNELS))).reshape(*np.array(GRID_SHAPE)[[1, 0, 2]], -1)
    values = np.ascontiguousarray(values.transpose(1, 0, 2, 3))
    values[below_horizon(sampling)] = np.nan
    return brdf_table(values, sampling)


def with_pixel_noise(table: xr.DataArray, rig: Rig, noise: PixelNoise, seed: int) -> xr.DataArray:
    """Add to a table the noise of the pixels that it was read from; cells that share a pixel share its noise.

    Each theta_d slice is one picture. Negative results stay negative: clipping would bias faint cells.
    """
    noise.checked()
    sphere = _sphere_of(rig)
    rng = np.random.default_rng(seed)
    i_theta_h, i_phi_d = (a.ravel() for a in np.indices((GRID_SHAPE[0], GRID_SHAPE[2])))
    pixels = cell_pixels(sphere, table.attrs["sampling"], CellSet(i_theta_h, i_phi_d, np.ones(i_theta_h.size)))
    values = table.values.copy()
    for j in range(GRID_SHAPE[1]):
        numbers, place = np.unique(np.stack([pixels.first[j], pixels.second[j]]), return_inverse=True)
        draws = rng.standard_normal((2, numbers.size, values.shape[3]))[:, place.reshape(2, -1)].mean(axis=1)
        picture = values[:, j].reshape(i_theta_h.size, -1)
        brightest = np.nanmax(picture, axis=0, initial=0.0)
        noisy = picture * (1 + noise.relative * draws[0]) + noise.floor * brightest * draws[1]
        values[:, j] = noisy.reshape(values[:, j].shape)
    return table.copy(data=values)


def _sphere_of(rig: Rig) -> Sphere:
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"a table is recorded from a Sphere, this rig has a {type(rig.sample).__name__}")
    return rig.sample
