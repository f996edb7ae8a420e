"""Size of the image of a source disc, which determines the number of points that represent the disc (docs/model.md 3).

The record under a source disc is the mean of the records under its points. From one point to the next, the highlight may
move only by a fraction of the width of its blur by kernel and lobe.
"""

from __future__ import annotations

import numpy as np

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Imaging
from matcam.lamp.lamps import disc_of
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder

_LOBE = 0.5
"""Standard deviation by which a lobe is assumed to blur a disc, as a share of the scale of the lobe. The complex
singularities of a GGX lobe, which limit the convergence of a quadrature, are at a distance of its scale.
"""
_WIDEST = 2.0
"""Largest radius of the image of a disc, in radii of the sample."""


def disc_fineness(
    rig: Rig,
    imaging: Imaging,
    lamp_angle: np.ndarray,
    material: Material | None = None,
    azimuth: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Compute the image radius of a source disc divided by the standard deviation of the blur of this image, no unit.

    Args:
        rig: the rig.
        imaging: imaging of the rig.
        lamp_angle: angle between lamp and optical axis, rad, any shape.
        material: the material. Default: None, a mirror.
        azimuth: azimuth of the lamp, rad, which is used only for a cylinder. Default: 0.
    """
    disc = disc_of(rig.lamp)
    if disc == 0:
        return np.zeros_like(lamp_angle)
    rig, imaging = jax.lax.stop_gradient((rig, imaging))
    finest = 0.0 if material is None else checks.outside_jit(material.finest, "the material's parameters")
    lamps, which = np.unique(lamp_angle, return_inverse=True)
    which = which.reshape(np.shape(lamp_angle))
    theta_d = imaging.sample.theta_d(jnp.asarray(lamps), rig.lamp.nearness)
    std = float(np.min(np.asarray(imaging.blur.stds)))
    along, across = (np.asarray(a)[which] for a in rig.px_per_rad(theta_d))
    # seen from the highlight, a near disc has a larger angular radius than from the centre of the sample
    larger = 1.0 if rig.lamp.nearness is None else 1 / (1 - float(rig.lamp.nearness))
    theta = np.asarray(theta_d)[which]
    cosine, radius, half = np.maximum(np.cos(theta), disc), float(imaging.sample.radius), disc * larger / 2
    if isinstance(imaging.sample, Cylinder):
        # across the cylinder, lens and lobe blur the image of the disc; along a distant cylinder, only the lobe does
        turn, lobe = (np.cos(azimuth), np.sin(azimuth)), _LOBE * finest
        scale = radius * np.cos(np.arctan2(np.sin(theta) * turn[0], np.cos(theta)))
        sizes = np.hypot(turn[0], turn[1] / cosine), np.hypot(turn[1], turn[0] / cosine)
        blurs = np.hypot(std / scale, lobe), np.hypot(std / across, lobe)
        return np.maximum(*(half * size / blur for size, blur in zip(sizes, blurs, strict=True)))
    return np.maximum(
        *(
            np.minimum(scale * half / aslant, _WIDEST * radius) / np.hypot(std, _LOBE * finest * scale)
            for scale, aslant in ((along, 1.0), (across, cosine))
        )
    )


def nearer(imaging: Imaging, distance: float) -> Imaging:
    """Multiply the lamp distance by the factor `distance`, no unit."""
    return (
        imaging if imaging.lamp_nearness is None else imaging._replace(lamp_nearness=imaging.lamp_nearness / distance)
    )
