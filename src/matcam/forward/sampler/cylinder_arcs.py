"""Arcs across a cylinder: parts of image rows inside the window of a pixel and between limb and terminator.

On a sphere, an arc is a part of a circle of normals. On a cylinder, a row of the image is such a circle. The left and right
side of the window, limb and terminator bound one arc on the row, in closed form. In a distant rig the radiance is the same
in all rows, so one row suffices. Otherwise, rows become denser towards the highlight. Both the angle u of the normals and
the position of the rows are substituted:

    u = centre + scale sinh(t).

The radiance of a lobe is smooth in t. For u, the centre is the angle at which the normal is closest to the half vector. For
the rows, u is replaced by the row, and the centre is the row of the highlight. If limb or terminator lies in the window,
masking varies on the scale of the lobe there, so a separate arc begins at that end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.arrays.elementary import cosine
from matcam.core.jax import AnyArray, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.blur import Imaging
from matcam.forward.sampler.arc_rules import MOST_NODES, arc_rules
from matcam.forward.sampler.cylinder_ridge import (
    PlacedLamps,
    ends_of_light,
    mirror_row,
    ridge_of,
    turn_along,
)
from matcam.forward.sampler.windows import Windows
from matcam.numerics.blocks import in_blocks, in_calls
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Element

_AWAY = 0.9
"""Smallest angle from the half vector at which the radiance is smooth on the scale of the kernel, relative to the angle
that corresponds to `BlurScale.near`.
"""


_COUNTS = {False: (5.0, 2.5, 12.0), True: (2.0, 1.5, 8.0)}
"""Numbers of nodes on an arc of Gauss-Legendre rules, and of midpoint rules (True, see `arc_nodes`): minimum, additional nodes
per unit of t, and additional nodes across a window whose kernel has the fineness 1.
"""


class CrossArcs(NamedTuple):
    """Arcs across a cylinder in ascending order of their numbers of nodes, arrays over (arcs,).

    Attributes:
        nodes: number of nodes.
        position: index of the pixel.
        row: row of the image, px.
        weight: weight of the row, px, times half the length of the arc in t; no unit where all rows are equal.
        centre: angle of the normal at which t is 0, rad.
        scale: scale of the substitution, rad.
        middle: t of the middle of the arc.
        half: half the length of the arc in t.
    """

    nodes: np.ndarray
    position: np.ndarray
    row: np.ndarray
    weight: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    middle: np.ndarray
    half: np.ndarray

    def at(self, index: np.ndarray | slice) -> CrossArcs:
        return CrossArcs(*(a[index] for a in self))

    def directions(self) -> tuple[()]:
        """Return an empty tuple, because one angle specifies the normal of a cylinder."""
        return ()

    def element(self, sample: Cylinder, node: jax.Array, _: tuple[()] = ()) -> tuple[Element, AnyArray]:
        """Compute the surface element at a node in [-1, 1] on each arc, and the weight of its radiance."""
        t = jnp.asarray(self.middle) + self.half * node
        grown, inverse = jnp.exp(t), jnp.exp(-t)
        u = jnp.asarray(self.centre) + self.scale * (grown - inverse) / 2
        per_px = (1 - sample.nearness * cosine(jnp.abs(u))) / sample.stretch
        element = sample.surface(u, jnp.asarray(self.row) * per_px)
        return element, self.weight * self.scale * (grown + inverse) / 2 * per_px


def smooth_on_cylinder(imaging: Imaging, windows: Windows, near: float) -> np.ndarray:
    """Find the pixels of a cylinder in whose windows the radiance is smooth on the scale of the kernel.

    Args:
        imaging: cylinder, blur and inverse distance of the lamp.
        windows: windows of the pixels.
        near: distance from a highlight within which a lobe may be narrow on the scale of the kernel, px.
    """
    inside, away, turn = _around(imaging, windows)[:3]
    return inside & (away > _AWAY * near * turn)


def arcs_across(
    imaging: Imaging, windows: Windows, fineness: float, finest: float, elongation: float
) -> tuple[CrossArcs, CrossArcs]:
    """Compute the arcs in the windows of pixels, with Gauss-Legendre and with equally spaced nodes (`PlanPart`).

    Args:
        imaging: cylinder, blur and inverse distance of the lamp.
        windows: windows of the pixels.
        fineness: factor of the number of nodes across a window, see `BlurScale`.
        finest: narrowest scale of the lobe, rad.
        elongation: elongation of the lobe, no unit.
    """
    count = windows.x.size
    if not count:
        nothing = np.zeros(0)
        return (CrossArcs(nothing.astype(int), nothing.astype(int), *[nothing] * 6),) * 2
    row, weight, which = windows.y, np.ones(count), np.arange(count)
    if not (imaging.sample.distant and imaging.lamp_nearness is None):
        *_, mirror, along = _around(imaging, windows)
        low, high = windows.y - windows.half[1], windows.y + windows.half[1]
        middle = np.clip(mirror, low, high)
        narrow = np.hypot(finest, along * (middle - mirror) / elongation) / np.maximum(along, 1e-300)
        spans = _Spans.of(middle, np.minimum(narrow, 1e9), low, high)  # rows with this scale, px, are not graded
        row, weight, which = spans.nodes(spans.counts(high - low, fineness, True))
    first, last, low, high, ridge, miss = in_calls(_arc_blocks, (*_columns(windows.at(which)), row), imaging)
    middle = np.clip(ridge, first, last)
    narrow = np.sqrt(finest**2 + (miss**2 + (middle - ridge) ** 2) / elongation**2)
    # a separate arc begins at each end of the lit part
    starts, ends = first <= low, last >= high
    before, after = middle - first, last - middle
    narrow = np.where(starts, np.minimum(narrow, np.hypot(finest, before)), narrow)
    narrow = np.where(ends, np.minimum(narrow, np.hypot(finest, after)), narrow)
    left, right = np.where(starts, first + before / 2, first), np.where(ends, last - after / 2, last)
    scales = np.full(row.size, finest)
    inner = ~starts & ~ends
    parts = (
        (False, _Spans.of(first, scales, first, left)),
        (False, _Spans.of(middle, narrow, left, np.where(inner, left, right))),
        (False, _Spans.of(last, scales, right, last)),
        (True, _Spans.of(middle, narrow, left, np.where(inner, right, left))),
    )
    found = []
    for evenly, spans in parts:
        some = np.flatnonzero(spans.half > 0)
        spans, width = spans.at(some), (last - first)[some]
        nodes = spans.counts(width, fineness, evenly)
        found.append(
            (
                nodes,
                which[some],
                row[some],
                weight[some] * spans.half,
                spans.centre,
                spans.scale,
                spans.middle,
                spans.half,
            )
        )
    arcs = CrossArcs(*(np.concatenate(a) for a in zip(*found[:-1], strict=True))), CrossArcs(*found[-1])
    ordered, even = (one.at(np.argsort(one.nodes, kind="stable")) for one in arcs)
    return ordered, even


class _Spans(NamedTuple):
    """Intervals of a substituted variable, arrays over (spans,); see `CrossArcs`."""

    centre: np.ndarray
    scale: np.ndarray
    middle: np.ndarray
    half: np.ndarray

    @classmethod
    def of(cls, centre: np.ndarray, scale: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Spans:
        first, last = (np.arcsinh((end - centre) / scale) for end in (low, high))
        return cls(centre, scale, (first + last) / 2, (last - first) / 2)

    def at(self, index: np.ndarray) -> _Spans:
        return _Spans(*(a[index] for a in self))

    def counts(self, width: np.ndarray, fineness: float, evenly: bool) -> np.ndarray:
        """Choose the number of nodes in each interval.

        width: width of the window, in the unit of `scale`. evenly: True for a midpoint rule.
        """
        steepest = self.scale * np.cosh(np.abs(self.middle) + self.half)
        least, graded, across = _COUNTS[evenly]
        needed = least + 2 * self.half * (graded + across * fineness * steepest / np.maximum(width, 1e-300))
        return np.minimum(2 * np.ceil(needed / 2), MOST_NODES).astype(int)

    def nodes(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute positions and weights of the nodes of midpoint rules, and the indices of their intervals."""
        which = np.repeat(np.arange(counts.size), counts)
        number = np.arange(which.size) - np.repeat(np.cumsum(counts) - counts, counts)
        node, share = arc_rules(True, MOST_NODES)[:, counts[which], number]
        centre, scale, middle, half = (a[which] for a in self)
        t = middle + half * node
        return centre + scale * np.sinh(t), share * half * scale * np.cosh(t), which


def _around(imaging: Imaging, windows: Windows) -> tuple[np.ndarray, ...]:
    """Compute properties of the radiance in the windows of pixels.

    Returns:
        True if neither limb nor terminator is in the window; smallest angle between normal and half vector, rad; largest
        rotation of normal or half vector, rad/px; row of the highlight, px; and rotation of the half vector along the
        axis of the cylinder, rad/px.
    """
    if not windows.x.size:
        return (np.zeros(0, dtype=bool), *[np.zeros(0)] * 4)
    return in_calls(_around_blocks, (*_columns(windows), windows.y), imaging)


def _columns(windows: Windows) -> tuple[np.ndarray, ...]:
    """List x and half side along x, px, lamp angle, rad, and cosine and sine of the lamp azimuth."""
    return windows.x, windows.half[0], windows.lamp, windows.cosine, windows.sine


@kept_program
def _around_blocks(used: jax.Array, rows: tuple[jax.Array, ...], imaging: Imaging) -> tuple[jax.Array, ...]:
    cylinder: Cylinder = imaging.sample  # type: ignore[assignment]

    def block(arguments):  # type: ignore[no-untyped-def]
        x, reach, *lamp, y = arguments
        light, low, high, first, last = _interval(imaging, x, reach, lamp)
        inside = (jnp.abs(x) + reach < cylinder.radius) & (first > low) & (last < high)
        mirror = mirror_row(cylinder, light, low, high)
        row = jnp.clip(mirror, y - reach, y + reach)
        peak, miss = ridge_of(cylinder, light, row, low, high)
        nearest = jnp.clip(peak, first, last)
        away = jnp.hypot(miss, jnp.sin(nearest - peak))
        u = cylinder.across(x, jnp.zeros_like(x))
        q, cosine = cylinder.nearness, jnp.cos(u)
        turn = (1 - q * cosine) ** 2 / (cylinder.stretch * jnp.maximum(cosine - q, 1e-9))
        turn = jnp.maximum(turn, turn_along(cylinder, light, u, row))
        return inside, away, turn, mirror, turn_along(cylinder, light, nearest, row)

    return in_blocks(block, used, rows)


@kept_program
def _arc_blocks(used: jax.Array, rows: tuple[jax.Array, ...], imaging: Imaging) -> tuple[jax.Array, ...]:
    cylinder: Cylinder = imaging.sample  # type: ignore[assignment]

    def block(arguments):  # type: ignore[no-untyped-def]
        x, reach, *lamp, row = arguments
        light, low, high, *window = _interval(imaging, x, reach, lamp)
        first, last = (jnp.clip(u, low, high) for u in window)
        return first, last, low, high, *ridge_of(cylinder, light, row, low, high)

    return in_blocks(block, used, rows)


def _interval(
    imaging: Imaging, x: jax.Array, reach: jax.Array, lamp: list[jax.Array]
) -> tuple[PlacedLamps, jax.Array, jax.Array, jax.Array, jax.Array]:
    """Compute the lamps of pixels, and four angles u, rad: both ends of the lit part and both sides of the window."""
    cylinder: Cylinder = imaging.sample  # type: ignore[assignment]
    light = _lamps(imaging, *lamp)
    first, last = (cylinder.across(x + side * reach, jnp.zeros_like(x)) for side in (-1, 1))
    return light, *ends_of_light(cylinder, light), first, last


def _lamps(imaging: Imaging, angle: jax.Array, cosine: jax.Array, sine: jax.Array) -> PlacedLamps:
    near, across = imaging.lamp_nearness, jnp.sin(angle)
    towards = across * cosine, across * sine, jnp.cos(angle)
    return PlacedLamps(towards, None if near is None else jnp.full_like(angle, near))
