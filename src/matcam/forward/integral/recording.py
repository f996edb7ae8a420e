"""What a camera records of a curved sample at given places in its pictures: the one operator behind tables and pictures.

It follows a plan (plan.py): each kind of target has its own integral. Around each highlight the record is made on a grid
that holds all of it, and read off between the grid's points. Wherever the kernel meets no end of the light, each integral
is divided by what it makes of a flat field, whose record is known: its quadrature's error falls out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.jax import AnyArray, jax, jnp
from matcam.forward.integral.blur import Blur
from matcam.forward.integral.integrals import Detail, Division, record_around, record_in_window, record_inside
from matcam.forward.integral.plan import Part, Plan, Targets
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.material.material import Material
from matcam.numerics.interpolate import POINTS, interpolated
from matcam.sample.shape import Curved

_GRADED, _ORDER = 6, 6
# Targets at a time: as many nodes as fit into a processor's cache
_INSIDE, _NODES, _READ = 4096, 128, 8192


def record(material: Material, sample: Curved, blur: Blur, plan: Plan) -> jax.Array:
    """Radiance under unit irradiance, 1/sr, that pixels centred on the plan's targets record; shape (targets, channels).
    The plan: made for this sample and this blur, or for numbers that differ little."""
    light = _Light(material, sample, blur)
    return jnp.asarray(sum(_record_part(light, part, plan.targets) for part in plan.parts))


class _Light(NamedTuple):
    material: Material
    sample: Curved
    blur: Blur

    def under(self, lamp_angle: jax.Array) -> Scene:
        return Scene(self.material, self.sample, lamp_angle)


def _record_part(light: _Light, part: Part, targets: Targets) -> jax.Array:
    """Every kind is dispatched by itself, so that they run side by side."""
    records = [jnp.zeros((0, light.under(jnp.zeros(())).channels()))]
    if part.inside.size:
        records.append(_record_inside(light, part.terms, *_chosen(targets, part.inside)[:3]))
    for window in part.windows:
        chosen = *_chosen(targets, window.chosen)[:3], window.whole
        kernel = jnp.asarray(part.reach), jnp.asarray(part.cuts)
        records.append(_record_in_window(light, part.terms, kernel, window.panels, window.ridge, *chosen))
    if part.near.size:
        grid = _Grid(part.terms, part.steps, part.even, *(jnp.asarray(a) for a in (part.reach, part.spacing)))
        chosen = *_chosen(targets, part.near), part.near_whole
        records.append(_read_highlights(light, grid, jnp.asarray(part.lamps), *chosen))
    return _placed(records, part.place)


def _chosen(targets: Targets, which: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(a[which] for a in targets)


@jax.jit
def _placed(records: list[jax.Array], place: np.ndarray) -> jax.Array:
    return jnp.concatenate([*records, jnp.zeros((1, records[0].shape[1]))])[place]


@eqx.filter_jit
def _record_inside(light: _Light, terms: tuple[int, ...], *places: AnyArray) -> jax.Array:
    def integral(x: jax.Array, y: jax.Array, lamp: jax.Array) -> jax.Array:
        return record_inside(light.under(lamp), light.blur, terms, x, y)

    return in_batches(integral, tuple(jnp.asarray(a) for a in places), _INSIDE)


@eqx.filter_jit
def _record_in_window(light, terms, kernel, panels, ridge, *chosen):  # type: ignore[no-untyped-def]
    division = Division(*kernel, panels, ridge)

    def integral(x: jax.Array, y: jax.Array, lamp: jax.Array, whole: jax.Array) -> jax.Array:
        values = record_in_window(light.under(lamp), light.blur, terms, x, y, division)
        return _against_flat_field(values, whole, light.blur, terms)

    return in_batches(integral, tuple(jnp.asarray(a) for a in chosen), _NODES // panels)


class _Grid(NamedTuple):
    """The grid around each highlight."""

    terms: tuple[int, ...]
    steps: int
    even: int
    reach: jax.Array
    spacing: jax.Array


@eqx.filter_jit
def _read_highlights(light: _Light, grid: _Grid, lamps: jax.Array, *chosen: AnyArray) -> jax.Array:
    columns, rows = np.arange(-grid.steps, grid.steps + 1), np.arange(-POINTS // 2, grid.steps + 1)
    detail = Detail(graded=_GRADED, even=grid.even, order=_ORDER)

    def stamp(lamp: jax.Array) -> jax.Array:
        x, y = highlight_x(light.sample, lamp) + grid.spacing * columns, grid.spacing * rows
        return record_around(light.under(lamp), light.blur, grid.terms, x, y, grid.reach, detail)

    stamps = jax.lax.map(stamp, lamps.ravel())

    def read(x: jax.Array, y: jax.Array, lamp: jax.Array, picture: jax.Array, whole: jax.Array) -> jax.Array:
        row = jnp.abs(y) / grid.spacing - rows[0]
        column = (x - highlight_x(light.sample, lamp)) / grid.spacing - columns[0]
        values = [interpolated(stamps, picture * lamps.shape[1] + k, row, column) for k in range(lamps.shape[1])]
        if len(values) == 1:
            value = values[0]
        else:  # a parabola through the three lamps
            t = ((lamp - lamps[picture, 1]) / (lamps[picture, 2] - lamps[picture, 1]))[:, None]
            value = values[0] * t * (t - 1) / 2 + values[1] * (1 - t) * (1 + t) + values[2] * t * (t + 1) / 2
        return _against_flat_field(value, whole, light.blur, grid.terms)

    return in_batches(read, tuple(jnp.asarray(a) for a in chosen), _READ)


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
