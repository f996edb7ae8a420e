"""The record of a curved sample at given places in its pictures: the one operator behind tables and pictures.

It follows a plan (`plan.py`), in which each kind of place has its own integral (`integrals.py`). Around each highlight the
record is made on a grid that holds all of it, and read off between the grid's points. Wherever the kernel meets no end of
the light, each integral is divided by its record of a flat field, which is known: the quadrature's error falls out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.jax import AnyArray, jax, jnp
from matcam.forward.integral.blur import BlurTerms, Imaging
from matcam.forward.integral.integrals import (
    HighlightPanels,
    Scene,
    WindowPanels,
    highlight_x,
    record_around,
    record_in_window,
    record_inside,
)
from matcam.forward.integral.plan import IntegrationPlan, PlanPart, RecordPlaces
from matcam.material.material import Material
from matcam.numerics.interpolate import POINTS, interpolated, lagrange_basis

_GRADED, _ORDER = 6, 6
_THREE_LAMPS = np.array([-1.0, 0.0, 1.0])
# Places at a time: as many nodes as fit into a processor's cache
_INSIDE, _NODES, _READ = 4096, 128, 8192


def record(material: Material, imaging: Imaging, plan: IntegrationPlan) -> jax.Array:
    """Record a material at the places of a plan.

    Args:
        material: the material.
        imaging: sample and blur, those of the plan or with parameters that differ little.
        plan: the plan.

    Returns:
        Radiance under unit irradiance, 1/sr, (places, channels). Differentiable in material, sample and blur.
    """
    subject = _Subject(material, imaging)
    return jnp.asarray(sum(_record_part(subject, part, plan.places) for part in plan.parts))


class _Subject(NamedTuple):
    """A material on a sample in front of a camera, under any lamp."""

    material: Material
    imaging: Imaging

    def under(self, lamp_angle: jax.Array) -> Scene:
        return Scene(self.material, self.imaging.sample, lamp_angle)

    def through(self, terms: tuple[int, ...]) -> BlurTerms:
        return BlurTerms(self.imaging.blur, terms)


def _record_part(subject: _Subject, part: PlanPart, places: RecordPlaces) -> jax.Array:
    """Dispatch each kind of place by itself, so that they run side by side."""
    records = [jnp.zeros((0, subject.under(jnp.zeros(())).channels()))]
    if part.inside.size:
        records.append(_record_inside(subject, part.terms, *_at(places, part.inside)[:3]))
    for window in part.windows:
        kernel = jnp.asarray(part.reach), jnp.asarray(part.cuts)
        panels = WindowPanels(*kernel, window.panels, window.ridge)
        records.append(_record_in_window(subject, part.terms, panels, *_at(places, window.index)[:3], window.whole))
    if part.near.size:
        grid = _HighlightGrid(part.terms, part.steps, part.even, jnp.asarray(part.reach), jnp.asarray(part.spacing))
        arrays = *_at(places, part.near), part.near_whole
        records.append(_read_highlights(subject, grid, jnp.asarray(part.lamps), *arrays))
    return _in_order(records, part.place)


def _at(places: RecordPlaces, index: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(a[index] for a in places)


@jax.jit
def _in_order(records: list[jax.Array], place: np.ndarray) -> jax.Array:
    return jnp.concatenate([*records, jnp.zeros((1, records[0].shape[1]))])[place]


@eqx.filter_jit
def _record_inside(subject: _Subject, terms: tuple[int, ...], *places: AnyArray) -> jax.Array:
    def integral(x: jax.Array, y: jax.Array, lamp: jax.Array) -> jax.Array:
        return record_inside(subject.under(lamp), subject.through(terms), x, y)

    return _in_batches(integral, tuple(jnp.asarray(a) for a in places), _INSIDE)


@eqx.filter_jit
def _record_in_window(subject: _Subject, terms: tuple[int, ...], panels: WindowPanels, *arrays: AnyArray) -> jax.Array:
    def integral(x: jax.Array, y: jax.Array, lamp: jax.Array, whole: jax.Array) -> jax.Array:
        blur = subject.through(terms)
        return _over_flat_field(record_in_window(subject.under(lamp), blur, x, y, panels), whole, blur)

    return _in_batches(integral, tuple(jnp.asarray(a) for a in arrays), _NODES // panels.along_v)


class _HighlightGrid(NamedTuple):
    """The grid around each highlight; fields as those of a `PlanPart`."""

    terms: tuple[int, ...]
    steps: int
    even: int
    reach: jax.Array
    spacing: jax.Array


@eqx.filter_jit
def _read_highlights(subject: _Subject, grid: _HighlightGrid, lamps: jax.Array, *arrays: AnyArray) -> jax.Array:
    columns, rows = np.arange(-grid.steps, grid.steps + 1), np.arange(-POINTS // 2, grid.steps + 1)
    panels = HighlightPanels(graded=_GRADED, even=grid.even, order=_ORDER)
    sample, blur = subject.imaging.sample, subject.through(grid.terms)

    def stamp(lamp: jax.Array) -> jax.Array:
        x, y = highlight_x(sample, lamp) + grid.spacing * columns, grid.spacing * rows
        return record_around(subject.under(lamp), blur, x, y, grid.reach, panels)

    stamps = jax.lax.map(stamp, lamps.ravel())

    def read(x: jax.Array, y: jax.Array, lamp: jax.Array, picture: jax.Array, whole: jax.Array) -> jax.Array:
        row = jnp.abs(y) / grid.spacing - rows[0]
        column = (x - highlight_x(sample, lamp)) / grid.spacing - columns[0]
        values = [interpolated(stamps, picture * lamps.shape[1] + k, row, column) for k in range(lamps.shape[1])]
        if len(values) == 1:
            value = values[0]
        else:  # a parabola through the three lamps
            between = ((lamp - lamps[picture, 1]) / (lamps[picture, 2] - lamps[picture, 1]))[:, None]
            value = sum(basis * one for basis, one in zip(lagrange_basis(_THREE_LAMPS, between), values, strict=True))
        return _over_flat_field(value, whole, blur)

    return _in_batches(read, tuple(jnp.asarray(a) for a in arrays), _READ)


def _over_flat_field(values: jax.Array, whole: jax.Array, blur: BlurTerms) -> jax.Array:
    """Divide records by the error of a flat field's, the last channel.

    That is done where the kernel is whole; the last channel is dropped.
    """
    values, flat = values[:, :-1], values[:, -1]
    if blur.blur.varies:
        return values  # each piece of surface is spread by its own kernel: a flat field need not read its radiance
    return values * jnp.where(whole, blur.weight / jnp.where(whole, flat, 1.0), 1.0)[:, None]


def _in_batches(function: Callable[..., jax.Array], arrays: tuple[jax.Array, ...], size: int) -> jax.Array:
    """Map over the leading axis in batches of one shape.

    So memory stays small. The last batch is padded.
    """
    count = arrays[0].shape[0]
    size = min(size, count)
    batches = -(-count // size)

    def split(array: jax.Array) -> jax.Array:
        padded = jnp.concatenate([array, jnp.broadcast_to(array[-1:], (batches * size - count, *array.shape[1:]))])
        return padded.reshape(batches, size, *array.shape[1:])

    out = jax.lax.map(lambda batch: function(*batch), tuple(split(a) for a in arrays))
    return out.reshape(-1, *out.shape[2:])[:count]
