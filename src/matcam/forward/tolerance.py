"""A picture to within a stated error, exact only where it has to be: most of a sample is smooth, or dark beside its highlight.

What a pixel records lies between the least and the largest radiance within its kernel's reach. Where these differ by less
than the error, the radiance at its centre will do. A highlight can hide between the centres, so all around it is exact.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.kernel_scale import groups_of
from matcam.forward.plan import Targets, filled, planned
from matcam.forward.recording import record
from matcam.forward.regions import highlight_x
from matcam.forward.scene import Scene
from matcam.material.material import Material
from matcam.sample.shape import Curved


def record_within(
    error: float, material: Material, sample: Curved, blur: Blur, lamp_angle: float, x: np.ndarray, y: np.ndarray
) -> jax.Array:
    """Radiance, 1/sr, that pixels centred on x (columns,), y (rows,) px, one apart, record, within `error` of the largest;
    shape (rows, columns, channels). Not to be differentiated: which pixels are exact depends on the material."""
    scales = [group.scale for group in groups_of(blur, sample)]
    around = int(np.ceil(max(scale.reach for scale in scales)))
    beyond = np.arange(1, around + 1)
    wide = [np.concatenate([a[0] - step * beyond[::-1], a, a[-1] + step * beyond]) for a, step in ((x, 1), (y, -1))]
    centres = np.asarray(_at_centres(Scene(material, sample, jnp.asarray(lamp_angle)), *np.meshgrid(*wide)))
    grown = (2 * around + 1, 2 * around + 1, 1)
    span = (maximum_filter(centres, grown) - minimum_filter(centres, grown)).max(axis=-1)
    span, centres = (a[around : around + y.size, around : around + x.size] for a in (span, centres))
    values, peak_x = centres.copy(), float(highlight_x(sample, jnp.asarray(lamp_angle)))
    x, y = np.meshgrid(x, y)

    def exactly(chosen: np.ndarray) -> None:
        which = filled(np.flatnonzero(chosen))
        if which.size:
            targets = Targets(
                x.ravel()[which],
                y.ravel()[which],
                np.full(which.size, lamp_angle),
                np.zeros(which.size, dtype=np.int32),
            )
            plan = planned(sample, blur, np.array([lamp_angle]), targets)
            values.reshape(-1, values.shape[-1])[which] = np.asarray(record(material, sample, blur, plan))

    side = max(scale.near for scale in scales)
    near = (np.abs(x - peak_x) < side) & (np.abs(y) < side)
    exactly(near)
    peak = values[near].max(initial=0.0) or centres.max()
    exactly((span > error * peak) & ~near)
    return jnp.asarray(values)


@jax.jit
def _at_centres(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    element, visible = scene.sample.at(x, y)
    lit = visible & (scene.seen(element).cos_i > 0)
    return jnp.where(lit[..., None], scene.sent(element), 0.0)
