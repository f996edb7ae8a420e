"""What a camera records of a curved sample at given places in its pictures: the one operator behind tables and pictures.

It follows a plan (plan.py): each kind of target has its own integral. Around each highlight the record is made on a grid
that holds all of it, and read off between the grid's points. Wherever the kernel meets no end of the light, each integral
is divided by what it makes of a flat field, whose record is known: its quadrature's error falls out.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import numpy as np

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.highlight import Detail, record_around
from matcam.forward.interpolation import POINTS, interpolated
from matcam.forward.plan import Part, Plan, Targets, Window
from matcam.forward.regions import highlight_x
from matcam.forward.scene import Scene
from matcam.forward.surroundings import Cuts, record_in_window, record_inside
from matcam.material.material import Material
from matcam.sample.shape import Curved

_GRADED, _ORDER = 6, 6
# Targets at a time: as many nodes as fit into a processor's cache
_INSIDE, _NODES, _READ = 4096, 128, 8192


def record(material: Material, sample: Curved, blur: Blur, plan: Plan) -> jax.Array:
    """Radiance under unit irradiance, 1/sr, that pixels centred on the plan's targets record; shape (targets, channels).
    The plan: made for this sample and this blur, or for numbers that differ little."""
    return jnp.asarray(sum(_record_part(material, sample, blur, part, plan.targets) for part in plan.parts))


@eqx.filter_jit
def _record_part(material: Material, sample: Curved, blur: Blur, part: Part, targets: Targets) -> jax.Array:
    x, y, lamp = (jnp.asarray(a) for a in targets[:3])
    places = x, y, lamp

    def inside(x: jax.Array, y: jax.Array, lamp: jax.Array) -> jax.Array:
        return record_inside(Scene(material, sample, lamp), blur, part.terms, x, y)

    def in_window(window: Window) -> jax.Array:
        cuts = Cuts(jnp.asarray(part.reach), jnp.asarray(part.cuts), window.panels, window.ridge)

        def integral(x: jax.Array, y: jax.Array, lamp: jax.Array, whole: jax.Array) -> jax.Array:
            values = record_in_window(Scene(material, sample, lamp), blur, part.terms, x, y, cuts)
            return _against_flat_field(values, whole, blur, part.terms)

        chosen = (*(a[window.chosen] for a in places), jnp.asarray(window.whole))
        return in_batches(integral, chosen, _NODES // window.panels)

    records = [in_window(window) for window in part.windows]
    if part.inside.size:
        records.insert(0, in_batches(inside, tuple(a[part.inside] for a in places), _INSIDE))
    if part.near.size:
        records.append(_read_highlights(material, sample, blur, part, targets))
    dark = jnp.zeros((1, Scene(material, sample, jnp.zeros(())).channels()))
    return jnp.concatenate([*records, dark])[part.place]


def _read_highlights(material: Material, sample: Curved, blur: Blur, part: Part, targets: Targets) -> jax.Array:
    lamps, spacing = jnp.asarray(part.lamps), jnp.asarray(part.spacing)
    columns, rows = np.arange(-part.steps, part.steps + 1), np.arange(-POINTS // 2, part.steps + 1)
    detail = Detail(graded=_GRADED, even=part.even, order=_ORDER)

    def stamp(lamp: jax.Array) -> jax.Array:
        x, y = highlight_x(sample, lamp) + spacing * columns, spacing * rows
        return record_around(Scene(material, sample, lamp), blur, part.terms, x, y, part.reach, detail)

    stamps = jax.lax.map(stamp, lamps.ravel())

    def read(x: jax.Array, y: jax.Array, lamp: jax.Array, picture: jax.Array, whole: jax.Array) -> jax.Array:
        row, column = jnp.abs(y) / spacing - rows[0], (x - highlight_x(sample, lamp)) / spacing - columns[0]
        values = [interpolated(stamps, picture * lamps.shape[1] + k, row, column) for k in range(lamps.shape[1])]
        if len(values) == 1:
            value = values[0]
        else:  # a parabola through the three lamps
            t = ((lamp - lamps[picture, 1]) / (lamps[picture, 2] - lamps[picture, 1]))[:, None]
            value = values[0] * t * (t - 1) / 2 + values[1] * (1 - t) * (1 + t) + values[2] * t * (t + 1) / 2
        return _against_flat_field(value, whole, blur, part.terms)

    chosen = tuple(jnp.asarray(a)[part.near] for a in targets)
    return in_batches(read, (*chosen, jnp.asarray(part.near_whole)), _READ)


def _against_flat_field(values: jax.Array, whole: jax.Array, blur: Blur, terms: tuple[int, ...]) -> jax.Array:
    """The records before the last channel; where the kernel is whole, over what the last, a flat field, ought to be."""
    recorded, flat = values[:, :-1], values[:, -1]
    if blur.varies:
        return recorded  # each piece of surface is spread by its own kernel: a flat field need not read its radiance
    expected = sum(blur.weights[term] for term in terms)
    return recorded * jnp.where(whole, expected / jnp.where(whole, flat, 1.0), 1.0)[:, None]


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
