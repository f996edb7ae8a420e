"""The reconstructed material as a table, with the standard deviation of every entry and what is supported."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS, brdf_table, merl_grid
from matcam.core.jax import jax
from matcam.inverse.correction.correction import SUPPORTED
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import Known

_BEYOND = np.radians(2.0)
"""theta_d beyond the pictures' own range up to which an entry may be supported."""
ATTRIBUTES = {
    "brdf": {"units": "1/sr", "long_name": "BRDF reconstructed from photographs"},
    "brdf_std": {"units": "1/sr", "long_name": "standard deviation of brdf: all sources of the error budget"},
    "supported": {"long_name": "within the pictures' angles, and standard deviation of brdf under 5 %"},
}


def material_table(fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Known]) -> xr.Dataset:
    """Return the table of a joint fit.

    Args:
        fit: lobe, strengths and diffuse parts.
        curves: F of each channel, in the fit's own unit.
        units: of each channel, value per radiance under unit irradiance: what a strength is divided by to be F, with relative
            standard deviation; NaN: F is relative.

    Returns:
        Dataset with `brdf` and `brdf_std` (1/sr), `supported`, over the MERL grid. A grey capture has three equal channels.
    """
    layout, solution = fit.layout, fit.solution
    grid = merl_grid("centre")
    half = len(grid.phi_d) // 2  # isotropic and reciprocal: phi_d and pi - phi_d are the same
    q = solution.p[: layout.lobe]
    theta_h, theta_d = grid.theta_h[:, None, None], grid.theta_d[:, None]
    lobe, by_q = lobe_and_slopes(fit.kind, q, theta_h, theta_d, grid.phi_d[:half])
    values, stds = [], []
    for channel, curve in enumerate(curves):
        value, std = channel_entries(fit, curve, channel, units[channel], lobe, by_q, grid.theta_d)
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
    """Tell which angles lie within those of the pictures, or next to them."""
    seen = fit.solution.theta_d
    return np.asarray((theta_d > seen.min() - _BEYOND) & (theta_d < seen.max() + _BEYOND))


def channel_entries(
    fit: SphereFit,
    curve: ReflectanceCurve,
    channel: int,
    unit: Known,
    lobe: np.ndarray,
    by_q: np.ndarray,
    theta_d: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return one channel's entries and their standard deviations, 1/sr, shape of `lobe`.

    Args:
        fit: strengths, diffuse parts and their covariance.
        curve: F of the channel, in the fit's own unit.
        channel: its index.
        unit: value per radiance under unit irradiance, with relative standard deviation; NaN: F is relative.
        lobe: with F = 1, 1/sr; theta_d along the last axis but one.
        by_q: its derivatives by the lobe's coordinates, in front.
        theta_d: angles along that axis, rad.
    """
    layout, solution, n = fit.layout, fit.solution, fit.layout.lobe
    reading = fit.strengths_rows()[channel :: layout.channels]
    turn = np.concatenate([np.eye(n, layout.size), curve.gain @ reading])
    joint = turn @ solution.covariance @ turn.T
    joint[n:, n:] += curve.own
    f, by_c = curve.at(theta_d)[:, None] / unit.value, curve.slopes(theta_d) / unit.value
    diffuse = solution.p[layout.diffuse][channel] / unit.value
    diffuse_var = solution.covariance[layout.diffuse, layout.diffuse][channel, channel] / unit.value**2
    value = lobe * f + diffuse / np.pi
    # the derivatives by lobe and curve, weighted with their joint covariance
    variance = np.einsum("q...,qr,r...->...", by_q, joint[:n, :n], by_q) * f**2
    variance += 2 * lobe * f * np.einsum("q...dp,dq->...dp", by_q, by_c @ joint[n:, :n])
    variance += lobe**2 * np.einsum("dc,ce,de->d", by_c, joint[n:, n:], by_c)[:, None]
    variance = np.maximum(variance, 0.0) + diffuse_var / np.pi**2
    variance += (solution.unexplained**2 + np.nan_to_num(unit.std) ** 2) * value**2
    return np.maximum(value, 0.0), np.sqrt(variance)


def lobe_and_slopes(kind: LobeKind, q: np.ndarray, *angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a lobe with F = 1, 1/sr, NaN below the horizon, and its derivatives by each coordinate, in front.

    Args:
        kind: of the lobe.
        q: its coordinates.
        angles: theta_h, theta_d, phi_d and, where the lobe depends on it, phi_h, rad, which broadcast.
    """
    pairs = [_lobe_slope(kind, q, unit, *angles) for unit in np.eye(len(q))]
    return np.asarray(pairs[0][0]), np.stack([np.asarray(slope) for _, slope in pairs])


@partial(jax.jit, static_argnums=0)
def _lobe_slope(kind: LobeKind, q: jax.Array, direction: jax.Array, *angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.jvp(lambda q: Microfacet(kind.slopes(q), 1.0, masking=kind.masking).brdf(*angles), (q,), (direction,))
