"""BRDF of the body under a fitted lobe: diffuse part and rough base.

The diffuse part is Lambertian, or lies under a dielectric coat, such as the body of a plastic. Light that enters and leaves
through the coat has a BRDF proportional to (1 - F(theta_i)) (1 - F(theta_o)) (Shirley et al. 1997; Burley 2012, 5.3). Here
F is the Fresnel term of the coat, and theta_i and theta_o are the angles of incidence and view to the normal. Real bodies
lie between the two, because the coat also reflects light back into the body. A fit therefore determines the share of the
diffuse part that is coated. If the data do not determine it, its prior contributes to the uncertainty.

A rough base under a smooth coat describes flakes under a clear coat, a lacquer or a varnish. The fitted lobe is that of the
coat. Light that crosses the coat, is reflected by a base of reflectance R, and crosses the coat again has the BRDF (Weidlich &
Wilkie 2007, section 3)

    R D G / (4 cos_i cos_o) (1 - F(theta_i)) (1 - F(theta_o)) .

D and G are those of a GGX surface with the roughness of the base, and F is that of a coat of refractive index 1.5.
Refraction is neglected, so the roughness of the base is its apparent roughness from outside the coat. A fit computes the
record of D G by the operator of its camera. The transmittances 1 - F are smooth, so their values at each cell are used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.arrays import xp
from matcam.core.grid import cosines
from matcam.core.jax import AnyArray, jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.ggx import GGX
from matcam.material.reflectance import reflectance_at_cosine

NARROWEST_PX = 8.0
"""Smallest product of the roughness of a base and the radius of the sphere, px. At this value a lens with a blur of 0.5 px
changes the peak of the base by at most 1 % up to 45 degrees.
"""
_INDEX = 1.5
"""Assumed refractive index of a coat. Varnishes and clear coats have 1.45 to 1.55; within this range the product of the
transmittances into and out of the coat changes by 2 % at 60 degrees.
"""


class DiffusePart(NamedTuple):
    """Diffuse part of a body.

    Attributes:
        albedo: albedo of each channel, pi times the BRDF at normal incidence and view (no unit).
        coated: share of the diffuse part that is under a coat (no unit). Default: 0, a Lambertian part.
    """

    albedo: tuple[float, ...]
    coated: float = 0.0

    def brdf(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        """Evaluate the BRDF, 1/sr, (..., channels). The angles, rad, broadcast to (...)."""
        value, _ = diffuse_and_slope(self.coated, loss_in_coat(theta_h, theta_d, phi_d))
        return value[..., None] * self.albedo


class Base(NamedTuple):
    """Rough base under a coat.

    Attributes:
        roughness: roughness alpha of the GGX lobe of the base (no unit).
        reflectance: reflectance of the base in each channel (no unit).
    """

    roughness: float
    reflectance: tuple[float, ...]

    def brdf(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        """Evaluate the BRDF, 1/sr, (..., channels). The angles, rad, broadcast to (...)."""
        value, _ = base_and_slope(np.log(self.roughness), *np.broadcast_arrays(theta_h, theta_d, phi_d))
        return value[..., None] * self.reflectance


@kept_program
def _with_slope(
    log_roughness: jax.Array, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array
) -> tuple[jax.Array, jax.Array]:
    passed = transmittance(theta_h, theta_d, phi_d)

    def value(log: jax.Array) -> jax.Array:
        above_horizon = jnp.nan_to_num(Microfacet(GGX(jnp.exp(log)), 1.0).brdf(theta_h, theta_d, phi_d))
        return above_horizon * passed

    return jax.jvp(value, (log_roughness,), (jnp.ones_like(log_roughness),))


def base_and_slope(
    log_roughness: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the BRDF of a base and its derivative.

    The base has a reflectance of 1. The derivative is with respect to ln roughness. Both results have the unit 1/sr, and
    the broadcast shape of the angles, rad. They are 0 below the horizon.
    """
    value, slope = _with_slope(*(placed(np.asarray(a, dtype=float)) for a in (log_roughness, theta_h, theta_d, phi_d)))
    return np.asarray(value), np.asarray(slope)


def transmittance(theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray) -> AnyArray:
    """Compute the product of the transmittances into and out of the coat.

    The product has the broadcast shape of the angles, rad.
    """
    into, out = (
        1 - reflectance_at_cosine(xp.maximum(cosine, 0.0), _INDEX, 0.0) for cosine in cosines(theta_h, theta_d, phi_d)
    )
    return into * out


def loss_in_coat(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
    """Compute the share of diffuse light that a coat removes, relative to normal incidence and view.

    The share has the broadcast shape of the angles, rad.
    """
    zero = np.zeros(1)
    return np.asarray(1 - transmittance(theta_h, theta_d, phi_d) / transmittance(zero, zero, zero))


def diffuse_and_slope(coated: float, lost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the BRDF of a diffuse part of albedo 1, and its derivative with respect to the coated share, 1/sr.

    Args:
        coated: coated share (no unit).
        lost: result of `loss_in_coat`.
    """
    return (1 - coated * lost) / np.pi, -lost / np.pi
