"""Families of lobes that are tried where the user names none, and how: F free in every picture, a Lambertian part."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from matcam.camera.noise import PixelNoise
from matcam.inverse.fit_result import MaterialFit
from matcam.inverse.material_fit import CameraUse, fit
from matcam.material.masking import Masking
from matcam.rigs import Rig

AUTO = "auto"
EVERY = 6
"""Slices of theta_d from one that a lobe is looked for in to the next."""

_CANDIDATES = ("ggx", "epd")


def candidate_fits(
    brdf: xr.DataArray | Sequence[xr.DataArray],
    rig: Rig,
    ndf: str,
    *,
    masking: Masking,
    noise: PixelNoise | None = None,
    camera: CameraUse | None = None,
    every: int = EVERY,
) -> list[MaterialFit]:
    """A fit for each candidate, or for the family `ndf` alone; the rest as in `fit`, with its errors."""
    return [
        fit(brdf, rig, family, fresnel="free", diffuse=True, masking=masking, noise=noise, camera=camera, every=every)
        for family in (_CANDIDATES if ndf == AUTO else (ndf,))
    ]


def likeliest(fits: Sequence[MaterialFit]) -> MaterialFit:
    """The fit whose family makes the data most probable."""
    return max(fits, key=lambda found: found.log_likelihood)
