"""Equations and figures of the paper of Holzschuch & Pacanowski (2017).

The paper is "The Effects of Digital Cameras Optics and Electronics for Material Acquisition", Workshop on Material
Appearance Modeling 2017 (hal-01576742).

This module contains equation (11) and the data of Figures 3, 4 and 5, which `figures.paper` draws. `fresnel` computes the
data of Figure 6.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.core.results.labelled import named
from matcam.forward.peaks.peak import peak_response
from matcam.forward.peaks.tangent_plane import lobe_record
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.rigs import Rig, merl

FIGURE_5_RATIOS = (0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 100.0)
"""Widths of the lobe in units of sigma_mtf / radius."""

_FIGURE_3_ANGLES = (0.0, 45.0, 60.0, 75.0)
_POINTS_PER_PX = 31  # odd, so that the peak itself is a sample
_NAMES = {
    "signal": "signal over the true peak, on the sensor without optics",
    "after_optics": "signal over the true peak, after the optics",
    "recorded": "signal over the true peak, as recorded by pixels",
    "loss": "recorded over true peak, relative to theta = 0",
    "loss_printed": "recorded over true peak by equation (11) as printed, relative to theta = 0",
    "cosine": "cosine of theta",
    "ratio": "width of the lobe divided by sigma_mtf / radius",
}
"""Descriptive names of the variables of the figures."""


def peak_eq11(
    sigma: ArrayLike, sigma_mtf: ArrayLike, sigma_p: ArrayLike, radius: ArrayLike, theta: ArrayLike
) -> jax.Array:
    """Evaluate equation (11), the recorded peak divided by the true peak.

    The ratio is erf((sigma_p / radius) / (sqrt2 sigma_m)) with sigma_m = sqrt(sigma^2 + (sigma_mtf / (radius cos theta))^2),
    equation (10). The arguments broadcast.

    Use this equation only to reproduce Figure 5, and `peak_response` otherwise. It uses a lobe of unit area and neglects
    that the angular width of a pixel is sigma_p / (radius cos theta) (docs/model.md 4).

    Args:
        sigma: width of the lobe, rad, positive.
        sigma_mtf: standard deviation of the blur of the optics, px, positive.
        sigma_p: half width of a pixel, px, positive.
        radius: radius of the sphere in the image, px, positive.
        theta: angle between normal and view at the highlight, rad, [0, pi/2).

    Returns:
        Recorded peak divided by true peak, no unit, shape of the broadcast arguments.

    Raises:
        ArgumentError: an argument is out of range.

    Source:
        Holzschuch & Pacanowski (2017), (10) and (11).

    Example:
        >>> round(float(matcam.paper.peak_eq11(0.002, 0.5, 0.5, 256.0, 0.0)), 4)
        0.5152
    """
    sigma = checks.positive("sigma", sigma, "rad")
    sigma_mtf = checks.positive("sigma_mtf", sigma_mtf, "px")
    sigma_p = checks.positive("sigma_p", sigma_p, "px")
    radius = checks.positive("radius", radius, "px")
    theta = checks.viewing_angle("theta", theta)
    sigma_m = jnp.hypot(sigma, sigma_mtf / (radius * jnp.cos(theta)))
    return jax.scipy.special.erf(sigma_p / radius / (jnp.sqrt(2) * sigma_m))


def figure_3_4(ratio: float, rig: Rig | None = None) -> xr.Dataset:
    """Compute Figure 3 (ratio 10) or 4 (ratio 1) of the paper.

    The lobe is a Gaussian with a standard deviation of ratio * sigma_mtf / radius, rad. sigma_mtf is the standard
    deviation of the blur of the optics, and radius is the radius of the sphere in the image, both in px. The highlight
    of the lobe is computed without blur, after the optics, and as recorded by the pixels. The positions are on a line
    in the plane of camera and lamp. theta_o is the angle between normal and view at the highlight, rad.

    Args:
        ratio: width of the lobe divided by sigma_mtf / radius, no unit.
        rig: rig with Gaussian optics and a sphere. Default: None, `rigs.merl()`.

    Returns:
        Dataset over (theta_o, x) of signals relative to the true peak, no unit: `signal`, `after_optics`, and `recorded`
        by the pixel that contains x. x is the distance from the peak, px.

    Source:
        Holzschuch & Pacanowski (2017), Figures 3 and 4.

    Example:
        >>> figure = matcam.paper.figure_3_4(1.0)
        >>> bool(figure["recorded"].max() < figure["after_optics"].max() < figure["signal"].max())
        True
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
    # the figure is one-dimensional: divide by the loss in the other direction, which is equal for all pixels
    recorded = lobe_record(rig, ndf, theta, np.tile(pixel, (theta.size, 1)), np.zeros((theta.size, x.size)))
    across = peak_response(rig, ndf, 0.0, dims=1)
    data = xr.Dataset(
        {
            "signal": (("theta_o", "x"), np.exp(-((x / std) ** 2) / 2)),
            "after_optics": (("theta_o", "x"), std / blurred * np.exp(-((x / blurred) ** 2) / 2)),
            "recorded": (("theta_o", "x"), np.asarray(recorded / across)),
        },
        coords={"theta_o": theta, "x": x},
        attrs={"ratio": ratio, "sigma_mtf_px": sigma, "half_width_px": half_width, "radius_px": radius},
    )
    return named(data, _NAMES | {"x": "distance from the peak [px]"})


def figure_5(rig: Rig | None = None) -> xr.Dataset:
    """Compute Figure 5 of the paper, the peak loss against theta.

    theta is the angle between normal and view at the highlight, rad. The recorded peak is divided by the recorded peak
    at theta = 0, for lobes of several widths.

    Args:
        rig: rig with Gaussian optics and a sphere. Default: None, `rigs.merl()`.

    Returns:
        Dataset over (ratio, theta), no unit. `loss` is computed as in docs/model.md 4, and `loss_printed` by equation
        (11). `cosine` is cos(theta). `ratio` is the width of the lobe divided by sigma_mtf / radius, where sigma_mtf is
        the standard deviation of the blur of the optics, px, and radius is the radius of the sphere in the image, px.

    Source:
        Holzschuch & Pacanowski (2017), Figure 5.

    Example:
        >>> figure = matcam.paper.figure_5()
        >>> figure["loss"].sel(ratio=0.01).isel(theta=0).item()
        1.0
    """
    rig = rig or merl()
    sigma, half_width, radius = _gaussian_numbers(rig)
    theta = np.radians(np.append(np.arange(0, 90, 0.5), 89.9))
    widths = np.array(FIGURE_5_RATIOS) * sigma / radius
    loss = np.stack([np.asarray(peak_response(rig, GaussianNDF(w), theta)) for w in widths])
    printed = np.asarray(peak_eq11(widths[:, None], sigma, half_width, radius, theta))
    data = xr.Dataset(
        {
            "loss": (("ratio", "theta"), loss / loss[:, :1]),
            "loss_printed": (("ratio", "theta"), printed / printed[:, :1]),
            "cosine": ("theta", np.cos(theta)),
        },
        coords={"ratio": list(FIGURE_5_RATIOS), "theta": theta},
        attrs={"sigma_mtf_px": sigma, "half_width_px": half_width, "radius_px": radius},
    )
    return named(data, _NAMES)


def _gaussian_numbers(rig: Rig) -> tuple[float, float, float]:
    """Return sigma_mtf, sigma_p and the radius of the sphere, px."""
    sigma = rig.camera.parameters()["optics.sigma_px"]
    return float(sigma), float(rig.camera.pixel.half_width), float(rig.sample.radius)  # type: ignore[attr-defined]
