"""The reconstructed material as a table, with the standard deviation of every entry and what is supported."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr

from matcam.core.grid import CHANNELS, brdf_table, merl_grid
from matcam.core.jax import jax, jnp
from matcam.inverse.correction.correction import SUPPORTED
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.material import shading_at
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import Known

_BEYOND = np.radians(2.0)
"""theta_d beyond the pictures' own range up to which an entry may be supported."""
_ATTRIBUTES = {
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
    lobe, by_q = _lobe_and_slopes(fit.kind, q, grid.theta_h, grid.theta_d, grid.phi_d[:half])
    covered = (grid.theta_d > solution.theta_d.min() - _BEYOND) & (grid.theta_d < solution.theta_d.max() + _BEYOND)
    rows = fit.strengths_rows()
    values, stds = [], []
    for channel, curve in enumerate(curves):
        reading = rows[channel :: layout.channels]
        unit, unit_std = units[channel].value, np.nan_to_num(units[channel].std)
        turn = np.concatenate([np.eye(layout.lobe, layout.size), curve.gain @ reading])
        joint = turn @ solution.covariance @ turn.T
        joint[layout.lobe :, layout.lobe :] += curve.own
        f, by_c = curve.at(grid.theta_d) / unit, curve.slopes(grid.theta_d) / unit
        diffuse = solution.p[layout.diffuse][channel] / unit
        diffuse_var = solution.covariance[layout.diffuse, layout.diffuse][channel, channel] / unit**2
        value = lobe * f[:, None] + diffuse / np.pi
        n = layout.lobe
        variance = np.einsum("qhdp,qr,rhdp->hdp", by_q, joint[:n, :n], by_q) * f[:, None] ** 2
        variance += 2 * lobe * f[:, None] * np.einsum("qhdp,dq->hdp", by_q, by_c @ joint[n:, :n])
        variance += lobe**2 * np.einsum("dc,ce,de->d", by_c, joint[n:, n:], by_c)[:, None]
        variance = np.maximum(variance, 0.0) + diffuse_var / np.pi**2
        variance += (solution.unexplained**2 + unit_std**2) * value**2
        values.append(np.maximum(value, 0.0))
        stds.append(np.sqrt(variance))
    value, std = (np.stack([_mirrored(one) for one in many], axis=-1) for many in (values, stds))
    if len(curves) == 1:
        value, std = (np.repeat(one, len(CHANNELS), axis=-1) for one in (value, std))
    with np.errstate(invalid="ignore"):
        supported = covered[None, :, None, None] & (std < SUPPORTED * value)
    table = brdf_table(value, "centre")
    return xr.Dataset(
        {
            "brdf": (table.dims, table.values, {**table.attrs, **_ATTRIBUTES["brdf"]}),
            "brdf_std": (table.dims, std, _ATTRIBUTES["brdf_std"]),
            "supported": (table.dims, supported, _ATTRIBUTES["supported"]),
        },
        coords=table.coords,
    )


def _mirrored(half: np.ndarray) -> np.ndarray:
    return np.concatenate([half, half[..., ::-1]], axis=-1)


def _lobe_and_slopes(
    kind: LobeKind, q: np.ndarray, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a lobe with F = 1 over a grid of angles, 1/sr, NaN below the horizon, and its derivatives by each coordinate."""
    pairs = [_lobe_slope(kind, q, unit, theta_h, theta_d, phi_d) for unit in np.eye(len(q))]
    return np.asarray(pairs[0][0]), np.stack([np.asarray(slope) for _, slope in pairs])


def _lobe(kind: LobeKind, q: jax.Array, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> jax.Array:
    at = shading_at(theta_h[:, None, None], theta_d[None, :, None], phi_d)
    above = (at.cos_i > 0) & (at.cos_o > 0)
    foreshortening = jnp.where(above, at.cos_i * at.cos_o, 1.0)
    reflected = Microfacet(kind.ndf(q), 1.0, masking=kind.masking).reflected(at)
    return jnp.where(above, reflected / foreshortening, jnp.nan)


@partial(jax.jit, static_argnums=0)
def _lobe_slope(
    kind: LobeKind, q: jax.Array, direction: jax.Array, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array
) -> tuple[jax.Array, jax.Array]:
    return jax.jvp(lambda q: _lobe(kind, q, theta_h, theta_d, phi_d), (q,), (direction,))
