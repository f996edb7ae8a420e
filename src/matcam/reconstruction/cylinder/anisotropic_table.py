"""The reconstructed anisotropic material as a table over half and difference angles and the half vector's azimuth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr

from matcam.core.jax import jax, jnp
from matcam.inverse.correction.correction import SUPPORTED
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.material import shading_at
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import Known

_SHAPE = (45, 24, 30, 12)
"""Cells along theta_h, phi_h, theta_d, phi_d."""
_BEYOND = np.radians(2.0)
"""theta_d beyond the pictures' own range up to which an entry may be supported."""


def anisotropic_table(fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Known]) -> xr.Dataset:
    """Return the table of a joint fit of a lobe with two roughnesses.

    phi_h counts from the material's x axis. A turn by 180 degrees about the normal changes nothing, nor does exchanging light
    and view (phi_d + 180 degrees): half of either azimuth is tabulated.

    Args:
        fit: lobe, strengths and diffuse parts.
        curves: F of each channel, in the fit's own unit.
        units: of each channel, value per radiance under unit irradiance: what a strength is divided by to be F, with relative
            standard deviation; NaN: F is relative.

    Returns:
        Dataset with `brdf` and `brdf_std` (1/sr), `supported`, over (theta_h, phi_h, theta_d, phi_d, channel).
    """
    n_h, n_p, n_d, n_q = _SHAPE
    theta_h, phi_h = ((np.arange(n_h) + 0.5) / n_h) ** 2 * np.pi / 2, (np.arange(n_p) + 0.5) / n_p * np.pi
    theta_d, phi_d = (np.arange(n_d) + 0.5) / n_d * np.pi / 2, (np.arange(n_q) + 0.5) / n_q * np.pi
    layout, solution = fit.layout, fit.solution
    q, n = solution.p[: layout.lobe], layout.lobe
    angles = np.meshgrid(theta_h, phi_h, theta_d, phi_d, indexing="ij", sparse=True)
    pairs = [_lobe_slope(fit.kind, q, unit_vector, *angles) for unit_vector in np.eye(n)]
    lobe, by_q = np.asarray(pairs[0][0]), np.stack([np.asarray(slope) for _, slope in pairs])
    covered = (theta_d > solution.theta_d.min() - _BEYOND) & (theta_d < solution.theta_d.max() + _BEYOND)
    rows = fit.strengths_rows()
    values, stds = [], []
    for channel, curve in enumerate(curves):
        unit, unit_std = units[channel].value, np.nan_to_num(units[channel].std)
        turn = np.concatenate([np.eye(n, layout.size), curve.gain @ rows[channel :: layout.channels]])
        joint = turn @ solution.covariance @ turn.T
        joint[n:, n:] += curve.own
        f, by_c = curve.at(theta_d)[:, None] / unit, curve.slopes(theta_d) / unit
        diffuse = solution.p[layout.diffuse][channel] / unit
        diffuse_var = solution.covariance[layout.diffuse, layout.diffuse][channel, channel] / unit**2
        value = lobe * f + diffuse / np.pi
        # the derivatives by lobe and curve, weighted with their joint covariance
        variance = sum(joint[i, j] * by_q[i] * by_q[j] for i in range(n) for j in range(n)) * f**2
        variance += 2 * lobe * f * sum(by_q[i] * (by_c @ joint[n:, i])[:, None] for i in range(n))
        variance += lobe**2 * np.einsum("dc,ce,de->d", by_c, joint[n:, n:], by_c)[:, None]
        variance = np.maximum(variance, 0.0) + diffuse_var / np.pi**2
        variance += (solution.unexplained**2 + unit_std**2) * value**2
        values.append(np.maximum(value, 0.0))
        stds.append(np.sqrt(variance))
    value, std = np.stack(values, axis=-1), np.stack(stds, axis=-1)
    with np.errstate(invalid="ignore"):
        supported = covered[:, None, None] & (std < SUPPORTED * value)
    dims = ("theta_h", "phi_h", "theta_d", "phi_d", "channel")
    return xr.Dataset(
        {
            "brdf": (
                dims,
                value.astype(np.float32),
                {"units": "1/sr", "long_name": "BRDF reconstructed from photographs"},
            ),
            "brdf_std": (
                dims,
                std.astype(np.float32),
                {"units": "1/sr", "long_name": "standard deviation of brdf: all sources of the error budget"},
            ),
            "supported": (
                dims,
                supported,
                {"long_name": "within the pictures' angles, and standard deviation of brdf under 5 %"},
            ),
        },
        coords={
            name: (name, angle, {"units": "rad"})
            for name, angle in (("theta_h", theta_h), ("phi_h", phi_h), ("theta_d", theta_d), ("phi_d", phi_d))
        }
        | {"channel": list(fit.channels)},
        attrs={"phi_h": "from the material's x axis about the normal", "period": "phi_h and phi_d repeat after pi"},
    )


@partial(jax.jit, static_argnums=0)
def _lobe_slope(kind: LobeKind, q: jax.Array, direction: jax.Array, *angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return a lobe with F = 1, 1/sr, NaN below the horizon, and its derivative along a direction of its coordinates."""
    theta_h, phi_h, theta_d, phi_d = angles

    def lobe(q: jax.Array) -> jax.Array:
        at = shading_at(theta_h, theta_d, phi_d, phi_h)
        above = (at.cos_i > 0) & (at.cos_o > 0)
        foreshortening = jnp.where(above, at.cos_i * at.cos_o, 1.0)
        reflected = Microfacet(kind.slopes(q), 1.0, masking=kind.masking).reflected(at)
        return jnp.where(above, reflected / foreshortening, jnp.nan)

    return jax.jvp(lobe, (q,), (direction,))
