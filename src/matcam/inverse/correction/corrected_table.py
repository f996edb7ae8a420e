"""Corrected table: values, standard deviations and supported entries, from the ratio of true to recorded lobe."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.ndimage import uniform_filter

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import CORRECTED, GRID_SHAPE, Sampling, merl_grid, sampling_of
from matcam.core.remark import Remark
from matcam.core.results.labelled import named
from matcam.inverse.correction.correction_limits import (
    BEFORE_LIMB,
    PEAK,
    ROWS,
    EnergyLimit,
    LobeRatio,
    above_noise,
    albedo,
    energy_limit,
)
from matcam.inverse.correction.farthest_glare import FarthestGlare
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.normalised_fresnel import GAIN
from matcam.numerics.fit_budget import VariancePart

SUPPORTED = 0.05
"""Largest standard deviation of the correction of a supported entry, relative to the corrected value."""
TABLE_ATTRIBUTES = {
    "brdf": {"units": "1/sr", "long_name": "BRDF corrected for the camera"},
    "brdf_std": {"units": "1/sr", "long_name": "standard deviation of brdf: correction and noise"},
    "correction_std": {
        "units": "1",
        "long_name": "standard deviation of true / recorded value, from the camera",
    },
    "noise_std": {"units": "1/sr", "long_name": "standard deviation of brdf from pixel noise"},
    "supported": {"units": "1", "long_name": "True if the standard deviation of the correction is below 5 % of brdf"},
    "response": {"units": "1", "long_name": "recorded / true BRDF of the fitted material"},
}
"""Attributes of the variables of a corrected table."""
_RISE = 0.01
"""Increase of the albedo above which a remark reports negative noise that was set to 0: the accuracy of good photometry."""
OPERATOR_ACCURACY = 1e-6
"""Error of the modelled record of a lobe, as a share of the largest value of the slice (docs/correct.md, Claims). Fainter parts
of a recorded lobe are unknown, even without noise.
"""
_NEIGHBOURS = (3, 1, 9)
"""Number of entries along theta_h, theta_d and phi_d over which a misfit is averaged. The lobe changes little over 9 degrees
of phi_d and over neighbouring rings. The error of the mean over 27 entries of 3 channels is 16 % of the variance of an entry.
"""
_LEAST_CONTRAST = 1e-3
"""Smallest assumed share of the lobe in the peak of a slice. It keeps the noise floor relative to the lobe finite in slices
that show only the body.
"""


def corrected_table(
    brdf: xr.DataArray,
    found: MaterialFit,
    noise: PixelNoise,
    noise_share: np.ndarray,
    ratio_of_lobes: LobeRatio,
    scattered: FarthestGlare,
    glare: float,
) -> tuple[xr.Dataset, EnergyLimit, tuple[VariancePart, ...]]:
    """Correct a table.

    Args:
        brdf: recorded table, 1/sr.
        found: fit of the table through the camera.
        noise: noise of a pixel.
        noise_share: variance of each entry divided by the variance of a pixel, (90, 90, 180).
        ratio_of_lobes: ratio of true to recorded lobe.
        scattered: largest contribution of glare from the highlight to each entry.
        glare: share of the light that the lens may scatter (no unit).

    Returns:
        Dataset of the corrected table, energy limit, and sources of the variance of the peaks.
    """
    data, sampling = brdf.values, sampling_of(brdf)
    peak = np.fmax.reduce(data, axis=(0, 2), initial=0.0)
    ratio = above_noise(ratio_of_lobes, _noise_floor(found, noise, peak, sampling))
    multiplied = _multiplied(data, _angles(sampling), found, noise, noise_share, peak, ratio, scattered, glare)
    corrected, camera_std, factor, parts = multiplied
    limit = energy_limit(data, corrected, camera_std, sampling)

    total, correction_std, noise_std = (np.empty_like(data) for _ in range(3))
    supported = np.empty(data.shape, dtype=bool)
    for rows in ROWS:
        recorded, known = data[rows], ratio.seen[rows] & np.isfinite(data[rows])
        camera, whole = camera_std[rows], factor[rows]
        if limit.acts:
            wanted = corrected[rows].copy()
            corrected[rows] = limit.of(rows, recorded, wanted, np.nan_to_num(camera))
            camera = np.hypot(camera, wanted - corrected[rows])
            if rows.start == 0:
                parts.append(VariancePart("energy limit", "B", (wanted - corrected[rows])[PEAK] ** 2))
        pixels = _pixel_variance(noise, noise_share[rows], recorded, peak)
        gains = (noise.picture_gain * recorded) ** 2 * whole**2
        if rows.start == 0:
            kind: Any = "B" if found.noise_given else "A"
            parts.append(VariancePart("noise of the pixels of the entry", kind, (pixels * whole**2)[PEAK]))
            parts.append(VariancePart(GAIN, kind, gains[PEAK]))
        pixels = pixels * whole**2 + gains
        camera, noise_std[rows] = (np.where(known, std, np.nan) for std in (camera, np.sqrt(pixels)))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            supported[rows] = known & (camera < SUPPORTED * corrected[rows])
            correction_std[rows] = np.where(recorded > 0, camera / recorded, np.nan)
        total[rows] = np.hypot(camera, noise_std[rows])
    attrs = {"diffuse": list(found.diffuse_part.albedo), "coated_share": found.diffuse_part.coated}
    if found.base is not None:
        attrs |= {"base": list(found.base.reflectance), "base_alpha": found.base.roughness}
    table = xr.Dataset(
        {
            "brdf": (brdf.dims, corrected, {**brdf.attrs, **TABLE_ATTRIBUTES["brdf"], CORRECTED: 1}),
            **{
                name: (brdf.dims, values, TABLE_ATTRIBUTES[name])
                for name, values in (
                    ("brdf_std", total),
                    ("correction_std", correction_std),
                    ("noise_std", noise_std),
                    ("supported", supported),
                    ("response", np.reciprocal(factor, out=factor)),
                )
            },
        },
        coords=brdf.coords,
        attrs=attrs,
    )
    return named(table), limit, tuple(parts)


def _multiplied(
    data: np.ndarray,
    angles: tuple[np.ndarray, np.ndarray, np.ndarray],
    found: MaterialFit,
    noise: PixelNoise,
    noise_share: np.ndarray,
    peak: np.ndarray,
    ratio: LobeRatio,
    scattered: FarthestGlare,
    glare: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[VariancePart]]:
    """Multiply a table by the ratio of true to recorded value of the fitted material.

    A difference between entry and model that noise does not explain belongs to the lobe or to the body, and to light of the
    theta_h of the entry or of others. The difference between these cases is part of the standard deviation.

    `data` are the entries of the table, 1/sr, and `angles` are those of `_angles`. `peak` is the largest value of each slice,
    1/sr, (90, channels). The other parameters are those of `corrected_table`.

    Returns:
        Corrected values, 1/sr, their standard deviation without noise, 1/sr, ratio of true to recorded value, all in the shape
        of `data`, and sources of the variance of the peaks.
    """
    body, body_std = np.empty((2, *data.shape))
    for rows in ROWS:
        body[rows], body_std[rows] = found.body(angles[0][rows], *angles[1:])
    recorded_body = body
    if found.base is not None:
        recorded_body = body + found.base.brdf(*angles) * (ratio.base - 1)
    strength = _strengths(ratio, data, recorded_body)
    excess, count = np.empty((2, *GRID_SHAPE))
    for rows in ROWS:
        model = strength * ratio.recorded[rows] + recorded_body[rows]
        variance = _pixel_variance(noise, noise_share[rows], model, peak)
        used = ratio.seen[rows] & np.isfinite(data[rows]) & (variance > 0)
        relative = ((data[rows] - model) ** 2 - variance) / np.where(used, np.maximum(model**2, variance), 1.0)
        excess[rows], count[rows] = np.where(used, relative, 0.0).sum(axis=-1), used.sum(axis=-1)
    misfit = _mean_of_neighbours(excess, count)  # squared relative difference that noise does not explain
    corrected, camera_std, factor = (np.empty_like(data) for _ in range(3))
    parts: list[VariancePart] = []
    for rows in ROWS:
        recorded, of_lobe = data[rows], np.exp(ratio.log[rows])
        of_body = np.divide(body[rows], recorded_body[rows], out=np.ones_like(recorded), where=recorded_body[rows] > 0)
        lobe = strength * ratio.recorded[rows]
        model = lobe + recorded_body[rows]
        part = np.divide(lobe, model, out=np.ones_like(model), where=model > 0)
        whole = np.where(ratio.seen[rows], part * of_lobe + (1 - part) * of_body, 1.0)
        corrected[rows], factor[rows] = recorded * whole, whole
        variance = (recorded * part * of_lobe * ratio.std[rows]) ** 2
        # the body is fitted to all slices together, whose images have independent gains
        body_variance = body_std[rows] ** 2 + (noise.picture_gain * body[rows]) ** 2 / found.theta_d.size
        glare_variance = (glare * scattered.of(rows)) ** 2 + (glare * recorded) ** 2
        unexplained = part * (1 - part) * (of_lobe - of_body) ** 2 + (part * of_lobe * ratio.mixing[rows]) ** 2
        added = (
            VariancePart("glare", "B", glare_variance * whole**2),
            VariancePart("body under the lobe", "A", body_variance * (whole - 1) ** 2, degrees=max(found.freedom, 1)),
            VariancePart("values that the model does not explain", "B", unexplained * misfit[rows] * model**2),
        )
        for source in added:
            variance += source.variance
        if not parts:
            scale = ((recorded * part * of_lobe)[PEAK]) ** 2
            parts = [one._replace(variance=one.variance * scale) for one in ratio.parts]
            parts += [one._replace(variance=np.broadcast_to(one.variance, recorded.shape)[PEAK]) for one in added]
        camera_std[rows] = np.where(ratio.seen[rows], np.sqrt(variance), np.nan)
    return corrected, camera_std, factor, parts


def _strengths(ratio: LobeRatio, data: np.ndarray, recorded_body: np.ndarray) -> np.ndarray:
    """Fit the strength of the recorded lobe in each slice and channel to the entries above the body, (90, channels).

    Strengths of slices without entries are interpolated.
    """
    power, product = np.zeros((2, GRID_SHAPE[1], data.shape[-1]))
    for rows in ROWS:
        used = ratio.seen[rows] & np.isfinite(data[rows])
        lobe = np.where(used, ratio.recorded[rows], 0.0)
        power += np.einsum("hdpc,hdpc->dc", lobe, lobe)
        product += np.einsum("hdpc,hdpc->dc", lobe, np.where(used, data[rows] - recorded_body[rows], 0.0))
    slices = np.arange(len(power))
    strengths = [
        np.interp(slices, slices[there > 0], np.maximum(one[there > 0] / there[there > 0], 0.0))
        for one, there in zip(product.T, power.T, strict=True)
    ]
    return np.stack(strengths, axis=-1)[:, None]


def _mean_of_neighbours(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Average positive and negative values over neighbouring entries in theta_h and phi_d, and set negative means to 0.

    Args:
        sums: sums of the values of all channels, (90, 90, 180).
        counts: numbers of these values, (90, 90, 180).

    Returns:
        Means, (90, 90, 180, 1).
    """
    mean, count = (uniform_filter(one, _NEIGHBOURS, mode=("nearest", "nearest", "wrap")) for one in (sums, counts))
    some = count > 0.5 / np.prod(_NEIGHBOURS)  # at least one value; the filter rounds
    return np.maximum(np.divide(mean, count, out=np.zeros_like(mean), where=some), 0.0)[..., None]


def _pixel_variance(noise: PixelNoise, share: np.ndarray, value: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Compute the variance of entries due to pixel noise, without the gain of an image, 1/sr^2.

    The parameters are those of `corrected_table`, for some rows. `value` are the entries, 1/sr.
    """
    return share[..., None] * ((noise.relative * value) ** 2 + (noise.floor * peak[None, :, None, :]) ** 2)


def _angles(sampling: Sampling) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute theta_h, theta_d and phi_d of all entries, rad. Their shapes broadcast to (90, 90, 180)."""
    grid = merl_grid(sampling)
    return grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d


def _noise_floor(found: MaterialFit, noise: PixelNoise, peak: np.ndarray, sampling: Sampling) -> np.ndarray:
    """Compute the noise floor of a pixel relative to the peak of the recorded lobe, (90,).

    The result for each slice is the largest value of all channels. It is at least the error of a modelled record.

    peak: largest value of each slice, 1/sr, (90, channels).
    """
    body, _ = found.body(np.zeros(1), merl_grid(sampling).theta_d, np.full(1, np.pi / 2))
    lobe = np.maximum(peak - body, _LEAST_CONTRAST * peak)
    share = np.divide(peak, lobe, out=np.ones_like(peak), where=peak > 0).max(axis=1)
    return max(noise.floor, OPERATOR_ACCURACY) * share


def recorded_table(table: xr.Dataset) -> xr.DataArray:
    """Recover the recorded table from a corrected table.

    The result differs from the recorded values for entries that the energy limit reduced.

    Args:
        table: Dataset that `correct` returned.

    Returns:
        The recorded table, 1/sr; NaN for missing entries.
    """
    return table["brdf"].copy(data=table["brdf"].values * table["response"].values)


def supported_values(table: xr.Dataset, recorded: xr.DataArray) -> xr.DataArray:
    """Replace unsupported values by recorded values.

    A format such as MERL has no flag for unsupported values.

    Beside a highlight, a corrected value is often far below the recorded value, which consists of blurred light of the
    highlight. The standard deviation of the correction may then exceed 5 % of the corrected value, although it is below 5 % of
    the recorded value. Such a corrected value is kept, because the corrected peak already contains the blurred light.
    Negative values, which are noise about 0, become 0, because a MERL file uses them for missing values (`zeroed_noise`).

    Args:
        table: Dataset that `correct` returned.
        recorded: table before the correction, 1/sr.

    Returns:
        Table with the same dimensions, 1/sr.

    Example:
        >>> matcam.write_merl("out.binary", supported_values(corrected, table))  # doctest: +SKIP
    """
    lowered = (table["response"].values > 1) & (table["correction_std"].values < SUPPORTED)
    kept = table["supported"].values | lowered
    return table["brdf"].copy(data=np.maximum(np.where(kept, table["brdf"].values, recorded.values), 0))


def zeroed_noise(recorded: xr.DataArray) -> tuple[Remark, ...]:
    """Report how much the albedo of a table increases if negative noise is set to 0.

    Args:
        recorded: table with noise, 1/sr.
    """
    share = float((recorded.values < 0).mean())
    raised = albedo(np.maximum(-recorded.values, 0.0), sampling_of(recorded))
    rise = float(raised[: int(np.degrees(BEFORE_LIMB))].max())
    if rise < _RISE:
        return ()
    text = f"{share:.0%} of the recorded entries are negative noise. A MERL file cannot contain them, so they are 0 there, "
    text += f"which increases its albedo by up to {rise:.2f}: use the NetCDF file, which keeps them"
    return (Remark("negative-noise", text),)
