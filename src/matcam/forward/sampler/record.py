"""Record of a sample at given positions in its images, from which tables and images are computed (docs/model.md 2, 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.core.threads import available_cores, in_order
from matcam.forward.integral.blur import BlurTerms, Imaging
from matcam.forward.integral.residual_at_limb import LimbRule
from matcam.forward.integral.scene import Scene, Turn
from matcam.forward.sampler.circle_arcs import CircleArcs
from matcam.forward.sampler.cylinder_arcs import CrossArcs
from matcam.forward.sampler.gauss_rules import MOST_NODES, gauss_rules
from matcam.forward.sampler.plan import PlanPart, RecordPlan, RecordPositions
from matcam.forward.sampler.smooth_light import record_inside
from matcam.material.material import Material
from matcam.numerics.blocks import in_blocks, repeated_sum, shaped

_BLOCKS, _ARCS, _SMOOTH = 32, 512, 256
"""Number of blocks of one call, and numbers of arcs and of pixels with smooth radiance in a block. The arrays of a block fit
into the cache of a processor.
"""
_RULES = 32, MOST_NODES
"""Largest numbers of nodes on an arc, with a program for each. A program skips unused nodes."""


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
        """Check whether all parameters are concrete, which excludes differentiation."""
        return all(map(is_concrete, jax.tree.leaves(tuple(self))))

    def computed(self, values: jax.Array) -> Any:
        """Convert values to an array of NumPy, unless parameters are traced."""
        return np.asarray(values) if self.known else values

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
        Radiance under unit irradiance, 1/sr, (positions, channels). Differentiable in material, sample, blur and turning.
    """
    subject = Subject(material, imaging, jnp.asarray(turning, dtype=float))
    calls: list[_Call] = []
    for part in plan.parts:
        blur = BlurTerms(imaging.blur, part.terms)
        for index, rule in ((part.smooth, None), (part.limb, part.limb_rule)):
            calls += [
                partial(_record_smooth, subject, blur, rule, plan.positions, index[begin : begin + _BLOCKS * _SMOOTH])
                for begin in range(0, index.size, _BLOCKS * _SMOOTH)
            ]
        calls += [
            partial(_record_arcs, subject, blur, plan.positions, part, slice(begin, begin + _BLOCKS * _ARCS))
            for begin in range(0, part.arcs.position.size, _BLOCKS * _ARCS)
        ]
    total: Any = np.zeros((plan.positions.x.size, subject.under(jnp.zeros(())).channels()))
    for position, values in in_order(lambda call: call(), calls, available_cores() if subject.known else 1):
        total = _added(total, position, values.reshape(-1, total.shape[1])[: position.size])
    return jnp.asarray(total)


_Call = Callable[[], tuple[np.ndarray, Any]]
"""Function that returns indices of pixels, and values to be added to their records, (blocks, rows, channels)."""


def _added(total: Any, position: np.ndarray, values: Any) -> Any:
    """Add values, (rows, channels), to the records of pixels."""
    if not is_concrete(values):
        return jnp.asarray(total).at[position].add(values)
    columns = (np.bincount(position, column, total.shape[0]) for column in np.asarray(values).T)
    return total + np.stack(list(columns), axis=-1)


def _record_smooth(
    subject: Subject, blur: BlurTerms, rule: LimbRule | None, positions: RecordPositions, index: np.ndarray
) -> tuple[np.ndarray, Any]:
    """Compute the record of pixels with smooth radiance, or at the limb with a rule for the residual of a lens."""
    pixels = positions.at(index)
    used, rows = shaped((*pixels[:3], pixels.turn), _BLOCKS, _SMOOTH)
    return index, subject.computed(_smooth_blocks(subject, blur, rule, used if subject.known else None, rows))


@kept_program
def _smooth_blocks(subject: Subject, blur: BlurTerms, rule: LimbRule | None, used: Any, rows: Any) -> jax.Array:
    def block(arguments: Any) -> jax.Array:
        x, y, lamp_angle, turn = arguments
        scene = subject.under(lamp_angle, turn)
        return record_inside(scene, blur, x, y) if rule is None else rule.record(scene, x, y)

    return in_blocks(block, used, rows)


class _ArcInputs(NamedTuple):
    """Arcs with the pixels that they belong to, arrays of one shape; see `RecordPositions`."""

    x: AnyArray
    y: AnyArray
    lamp_angle: AnyArray
    turn: Turn | None
    arcs: CircleArcs | CrossArcs


def _record_arcs(
    subject: Subject, blur: BlurTerms, positions: RecordPositions, part: PlanPart, some: slice
) -> tuple[np.ndarray, Any]:
    """Compute the contributions of some arcs to the records of their pixels."""
    own = part.arcs.at(some)
    pixels = positions.at(own.position)
    arcs = own if isinstance(own, CrossArcs) else own.on_circles(part.frames)
    used, rows = shaped(_ArcInputs(*pixels[:3], pixels.turn, arcs), _BLOCKS, _ARCS)
    counts = np.resize(own.nodes, _BLOCKS * _ARCS).reshape(_BLOCKS, _ARCS).max(axis=1)
    rules = next(rules for rules in map(gauss_rules, _RULES) if counts.max() < rules.shape[1])
    values = _arc_blocks(subject, blur, used if subject.known else None, counts, rules, rows)
    return own.position, subject.computed(values)


@kept_program
def _arc_blocks(subject: Subject, blur: BlurTerms, used: Any, counts: Any, rules: Any, rows: _ArcInputs) -> jax.Array:
    sample, kernel = subject.imaging.sample, blur.blur

    def block(arguments: Any) -> jax.Array:
        count, pixels, directions, towards_lamp = arguments
        scene = replace(subject.under(pixels.lamp_angle, pixels.turn), towards_lamp=towards_lamp)

        def seen(rule: tuple[jax.Array, jax.Array]) -> jax.Array:
            """Compute the contribution of one node of each arc to the record of its pixel."""
            node, share = rule
            element, weight = pixels.arcs.element(sample, node, directions)
            at_x, at_y = scene.on_sensor(element.x, element.y)
            x, y = pixels.x - at_x, pixels.y - at_y
            spread = kernel.spread(sample, element.normal[2], scene.lamp_angle, scene.lamp_nearness)
            at = kernel.across if scene.uniform_rows else partial(kernel.at, y=y)
            terms = (kernel.share(one) * at(one, spread, x) for one in blur.terms)
            return scene.sent(element) * (sum(terms, jnp.zeros(())) * weight * share)[:, None]

        nothing = jnp.zeros((pixels.x.size, scene.channels()))
        return repeated_sum(seen, None if used is None else count, tuple(rules[:, count]), nothing)

    # XLA would compute functions of the arcs again for every node if they were computed inside the blocks
    lamp_angle = rows.lamp_angle + subject.turning
    each = counts, rows, rows.arcs.directions(), (jnp.sin(lamp_angle), jnp.cos(lamp_angle))
    return in_blocks(block, used, each)
