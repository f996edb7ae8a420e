"""Table of a reconstructed anisotropic material over half and difference angles and the azimuth of the half vector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from matcam.core.results.labelled import named
from matcam.files.capture_settings import Stated
from matcam.reconstruction.material_table import table_entries, with_support
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit

_SHAPE = (45, 24, 30, 12)
"""Number of cells along theta_h, phi_h, theta_d and phi_d."""


def anisotropic_table(fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Stated]) -> xr.Dataset:
    """Tabulate a joint fit of a lobe with two roughnesses.

    phi_h is measured from the x axis of the material. The BRDF is invariant under a rotation by 180 degrees
    about the normal, and under exchange of light and view (phi_d + 180 degrees). Therefore each azimuth is tabulated over
    180 degrees only.

    Args:
        fit: lobe, strengths and diffuse parts.
        curves: F of each channel, in the unit of the fit.
        units: unit of each channel, which is the image value per radiance under unit irradiance, with its relative
            standard deviation. F is the strength divided by the unit. If the standard deviation is NaN, F is relative.

    Returns:
        Dataset with `brdf` and `brdf_std`, 1/sr, and the mask `supported`, over theta_h, phi_h, theta_d, phi_d, rad, and
        channel.
    """
    n_h, n_p, n_d, n_q = _SHAPE
    theta_h, phi_h = ((np.arange(n_h) + 0.5) / n_h) ** 2 * np.pi / 2, (np.arange(n_p) + 0.5) / n_p * np.pi
    theta_d, phi_d = (np.arange(n_d) + 0.5) / n_d * np.pi / 2, (np.arange(n_q) + 0.5) / n_q * np.pi
    angles = np.meshgrid(theta_h, phi_h, theta_d, phi_d, indexing="ij", sparse=True)
    value, std = table_entries(fit, curves, units, angles[0], angles[2], angles[3], angles[1])
    axes = (
        ("theta_h", theta_h),
        ("phi_h", phi_h),
        ("theta_d", theta_d),
        ("phi_d", phi_d),
        ("channel", list(fit.channels)),
    )
    table = with_support(fit, xr.DataArray(value.astype(np.float32), axes), value, std, theta_d)
    return named(
        table.assign_attrs(
            phi_h="measured about the normal, from the material's x axis",
            period="phi_h and phi_d have period pi",
        )
    )
