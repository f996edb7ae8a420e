"""Source disc in the quadrature rule of a pixel: the kernel is integrated in closed form over chords of the disc.

A rotation maps the half vector for the centre of the lamp to that for another point of the lamp. The same rotation is
applied to the normals, and the kernel is evaluated at their new positions (docs/model.md 3). This is exact for distant
cameras and lamps. For near cameras and lamps it is exact at the highlight.

The images of the chords (`numerics/disc_chords.py`) lie along the second axis of the pixel. On each chord, the point whose
image has the second coordinate of the pixel determines two quantities: the distance of the image from the pixel along the
first axis, and the ratio of the lengths of the image and the chord.

An image of the disc that is much smaller than the blur is nearly an ellipse. It is approximated by a sum of a few
Gaussians (`numerics/disc_gaussians.py`). The sum takes a twentieth of the computing time of the chords.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from matcam.camera.pixel import PIXELS_SHARE
from matcam.core.jax import is_concrete, jax, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.forward.sampler.windows import SphereView
from matcam.inverse.operator.sample_view import SampleView
from matcam.numerics.disc_chords import CHORD_RULE, COUNTS, chord_rule, chords_of
from matcam.numerics.disc_gaussians import DISC_GAUSSIANS, LARGEST
from matcam.sample.sight import highlight_between

_GAUSSIAN = 0.45
"""Largest ratio of the radius of the lamp's image to the standard deviation of the blur at which the image is replaced by a
Gaussian of the same variance. The error is at most 1e-3.
"""
DISC_RULE = (*CHORD_RULE, _GAUSSIAN, PIXELS_SHARE, LARGEST, len(DISC_GAUSSIANS))
"""Parameters that determine the number of chords. A stored rule is valid only for the same parameters."""
_SMALLEST = 1e-5
"""Smallest angular radius of a disc, rad. A point source is computed with this radius, so that its chords are not of
length 0.
"""
_SLACK = 1.1
"""Safety factor on the size of an image, which may be larger at the end of the kernel than at its middle."""
_ALIGNED = 1e-9
"""Sine of the angle between the pixel's axes and the plane of camera and lamp below which they are treated as parallel.
It exceeds the rounding error of the azimuth.
"""
_ROUND = np.pi * np.arange(16) / 8
"""Azimuths of the points on the rim of the disc at which the shift of the highlight is computed, rad."""


def _chords() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tabulate the chords of a disc for each of `COUNTS`.

    The tables contain the distances from the centre, the half lengths, and the shares of the light of the disc. They are
    padded with chords whose share is 0.
    """
    at, half, share = np.zeros((3, len(COUNTS), COUNTS[-1]))
    half += 1.0
    for n, count in enumerate(COUNTS):
        at[n, :count], half[n, :count], share[n, :count] = chords_of(count)
    return at, half, share


_AT, _HALF, _SHARE = _chords()


class LampDisc(NamedTuple):
    """Source disc and its chords for each pixel.

    Attributes:
        radius: angular radius of the disc, rad, (pixels,).
        lamp_angle: angle between the lamp's centre and the optical axis, rad, (pixels,).
        chord: components of the direction of the chords along the plane of camera and lamp and across it, (pixels, 2).
        rule: index into `COUNTS`, (pixels,).
        turn: cosine and sine of the angle between the plane of camera and lamp and the first axis of the pixel, (pixels, 2).
        image: shift of the highlight per shift of the lamp along the plane of camera and lamp and across it, px/rad,
            (pixels, 2).
        relative: ratio of half the larger width of the image to the standard deviation of the blur, (pixels,).
    """

    radius: jax.Array | np.ndarray
    lamp_angle: np.ndarray
    chord: np.ndarray
    rule: np.ndarray
    turn: np.ndarray
    image: np.ndarray
    relative: np.ndarray


def lamp_discs(
    view: SampleView, blurs: list[Blur], stds: list[float], lamp_angle: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[list[LampDisc | None], np.ndarray]:
    """Compute the source disc of each blur, and the largest shifts of the image between points of the disc.

    Args:
        view: geometry of sphere, camera and lamp.
        blurs: the blurs.
        stds: standard deviation of a Gaussian that is as sharp as each blur, px.
        lamp_angle: lamp angle of the pixels, rad, (pixels,).
        x: distance of the pixels from the optical axis, towards the lamp, px, (pixels,).
        y: distance of the pixels from the optical axis, perpendicular to x, px, (pixels,).

    Returns:
        List with the disc of each blur, and the largest shifts of the image, at the highlight or at the pixel, along the axes
        of the pixels, px, (blurs, 2, pixels). A disc is None for a point source. If for every blur a Gaussian with the variance
        of the disc can replace the disc, all discs are None, and the shifts are 0.
    """
    half = float(blurs[0].pixel.half_width)
    turn = view.azimuth - np.pi / 2 * np.round(
        view.azimuth / (np.pi / 2)
    )  # a square pixel is invariant under a quarter turn
    cosine, sine = np.cos(turn), np.sin(turn)
    moved = [_moved(view.on_sphere, view.azimuth, blur, lamp_angle, x, y) for blur in blurs]
    if all(
        np.hypot(*at_peak).max() <= _GAUSSIAN * np.hypot(std, half / np.sqrt(3))
        for (at_peak, _), std in zip(moved, stds, strict=True)
    ):
        return [None] * len(blurs), np.zeros((len(blurs), 2, *x.shape))
    along, across = _image(view.on_sphere, lamp_angle)
    chord = np.stack([across * sine, along * cosine], -1)
    chord /= np.hypot(chord[:, :1], chord[:, 1:])
    turns = np.broadcast_to([cosine, sine], (x.size, 2))
    discs: list[LampDisc | None] = []
    for blur, (at_peak, _), std in zip(blurs, moved, stds, strict=True):
        first, second = (np.abs(a).max(0) for a in _rotated(*at_peak, cosine, sine))
        first, second = (a / np.hypot(std, PIXELS_SHARE * half) for a in (first, second))
        rule, relative = chord_rule(first, second), np.maximum(first, second)
        radius, image = np.full(x.shape, float(blur.lamp_radius)), np.stack([along, across], -1)
        disc = LampDisc(radius, lamp_angle, chord, rule, turns, image, relative)
        discs.append(disc if float(blur.lamp_radius) > 0 else None)
    return discs, np.stack([_SLACK * reach for _, reach in moved])


def lamp_kernel(
    view: SphereView,
    blur: Blur,
    disc: LampDisc,
    points: ChordPoints,
    normal: tuple,
    at: tuple,
    variances: tuple,
) -> jax.Array:
    """Integrate the kernel over the source disc at nodes, 1/px^2.

    The integral has shape (groups, nodes), with a group of nodes for each arc in a pixel. It is differentiable with
    respect to the radius of the disc.

    Args:
        view: the sphere and the distances of camera and lamp.
        blur: the blur for a point source.
        disc: source disc for the pixel of each group.
        points: result of `chord_points` for the disc.
        normal: components of the normals for the centre of the lamp, (groups, nodes) each.
        at: position of the pixel along the plane of camera and lamp and across it, (groups, 1) each, px.
        variances: variances that are added to the blur along x and y, px^2, (groups, 1) each.
    """

    def by_chords() -> jax.Array:
        return _by_chords(view, blur, disc, points, normal, at, variances)

    if not _is_distant(view):
        return by_chords()
    return jax.lax.cond(
        jnp.all(of_gaussians(view, disc)),
        lambda: _by_gaussians(view, blur, disc, normal, at, variances),
        by_chords,
    )


def of_gaussians(view: SphereView, disc: LampDisc) -> Any:
    """Select the pixels in which a sum of Gaussians describes the disc, (pixels,).

    An image along the axes of the pixel that is much smaller than the blur is nearly an ellipse.
    """
    small = (disc.relative <= LARGEST) & (abs(disc.turn[:, 1]) < _ALIGNED)
    return small if _is_distant(view) else small & False


def _is_distant(view: SphereView) -> bool:
    return is_concrete(view.camera) and is_concrete(view.lamp) and view.distant


class ChordPoints(NamedTuple):
    """Highlights of three points of each chord of a disc: start, middle and end.

    Attributes:
        share: share of the light of each chord, no unit, (chords, pixels). A chord with the share 0 is not used.
        centre: components of the normal at the highlight of the lamp's centre, (3, pixels).
        normal: components of the normals at the highlights of the points, (chords, 3, points, pixels).
        light: share of the chord times the record of each point relative to that of the lamp's centre, no unit,
            (chords, points, pixels).
        less: third-order term of the image of the chord, divided by half the difference between the ends of this image, no
            unit, (chords, pixels).
    """

    share: jax.Array
    centre: jax.Array
    normal: jax.Array
    light: jax.Array
    less: jax.Array


def chord_points(view: SphereView, disc: LampDisc) -> ChordPoints:
    """Compute the highlights of the chords, which are the same for all nodes of a pixel.

    All entries are 0 if Gaussians describe all discs.
    """
    radius, lamp = jnp.maximum(disc.radius, _SMALLEST), disc.lamp_angle
    centre, own_light = _highlights(view, 0.0, 0.0, radius, lamp)
    # start, middle and end of a chord, and two points in between
    on_chord = np.array([-1.0, 0.0, 1.0, -0.5, 0.5])[:, None]

    def of_chord(chord):  # type: ignore[no-untyped-def]
        distance, half_length, share = chord
        u, v = (
            distance * disc.chord[:, 1 - n] * side + on_chord * half_length * disc.chord[:, n]
            for n, side in ((0, 1), (1, -1))
        )
        to, light = _highlights(view, u, v, radius, lamp)
        run = _rotated(*_position(view, to), *disc.turn.T)[1]
        less = (4 - 8 * (run[4] - run[3]) / (run[2] - run[0])) / 3
        return jnp.stack([a[:3] for a in to]), share * light[:3] / own_light, less

    chords = tuple(jnp.asarray(table)[disc.rule].T for table in (_AT, _HALF, _SHARE))
    used = jnp.any(chords[2] > 0, axis=1) & ~jnp.all(of_gaussians(view, disc))
    like = jax.eval_shape(of_chord, jax.tree.map(lambda a: a[0], chords))
    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), like)
    found = jax.lax.map(lambda one: jax.lax.cond(one[0], of_chord, lambda _: nothing, one[1]), (used, chords))
    return ChordPoints(chords[2], jnp.stack(centre), *found)


def _by_gaussians(view, blur: Blur, disc: LampDisc, normal, at, variances):  # type: ignore[no-untyped-def]
    """Integrate the kernel over a disc much smaller than the blur, as a sum of Gaussians."""
    widening = dataclasses.replace(blur, varies=True)
    offset = at[0] - view.radius * normal[0], at[1] - view.radius * normal[1]
    half_widths = [(disc.radius * scale)[:, None] for scale in disc.image.T]

    def of_width(total, gaussian):  # type: ignore[no-untyped-def]
        share, wide = gaussian
        along, across = (v + wide * half**2 for v, half in zip(variances, half_widths, strict=True))
        added = Spread(along, across, jnp.zeros(()))
        seen = sum((blur.share(j) * widening.at(j, added, *offset) for j in blur.terms), jnp.zeros(()))
        return total + share * seen, None

    start = jnp.zeros(jnp.broadcast_shapes(*(a.shape for a in normal)))
    return jax.lax.scan(of_width, start, tuple(jnp.asarray(a) for a in DISC_GAUSSIANS.T))[0]


def _by_chords(view, blur: Blur, disc: LampDisc, points: ChordPoints, normal, at, variances):  # type: ignore[no-untyped-def]
    """Integrate the kernel over a disc as a sum over chords, in closed form along each chord."""
    cosine, sine = (a[:, None] for a in disc.turn.T)
    own_x, own_y = _rotated(at[0], at[1], cosine, sine)
    from_ = [a[:, None] for a in points.centre]

    def of_chord(total, chord):  # type: ignore[no-untyped-def]
        _, to, light, less = chord
        light, less = light[..., None], less[:, None]
        there = _turned(from_, [a[:, :, None] for a in to], normal)
        x, y = _rotated(*_position(view, there), cosine, sine)
        x, (y_0, y_1, y_2) = x - own_x, y - own_y
        half, curvature = (y_2 - y_0) / 2, (y_2 + y_0) / 2 - y_1
        # position on the chord, in [-1, 1], whose image has the y coordinate of the pixel; the y coordinate of the image is
        # a cubic polynomial of the position on the chord
        on = -y_1 / half
        on = jnp.clip(on - curvature * on**2 / half - less * (on**3 - on), -1, 1)
        seen = sum(
            blur.weights[j]
            * blur.kernel(_parabola(*x, on), j, variances[0])
            * (blur.kernel_until(y_2, j, variances[1]) - blur.kernel_until(y_0, j, variances[1]))
            for j in blur.terms
        )
        density = 2 * (half * (1 + less * (3 * on**2 - 1)) + 2 * curvature * on)
        return total + seen * _parabola(*light, on) / density

    def step(total, chord):  # type: ignore[no-untyped-def]
        return jax.lax.cond(jnp.any(chord[0] > 0), of_chord, lambda total, _: total, total, chord), None

    start = jnp.zeros(jnp.broadcast_shapes(*(a.shape for a in normal)))
    return jax.lax.scan(step, start, (points.share, points.normal, points.light, points.less))[0]


def _moved(
    view: SphereView, azimuth: float, blur: Blur, lamp_angle: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Compute the shifts, px, between the centre of the disc and points on its rim.

    Returns:
        Shifts of the highlight along x and y, (points, pixels) each, and the largest shifts of the image, at the highlight
        or at the pixel, along the axes of the pixels, (2, pixels).
    """
    farthest = np.zeros((2, *x.shape))
    if float(blur.lamp_radius) == 0:
        return (farthest[:1], farthest[:1]), farthest
    radius = np.maximum(float(blur.lamp_radius), _SMALLEST)
    peak = _highlights(view, 0.0, 0.0, radius, lamp_angle)[0]
    seen = view.normals(x, y)
    at_peak: list[list[np.ndarray]] = []
    for angle in _ROUND:
        to = _highlights(view, np.cos(angle), np.sin(angle), radius, lamp_angle)[0]
        at_peak.append([np.asarray(a - b) for a, b in zip(_position(view, to), _position(view, peak), strict=True)])
        here = [
            np.asarray(a - b)
            for a, b in zip(_position(view, _turned(peak, to, seen)), _position(view, seen), strict=True)
        ]
        for offset in (at_peak[-1], here):
            on_pixel = _rotated(offset[0], offset[1], np.cos(azimuth), np.sin(azimuth))
            farthest = np.maximum(farthest, np.abs(on_pixel))
    along, across = np.moveaxis(np.array(at_peak), 1, 0)
    return (along, across), farthest


def _image(view: SphereView, lamp_angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the shift of the highlight per shift of the lamp, px/rad.

    The two results are for shifts along the plane of camera and lamp and across it.
    """
    step = 1e-4  # rad; the error of the differences is of second order
    ends = [_highlights(view, u, v, step, lamp_angle)[0] for u, v in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0))]
    (x, _), (other, _), (_, y) = (_position(view, end) for end in ends)
    return np.asarray(x - other) / 2 / step, np.asarray(y) / step


def _highlights(view: SphereView, u: Any, v: Any, radius: Any, lamp_angle: Any) -> tuple[tuple, Any]:
    """Compute the normal at the highlight of each point of the disc, and a factor proportional to the record of the point.

    For NumPy arrays of lamp angles the computation uses NumPy, because JAX would compile each operation separately. `u` and `v`
    are the positions of the points along the plane of camera and lamp and across it, in radii of the disc. `radius` is the
    angular radius of the disc, and `lamp_angle` is the lamp angle of its centre, rad.
    """
    xp: Any = np if isinstance(lamp_angle, np.ndarray) else jnp
    square = u**2 + v**2
    # the radiance of a distant disc is uniform over its solid angle; a near disc is flat and faces the centre of the sphere
    sunk, distant = square * 2 * xp.sin(radius / 2) ** 2, view.lamp == 0
    up = xp.where(distant, 1 - sunk, 1.0)
    aside = xp.where(distant, np.sqrt(2) * xp.sin(radius / 2) * xp.sqrt(2 - sunk), xp.tan(radius))
    length = xp.where(distant, 1.0, xp.sqrt(1 + square * xp.tan(radius) ** 2))
    sin, cos = xp.sin(lamp_angle), xp.cos(lamp_angle)
    lamp = [a / length for a in (up * sin + aside * u * cos, aside * v, up * cos - aside * u * sin)]
    w = view.lamp / length
    if _is_distant(view):  # the half vector of the lamp and the optical axis
        twice = xp.sqrt(xp.maximum(2 * (1 + lamp[2]), 1e-30))
        normal = lamp[0] / twice, lamp[1] / twice, twice / 2
    else:
        off = xp.sqrt(xp.maximum(lamp[0] ** 2 + lamp[1] ** 2, 1e-30))
        angle = xp.asarray(highlight_between(jnp.asarray(xp.arctan2(off, lamp[2])), view.camera, w))
        normal = xp.sin(angle) * lamp[0] / off, xp.sin(angle) * lamp[1] / off, xp.cos(angle)
    up = sum(a * b for a, b in zip(normal, lamp, strict=True))
    depth, view_2 = 1 - view.camera * normal[2], 1 + view.camera**2 - 2 * view.camera * normal[2]
    return normal, xp.sqrt(view_2) / depth**3 / (1 + w**2 - 2 * w * up) / length**2


def _turned(one: Any, other: Any, normal: Any) -> tuple:
    """Rotate `normal` by the shortest rotation that maps the unit vector `one` to the unit vector `other`."""
    axis = [one[j] * other[k] - one[k] * other[j] for j, k in ((1, 2), (2, 0), (0, 1))]
    cos = sum(a * b for a, b in zip(one, other, strict=True))
    part = sum(a * b for a, b in zip(axis, normal, strict=True)) / (1 + cos)
    return tuple(
        cos * normal[i] + axis[j] * normal[k] - axis[k] * normal[j] + axis[i] * part
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    )


def _rotated(x: Any, y: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Rotate positions from the axes of the plane of camera and lamp to those of the pixel."""
    return x * cosine - y * sine, x * sine + y * cosine


def _position(view: SphereView, normal: Any) -> tuple[Any, Any]:
    """Compute the image position of a normal, px."""
    far = is_concrete(view.camera) and view.camera == 0  # the z component of the normal is not required
    scale = view.stretch if far else view.stretch / (1 - view.camera * normal[2])
    return scale * normal[0], scale * normal[1]


def _parabola(first: Any, middle: Any, last: Any, on: Any) -> Any:
    """Evaluate, at `on`, the parabola through the values at -1, 0 and 1."""
    return middle + on * ((last - first) / 2 + on * ((last + first) / 2 - middle))
