"""The paper as printed: Holzschuch & Pacanowski, "The Effects of Digital Cameras Optics and Electronics for Material
Acquisition", Workshop on Material Appearance Modeling 2017 (hal-01576742).

Its equation (11), and the data of its Figures 3, 4 and 5 (`figures.paper` draws them; Figure 6 is `fresnel`).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.peaks.peak import peak_response
from matcam.forward.peaks.tangent_plane import lobe_record
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.rigs import Rig, merl

FIGURE_5_RATIOS = (0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 100.0)
"""Widths of the lobe in units of sigma_mtf / radius."""

_FIGURE_3_ANGLES = (0.0, 45.0, 60.0, 75.0)
_POINTS_PER_PX = 31  # odd, so that the peak itself is among them


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


def figure_3_4(ratio: float, rig: Rig | None = None) -> xr.Dataset:
    """Figures 3 (ratio 10) and 4 (ratio 1): a Gaussian highlight of std ratio sigma_mtf / radius, as it arrives on the
    sensor, after the optics, and as the pixels record it, across the plane of camera and lamp at several theta_o.

    Dataset over (theta_o, x): signal, after_optics, recorded (of the pixel that x lies in). x: px from the peak.
    """
    rig = rig or merl()
    sigma, half_width, radius = _gaussian_numbers(rig)
    theta = np.radians(_FIGURE_3_ANGLES)
    ndf = GaussianNDF(ratio * sigma / radius)
    reach = int(np.ceil(3.5 * sigma * np.hypot(ratio, 1) + 0.5))
    within = (np.arange(_POINTS_PER_PX) - _POINTS_PER_PX // 2) / _POINTS_PER_PX
    pixel = np.repeat(np.arange(-reach, reach + 1.0), _POINTS_PER_PX)
    x = pixel + np.tile(within, 2 * reach + 1)
    std = (ratio * sigma * np.cos(theta))[:, None]
    blurred = np.hypot(std, sigma)
    # the figure is one-dimensional: divide out what the direction across takes from every pixel alike
    recorded = lobe_record(rig, ndf, theta, np.tile(pixel, (theta.size, 1)), np.zeros((theta.size, x.size)))
    across = peak_response(rig, ndf, 0.0, dims=1)
    return xr.Dataset(
        {
            "signal": (("theta_o", "x"), np.exp(-((x / std) ** 2) / 2)),
            "after_optics": (("theta_o", "x"), std / blurred * np.exp(-((x / blurred) ** 2) / 2)),
            "recorded": (("theta_o", "x"), np.asarray(recorded / across)),
        },
        coords={"theta_o": ("theta_o", theta, {"units": "rad"}), "x": ("x", x, {"units": "px"})},
        attrs={"ratio": ratio, "sigma_mtf_px": sigma, "half_width_px": half_width, "radius_px": radius},
    )


def figure_5(rig: Rig | None = None) -> xr.Dataset:
    """Figure 5: loss at the peak relative to theta = 0, against theta, for lobes of width ratio sigma_mtf / radius.

    Dataset over (ratio, theta): loss (MODEL 4's a(s)), loss_printed (equation (11)); over theta: cosine.
    """
    rig = rig or merl()
    sigma, half_width, radius = _gaussian_numbers(rig)
    theta = np.radians(np.append(np.arange(0, 90, 0.5), 89.9))
    widths = np.array(FIGURE_5_RATIOS) * sigma / radius
    loss = np.stack([np.asarray(peak_response(rig, GaussianNDF(w), theta)) for w in widths])
    printed = np.asarray(peak_eq11(widths[:, None], sigma, half_width, radius, theta))
    return xr.Dataset(
        {
            "loss": (("ratio", "theta"), loss / loss[:, :1]),
            "loss_printed": (("ratio", "theta"), printed / printed[:, :1]),
            "cosine": ("theta", np.cos(theta)),
        },
        coords={"ratio": list(FIGURE_5_RATIOS), "theta": ("theta", theta, {"units": "rad"})},
        attrs={"sigma_mtf_px": sigma, "half_width_px": half_width, "radius_px": radius},
    )


def _gaussian_numbers(rig: Rig) -> tuple[float, float, float]:
    """(sigma_mtf, sigma_p, radius) of a rig of the paper's kind."""
    sigma = rig.camera.parameters()["optics.sigma_px"]
    return float(sigma), float(rig.camera.pixel.half_width), float(rig.sample.radius)  # type: ignore[attr-defined]
