"""A measurement that needs no download: what the MERL rig would have recorded of an ideal chromium sphere."""

from __future__ import annotations

from functools import lru_cache

import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import CHANNEL_WAVELENGTHS
from matcam.forward.lobe_table import with_pixel_noise
from matcam.forward.measurement import measure
from matcam.material.metals import metal
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.material.reflectance import Conductor
from matcam.rigs import merl

WIDTH = 0.002
"""Width of the simulated lobe, rad: half a pixel on the MERL rig's sphere."""


def simulated_chromium(seed: int = 1) -> xr.DataArray:
    """BRDF table of chromium (n, k of Rakic et al. 1998) with a Gaussian lobe of 0.002 rad, recorded by the MERL rig
    with 1 % noise per pixel, and no floor: a MERL file cannot hold what is below 0. The true answer is known: a test of eyes
    and installation, not of the method (tests/oracle is that)."""
    return _simulated(seed).copy()


@lru_cache(maxsize=1)
def _simulated(seed: int) -> xr.DataArray:
    n, k, _ = metal("Cr", CHANNEL_WAVELENGTHS, "rakic")
    # without masking: for so smooth a surface it is 1 to within 1e-6 up to 89 degrees
    chromium = Microfacet(GaussianNDF(WIDTH), Conductor(n, k), masking=None)
    table = with_pixel_noise(measure(chromium, merl()), merl(), PixelNoise(0.01, 0.0), seed)
    return table.assign_attrs(source="simulated chromium")
