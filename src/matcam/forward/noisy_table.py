"""Tables with the noise of the pixels that they were read from.

One picture of a sphere, with lamp and camera 2 theta_d apart, is one theta_d slice of a table (docs/model.md 3, 8). It shows
each cell twice: at azimuth pi - phi_d about the half vector, and opposite. A cell's value is the mean of the two, and cells
on one pixel share its noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNEL_WAVELENGTHS, GRID_SHAPE, Sampling, checked_table, merl_grid, sampling_of
from matcam.core.jax import jax
from matcam.core.workspace import default_workspace
from matcam.forward.measurement import measure
from matcam.material.metals import metal
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.material.reflectance import Conductor
from matcam.rigs import Rig, merl
from matcam.sample.curved import Sphere
from matcam.sample.shape import Place

PICTURE_STRIDE = 1 << 13
"""Pixels per picture row in a pixel's number; a picture is never that wide."""

CHROMIUM_WIDTH = 0.002
"""Width of the lobe of `simulated_chromium`, rad: half a pixel on the MERL rig's sphere."""


def with_pixel_noise(table: xr.DataArray, rig: Rig, noise: PixelNoise, seed: int) -> xr.DataArray:
    """Add to a table the noise of the pixels behind its cells.

    Each theta_d slice is one picture. Cells that share a pixel share its noise. Negative results stay negative: clipping
    would bias faint cells.

    Args:
        table: BRDF on the MERL grid, (90, 90, 180, channels), 1/sr.
        rig: rig that recorded it; its sample must be a `Sphere`.
        noise: standard deviation of a pixel, relative to its value and to its picture's brightest (no unit).
        seed: seed of the random numbers, a whole number; the same seed gives the same noise.

    Returns:
        The noisy table, with the coordinates and attributes of the given one.

    Raises:
        ArgumentError: the sample is no sphere, the noise is out of its range, or the table is not on the MERL grid.

    Source:
        docs/model.md 8: noise belongs to pixels, not to cells.

    Example:
        >>> material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> table = matcam.measure(material, matcam.Rig(matcam.rigs.merl().camera, matcam.Flat()))
        >>> noisy = matcam.forward.with_pixel_noise(table, matcam.rigs.merl(), matcam.camera.PixelNoise(0.01, 0.0), seed=1)
        >>> bool(abs(noisy / table - 1).mean() < 0.01)
        True
    """
    noise.check()
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"a noisy table needs a rig with a Sphere, this one has a {type(rig.sample).__name__}")
    rng = np.random.default_rng(seed)
    pixels = cell_pixels(rig.sample, sampling_of(checked_table(table)))
    values = table.values.copy()
    for j in range(GRID_SHAPE[1]):
        numbers, place = np.unique(np.stack([pixels.first[j], pixels.second[j]]), return_inverse=True)
        place = place.reshape(2, *pixels.first[j].shape)
        draws = rng.standard_normal((2, numbers.size, values.shape[3]))[:, place].mean(axis=1)
        picture = values[:, j]
        brightest = np.nanmax(picture, axis=(0, 1), initial=0.0)
        values[:, j] = picture * (1 + noise.relative * draws[0]) + noise.floor * brightest * draws[1]
    return table.copy(data=values)


class CellPixels(NamedTuple):
    """Numbers of the pixels that show each cell, arrays of shape (theta_d, theta_h, phi_d).

    A number is unique within its slice. The sphere's axis lies on a pixel's centre.

    Attributes:
        first: pixel at azimuth pi - phi_d about the half vector.
        second: pixel opposite.
    """

    first: np.ndarray
    second: np.ndarray


def cell_pixels(sphere: Sphere, sampling: Sampling) -> CellPixels:
    """Number the pixels of a sphere's pictures behind the cells."""
    grid = merl_grid(sampling)
    theta_h, theta_d, phi_d = grid.theta_h[:, None], grid.theta_d[:, None, None], grid.phi_d
    place = jax.jit(lambda sphere, *angles: sphere.place(*angles))
    return CellPixels(*(_pixel_number(place(sphere, theta_h, theta_d, phi_d + turn)) for turn in (0, np.pi)))


def _pixel_number(place: Place) -> np.ndarray:
    x, y = (np.rint(np.asarray(a)).astype(np.int64) for a in (place.x, place.y))
    return x * PICTURE_STRIDE + y


def simulated_chromium(seed: int = 1) -> xr.DataArray:
    """Simulate what the MERL rig would have recorded of an ideal chromium sphere.

    The lobe is Gaussian, 0.002 rad wide; n and k are those of Rakic et al. (1998). Noise is 1 % per pixel, without a floor: a
    MERL file cannot hold values below 0. The true answer is known, so this tests eyes and installation. It does not test the
    method, for which tests/oracle is made.
    """
    return default_workspace().remember("simulated chromium", seed, lambda: _noisy_chromium(seed), most=1).copy()


def _noisy_chromium(seed: int) -> xr.DataArray:
    n, k, _ = metal("Cr", CHANNEL_WAVELENGTHS, "rakic")
    # without masking: for so smooth a surface it is 1 to within 1e-6 up to 89 degrees
    chromium = Microfacet(GaussianNDF(CHROMIUM_WIDTH), Conductor(n, k), masking=None)
    table = with_pixel_noise(measure(chromium, merl()), merl(), PixelNoise(0.01, 0.0), seed)
    return table.assign_attrs(source="simulated chromium")
