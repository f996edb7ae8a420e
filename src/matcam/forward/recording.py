"""What a camera records of a curved sample at given places in its pictures: the one operator behind tables and pictures.

Targets are sorted once, by geometry alone; each kind has its own integral, and all are smooth functions of material and
camera. Around each highlight the record is made on a grid that holds all of it, and read off between the grid's points.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.highlight import Detail, record_around
from matcam.forward.interpolation import POINTS, interpolated
from matcam.forward.regions import Group, Sorted, groups_of, sorted_targets
from matcam.forward.scene import Scene
from matcam.forward.surroundings import record_across_ridge, record_at_ends, record_inside
from matcam.material.material import Material
from matcam.sample.shape import Curved

_DETAIL = Detail(graded=6, even=8, order=6)
# Targets at a time: as many nodes as fit into a processor's cache
_INSIDE, _WINDOWS, _READ = 4096, 64, 8192


class Targets(NamedTuple):
    """Places in pictures, shape (targets,): position px, the lamp's angle rad, and the number of the picture."""

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    picture: np.ndarray


def record(material: Material, sample: Curved, blur: Blur, lamp_angles: np.ndarray, targets: Targets) -> jax.Array:
    """Radiance under unit irradiance, 1/sr, that pixels centred on `targets` record; shape (targets, channels).

    lamp_angles: (pictures,), rad. A target's own lamp may differ a little from that of its picture (before a near camera a
    slice of a table is taken from pictures of many lamps): around the highlight, three lamps that span them are recorded.
    """
    total: jax.Array | float = 0.0
    for group in groups_of(blur, sample):
        kinds = sorted_targets(sample, targets.x, targets.y, targets.lamp_angle, group.scale)
        lamps = _lamps_around(lamp_angles, targets, kinds.near)
        total += _record_group(material, sample, blur, group, jnp.asarray(lamps), targets, kinds)
    return jnp.asarray(total)


def _lamps_around(lamp_angles: np.ndarray, targets: Targets, near: np.ndarray) -> np.ndarray:
    """Lamps at which to record each picture's highlight, (pictures, 1 or 3), rad."""
    offset = np.abs(targets.lamp_angle[near] - lamp_angles[targets.picture[near]])
    if not near.size or offset.max() < 1e-12:
        return lamp_angles[:, None]
    widest = np.full(lamp_angles.size, 1e-6)
    np.maximum.at(widest, targets.picture[near], offset)
    return lamp_angles[:, None] + widest[:, None] * np.array([-1.0, 0.0, 1.0])


@eqx.filter_jit
def _record_group(
    material: Material, sample: Curved, blur: Blur, group: Group, lamps: jax.Array, targets: Targets, kinds: Sorted
) -> jax.Array:
    terms, scale = group
    x, y, lamp = (jnp.asarray(a) for a in (targets.x, targets.y, targets.lamp_angle))
    out = jnp.zeros((x.size, Scene(material, sample, jnp.zeros(())).channels()))

    def added(out: jax.Array, chosen: np.ndarray, function: Callable[..., jax.Array], size: int, *more) -> jax.Array:  # type: ignore[no-untyped-def]
        if not chosen.size:
            return out
        values = in_batches(function, (x[chosen], y[chosen], lamp[chosen], *(a[chosen] for a in more)), size)
        return out.at[chosen].set(values)

    def inside(x: jax.Array, y: jax.Array, lamp: jax.Array) -> jax.Array:
        return record_inside(Scene(material, sample, lamp), blur, terms, x, y)

    def window(integral: Callable[..., jax.Array], panels: int) -> Callable[..., jax.Array]:
        return lambda x, y, lamp: integral(Scene(material, sample, lamp), blur, terms, x, y, scale.reach, panels)

    out = added(out, kinds.inside, inside, _INSIDE)
    out = added(out, kinds.ends, window(record_at_ends, 2), _WINDOWS)
    out = added(out, kinds.ridge, window(record_across_ridge, 2), _WINDOWS)
    out = added(out, kinds.slanted, window(record_at_ends, 4), _WINDOWS // 2)
    out = added(out, kinds.pole, window(record_at_ends, 10), _WINDOWS // 4)
    if not kinds.near.size:
        return out

    steps = int(np.ceil(scale.near / scale.spacing)) + POINTS // 2
    columns, rows = np.arange(-steps, steps + 1), np.arange(-POINTS // 2, steps + 1)

    def highlight_x(lamp: jax.Array) -> jax.Array:
        return sample.surface(sample.highlight(lamp), jnp.zeros(())).x

    def stamp(lamp: jax.Array) -> jax.Array:
        x, y = highlight_x(lamp) + scale.spacing * columns, jnp.asarray(scale.spacing * rows)
        return record_around(Scene(material, sample, lamp), blur, terms, x, y, scale.reach, _DETAIL)

    stamps = jax.lax.map(stamp, lamps.ravel())

    def read(x: jax.Array, y: jax.Array, lamp: jax.Array, picture: jax.Array) -> jax.Array:
        row, column = jnp.abs(y) / scale.spacing - rows[0], (x - highlight_x(lamp)) / scale.spacing - columns[0]
        values = [interpolated(stamps, picture * lamps.shape[1] + k, row, column) for k in range(lamps.shape[1])]
        if len(values) == 1:
            return values[0]
        # a parabola through the three lamps
        t = ((lamp - lamps[picture, 1]) / (lamps[picture, 2] - lamps[picture, 1]))[:, None]
        return values[0] * t * (t - 1) / 2 + values[1] * (1 - t) * (1 + t) + values[2] * t * (t + 1) / 2

    return added(out, kinds.near, read, _READ, jnp.asarray(targets.picture))


def in_batches(function: Callable[..., jax.Array], arrays: tuple[jax.Array, ...], size: int) -> jax.Array:
    """Map over the leading axis in batches of one shape, so that memory stays small; the last batch is filled up."""
    count = arrays[0].shape[0]
    size = min(size, count)
    batches = -(-count // size)

    def batched(array: jax.Array) -> jax.Array:
        filled = jnp.concatenate([array, jnp.broadcast_to(array[-1:], (batches * size - count, *array.shape[1:]))])
        return filled.reshape(batches, size, *array.shape[1:])

    out = jax.lax.map(lambda batch: function(*batch), tuple(batched(a) for a in arrays))
    return out.reshape(-1, *out.shape[2:])[:count]
