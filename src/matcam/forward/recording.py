"""What a camera records of a scene at given places in its picture: the one operator behind tables and pictures.

Targets are sorted once, by geometry alone, into those near the highlight, those along the ends of the light and those
inside; each kind has its own integral, and all are smooth functions of material and camera.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.highlight import Detail, record_around
from matcam.forward.interpolation import POINTS, interpolated
from matcam.forward.regions import Scale
from matcam.forward.scene import Scene
from matcam.forward.surroundings import record_across_ridge, record_at_ends, record_inside
from matcam.material.material import Material
from matcam.sample.shape import Curved

_INSIDE_AT_A_TIME = 4096
_ENDS_AT_A_TIME = 512
DETAIL = Detail(graded=6, even=8, order=6)


class Targets(NamedTuple):
    """Places in pictures, shape (targets,): position px, the lamp's angle rad, and which of `lamps` it is near to."""

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    picture: np.ndarray


class Sorted(NamedTuple):
    """Indices of targets by the way in which they are integrated."""

    near: np.ndarray
    ridge: np.ndarray
    pole: np.ndarray
    ends: np.ndarray
    inside: np.ndarray


def in_batches(function, arrays, size):  # type: ignore[no-untyped-def]
    """Map over the leading axis in batches of one shape, so that memory stays small; the last batch is filled up."""
    count = arrays[0].shape[0]
    batches = -(-count // size)
    padded = tuple(
        jnp.concatenate([a, jnp.broadcast_to(a[-1:], (batches * size - count, *a.shape[1:]))]).reshape(
            batches, size, *a.shape[1:]
        )
        for a in arrays
    )
    out = jax.lax.map(lambda batch: function(*batch), padded)
    return out.reshape(-1, *out.shape[2:])[:count]


@eqx.filter_jit
def record_table(
    material: Material, sample: Curved, blur: Blur, lamps: jax.Array, targets: Targets, kinds: Sorted, scale: Scale
) -> jax.Array:
    """Record of `targets` in pictures of one sample under `lamps` (pictures,); radiance per unit irradiance, shape
    (targets, channels). Around each highlight the record is made on a grid, and read off between its points."""
    terms = tuple(range(blur.stds.size))
    channels = Scene(material, sample, jnp.zeros(())).channels()
    out = jnp.zeros((targets.x.size, channels))
    x, y, lamp = (jnp.asarray(a) for a in (targets.x, targets.y, targets.lamp_angle))

    if kinds.inside.size:

        def inside(x, y, lamp):  # type: ignore[no-untyped-def]
            return record_inside(Scene(material, sample, lamp), blur, terms, x, y)

        chosen = kinds.inside
        out = out.at[chosen].set(in_batches(inside, (x[chosen], y[chosen], lamp[chosen]), _INSIDE_AT_A_TIME))
    for integrate, chosen, panels in (
        (record_at_ends, kinds.ends, 3),
        (record_across_ridge, kinds.ridge, 2),
        (record_across_ridge, kinds.pole, 12),
    ):
        if chosen.size:

            def windowed(x, y, lamp, integrate=integrate, panels=panels):  # type: ignore[no-untyped-def]
                return integrate(Scene(material, sample, lamp), blur, terms, x, y, scale.reach, panels)

            out = out.at[chosen].set(in_batches(windowed, (x[chosen], y[chosen], lamp[chosen]), _ENDS_AT_A_TIME // panels * 2))
    if kinds.near.size:
        chosen = kinds.near
        steps = int(np.ceil(scale.near / scale.spacing)) + POINTS // 2
        columns, rows = np.arange(-steps, steps + 1), np.arange(-POINTS // 2, steps + 1)

        def stamp(lamp: jax.Array) -> jax.Array:
            scene = Scene(material, sample, lamp)
            peak = sample.surface(sample.highlight(lamp), jnp.zeros(())).x
            return record_around(
                scene, blur, terms, peak + scale.spacing * columns, scale.spacing * rows, scale.reach, DETAIL
            )

        stamps = jax.lax.map(stamp, lamps)

        def read(x, y, lamp, picture):  # type: ignore[no-untyped-def]
            peak = sample.surface(sample.highlight(lamp), jnp.zeros(())).x
            row, column = jnp.abs(y) / scale.spacing - rows[0], (x - peak) / scale.spacing - columns[0]
            return interpolated(stamps, picture, row, column)

        picture = jnp.asarray(targets.picture[chosen])
        out = out.at[chosen].set(in_batches(read, (x[chosen], y[chosen], lamp[chosen], picture), _INSIDE_AT_A_TIME))
    return out
