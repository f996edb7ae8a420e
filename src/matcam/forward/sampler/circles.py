"""Circles of normals along which the record of a window is integrated (docs/forward.md).

The radiance of a lobe depends mainly on the angle from the normal of the highlight. Circles about this normal therefore
resolve a highlight of any width if they become denser towards the normal. Far from the highlight, the shape of the window
on the sphere matters more: near the limb the window is a narrow strip. The axis of the circles is then perpendicular to the
strip and to the optical axis. The circles run along the strip, and cross limb and terminator at large angles.

The angles theta of the circles from the axis are nodes of a quadrature rule (`arc_rules`) in

    t(theta) = 3 asinh(theta / scale) + theta / pitch.

Far from the axis, the distance between neighbouring nodes is proportional to `pitch`, rad. The nodes become denser towards
the axis down to an angle of `scale`, rad.

At a circle that touches limb or terminator, the length of the arcs has a square-root singularity in theta. Another
substitution removes the singularity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.sampler.arc_rules import arc_rule
from matcam.forward.sampler.arcs import Arcs, Clips, Frame, gaps_of
from matcam.forward.sampler.windows import SphereView, Windows
from matcam.numerics.blocks import in_blocks, in_calls

_GRADED = 3.0
"""Number of nodes per unit of ln(theta) towards the highlight."""
_ACROSS = 14.0
"""Number of nodes across a window whose kernel has the fineness 1."""
_MORE, _MORE_AT_TOUCH = 6, 4
"""Number of additional nodes of every span, and of a span near a circle that touches limb or terminator."""
_EVENLY, _MORE_EVENLY = 0.75, 2
"""Number of nodes of a midpoint rule relative to `_ACROSS` and `_GRADED`, and number of additional nodes. A Gaussian of 0.5
px with a pixel of 1 px then has a step of 1.2 standard deviations, with an error of 1e-6.
"""
COARSEST = 0.2
"""Largest scale of the grading towards the highlight, px at the centre of the sphere."""
_FAR = 1 / 8
"""Distance from the highlight, in lengths of the window on the sphere, beyond which the radiance is smooth along the window."""
_STRIP = 2.0
"""Ratio of length to width of a window on the sphere above which it is a strip."""
_FORESHORTENED = 1.5
"""Ratio of the largest angle from the highlight to the angle up to which circles touch the sides of a strip. Above this
ratio, both ranges of angles have separate nodes.
"""
_NEAR_TOUCH = 0.5
"""Distance of a touching circle from a span, in lengths of the span, below which the circle affects the nodes."""
_SLACK, _SLACK_AT_END = 0.02, 0.25
"""Shares by which the range of angles on the border of a window is widened, without and with limb or terminator in the
window. In the second case, the range is then narrowed to the circles with arcs.
"""
_PROBES = (1 - np.cos(np.pi * np.arange(25) / 24)) / 2
"""Positions in a range of angles at which circles with arcs are searched for, denser towards the ends."""
_AT_END = 1e-3
"""Upper limit of cos theta_i or cos theta_o at which a normal on the border of a window counts as a normal of terminator or
limb.
"""
_EQUAL = 1e-9
"""Difference of angles, rad, below which they are equal."""


class Circles(NamedTuple):
    """Circles of some windows, arrays of shape (circles,).

    Attributes:
        window: index of the window.
        angle: angle from the axis, rad.
        weight: weight in the integral over normals, rad, including the sine of the angle.
    """

    window: np.ndarray
    angle: np.ndarray
    weight: np.ndarray


class CircleLayout(NamedTuple):
    """Circles and arcs of some windows.

    Attributes:
        frame: frame of the circles of each window, arrays of shape (3, windows).
        highlight: smallest angle between the highlight and a window whose circles have another axis than the highlight,
            rad; infinite for windows with circles about the highlight.
        circles: the circles.
        arcs: their arcs.
    """

    frame: Frame
    highlight: np.ndarray
    circles: Circles
    arcs: Arcs


class _Spans(NamedTuple):
    """Ranges of the angle with smooth integrands, arrays of shape (spans,).

    Attributes:
        window: index of the window.
        low: smallest angle, rad.
        high: largest angle, rad.
        scale: scale of the grading, rad.
        pitch: distance of the nodes far from the highlight, rad.
        before: angle of a touching circle at or below `low`, rad; NaN: none nearby.
        after: angle of a touching circle at or above `high`, rad; NaN: none nearby.
    """

    window: np.ndarray
    low: np.ndarray
    high: np.ndarray
    scale: np.ndarray
    pitch: np.ndarray
    before: np.ndarray
    after: np.ndarray


def lay_circles(view: SphereView, windows: Windows, finest: float, fineness: float) -> CircleLayout:
    """Compute the circles of at most `arcs.CHUNK` windows, and their arcs.

    Args:
        view: radius of the sphere, and inverse distances of camera and lamp.
        windows: the windows.
        finest: narrowest scale of the lobe, rad.
        fineness: factor of the number of nodes across a window, see `BlurScale`.
    """
    border = windows.border(view)
    limb, terminator = ends_inside(view, windows, border)
    ends = limb | terminator
    about, across = about_highlight(windows), _across_radius(windows)
    peak = about.axis
    inside = windows.contains(view, peak)
    nearest, farthest = windows.extremes(view, border, from_highlight)
    nearest = np.where(inside, 0.0, nearest)
    polar = angles_from_axis(across, border)
    first, last = polar.min(-1), polar.max(-1)
    along = np.arctan2(_dot(across.second, border), border[2])
    length, width = np.ptp(along, axis=-1), last - first
    strip = ((length > _STRIP * width) | ends) & (nearest > _FAR * np.maximum(length, width))
    frame = Frame(*(np.where(strip, b, a) for a, b in zip(about, across, strict=True)))
    low, high = np.where(strip, first, nearest), np.where(strip, last, farthest)
    slack = np.where(ends, _SLACK_AT_END, _SLACK) * (high - low)
    low, high = np.where(low > 0, np.maximum(low - slack, 0.0), 0.0), np.minimum(high + slack, np.pi)
    clips = Clips.of(windows.half_spaces(view), frame)
    low, high = _with_arcs(clips, low, high, ends)

    # up to this angle, circles about the highlight touch the sides of a strip; at larger angles they cross the strip
    peak_polar = np.arccos(np.clip(_dot(across.axis, peak), -1, 1))
    side = np.maximum(np.abs(last - peak_polar), np.abs(first - peak_polar))
    both = ~strip & (low < side) & (high > _FORESHORTENED * side)
    nodes = _ACROSS * fineness
    ratio = np.where(~strip & (low < side), np.clip((high - low) / width, 1, 2), 1.0)
    pitches = np.where(both, width, (high - low) / ratio) / nodes, (high - side) / nodes
    scale = np.where(strip, 1e3, min(COARSEST / view.radius, finest))  # nodes along a strip are not graded
    touching = np.where(ends[:, None], touching_angles(view, windows, frame), np.nan)
    spans = _spans(np.where(both, side, np.nan), touching, (low, high), scale, pitches)
    # the integrand vanishes at both ends of the range, unless the highlight, a terminator or a touching limb is there
    circles = _nodes(spans, (low > 0) & ~terminator & (strip | ~limb))
    arcs = Arcs.of(*gaps_of(clips, circles.window, circles.angle))
    return CircleLayout(frame, np.where(strip, nearest, np.inf), circles, arcs)


def ends_inside(view: SphereView, windows: Windows, border: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Check whether limb and terminator may be in each window. border: normals along the borders of the windows."""
    limb, terminator = (np.any(above < _AT_END, axis=1) for above in above_ends(view, windows, border))
    return limb, terminator


def above_ends(view: SphereView, windows: Windows, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute cosines of normals to camera and lamp, minus those at limb and terminator, (windows, points) each."""
    lit = np.sin(windows.lamp)[:, None] * normals[0] + np.cos(windows.lamp)[:, None] * normals[2]
    return normals[2] - view.camera, lit - view.lamp


def about_highlight(windows: Windows) -> Frame:
    """Build the frame whose circles run around the normal of the highlight; azimuth 0 is in the plane of camera and lamp."""
    sine, cosine, zero = np.sin(windows.peak), np.cos(windows.peak), np.zeros(windows.peak.size)
    return Frame(np.stack([sine, zero, cosine]), np.stack([cosine, zero, -sine]), np.stack([zero, zero + 1, zero]))


def _across_radius(windows: Windows) -> Frame:
    """Build the frame whose circles run along the radius of the sphere's image through the centre of each window.

    The axis of the circles is perpendicular to this radius, in the image plane.
    """
    x, y = windows.to_lamp(windows.x, windows.y)
    azimuth, zero = np.arctan2(y, x), np.zeros(x.size)
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    return Frame(np.stack([-sine, cosine, zero]), np.stack([zero, zero, zero + 1]), np.stack([cosine, sine, zero]))


def _dot(vector: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Compute scalar products of a vector of each window, (3, windows), with other vectors, (3, windows, ...)."""
    return np.sum(vector.reshape(*vector.shape, *[1] * (others.ndim - 2)) * others, axis=0)


def angles_from_axis(frame: Frame, normals: np.ndarray) -> np.ndarray:
    """Compute the angles between normals, (3, windows, points), and the axis, rad."""
    off = np.sqrt(
        _dot(frame.first, normals) ** 2 + _dot(frame.second, normals) ** 2
    )  # np.hypot takes four times as long
    return np.arctan2(off, _dot(frame.axis, normals))


def from_highlight(windows: Windows, normals: np.ndarray) -> np.ndarray:
    """Compute the angles between normals, (3, windows, points), and the normal of the highlight, rad."""
    return angles_from_axis(about_highlight(windows), normals)


def _with_arcs(clips: Clips, low: np.ndarray, high: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Narrow ranges of angles to the circles that have arcs.

    Only the ranges of windows with limb or terminator change; `ends` is True for these windows. A range becomes empty if no
    circle has arcs.
    """
    index = np.flatnonzero(ends)
    if not index.size:
        return low, high
    angle = low[index, None] + (high - low)[index, None] * _PROBES
    _, length = gaps_of(clips, np.repeat(index, _PROBES.size), angle.ravel())
    seen = np.any(length != 0, axis=-1).reshape(angle.shape)
    first = np.maximum(seen.argmax(1) - 1, 0)
    last = np.minimum(_PROBES.size - seen[:, ::-1].argmax(1), _PROBES.size - 1)
    some, each = seen.any(1), np.arange(index.size)
    low, high = low.copy(), high.copy()
    low[index] = angle[each, first]
    high[index] = np.where(some, angle[each, last], low[index])
    return low, high


def touching_angles(view: SphereView, windows: Windows, frame: Frame) -> np.ndarray:
    """Compute the angles of circles that touch the limb or the terminator, (windows, 4), rad."""
    zero = np.zeros(windows.lamp.size)
    away_from_camera = np.stack([zero, zero, zero - 1])
    away_from_lamp = np.stack([-np.sin(windows.lamp), zero, -np.cos(windows.lamp)])
    found = []
    for normal, nearness in ((away_from_camera, view.camera), (away_from_lamp, view.lamp)):
        between, radius = np.arccos(np.clip(_dot(frame.axis, normal), -1, 1)), np.arccos(-nearness)
        total = between + radius
        found += [np.abs(between - radius), np.minimum(total, 2 * np.pi - total)]
    return np.stack(found, -1)


def _spans(
    side: np.ndarray,
    touching: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
    scale: np.ndarray,
    pitches: tuple[np.ndarray, np.ndarray],
) -> _Spans:
    """Divide ranges of angles at touching circles, and at the angle `side`, where the pitch changes.

    side: angle, rad; NaN: the pitch is constant.
    """
    low, high = ends
    cuts = np.concatenate([touching, side[:, None]], axis=1)
    cuts = np.where((cuts > low[:, None] + _EQUAL) & (cuts < high[:, None] - _EQUAL), cuts, np.nan)
    edges = np.sort(np.concatenate([low[:, None], high[:, None], cuts], axis=1), axis=1)  # NaN is sorted to the end
    # limb and terminator may touch circles of equal angles, up to rounding
    window, number = np.nonzero(edges[:, 1:] > edges[:, :-1] + _EQUAL)
    low, high = edges[window, number], edges[window, number + 1]
    near = _NEAR_TOUCH * (high - low)
    at = touching[window]
    before = np.where((at <= low[:, None] + _EQUAL) & (at > (low - near)[:, None]), at, -np.inf).max(1)
    after = np.where((at >= high[:, None] - _EQUAL) & (at < (high + near)[:, None]), at, np.inf).min(1)
    before, after = np.minimum(before, low), np.maximum(after, high)
    pitch = np.where(low >= side[window] - _EQUAL, pitches[1][window], pitches[0][window])
    before, after = (np.where(np.isfinite(a), a, np.nan) for a in (before, after))
    return _Spans(window, low, high, scale[window], pitch, before, after)


def _nodes(spans: _Spans, vanishes: np.ndarray) -> Circles:
    """Compute the nodes of spans and their weights.

    vanishes: True if the integrand vanishes at both ends of the range of a window, (windows,). A single span then has a
        midpoint rule.
    """
    length = _t(spans.high, spans.scale, spans.pitch) - _t(spans.low, spans.scale, spans.pitch)
    touches = np.isfinite(spans.before).astype(int) + np.isfinite(spans.after)
    single = np.bincount(spans.window, minlength=vanishes.size)[spans.window] == 1
    evenly = vanishes[spans.window] & single & (touches == 0)
    count = np.where(evenly, _EVENLY * length + _MORE_EVENLY, length + _MORE + _MORE_AT_TOUCH * touches)
    count = np.where(evenly, 2 * np.ceil(count / 2), 4 * np.ceil(count / 4)).astype(int)  # few different numbers
    span, at, share = [], [], []
    for even, number in sorted({*zip(evenly.tolist(), count.tolist(), strict=True)}):
        index = np.flatnonzero((count == number) & (evenly == even))
        node, weight = arc_rule(even, number)
        span.append(np.repeat(index, number))
        at.append(np.tile(node, index.size))
        share.append(np.tile(weight, index.size))
    if not span:
        return Circles(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    index, node, weight = np.concatenate(span), np.concatenate(at), np.concatenate(share)
    ends = [_t(a, spans.scale, spans.pitch) for a in (spans.low, spans.high, spans.before, spans.after)]
    angle, rate = in_calls(_angles, (*(a[index] for a in (*spans[1:5], *ends)), node))
    return Circles(spans.window[index], angle, rate * weight * np.sin(angle))


def _t(angle, scale, pitch):  # type: ignore[no-untyped-def]
    xp = np if isinstance(angle, np.ndarray) else jnp
    return _GRADED * xp.arcsinh(angle / scale) + angle / pitch


@kept_program
def _angles(used: jax.Array, spans: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    """Compute the angles at nodes in [-1, 1], and their derivatives with respect to the node, rad."""

    def block(arguments):  # type: ignore[no-untyped-def]
        low, high, scale, pitch, first, last, before, after, node = arguments
        share = (node + 1) / 2
        at_low, at_high = ~jnp.isnan(before), ~jnp.isnan(after)
        start, end = jnp.where(at_low, before, first), jnp.where(at_high, after, last)
        # with a touching circle at one end, its distance in t is a square; with touching circles at both ends, t is a cosine
        below, above = (jnp.sqrt(jnp.maximum(a - start, 0.0)) for a in (first, last))
        root = below + (above - below) * share
        left, right = (jnp.sqrt(jnp.maximum(end - a, 0.0)) for a in (first, last))
        rest = left + (right - left) * share
        middle, radius = (start + end) / 2, (end - start) / 2
        turn = [jnp.arccos(jnp.clip((middle - a) / radius, -1, 1)) for a in (first, last)]
        at = turn[0] + (turn[1] - turn[0]) * share
        t = jnp.where(at_low, start + root**2, first + (last - first) * share)
        rate = jnp.where(at_low, root * (above - below), (last - first) / 2)
        t = jnp.where(at_high, end - rest**2, t)
        rate = jnp.where(at_high, rest * (left - right), rate)
        t = jnp.where(at_low & at_high, middle - radius * jnp.cos(at), t)
        rate = jnp.where(at_low & at_high, radius * jnp.sin(at) * (turn[1] - turn[0]) / 2, rate)

        def slope(angle: jax.Array) -> jax.Array:
            return _GRADED / jnp.hypot(angle, scale) + 1 / pitch

        def newton(_: int, angle: jax.Array) -> jax.Array:  # t is concave, so the steps converge from below
            return jnp.clip(angle + (t - _t(angle, scale, pitch)) / slope(angle), low, high)

        guess = jnp.clip(jnp.minimum(scale * jnp.sinh(jnp.minimum(t / _GRADED, 300.0)), pitch * t), low, high)
        angle = jax.lax.fori_loop(0, 5, newton, guess)  # to a relative error of 1e-13
        return angle, rate / slope(angle)

    return in_blocks(block, used, spans)
