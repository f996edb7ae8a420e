"""Response at the peak of a highlight: recorded peak over true peak (docs/model.md 4).

The tangent plane approximation is fast. On a sphere of 256 px radius, its error is 1e-5 for lobes narrower than 0.002 rad at
viewing angles up to 83 degrees. The error is 2 % for lobes of 0.05 rad at 80 degrees. The exact computation integrates
over the curved sample with its limb.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.core import checks
from matcam.core.arrays import xp
from matcam.core.errors import ArgumentError
from matcam.forward.peaks.tangent_plane import response_at_peak
from matcam.material.masking import MASKINGS, Masking
from matcam.material.ndf.distribution import SlopeDistribution
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_ACROSS = 1e-9
"""Largest sine of the azimuth of a lamp in the plane across the axis of a cylinder."""


def peak_response(
    rig: Rig,
    ndf: SlopeDistribution,
    theta: ArrayLike,
    dims: int = 2,
    exact: bool = False,
    masking: Masking = "smith",
) -> jax.Array:
    """Compute the recorded peak divided by the true peak of a highlight.

    In the tangent plane the response lies in (0, 1]. On a sphere, the response of a lobe much narrower than the kernel
    decreases at most by the factor cos(theta) relative to theta = 0. The integral over the lobe is accurate to 1e-6 for
    every lobe and every single lens. The exact response may exceed 1 close to the limb, where the BRDF increases. The
    relative error of the exact response is below 1e-6 for Gaussian lenses. Other lenses are approximated by sums of
    Gaussians; on a sphere, the residual of this approximation is included.

    Args:
        rig: camera, sample and lamp. The square pixels do not rotate with `lamp_azimuth`.
        ndf: distribution of the microfacets' normals, such as `GGX(0.01)`.
        theta: viewing angle of the highlight, half the angle between lamp and camera, in [0, pi/2), rad, any shape.
        dims: 2 for a real sample, 1 for the one-dimensional model of Holzschuch and Pacanowski, which includes only the blur
            along the direction towards the limb. Default: 2.
        exact: True for the curved sample with its limb, in two dimensions, for any NDF. Default: False, the tangent
            plane, which is faster and accurate to 1e-3 up to 75 degrees for lobes narrower than 0.05 rad.
        masking: "smith" (height-correlated), "smith-separable", "van-ginneken" or None (no masking). Only the exact
            response depends on it. Default: "smith".

    Returns:
        Response, of the shape of `theta`, no unit. It is differentiable in the parameters of `rig` and `ndf` and, in the
        tangent plane, in `theta`.

    Raises:
        ArgumentError: an argument is out of its range; the lobe is not isotropic and `exact` is False; the lens has several
            colours or varies over the field; the lens has aberrations, `exact` is True and the sample is a cylinder; the lamp
            of a cylinder is outside the plane across its axis; or `theta` is traced and `exact` is True.

    Source:
        Holzschuch and Pacanowski (2017), section 3, as corrected in docs/model.md 4.

    Example:
        >>> response = matcam.peak_response(matcam.rigs.merl(), matcam.GaussianNDF(0.002), np.radians([0, 75]))
        >>> print(np.round(response, 3))
        [0.437 0.146]
    """
    theta = checks.viewing_angle("theta", theta)
    checks.choice("dims", dims, (1, 2))
    checks.choice("masking", masking, MASKINGS)
    checks.instance("rig", rig, Rig, "rigs.merl()")
    if not isinstance(ndf, SlopeDistribution):
        raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
    turn = float(rig.azimuths())
    if isinstance(rig.sample, Cylinder) and abs(np.sin(turn)) > _ACROSS:
        raise ArgumentError(
            "the lamp of a cylinder must be in the plane across its axis: its azimuth must be 0 or 180 degrees, got "
            f"{np.degrees(turn):g} degrees"
        )
    flat = xp.reshape(theta, -1)
    if checks.flag("exact", exact):
        if dims != 2:
            raise ArgumentError("exact=True applies to the real sample, for which dims must be 2, got 1")
        from matcam.forward.peaks.exact_peak import exact_response

        return exact_response(rig, ndf, flat, masking).reshape(theta.shape)
    return response_at_peak(rig, ndf, flat, dims).reshape(theta.shape)
