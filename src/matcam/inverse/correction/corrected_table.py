"""Corrected table: values, standard deviations and supported entries, from the ratio of true to recorded lobe."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.grid import CORRECTED, Sampling, merl_grid, sampling_of
from matcam.core.results.labelled import named
from matcam.inverse.correction.correction_limits import PEAK, ROWS, EnergyLimit, LobeRatio, above_noise, energy_limit
from matcam.inverse.correction.farthest_glare import FarthestGlare
from matcam.inverse.fit.body import Base, DiffusePart
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
    "response": {"units": "1", "long_name": "recorded / true lobe"},
}
"""Attributes of the variables of a corrected table."""
OPERATOR_ACCURACY = 1e-6
"""Error of the modelled record of a lobe, as a share of the largest value of the slice (docs/correct.md, Claims). Fainter parts
of a recorded lobe are unknown, even without noise.
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
    angles = _angles(sampling)
    peak = np.nanmax(np.where(np.isfinite(data), data, 0), axis=(0, 2))
    ratio_of_lobes = above_noise(ratio_of_lobes, _noise_floor(found, noise, peak, sampling))
    seen = ratio_of_lobes.seen
    ratio = np.where(seen, np.exp(ratio_of_lobes.log), 1.0)
    corrected, camera_std = np.empty_like(data), np.empty_like(data)
    parts: list[VariancePart] = []
    for rows in ROWS:
        body, body_std = found.body(angles[0][rows], *angles[1:])
        above, factor = data[rows] - body, ratio[rows]
        corrected[rows] = body + above * factor
        variance = (above * factor * ratio_of_lobes.std[rows]) ** 2
        # the body is fitted to all slices together, whose images have independent gains
        body_variance = body_std**2 + (noise.picture_gain * body) ** 2 / found.theta_d.size
        added = (
            VariancePart("glare", "B", (scattered.of(rows) ** 2 + (glare * data[rows]) ** 2) * factor**2),
            VariancePart("body under the lobe", "A", body_variance * (factor - 1) ** 2, degrees=max(found.freedom, 1)),
        )
        for part in added:
            variance += part.variance
        if not parts:
            scale = ((above * factor)[PEAK]) ** 2
            parts = [one._replace(variance=one.variance * scale) for one in ratio_of_lobes.parts]
            parts += [part._replace(variance=np.broadcast_to(part.variance, above.shape)[PEAK]) for part in added]
        camera_std[rows] = np.where(seen[rows], np.sqrt(variance), np.nan)
    limit = energy_limit(data, corrected, camera_std, sampling)

    total, correction_std, noise_std = (np.empty_like(data) for _ in range(3))
    supported = np.empty(data.shape, dtype=bool)
    for rows in ROWS:
        recorded, known = data[rows], seen[rows] & np.isfinite(data[rows])
        camera, factor = camera_std[rows], ratio[rows]
        if limit.acts:
            wanted = corrected[rows].copy()
            corrected[rows] = limit.of(rows, recorded, wanted, np.nan_to_num(camera))
            camera = np.hypot(camera, wanted - corrected[rows])
            if rows.start == 0:
                parts.append(VariancePart("energy limit", "B", (wanted - corrected[rows])[PEAK] ** 2))
        corrected[rows] = np.maximum(corrected[rows], 0.0)
        pixels = noise_share[rows, ..., None] * (
            (noise.relative * recorded) ** 2 + (noise.floor * peak[None, :, None, :]) ** 2
        )
        gains = (noise.picture_gain * recorded) ** 2 * factor**2
        if rows.start == 0:
            kind: Any = "B" if found.noise_given else "A"
            parts.append(VariancePart("noise of the pixels of the entry", kind, (pixels * factor**2)[PEAK]))
            parts.append(VariancePart(GAIN, kind, gains[PEAK]))
        pixels = pixels * factor**2 + gains
        camera, noise_std[rows] = (np.where(known, std, np.nan) for std in (camera, np.sqrt(pixels)))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            supported[rows] = known & (camera < SUPPORTED * corrected[rows])
            correction_std[rows] = np.where(recorded > 0, camera / recorded, np.nan)
        total[rows] = np.hypot(camera, noise_std[rows])
    attrs = {"diffuse": list(found.diffuse_part.albedo), "coated_share": found.diffuse_part.coated}
    if found.base is not None:
        attrs |= {"base": list(found.base.reflectance), "base_alpha": found.base.roughness}
    response = np.exp(-ratio_of_lobes.log)
    if response.shape[-1] == 1:  # all channels have one lens
        response = response[..., 0]
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
                )
            },
            "response": (brdf.dims[: response.ndim], response, TABLE_ATTRIBUTES["response"]),
        },
        coords=brdf.coords,
        attrs=attrs,
    )
    return named(table), limit, tuple(parts)


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

    The result differs from the recorded values for entries that the energy limit reduced, and for negative entries that were
    set to 0.

    Args:
        table: Dataset that `correct` returned.

    Returns:
        The recorded table, 1/sr; NaN for missing entries.
    """
    angles, attrs = _angles(sampling_of(table["brdf"])), table.attrs
    diffuse = DiffusePart(tuple(np.atleast_1d(attrs.get("diffuse", 0.0))), float(attrs.get("coated_share", 0.0)))
    body = diffuse.brdf(*angles)
    if "base" in attrs:
        body = body + Base(attrs["base_alpha"], tuple(np.atleast_1d(attrs["base"]))).brdf(*angles)
    changed = np.isfinite(table["brdf_std"].values)
    response = np.where(changed, responses(table), 1.0)
    return table["brdf"].copy(data=body + (table["brdf"].values - body) * response)


def responses(table: xr.Dataset) -> np.ndarray:
    """Select the ratio of recorded to true lobe of a corrected table, (90, 90, 180, colours).

    There is one colour if the lens is achromatic.
    """
    values = table["response"].values
    return values if values.ndim == table["brdf"].ndim else values[..., None]


def supported_values(table: xr.Dataset, recorded: xr.DataArray) -> xr.DataArray:
    """Replace unsupported values by recorded values.

    A format such as MERL has no flag for unsupported values.

    Beside a highlight, a corrected value is often far below the recorded value, which consists of blurred light of the
    highlight. The standard deviation of the correction may then exceed 5 % of the corrected value, although it is below 5 % of
    the recorded value. Such a corrected value is kept, because the corrected peak already contains the blurred light.
    Negative values, which are noise about 0, become 0, because a MERL file uses them for missing values.

    Args:
        table: Dataset that `correct` returned.
        recorded: table before the correction, 1/sr.

    Returns:
        Table with the same dimensions, 1/sr.

    Example:
        >>> matcam.write_merl("out.binary", supported_values(corrected, table))  # doctest: +SKIP
    """
    lowered = (responses(table) > 1) & (table["correction_std"].values < SUPPORTED)
    kept = table["supported"].values | lowered
    return table["brdf"].copy(data=np.maximum(np.where(kept, table["brdf"].values, recorded.values), 0))
