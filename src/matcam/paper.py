"""The paper as printed: Holzschuch & Pacanowski, "The Effects of Digital Cameras Optics and Electronics for Material
Acquisition", Workshop on Material Appearance Modeling 2017 (hal-01576742).

Its equation (11), and the data of its Figures 3 to 6 (figures/paper.py draws them).
"""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp


def peak_eq11(
    sigma: ArrayLike, sigma_mtf: ArrayLike, sigma_p: ArrayLike, radius: ArrayLike, theta: ArrayLike
) -> jax.Array:
    """Equations (10) and (11) as printed: erf((sigma_p / radius) / (sqrt2 sigma_m)),
    sigma_m = sqrt(sigma^2 + (sigma_mtf / (radius cos theta))^2). Arguments broadcast.

    sigma: width of the lobe, rad. sigma_mtf: std of the optics, px. sigma_p: half width of a pixel, px. radius: of
    the sphere's picture, px. theta: rad, [0, pi/2).

    For reproducing Figure 5 only: it starts from a lobe of unit area and forgets that a pixel seen as an angle is
    sigma_p / (radius cos theta) wide (MODEL 4). Use `peak_response`.
    """
    sigma = checks.positive("sigma", sigma, "rad")
    sigma_mtf = checks.positive("sigma_mtf", sigma_mtf, "px")
    sigma_p = checks.positive("sigma_p", sigma_p, "px")
    radius = checks.positive("radius", radius, "px")
    theta = checks.viewing_angle("theta", theta)
    sigma_m = jnp.hypot(sigma, sigma_mtf / (radius * jnp.cos(theta)))
    return jax.scipy.special.erf(sigma_p / radius / (jnp.sqrt(2) * sigma_m))
