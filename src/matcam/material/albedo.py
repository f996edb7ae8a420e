"""How much light a material sends back in all."""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam import checks
from matcam.material.material import Material
from matcam.shading import local_shading, vector

_NODES, _AZIMUTHS = 720, 64


def albedo(material: Material, theta: ArrayLike) -> np.ndarray:
    """Directional-hemispherical reflectance, the integral of BRDF cos theta_i over the light's directions, for views at theta
    (rad, [0, pi/2), shape (n,)), azimuth 0: shape (n, channels). What is missing counts as 0.

    By the midpoint rule over half vectors, even in sqrt(theta_h), where d omega_i = 4 cos theta_d d omega_h: lobes as narrow
    as 1e-4 rad are resolved.
    """
    angles = np.atleast_1d(np.asarray(checks.viewing_angle("theta", theta)))
    u = ((np.arange(_NODES) + 0.5) / _NODES)[:, None]
    phi = ((np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS * 2 * np.pi)[None, :]
    theta_h = u**2 * np.pi / 2
    half = np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h) + 0 * phi
    solid = np.sin(theta_h) * np.pi * u / _NODES * 2 * np.pi / _AZIMUTHS
    found = []
    for angle in angles:
        view = np.sin(angle), 0.0, np.cos(angle)
        towards = half[0] * view[0] + half[2] * view[2]
        light = vector(*(2 * towards * h - v for h, v in zip(half, view, strict=True)))
        reflected = material.reflected(local_shading(light, vector(*view)))
        values = np.asarray(reflected).reshape(_NODES, _AZIMUTHS, -1)
        weight = np.where(towards > 0, 4 * towards * solid, 0.0) / view[2]
        found.append(np.nansum(values * weight[..., None], axis=(0, 1)))
    return np.stack(found)
