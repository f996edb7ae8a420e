"""Record of a curved sample at given positions in its images: the operator behind tables and images.

A plan (`plan.py`) assigns an integral (`integrals.py`) to each position. Around each highlight the record is computed
on a grid and interpolated between its points. Where the kernel contains no end of the light, each integral is divided
by its record of a flat field, whose true value is known, so that quadrature errors cancel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.blur import BlurTerms, Imaging
from matcam.forward.integral.integrals import (
    HighlightPanels,
    WindowPanels,
    record_around,
    record_around_turned,
    record_in_window,
    record_inside,
)
from matcam.forward.integral.plan import IntegrationPlan, PlanPart, RecordPlaces
from matcam.forward.integral.rest_at_limb import LimbRule
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.material.material import Material
from matcam.numerics.approximation import POINTS, interpolated, lagrange_basis

_GRADED, _ORDER, _ORDER_FAINT = 6, 6, 4
_THREE_LAMPS = np.array([-1.0, 0.0, 1.0])
# Nodes along u and v of a window's panels
_WINDOW, _RIDGE_WINDOW, _WINDOW_OF_SEVERAL, _FAINT_WINDOW = (8, 8), (6, 7), (11, 11), (7, 7)
# positions that are computed at a time: their nodes fit into the cache of a processor
_INSIDE, _NODES, _READ = 4096, 128, 8192


def record(material: Material, imaging: Imaging, plan: IntegrationPlan) -> jax.Array:
    """Record a material at the positions of a plan.

    Args:
        material: the material.
        imaging: sample and blur, as in the plan or with slightly different parameters.
        plan: the plan.

    Returns:
        Radiance under unit irradiance, 1/sr, (places, channels). Differentiable in material, sample and blur.
    """
    subject = _Subject(material, imaging)
    return jnp.asarray(sum(_record_part(subject, part, plan.places) for part in plan.parts))


class _Subject(NamedTuple):
    """Material on a sample in front of a camera, under any lamp."""

    material: Material
    imaging: Imaging

    def under(self, lamp_angle: jax.Array, turn: Turn | None = None) -> Scene:
        return Scene(self.material, self.imaging.sample, lamp_angle, self.imaging.lamp_nearness, turn)

    def through(self, terms: tuple[int, ...]) -> BlurTerms:
        return BlurTerms(self.imaging.blur, terms)


def _record_part(subject: _Subject, part: PlanPart, places: RecordPlaces) -> jax.Array:
    """Dispatch each kind of position separately, so that they run in parallel."""
    records = [jnp.zeros((0, subject.under(jnp.zeros(())).channels()))]
    if part.inside.size:
        records.append(_record_inside(subject, part.terms, _at(places, part.inside)))
    if part.limb_rule is not None and part.limb.size:
        records.append(_record_at_limb(subject, part.limb_rule, _at(places, part.limb)))
    for window in part.windows:
        kernel = jnp.asarray(part.reach), jnp.asarray(part.cuts)
        panels = WindowPanels(*kernel, window.panels, window.ridge, _orders(subject, part, ridge=window.ridge))
        records.append(_record_in_window(subject, part.terms, panels, _at(places, window.index), window.whole))
    if part.near.size:
        order = _ORDER_FAINT if part.faint else _ORDER
        around = HighlightPanels(_GRADED, part.even, order, part.margin, part.shares)
        grid = _HighlightGrid(
            part.terms, part.steps, around, jnp.asarray(part.reach_in_focus), jnp.asarray(part.spacing)
        )
        lamps = jnp.asarray(part.lamps), None if part.turns is None else jnp.asarray(part.turns)
        picture = places.picture[part.near]
        records.append(_read_highlights(subject, grid, lamps, _at(places, part.near), picture, part.near_whole))
    return _in_order(records, part.place)


def _orders(subject: _Subject, part: PlanPart, *, ridge: bool) -> tuple[int, int]:
    """Choose the Gauss-Legendre nodes of the panels of a window along u and v."""
    if part.faint:
        return _FAINT_WINDOW
    if subject.imaging.blur.rest is None:
        return _RIDGE_WINDOW if ridge else _WINDOW
    # for terms of several widths, the window is that of the widest and the nodes are those of the narrowest
    return _WINDOW if len(part.terms) == 1 else _WINDOW_OF_SEVERAL


class _Pixels(NamedTuple):
    """Pixels and their lamps, arrays of shape (pixels,)."""

    x: AnyArray
    y: AnyArray
    lamp_angle: AnyArray
    turn: Turn | None


def _at(places: RecordPlaces, index: np.ndarray) -> _Pixels:
    turn = None if places.azimuth is None else places._replace(azimuth=places.azimuth[index]).turn
    return _Pixels(places.x[index], places.y[index], places.lamp_angle[index], turn)


def _in_order(records: list[jax.Array], place: np.ndarray) -> jax.Array:
    if all(map(is_concrete, records)) and jax.default_backend() == "cpu":
        nothing = np.zeros((1, records[0].shape[1]))  # without a program for each shape of an image
        return jnp.asarray(np.concatenate([*map(np.asarray, records), nothing])[place])
    return _in_order_compiled(records, place)


@jax.jit
def _in_order_compiled(records: list[jax.Array], place: np.ndarray) -> jax.Array:
    return jnp.concatenate([*records, jnp.zeros((1, records[0].shape[1]))])[place]


@kept_program
def _record_inside(subject: _Subject, terms: tuple[int, ...], pixels: _Pixels) -> jax.Array:
    def integral(at: _Pixels) -> jax.Array:
        scene = subject.under(jnp.asarray(at.lamp_angle), at.turn)
        return record_inside(scene, subject.through(terms), jnp.asarray(at.x), jnp.asarray(at.y))

    return in_batches(integral, (pixels,), _INSIDE)


@kept_program
def _record_at_limb(subject: _Subject, rule: LimbRule, pixels: _Pixels) -> jax.Array:
    def integral(at: _Pixels) -> jax.Array:
        return rule.record(subject.under(jnp.asarray(at.lamp_angle), at.turn), jnp.asarray(at.x), jnp.asarray(at.y))

    return in_batches(integral, (pixels,), _INSIDE)


@kept_program
def _record_in_window(
    subject: _Subject, terms: tuple[int, ...], panels: WindowPanels, pixels: _Pixels, whole: AnyArray
) -> jax.Array:
    def integral(at: _Pixels, whole: jax.Array) -> jax.Array:
        blur, scene = subject.through(terms), subject.under(jnp.asarray(at.lamp_angle), at.turn)
        recorded = record_in_window(scene, blur, jnp.asarray(at.x), jnp.asarray(at.y), panels)
        return _over_flat_field(recorded, whole, blur)

    return in_batches(integral, (pixels, whole), _NODES // panels.along_v)


class _HighlightGrid(NamedTuple):
    """Grid around each highlight; fields as in `PlanPart`."""

    terms: tuple[int, ...]
    steps: int
    panels: HighlightPanels
    reach: jax.Array
    spacing: jax.Array


@kept_program
def _read_highlights(
    subject: _Subject,
    grid: _HighlightGrid,
    lamps: tuple[jax.Array, jax.Array | None],
    pixels: _Pixels,
    *arrays: AnyArray,
) -> jax.Array:
    angles, azimuths = lamps
    columns, more = np.arange(-grid.steps, grid.steps + 1), grid.panels.margin
    # the plane of camera and lamp is a plane of symmetry, unless the pixel is turned or the lens is not even
    alike = azimuths is None and subject.imaging.blur.even
    rows = np.arange(-POINTS // 2, grid.steps + 1) if alike else columns
    beyond, above = (np.arange(points[0] - more, points[-1] + more + 1) for points in (columns, rows))
    sample, blur, nearness = subject.imaging.sample, subject.through(grid.terms), subject.imaging.lamp_nearness

    def stamp(lamp: tuple[jax.Array, Turn | None]) -> jax.Array:
        peak, turn = highlight_x(sample, lamp[0], nearness), lamp[1]
        if turn is None:
            x, y = peak + grid.spacing * beyond, grid.spacing * above
            return record_around(subject.under(lamp[0]), blur, x, y, grid.reach, grid.panels)
        x, y = peak * turn.cosine + grid.spacing * beyond, peak * turn.sine + grid.spacing * above
        return record_around_turned(subject.under(*lamp), blur, x, y, grid.reach, grid.panels)

    turns = None
    if azimuths is not None:
        every = jnp.repeat(azimuths, angles.shape[1])
        turns = Turn(jnp.cos(every), jnp.sin(every))
    stamps = jax.lax.map(stamp, (angles.ravel(), turns))

    def read(at: _Pixels, picture: jax.Array, whole: jax.Array) -> jax.Array:
        peak = highlight_x(sample, jnp.asarray(at.lamp_angle), nearness)
        if at.turn is None:
            row, column = jnp.abs(at.y) if alike else jnp.asarray(at.y), at.x - peak
        else:
            row, column = at.y - peak * at.turn.sine, at.x - peak * at.turn.cosine
        row, column = row / grid.spacing - rows[0], column / grid.spacing - columns[0]
        values = [interpolated(stamps, picture * angles.shape[1] + k, row, column) for k in range(angles.shape[1])]
        if len(values) == 1:
            value = values[0]
        else:  # a parabola through the three lamps
            between = (at.lamp_angle - angles[picture, 1]) / (angles[picture, 2] - angles[picture, 1])
            basis = lagrange_basis(_THREE_LAMPS, between[:, None])
            value = sum(own * one for own, one in zip(basis, values, strict=True))
        return _over_flat_field(value, whole, blur)

    return in_batches(read, (pixels, *arrays), _READ)


def _over_flat_field(values: jax.Array, whole: jax.Array, blur: BlurTerms) -> jax.Array:
    """Divide records by the relative error of a flat field, the last channel.

    The division applies where the kernel contains no end of the light. The last channel is removed.
    """
    values, flat = values[:, :-1], values[:, -1]
    if blur.blur.varies or blur.of_rest:
        return values  # each surface element has its own kernel: the record of a flat field need not equal its radiance
    return values * jnp.where(whole, blur.weight / jnp.where(whole, flat, 1.0), 1.0)[:, None]


def in_batches(function: Callable[..., jax.Array], arrays: tuple[Any, ...], size: int) -> jax.Array:
    """Map over the leading axis of all arrays in batches of one shape.

    This limits the memory. The last batch is padded.
    """
    arrays = jax.tree.map(jnp.asarray, arrays)
    count = jax.tree.leaves(arrays)[0].shape[0]
    size = min(size, count)
    batches = -(-count // size)

    def split(array: jax.Array) -> jax.Array:
        padded = jnp.concatenate([array, jnp.broadcast_to(array[-1:], (batches * size - count, *array.shape[1:]))])
        return padded.reshape(batches, size, *array.shape[1:])

    out = jax.lax.map(lambda batch: function(*batch), jax.tree.map(split, arrays))
    return out.reshape(-1, *out.shape[2:])[:count]
