"""Source disc in a record: number and positions of the points that represent it (docs/model.md 3).

On a sphere the record under a disc is the mean of the records under its points. The distance of two points may move the
highlight by a fraction of its blur by kernel and lobe.
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
"""Share of the scale of a lobe that is used as its blur. The singularities of a GGX lobe lie at its scale."""
_WIDEST = 2.0
"""Largest radius of the image of a disc, in radii of the sample."""


def disc_fineness(rig: Rig, imaging: Imaging, lamp_angle: np.ndarray, material: Material | None = None) -> np.ndarray:
    """Compute the radius of the image of a lamp over the standard deviation of its blur, no unit.

    Args:
        rig: the rig.
        imaging: imaging of the rig.
        lamp_angle: angle between lamp and optical axis, rad, any shape.
        material: the material. Default: None, a mirror.
    """
    disc = disc_of(rig.lamp)
    if disc == 0:
        return np.zeros_like(lamp_angle)
    rig, imaging = jax.lax.stop_gradient((rig, imaging))
    finest = 0.0 if material is None else checks.outside_jit(material.finest, "the material's parameters")
    theta_d = imaging.sample.theta_d(jnp.asarray(lamp_angle), rig.lamp.nearness)
    std = float(np.min(np.asarray(imaging.blur.stds)))
    along, across = (np.asarray(a) for a in rig.px_per_rad(theta_d))
    # from the highlight, a near disc has a larger angle than from the centre of the sample
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
