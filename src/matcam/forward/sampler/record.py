"""Record of a sample at given positions in its images, from which tables and images are computed (docs/model.md 2, 3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, computes_on_gpu, is_concrete, jax, jnp, transferred
from matcam.core.programs import kept_program
from matcam.core.threads import available_cores, in_order
from matcam.forward.integral.blur import Imaging
from matcam.forward.integral.residual_at_limb import LimbRule
from matcam.forward.integral.scene import Scene, Turn
from matcam.forward.sampler.arc_rules import MOST_NODES, arc_rules
from matcam.forward.sampler.circle_arcs import CircleArcs
from matcam.forward.sampler.cylinder_arcs import CrossArcs
from matcam.forward.sampler.plan import ArcRows, PlanPart, RecordPlan, RecordPositions
from matcam.forward.sampler.smooth_light import record_inside
from matcam.material.material import Material
from matcam.material.tabulated_masking import with_tabulated_masking
from matcam.numerics.blocks import in_blocks, repeated_sum, shaped

_BLOCKS, _ARCS, _SMOOTH = 32, 512, 256
"""Number of blocks of a tile, and numbers of arcs and of pixels with smooth radiance in a block, on a processor. The arrays
of a block fit into its cache.
"""
_ROWS_ON_GPU = 1 << 20
"""Rows of a tile on a GPU, in a single block. All rows of a block are computed in parallel."""
_RULES = 32, MOST_NODES
"""Largest numbers of nodes on an arc. A program skips unused nodes, so one program serves all arcs, except for derivatives,
which require all nodes.
"""


class Subject(NamedTuple):
    """Material on a sample in front of a camera, under any lamp.

    Attributes:
        material: the material.
        imaging: sample, blur and inverse distance of the lamp.
        turning: offset of all lamp angles, rad.
    """

    material: Material
    imaging: Imaging
    turning: jax.Array

    @property
    def known(self) -> bool:
        """True if all parameters are concrete, which excludes differentiation."""
        return all(map(is_concrete, jax.tree.leaves(tuple(self))))

    def through(self, terms: tuple[int, ...]) -> Subject:
        """Restrict the blur to some of its terms."""
        return self._replace(imaging=self.imaging._replace(blur=self.imaging.blur.only(terms)))

    def under(self, lamp_angle: AnyArray, turn: Turn | None = None) -> Scene:
        """Build the scene under lamps. lamp_angle: angle between lamp and optical axis, rad."""
        angle = jnp.asarray(lamp_angle) + self.turning
        return Scene(self.material, self.imaging.sample, angle, self.imaging.lamp_nearness, turn)


def record(material: Material, imaging: Imaging, plan: RecordPlan, turning: jax.Array | float = 0.0) -> jax.Array:
    """Compute the record of a material at the positions of a plan.

    Args:
        material: the material.
        imaging: sample and blur, as in the plan or with slightly different parameters.
        plan: the plan.
        turning: small offset of all lamp angles, rad. Default: 0.

    Returns:
        Radiance under unit irradiance, 1/sr, (positions, channels). It is differentiable in the parameters of material,
        sample and blur, and in `turning`.
    """
    subject = Subject(with_tabulated_masking(material), imaging, jnp.asarray(turning, dtype=float))
    shape = plan.positions.x.size, subject.under(jnp.zeros(())).channels()
    on_gpu = computes_on_gpu()
    if subject.known and not on_gpu:  # NumPy adds in place, and the threads wait for their programs
        tiles = _tiles(plan, False, _RULES[-1:])
        found = in_order(lambda tile: jax.device_get(_recorded(subject, tile())), tiles, available_cores())
        return jnp.asarray(_added_by_numpy(shape, found))
    tiles = _tiles_on_gpu(plan) if subject.known else _tiles(plan, on_gpu, _RULES)
    return _added_by_jax(shape, in_order(lambda tile: _recorded(subject, tile()), tiles, 1))


class _Tile(NamedTuple):
    """Rows that one call of a program computes: arcs, or pixels without arcs.

    Attributes:
        terms: indices of the terms of the blur.
        position: index of the position of each row.
        used: number of blocks with rows.
        rows: the rows, in arrays of shape (blocks, rows).
        counts: number of nodes on each arc of a block, (blocks,); None: the rows are pixels.
        rules: Gauss-Legendre rules or midpoint rules for arcs; for pixels, the rule for the residual of a lens at the limb,
            or None.
    """

    terms: tuple[int, ...]
    position: AnyArray
    used: AnyArray
    rows: Any
    counts: AnyArray | None
    rules: Any


def _tiles(plan: RecordPlan, on_gpu: bool, lengths: tuple[int, ...]) -> list[Callable[[], _Tile]]:
    """List the tiles of a plan, as functions that build them.

    The rows of all tiles together would occupy several GB. lengths: largest numbers of nodes on an arc, with a program
    for each.
    """
    pixels, arcs = ((1, _ROWS_ON_GPU),) * 2 if on_gpu else ((_BLOCKS, _SMOOTH), (_BLOCKS, _ARCS))
    tiles: list[Callable[[], _Tile]] = []
    for part in plan.parts:
        for index, rule in ((part.smooth, None), (part.limb, part.limb_rule)):
            some = (index[begin : begin + math.prod(pixels)] for begin in range(0, index.size, math.prod(pixels)))
            tiles += [partial(_pixel_tile, plan.positions, part.terms, rule, one, pixels) for one in some]
        for even, own in enumerate((part.arcs, part.even_arcs)):
            parts = (slice(begin, begin + math.prod(arcs)) for begin in range(0, own.position.size, math.prod(arcs)))
            tiles += [partial(_arc_tile, plan.positions, part, own.at(one), arcs, lengths, bool(even)) for one in parts]
    return tiles


@lru_cache(maxsize=1)
def _tiles_on_gpu(plan: RecordPlan) -> list[Callable[[], _Tile]]:
    """Transfer all tiles of a plan to the GPU once, because the transfer takes longer than the computation."""
    return [partial(lambda tile: tile, transferred(tile())) for tile in _tiles(plan, True, _RULES[-1:])]


def _pixel_tile(
    positions: RecordPositions,
    terms: tuple[int, ...],
    rule: LimbRule | None,
    index: np.ndarray,
    shape: tuple[int, int],
) -> _Tile:
    pixels = positions.at(index)
    used, rows = shaped((*pixels[:3], pixels.turn), *shape)
    return _Tile(terms, index, used, rows, None, rule)


def _arc_tile(
    positions: RecordPositions,
    part: PlanPart,
    own: ArcRows | CrossArcs,
    shape: tuple[int, int],
    lengths: tuple[int, ...],
    even: bool,
) -> _Tile:
    """Collect arcs with the pixels to whose records they contribute.

    lengths: see `_tiles`. even: True for arcs with equally spaced nodes.
    """
    pixels = positions.at(own.position)
    arcs = own if isinstance(own, CrossArcs) else own.on_circles(part.frames)
    used, rows = shaped(_ArcInputs(*pixels[:3], pixels.turn, arcs), *shape)
    counts = np.resize(own.nodes, shape).max(axis=1)
    rules = arc_rules(even, next(most for most in lengths if counts.max() <= most))
    return _Tile(part.terms, own.position, used, rows, counts, rules)


def _recorded(subject: Subject, tile: _Tile) -> tuple[AnyArray, Any]:
    subject, used = subject.through(tile.terms), tile.used if subject.known else None
    if tile.counts is None:
        values = _smooth_blocks(subject, tile.rules, used, tile.rows)
    else:
        values = _arc_blocks(subject, used, tile.counts, tile.rules, tile.rows)
    return tile.position, values


def _added_by_numpy(shape: tuple[int, int], found: Iterable[tuple[AnyArray, Any]]) -> np.ndarray:
    """Add the values of all tiles to the records of their positions. shape: (positions, channels)."""
    total = np.zeros(shape, order="F")
    for position, values in found:
        own = values.reshape(-1, shape[1])[: position.size]
        for column, value in zip(total.T, own.T, strict=True):
            np.add.at(column, position, value)
    return total


def _added_by_jax(shape: tuple[int, int], found: Iterable[tuple[AnyArray, Any]]) -> jax.Array:
    """Compute the results of `_added_by_numpy` on a GPU, or for differentiation."""
    total = jnp.zeros(shape)
    for position, values in found:
        total = _with_tile(total, position, values)
    return total


@jax.jit
def _with_tile(total: jax.Array, position: jax.Array, values: jax.Array) -> jax.Array:
    return total.at[position].add(values.reshape(-1, total.shape[1])[: position.size])


@kept_program
def _smooth_blocks(subject: Subject, rule: LimbRule | None, used: Any, rows: Any) -> jax.Array:
    def block(arguments: Any) -> jax.Array:
        x, y, lamp_angle, turn = arguments
        scene = subject.under(lamp_angle, turn)
        return record_inside(scene, subject.imaging.blur, x, y) if rule is None else rule.record(scene, x, y)

    return in_blocks(block, used, rows)


class _ArcInputs(NamedTuple):
    """Arcs, and the pixel of each arc; see `RecordPositions`. All arrays have the same shape."""

    x: AnyArray
    y: AnyArray
    lamp_angle: AnyArray
    turn: Turn | None
    arcs: CircleArcs | CrossArcs


@kept_program(runs="mostly")
def _arc_blocks(subject: Subject, used: Any, counts: Any, rules: Any, rows: _ArcInputs) -> jax.Array:
    sample, blur = subject.imaging.sample, subject.imaging.blur

    def block(arguments: Any) -> jax.Array:
        count, pixels, directions, towards_lamp = arguments
        scene = replace(subject.under(pixels.lamp_angle, pixels.turn), towards_lamp=towards_lamp)

        def seen(rule: tuple[jax.Array, jax.Array]) -> jax.Array:
            node, share = rule
            element, weight = pixels.arcs.element(sample, node, directions)
            at_x, at_y = scene.on_sensor(element.x, element.y)
            x, y = pixels.x - at_x, pixels.y - at_y
            spread = blur.spread(sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
            at = blur.across if scene.uniform_rows else partial(blur.at, y=y)
            terms = (blur.share(one) * at(one, spread, x) for one in blur.terms)
            return scene.sent(element) * (sum(terms, jnp.zeros(())) * weight * share)[:, None]

        nothing = jnp.zeros((pixels.x.size, scene.channels()))
        return repeated_sum(seen, None if used is None else count, tuple(rules[:, count]), nothing)

    # XLA would compute functions of the arcs again for every node if they were computed inside the blocks
    lamp_angle = rows.lamp_angle + subject.turning
    each = counts, rows, rows.arcs.directions(), (jnp.sin(lamp_angle), jnp.cos(lamp_angle))
    return in_blocks(block, used, each)
