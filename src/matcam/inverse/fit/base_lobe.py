"""Rough base under a smooth coat: the second surface of a clear coat over flakes, a lacquer or a varnish.

The lobe of a fit is that of the coat. Light that crosses the coat, is reflected by a base of reflectance R, and crosses the
coat again has the BRDF (Weidlich & Wilkie 2007, section 3)

    R D G / (4 cos_i cos_o) (1 - F(theta_i)) (1 - F(theta_o)) ,

with a GGX of its own roughness and F of a coat of index 1.5. Refraction is neglected, so the roughness is that seen from
outside. The base is so broad that a camera records it as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.grid import azimuth_difference, cosines
from matcam.core.jax import AnyArray, jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.material.masking import g2
from matcam.material.ndf.ggx import GGX
from matcam.material.reflectance import Dielectric

NARROWEST_PX = 8.0
"""Smallest roughness of a base, times the radius of the sphere, px: a lens of half a pixel then changes its peak by at most 1 %
up to 45 degrees.
"""
_INDEX = 1.5
"""Refractive index of varnishes and clear coats, 1.45 to 1.55: the transmittance in and out changes by 2 % at 60 degrees."""
_ALONG = 1 - 1e-12
"""Largest cosine, at which the derivative of the angle is finite."""
STEEPEST = 1e-3
"""Cosine below which directions count as this close to the horizon, so that a BRDF stays finite."""


class Base(NamedTuple):
    """Rough base under a coat.

    Attributes:
        roughness: roughness alpha of its GGX lobe, a slope.
        reflectance: reflectance of each channel.
    """

    roughness: float
    reflectance: tuple[float, ...]

    def brdf(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        """Evaluate the BRDF, 1/sr, in the shape of the angles, rad, and (channels,)."""
        value, _ = base_and_slope(np.log(self.roughness), *np.broadcast_arrays(theta_h, theta_d, phi_d))
        return value[..., None] * self.reflectance


@kept_program
def _with_slope(
    log_roughness: jax.Array, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array
) -> tuple[jax.Array, jax.Array]:
    def value(log: jax.Array) -> jax.Array:
        return _base_lobe(jnp.exp(log), theta_h, theta_d, phi_d)

    return jax.jvp(value, (log_roughness,), (jnp.ones_like(log_roughness),))


def base_and_slope(
    log_roughness: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the BRDF of a base of reflectance 1, 1/sr, and its derivative with respect to ln roughness."""
    value, slope = _with_slope(*(placed(np.asarray(a, dtype=float)) for a in (log_roughness, theta_h, theta_d, phi_d)))
    return np.asarray(value), np.asarray(slope)


def _base_lobe(roughness: AnyArray, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray) -> jax.Array:
    cos_i, cos_o = (jnp.maximum(cos, STEEPEST) for cos in cosines(theta_h, theta_d, phi_d))
    lobe = GGX(roughness)
    facets = lobe.d(theta_h) * g2(
        "smith", lobe.smith_lambda(cos_i), lobe.smith_lambda(cos_o), azimuth_difference(theta_h, theta_d, phi_d)
    )
    coat = Dielectric(_INDEX)
    crossed_i, crossed_o = (1 - coat.at(jnp.arccos(jnp.minimum(cos, _ALONG))) for cos in (cos_i, cos_o))
    return facets / (4 * cos_i * cos_o) * crossed_i * crossed_o
