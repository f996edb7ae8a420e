"""A lamp's disc in a record: how many points stand for it, and where they are (docs/model.md 3).

On a sphere the record under a disc is the mean over its points, each a lamp of its own. Between two points the highlight may
move by a share of what blurs it: the kernel, and the lobe.
"""

from __future__ import annotations

import numpy as np

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Imaging
from matcam.lamp.lamps import disc_of
from matcam.material.material import Material
from matcam.rigs import Rig

LOBE = 0.5
"""Share of a lobe's scale that counts as its blur: a GGX lobe has its singularities at its scale."""
_WIDEST = 2.0
"""Largest radius of a disc's image, in radii of the sample."""


def disc_fineness(rig: Rig, imaging: Imaging, lamp_angle: np.ndarray, material: Material | None = None) -> np.ndarray:
    """Return the radius of a lamp's image over the standard deviation of its blur, no unit.

    Args:
        rig: the rig.
        imaging: its imaging.
        lamp_angle: angle between lamp and optical axis, rad, any shape.
        material: what the lamp is seen in. Default: None, a mirror.
    """
    disc = disc_of(rig.lamp)
    if disc == 0:
        return np.zeros_like(lamp_angle)
    rig, imaging = jax.lax.stop_gradient((rig, imaging))
    finest = 0.0 if material is None else checks.outside_jit(material.finest, "the material's numbers")
    theta_d = imaging.sample.theta_d(jnp.asarray(lamp_angle), rig.lamp.nearness)
    std = float(np.min(np.asarray(imaging.blur.stds)))
    along, across = (np.asarray(a) for a in rig.px_per_rad(theta_d))
    # seen from the highlight, a near disc is larger than from the sample's centre
    larger = 1.0 if rig.lamp.nearness is None else 1 / (1 - float(rig.lamp.nearness))
    cosine = np.maximum(np.cos(np.asarray(theta_d)), disc)
    widest = _WIDEST * float(imaging.sample.radius)
    return np.maximum(
        *(
            np.minimum(scale * disc * larger / 2 / aslant, widest) / np.hypot(std, LOBE * finest * scale)
            for scale, aslant in ((along, 1.0), (across, cosine))
        )
    )


def nearer(imaging: Imaging, distance: float) -> Imaging:
    """Return the imaging of a lamp at a multiple of the distance."""
    return (
        imaging if imaging.lamp_nearness is None else imaging._replace(lamp_nearness=imaging.lamp_nearness / distance)
    )
