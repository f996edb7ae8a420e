"""Table of the reconstructed material, with the standard deviation and support of every entry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS, brdf_table, cosines, merl_grid
from matcam.core.jax import jax
from matcam.inverse.correction.corrected_table import CORRECTED, SUPPORTED
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.diffuse_shape import departure, terms
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import Known

_BEYOND = np.radians(2.0)
"""Largest distance of theta_d from the range of the images at which an entry may be supported, rad."""
ATTRIBUTES: dict[str, dict[str, str | int]] = {
    "brdf": {"units": "1/sr", "long_name": "BRDF reconstructed from photographs", CORRECTED: 1},
    "brdf_std": {"units": "1/sr", "long_name": "standard deviation of brdf from all sources of the error budget"},
    "supported": {
        "units": "1",
        "long_name": "within the range of theta_d of the images, and standard deviation below 5 %",
    },
}


def material_table(fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Known]) -> xr.Dataset:
    """Tabulate the material of a joint fit.

    Args:
        fit: lobe, strengths and diffuse parts.
        curves: F of each channel, in the unit of the fit.
        units: unit of each channel: value per radiance under unit irradiance, with its relative standard deviation.
            Strengths divided by the unit are F. If the standard deviation is NaN, F is relative.

    Returns:
        Dataset with `brdf`, `brdf_std` (1/sr) and `supported` over the MERL grid. A grey capture has three equal channels.
    """
    grid = merl_grid("centre")
    half = len(grid.phi_d) // 2  # isotropic and reciprocal: phi_d and pi - phi_d are equivalent
    unit = unit_entries(fit, grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d[:half])
    values, stds = [], []
    for channel, curve in enumerate(curves):
        value, std = channel_entries(fit, curve, channel, units[channel], unit, grid.theta_d)
        values.append(value)
        stds.append(std)
    value, std = (np.stack([_mirrored(one) for one in many], axis=-1) for many in (values, stds))
    if len(curves) == 1:
        value, std = (np.repeat(one, len(CHANNELS), axis=-1) for one in (value, std))
    with np.errstate(invalid="ignore"):
        supported = covered(fit, grid.theta_d)[None, :, None, None] & (std < SUPPORTED * value)
    table = brdf_table(value, "centre")
    return xr.Dataset(
        {
            "brdf": (table.dims, table.values, {**table.attrs, **ATTRIBUTES["brdf"]}),
            "brdf_std": (table.dims, std, ATTRIBUTES["brdf_std"]),
            "supported": (table.dims, supported, ATTRIBUTES["supported"]),
        },
        coords=table.coords,
    )


def _mirrored(half: np.ndarray) -> np.ndarray:
    return np.concatenate([half, half[..., ::-1]], axis=-1)


def covered(fit: SphereFit, theta_d: np.ndarray) -> np.ndarray:
    """Compute the mask of the angles that lie within the range of the images, or up to 2 degrees beyond."""
    seen = fit.solution.theta_d
    return np.asarray((theta_d > seen.min() - _BEYOND) & (theta_d < seen.max() + _BEYOND))


class UnitEntries(NamedTuple):
    """Table entries for strengths and albedos of 1, on the last axes. theta_d is on the second to last axis.

    Attributes:
        lobe: entries of the lobe with F = 1, in 1/sr; NaN below the horizon.
        by_lobe: derivatives of `lobe` with respect to the coordinates of the lobe, on the first axis.
        diffuse: entries of the diffuse part, 1/sr.
        by_shape: derivatives of `diffuse` with respect to the terms that modify Lambert's law, on the first axis.
    """

    lobe: np.ndarray
    by_lobe: np.ndarray
    diffuse: np.ndarray
    by_shape: np.ndarray


def channel_entries(
    fit: SphereFit,
    curve: ReflectanceCurve,
    channel: int,
    unit: Known,
    entries: UnitEntries,
    theta_d: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the entries of one channel and their standard deviations, 1/sr, with the shape of the unit entries.

    Args:
        fit: strengths, diffuse parts and their covariance.
        curve: F of the channel, in the unit of the fit.
        channel: index of the channel.
        unit: value per radiance under unit irradiance, with its relative standard deviation. If the latter is NaN, F is
            relative.
        entries: entries for strengths and albedos of 1.
        theta_d: angles along the second to last axis of the entries, rad.
    """
    layout, solution, n = fit.layout, fit.solution, fit.layout.lobe
    reading = fit.strengths_rows()[channel :: layout.channels]
    turn = np.concatenate([np.eye(n, layout.size), curve.gain @ reading])
    joint = turn @ solution.covariance @ turn.T
    joint[n:, n:] += curve.own
    f, by_c = curve.at(theta_d)[:, None] / unit.value, curve.slopes(theta_d) / unit.value
    albedo = solution.p[layout.diffuse][channel] / unit.value
    lobe, by_q = entries.lobe, entries.by_lobe
    value = lobe * f + albedo * entries.diffuse
    # derivatives with respect to lobe and curve, weighted with their joint covariance
    variance = np.einsum("q...,qr,r...->...", by_q, joint[:n, :n], by_q) * f**2
    variance += 2 * lobe * f * np.einsum("q...dp,dq->...dp", by_q, by_c @ joint[n:, :n])
    variance += lobe**2 * np.einsum("dc,ce,de->d", by_c, joint[n:, n:], by_c)[:, None]
    of_diffuse = [layout.diffuse.start + channel, *range(layout.diffuse_shape.start, layout.diffuse_shape.stop)]
    row = np.concatenate([entries.diffuse[None] / unit.value, albedo * entries.by_shape])
    joint = solution.covariance[np.ix_(of_diffuse, of_diffuse)]
    variance = np.maximum(variance, 0.0) + np.maximum(np.einsum("q...,qr,r...->...", row, joint, row), 0.0)
    variance += (solution.unexplained**2 + np.nan_to_num(unit.std) ** 2) * value**2
    return np.maximum(value, 0.0), np.sqrt(variance)


def unit_entries(fit: SphereFit, *angles: np.ndarray) -> UnitEntries:
    """Compute the entries of a lobe with F = 1 and of a diffuse part of albedo 1, and their derivatives.

    Args:
        fit: lobe and shape of the diffuse part.
        angles: theta_h, theta_d, phi_d and, if the lobe depends on it, phi_h, rad, in arrays that broadcast.
    """
    p, layout = fit.solution.p, fit.layout
    q, shape = p[: layout.lobe], p[layout.diffuse_shape]
    pairs = [_lobe_slope(fit.kind, q, unit, *angles) for unit in np.eye(len(q))]
    lobe = np.asarray(pairs[0][0])
    cos_i, cos_o = cosines(*angles[:3])
    diffuse = np.broadcast_to(departure(shape, cos_i, cos_o, angles[1]), lobe.shape) / np.pi
    by_shape = [np.broadcast_to(term, lobe.shape) / np.pi for term in terms(cos_i, cos_o, angles[1])[: shape.size]]
    return UnitEntries(
        lobe,
        np.stack([np.asarray(slope) for _, slope in pairs]),
        diffuse,
        np.stack(by_shape) if by_shape else np.empty((0, *lobe.shape)),
    )


@partial(jax.jit, static_argnums=0)
def _lobe_slope(kind: LobeKind, q: jax.Array, direction: jax.Array, *angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.jvp(lambda q: Microfacet(kind.slopes(q), 1.0, masking=kind.masking).brdf(*angles), (q,), (direction,))
