"""A whole table as a perfect camera would have measured it, with what is known of every entry (MODEL 8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import FitError
from matcam.core.grid import checked_table, merl_grid, sampling_of
from matcam.inverse.correction.doubts import Doubt, doubts
from matcam.inverse.correction.lobe_ratio import LobeRatio, lobe_ratio, seen_cells
from matcam.inverse.correction.shape_correction import (
    BENT,
    ShapeCorrection,
    remark_on_shape,
    shape_correction,
    unshaped,
)
from matcam.inverse.fit.candidates import AUTO, EVERY, bent, candidate_fits, likeliest
from matcam.inverse.fit.fit_result import MaterialFit
from matcam.inverse.operator.lobe_operator import check_rig, radius_of
from matcam.material.masking import MASKINGS, Masking
from matcam.material.registry import FAMILIES
from matcam.rigs import Rig

SUPPORTED = 0.05
"""Relative standard deviation up to which an entry is supported."""

_NEAREST_GLARE = 8.0
"""px; a halo closer to the highlight than this is the lens's core, and told by its profile."""


class Correction(NamedTuple):
    """`table`: Dataset of `correct`. fit: of the lobe through the camera. doubts: the same with a number of the rig free.
    shape: what was changed of the family's lobe. remarks: what a reader should know, in plain words."""

    table: xr.Dataset
    fit: MaterialFit
    doubts: tuple[Doubt, ...]
    shape: ShapeCorrection
    remarks: tuple[str, ...]


def correct(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    glare: float = 1e-3,
) -> xr.Dataset:
    """The table that a perfect camera would have measured: `correction(...)`'s table alone."""
    return correction(brdf, rig, ndf, masking=masking, noise=noise, glare=glare).table


def correction(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    glare: float = 1e-3,
) -> Correction:
    """Correct a whole table for the camera that recorded it, and say of every entry how well it is known.

    brdf: table as from `read_merl`. rig: a distant camera and lamp and a sphere. ndf: a family, or "auto": the likelier of
    "ggx" and "epd". noise: of a pixel; None: estimated. glare: share of light that the lens may scatter far beyond what its
    profile says; it limits what is supported beside a highlight.

    A lobe is fitted through the camera (F free in every picture, a Lambertian part), then bent as far as the data ask
    (`shape_correction`). Each entry's part above the Lambertian one is multiplied by true over recorded lobe: the ratio
    carries the measurement's own detail. Dataset over the table's dims:
      brdf        1/sr; missing stays missing, negative noise becomes 0; reciprocal as the table is
      brdf_std    standard deviation: pixel noise, fitted numbers, camera's stated uncertainty, shape, what a lens or a
                  lamp left free would change, glare. NaN where the sphere's last pixels show the entry: left as it was
      supported   whether brdf_std is under 5 % of brdf
      response    recorded / true lobe, over the first three dims

    Errors as `fit`'s.
    """
    brdf = checked_table(brdf)
    check_rig(rig)
    checks.choice("ndf", ndf, (AUTO, *FAMILIES))
    checks.choice("masking", masking, MASKINGS)
    checks.within("glare", glare, 0, 0.5)
    best = family = likeliest(candidate_fits(brdf, rig, ndf, masking=masking, noise=noise))
    doubted = doubts(family, brdf, rig, noise, EVERY)
    shape = shape_correction(best, noise)
    if shape.strength > BENT:  # too far for what is linear: the lobe itself is bent
        best = bent(family, brdf, rig, 1.0, noise, 3 * EVERY)
        shape = unshaped(best, shape.strength)
    ratio = lobe_ratio(rig, sampling_of(brdf), best, shape, family, doubted)
    table = _assembled(brdf, rig, best, shape, ratio, glare)
    remarks = _remarks(best, doubted, shape)
    table.attrs.update(
        ndf=best.family, masking=masking or "none", glare=glare, sampling=sampling_of(brdf),
        source=str(brdf.attrs.get("source", "")), remarks="; ".join(remarks),
        camera_uncertainty="stated" if rig.camera.uncertainty else "none stated: taken as exact",
    )  # fmt: skip
    return Correction(table, best, doubted, shape, remarks)


def _assembled(
    brdf: xr.DataArray,
    rig: Rig,
    found: MaterialFit,
    shape: ShapeCorrection,
    ratio_of_lobes: LobeRatio,
    glare: float,
) -> xr.Dataset:
    data = brdf.values
    layout, p = found.problem.layout, found.solved.p
    channels = range(data.shape[3])
    body = np.array([p[layout.unit(u)][-1] for u in channels]) / np.pi
    known = seen_cells(sampling_of(brdf))[..., None]
    ratio = np.where(known, np.exp(ratio_of_lobes.log)[..., None], 1.0)
    above = data - body
    lobe = above > 0
    corrected = np.maximum(np.where(lobe, body + above * ratio, data), 0.0)

    noise = shape.noise
    peak = np.nanmax(np.where(np.isfinite(data), data, 0), axis=(0, 2))[None, :, None, :]
    variance = (noise.relative**2 + noise.picture_gain**2) * data**2 + (noise.floor * peak) ** 2
    variance = variance * np.where(lobe, ratio, 1.0) ** 2
    variance += np.where(lobe, above * ratio * ratio_of_lobes.std[..., None], 0.0) ** 2
    scattered = glare * _farthest_glare(brdf, rig, found)
    variance += (scattered**2 + (glare * data) ** 2) * np.where(lobe, ratio, 1.0) ** 2
    std = np.where(known & np.isfinite(data), np.sqrt(variance), np.nan)
    bent = bool(layout.bends)  # then the shape's own uncertainty says it
    good = bent or found.determined or found.half_width_std < SUPPORTED * found.half_width
    with np.errstate(invalid="ignore"):
        supported = known & (std < SUPPORTED * corrected) & good
    first = brdf.dims[:3]
    return xr.Dataset(
        {
            "brdf": (brdf.dims, corrected, {**brdf.attrs, "units": "1/sr", "long_name": "BRDF freed from the camera"}),
            "brdf_std": (brdf.dims, std, {"units": "1/sr", "long_name": "standard deviation of brdf"}),
            "supported": (brdf.dims, supported, {"long_name": "standard deviation under 5 %"}),
            "response": (first, np.exp(-ratio_of_lobes.log), {"long_name": "recorded / true lobe"}),
        },
        coords=brdf.coords,
    )


def _farthest_glare(brdf: xr.DataArray, rig: Rig, found: MaterialFit) -> np.ndarray:
    """The most that a halo of any radius, holding all of the highlight's light, could add to an entry, 1/sr: a Gaussian of
    std s adds flux exp(-d^2 / 2 s^2) / (2 pi s^2) at distance d, whose maximum over s is flux / (pi e d^2)."""
    grid = merl_grid(sampling_of(brdf))
    strength = found.curves["fresnel"].values
    there = np.isfinite(strength).all(axis=1)
    if not there.any():
        raise FitError("no picture shows a highlight")
    seen = found.problem.theta_d[there]
    f = np.stack([np.interp(grid.theta_d, seen, column[there]) for column in strength.T], axis=-1)
    radius = radius_of(rig)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    x = radius * (np.sin(td) * (np.cos(th) - 1) - np.sin(th) * np.cos(ph) * np.cos(td))
    distance2 = np.maximum(x**2 + (radius * np.sin(th) * np.sin(ph)) ** 2, _NEAREST_GLARE**2)
    # integral of D over normals is about 1: flux = F r^2 / 4
    cos_i = np.maximum(np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph)), 0.05)
    return f[None, :, None, :] * (radius**2 / 4 / (np.pi * np.e * distance2 * cos_i))[..., None]


def _remarks(found: MaterialFit, doubted: tuple[Doubt, ...], shape: ShapeCorrection) -> tuple[str, ...]:
    """What a reader should know of a correction, in plain words."""
    said = list(found.remarks)
    if shape.strength > BENT:
        said.append(remark_on_shape(shape, found.family))
    return (*said, *(doubt.remark for doubt in doubted if doubt.contradicts))
