"""Table of the reconstructed material, with the standard deviation and support of every entry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS, CORRECTED, brdf_table, cosines, merl_grid
from matcam.core.jax import jax
from matcam.files.capture_settings import Stated
from matcam.inverse.correction.corrected_table import SUPPORTED
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.diffuse_shape import departure, terms
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit

_BEYOND = np.radians(2.0)
"""Largest distance of theta_d from the range of the images at which an entry may be supported, rad."""
_ATTRIBUTES: dict[str, dict[str, str | int]] = {
    "brdf": {"units": "1/sr", "long_name": "BRDF reconstructed from photographs", CORRECTED: 1},
    "brdf_std": {"units": "1/sr", "long_name": "standard deviation of brdf from all sources of the error budget"},
    "supported": {
        "units": "1",
        "long_name": "within the range of theta_d of the images, and standard deviation below 5 %",
    },
}


def material_table(fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Stated]) -> xr.Dataset:
    """Tabulate the material of a joint fit.

    Args:
        fit: lobe, strengths and diffuse parts.
        curves: F of each channel, in the unit of the fit.
        units: unit of each channel, which is the image value per radiance under unit irradiance, with its relative
            standard deviation. F is the strength divided by the unit. If the standard deviation is NaN, F is relative.

    Returns:
        Dataset with `brdf` and `brdf_std`, 1/sr, and the mask `supported`, over the MERL grid. For a grey capture, the
        three channels are equal.
    """
    grid = merl_grid("centre")
    half = len(grid.phi_d) // 2  # isotropic and reciprocal: phi_d and pi - phi_d are equivalent
    angles = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d[:half]
    value, std = (_mirrored(one) for one in table_entries(fit, curves, units, *angles))
    if len(curves) == 1:
        value, std = (np.repeat(one, len(CHANNELS), axis=-1) for one in (value, std))
    return with_support(fit, brdf_table(value, "centre"), value, std, grid.theta_d)


def _mirrored(half: np.ndarray) -> np.ndarray:
    return np.concatenate([half, half[..., ::-1, :]], axis=-2)


def with_support(
    fit: SphereFit, table: xr.DataArray, value: np.ndarray, std: np.ndarray, theta_d: np.ndarray
) -> xr.Dataset:
    """Combine the entries of a table, their standard deviations, and a mask of the supported entries.

    Args:
        fit: fit whose images determine the supported range of theta_d.
        table: entries, 1/sr, (..., theta_d, phi_d, channel).
        value: entries with full precision, 1/sr, same shape.
        std: standard deviations of the entries, 1/sr, same shape.
        theta_d: difference angles along the third to last axis, rad.
    """
    seen = fit.solution.theta_d
    covered = (theta_d > seen.min() - _BEYOND) & (theta_d < seen.max() + _BEYOND)
    with np.errstate(invalid="ignore"):
        supported = covered[:, None, None] & (std < SUPPORTED * value)
    return xr.Dataset(
        {
            "brdf": (table.dims, table.values, {**table.attrs, **_ATTRIBUTES["brdf"]}),
            "brdf_std": (table.dims, std.astype(table.dtype), _ATTRIBUTES["brdf_std"]),
            "supported": (table.dims, supported, _ATTRIBUTES["supported"]),
        },
        coords=table.coords,
    )


def table_entries(
    fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Stated], *angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the entries of a table and their standard deviations, 1/sr. The channels are on the last axis.

    Args:
        fit: lobe, strengths, diffuse parts and their covariance.
        curves: F of each channel, in the unit of the fit.
        units: unit of each channel, as for `material_table`.
        angles: theta_h, theta_d, phi_d and, if the lobe depends on it, phi_h, rad, in arrays that broadcast. theta_d varies
            along the second to last axis.
    """
    layout, solution, n = fit.layout, fit.solution, fit.layout.lobe
    q, shape, theta_d = solution.p[:n], solution.p[layout.diffuse_shape], angles[1].ravel()
    # entries for strengths and albedos of 1, NaN below the horizon, and their derivatives on the first axis
    pairs = [_lobe_slope(fit.kind, q, unit, *angles) for unit in np.eye(n)]
    lobe, by_q = np.asarray(pairs[0][0]), np.stack([np.asarray(slope) for _, slope in pairs])
    cos_i, cos_o = cosines(*angles[:3])
    white = np.broadcast_to(departure(shape, cos_i, cos_o, angles[1]), lobe.shape) / np.pi
    by_shape = [np.broadcast_to(term, lobe.shape) / np.pi for term in terms(cos_i, cos_o, angles[1])[: shape.size]]

    def of_channel(channel: int, curve: ReflectanceCurve, unit: Stated) -> tuple[np.ndarray, np.ndarray]:
        turn = np.concatenate([np.eye(n, layout.size), curve.gain @ fit.strengths_rows()[channel :: layout.channels]])
        joint = turn @ solution.covariance @ turn.T
        joint[n:, n:] += curve.own
        f, by_c = curve.at(theta_d)[:, None] / unit.value, curve.slopes(theta_d) / unit.value
        albedo = solution.p[layout.diffuse][channel] / unit.value
        value = lobe * f + albedo * white
        # derivatives with respect to lobe and curve, weighted with their joint covariance
        variance = np.einsum("q...,qr,r...->...", by_q, joint[:n, :n], by_q) * f**2
        variance += 2 * lobe * f * np.einsum("q...dp,dq->...dp", by_q, by_c @ joint[n:, :n])
        variance += lobe**2 * np.einsum("dc,ce,de->d", by_c, joint[n:, n:], by_c)[:, None]
        of_diffuse = np.r_[layout.diffuse.start + channel, layout.diffuse_shape, layout.of("lamp")]
        by_nearness = -albedo * fit.light.unit_by_nearness * white
        row = np.stack([white / unit.value, *(albedo * term for term in by_shape), by_nearness])
        joint = solution.covariance[np.ix_(of_diffuse, of_diffuse)]
        variance = np.maximum(variance, 0.0) + np.maximum(np.einsum("q...,qr,r...->...", row, joint, row), 0.0)
        variance += (solution.unexplained**2 + np.nan_to_num(unit.std) ** 2) * value**2
        return np.maximum(value, 0.0), np.sqrt(variance)

    channels = [of_channel(channel, *pair) for channel, pair in enumerate(zip(curves, units, strict=True))]
    value, std = (np.stack(parts, axis=-1) for parts in zip(*channels, strict=True))
    return value, std


@partial(jax.jit, static_argnums=0)
def _lobe_slope(kind: LobeKind, q: jax.Array, direction: jax.Array, *angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.jvp(lambda q: Microfacet(kind.slopes(q), 1.0, masking=kind.masking).brdf(*angles), (q,), (direction,))
