"""Record of a cylinder at positions of its images, each under its own lamp at any position (docs/model.md 3).

The axes of the pixel are those of the cylinder, so the kernel is a product across the cylinder and along it:

    R(x, y) = integral over rows of  k(y - row)  integral over the visible, lit u of  k(x - x(u)) rho cos_i cos_o ... du.

In a distant rig light is constant along the cylinder, and the outer integral is 1. Otherwise the mirror point of a lamp
is found as in a plane, because a path reflected by a cylinder has a constant slope along its axis.

- Where light is smooth on the kernel's scale, in one direction or in both, the Gauss rule of the kernel is used (`Blur.rule`).
- Elsewhere panels become smaller towards the position closest to the half vector, on the scale of the lobe. They end at
  the borders of a sharp pixel, and at the limb and the terminator, which are straight: the light ends at the same u in
  every row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam.core.jax import AnyArray, jax, jnp
from matcam.core.programs import kept_program
from matcam.core.shading import Vector, shading
from matcam.forward.integral.blur import Blur, BlurTerms, Line, Spread
from matcam.forward.integral.blur_groups import groups_of
from matcam.material.material import Material
from matcam.numerics.approximation import graded_nodes
from matcam.numerics.blocks import in_batches, pad_indices
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Element, highlight_between

_REACH = 6.2
"""Support radius of a kernel, in standard deviations."""
_AWAY = 9.0
"""Angle from the half vector, in standard deviations of the kernel, beyond which the light is smooth on the scale of
the kernel.
"""
_GRADED, _EVEN, _ORDER = 6, 4, 6
_ENDS = 3.0
"""Width of the panel at the ends of the light, where masking sets in, in scales of the lobe."""
_STEPS = 6
"""Number of Newton steps to the position closest to the half vector. Each reduces the error to a few per cent."""
_SMOOTH, _ROUGH, _BOTH = 4096, 256, 2
"""Numbers of positions that are computed at a time, on a line and where rows are rough, too. Their nodes fit into the
cache of a processor.
"""
_RULE = 5
"""Number of nodes of `Blur.rule`."""


class CylinderPlaces(NamedTuple):
    """Positions in images of a cylinder, arrays of shape (positions,), each under its own lamp.

    Attributes:
        x: distance from the axis, px.
        y: position along the axis, from the plane of camera and lamp, px.
        lamp: direction from the cylinder's centre to the lamp, three arrays.
        nearness: inverse of the lamp's distance from the centre, 1/radii; None: distant lamps.
    """

    x: AnyArray
    y: AnyArray
    lamp: Vector
    nearness: AnyArray | None = None


class PlacedLamps(NamedTuple):
    """Lamps of some positions, in shapes that broadcast: directions, and nearness; None: distant."""

    towards: Vector
    nearness: AnyArray | None

    def beside(self, axes: int) -> PlacedLamps:
        """Return the lamps for arrays with further axes of nodes."""
        return jax.tree.map(lambda a: jnp.asarray(a).reshape(*a.shape, *[1] * axes), self)


def towards(lamp_angle: ArrayLike, azimuth: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the directions to lamps at angles from the optical axis and azimuths about it, rad."""
    lamp_angle, azimuth = np.broadcast_arrays(lamp_angle, azimuth)
    sine = np.sin(lamp_angle)
    return sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(lamp_angle)


def record_cylinder(material: Material, cylinder: Cylinder, blur: Blur, places: CylinderPlaces) -> jax.Array:
    """Compute the radiance that positions on a cylinder record, 1/sr, (positions, channels).

    The lamps' irradiance is 1 at the cylinder's centre. Differentiable in material and blur.

    Args:
        material: the material.
        cylinder: the cylinder.
        blur: under a lamp without a disc.
        places: the positions.
    """
    elongation = np.asarray(float(material.elongation))
    record = jnp.zeros((places.x.size, _channels(material, cylinder)))
    for terms, _ in groups_of(blur, cylinder):  # narrow terms require nodes that wide ones do not
        across, along = smooth_places(cylinder, blur, terms, places, float(elongation))
        for rough_x, rough_y in ((False, False), (True, False), (True, True)):
            # where only the rows are rough, the columns are treated as rough, too
            which = (~(across & along) == rough_x) & (~along == rough_y)
            index = pad_indices(np.flatnonzero(which))
            if index.size:
                own = jax.tree.map(lambda a, index=index: a[index], places)
                through = BlurTerms(blur, terms)
                if rough_x:
                    part = _record_rough(material, cylinder, through, own, elongation, rough_y)
                else:
                    part = _record_smooth(material, cylinder, through, own)
                record += jnp.zeros_like(record).at[index].set(part)
    return record


def is_line(cylinder: Cylinder, places: CylinderPlaces) -> bool:
    """Check whether light is constant along the cylinder."""
    return cylinder.distant and places.nearness is None


def smooth_places(
    cylinder: Cylinder, blur: Blur, terms: tuple[int, ...], places: CylinderPlaces, elongation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Find positions where the light is smooth on the scale of the kernel, across the cylinder and along it; two arrays
    (positions,).
    """
    cylinder, blur = jax.lax.stop_gradient((cylinder, blur))
    line = is_line(cylinder, places)
    if float(blur.aperture) > 0:  # defocus changes the kernel with the position
        return np.zeros(places.x.shape, dtype=bool), np.full(places.x.shape, line)
    half = float(blur.pixel.half_width)
    widest = float(np.max(np.asarray(blur.stds)[list(terms)]))
    std, reach = float(np.hypot(widest, half / np.sqrt(3))), _REACH * widest + half
    light = PlacedLamps(places.lamp, places.nearness)
    x, y = places.x, places.y
    size = 1 << max(x.size - 1, 1).bit_length()  # few sizes, because each requires a program
    padded = jax.tree.map(lambda a: np.resize(a, size), (x, y, light))
    inside, away, turn_x, turn_y = (np.asarray(a)[: x.size] for a in _smoothness(cylinder, *padded, reach))
    across = inside & (away > _AWAY * elongation * std * turn_x)
    return across, np.full(x.shape, True) if line else away > _AWAY * elongation * std * turn_y


@jax.jit
def _smoothness(
    cylinder: Cylinder, x: jax.Array, y: jax.Array, light: PlacedLamps, reach: float
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Compute whether no end of the light is in the support, the smallest angle from the half vector there, and its
    slope per px.
    """
    low, high = ends_of_light(cylinder, light)
    first, last = (_at_column(cylinder, x + side * reach) for side in (-1, 1))
    inside = (jnp.abs(x) + reach < cylinder.radius) & (first > low) & (last < high)
    row = jnp.clip(mirror_row(cylinder, light, low, high), y - reach, y + reach)
    peak, miss = ridge_of(cylinder, light, row, low, high)
    away = jnp.hypot(miss, jnp.sin(jnp.clip(peak, first, last) - peak))
    u = _at_column(cylinder, x)
    q, cosine = cylinder.nearness, jnp.cos(u)
    turn_x = (1 - q * cosine) ** 2 / (cylinder.stretch * jnp.maximum(cosine - q, 1e-9))
    return inside, away, turn_x, turn_along(cylinder, light, u, row)


def _at_column(cylinder: Cylinder, x: jax.Array) -> jax.Array:
    """Compute the visible u at columns, px, or the closest to it."""
    return cylinder.across(x, jnp.zeros_like(x))


def ends_of_light(cylinder: Cylinder, light: PlacedLamps) -> tuple[jax.Array, jax.Array]:
    """Compute the range of u in which the cylinder is visible and lit."""
    across = jnp.hypot(light.towards[0], light.towards[2])
    # a lamp along the axis lights no surface
    near = None if light.nearness is None else light.nearness / jnp.maximum(across, 1e-12)
    return cylinder.lit(jnp.zeros_like(across), jnp.arctan2(light.towards[0], light.towards[2]), near)


def mirror_row(cylinder: Cylinder, light: PlacedLamps, low: jax.Array, high: jax.Array) -> jax.Array:
    """Compute the row, px, in which the cylinder mirrors the lamp; 0 if all rows or no row does."""
    x, y, z = light.towards
    if light.nearness is None and cylinder.distant:
        return jnp.zeros_like(x)
    across = jnp.maximum(jnp.hypot(x, z), 1e-12)
    q, w = cylinder.nearness, jnp.zeros_like(across) if light.nearness is None else light.nearness / across
    angle = jnp.arctan2(x, z)
    u = jnp.clip(highlight_between(angle, q, w), low, high)
    # lengths along the axis of the paths from the mirror to lamp and camera, over the distances of these
    to_lamp, to_camera = (jnp.sqrt(1 - 2 * r * jnp.cos(u - a) + r**2) for r, a in ((w, angle), (q, 0.0)))
    climb = w + q * to_lamp / to_camera
    height = jnp.where(climb > 0, y / across / jnp.where(climb > 0, climb, 1.0), 0.0)
    return cylinder.surface(u, height).y


def seen_at(
    cylinder: Cylinder, light: PlacedLamps, u: jax.Array, row: jax.Array
) -> tuple[Element, Vector, jax.Array | None]:
    """Compute the surface at u in rows, px, the direction to the lamp, and its squared distance; None: 1."""
    element = cylinder.surface(u, row / cylinder.stretch * (1 - cylinder.nearness * jnp.cos(u)))
    if light.nearness is None:
        return element, light.towards, None
    w, (x, y, z) = light.nearness, light.towards
    x, y, z = x - w * element.normal[0], y - w * cylinder.height(element), z - w * element.normal[2]
    square = x**2 + y**2 + z**2
    length = jnp.sqrt(square)
    return element, (x / length, y / length, z / length), square


def ridge_of(
    cylinder: Cylinder, light: PlacedLamps, row: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the u at which a row comes closest to the half vector, and the angle between them, rad."""
    angle = jnp.arctan2(light.towards[0], light.towards[2] + 1)

    def newton(_: int, u: jax.Array) -> jax.Array:
        element, lamp, square = seen_at(cylinder, light, u, row)
        tangent, normal, view = element.tangent, element.normal, element.view
        aside = [tangent[0] * one[0] + tangent[2] * one[2] for one in (lamp, view)]
        slope = normal[0] * (lamp[0] + view[0]) + normal[2] * (lamp[2] + view[2])
        if light.nearness is not None and square is not None:  # the view direction of a near point differs, too
            slope += light.nearness * (1 - aside[0] ** 2) / jnp.sqrt(square)
        if not cylinder.distant:
            slope += cylinder.nearness * (1 - aside[1] ** 2)
        return jnp.clip(u + (aside[0] + aside[1]) / jnp.maximum(slope, 0.05), low, high)

    line = light.nearness is None and cylinder.distant
    start = jnp.clip(angle, low, high) + 0 * row
    u = start if line else jax.lax.fori_loop(0, _STEPS, newton, start)
    element, lamp, _ = seen_at(cylinder, light, u, row)
    half = [a + b for a, b in zip(lamp, element.view, strict=True)]
    return u, jnp.arctan2(jnp.abs(half[1]), jnp.hypot(half[0], half[2]))


def turn_along(cylinder: Cylinder, light: PlacedLamps, u: jax.Array, row: jax.Array) -> jax.Array:
    """Compute the largest rotation of the half vector along the cylinder, rad/px."""
    if light.nearness is None and cylinder.distant:
        return jnp.zeros_like(u)
    element, lamp, square = seen_at(cylinder, light, u, row)
    turn = cylinder.nearness + jnp.zeros_like(u)
    if light.nearness is not None and square is not None:
        turn += light.nearness / jnp.sqrt(square)
    total = sum((a + b) ** 2 for a, b in zip(lamp, element.view, strict=True))
    return turn / jnp.sqrt(jnp.maximum(total, 1e-12)) * (1 - cylinder.nearness * jnp.cos(u)) / cylinder.stretch


def _sent(material: Material, cylinder: Cylinder, light: PlacedLamps, u: jax.Array, row: jax.Array) -> jax.Array:
    """Compute the light of the surface at u in rows, px, per rad and px, channels last."""
    element, lamp, square = seen_at(cylinder, light, u, row)
    # area is px^2 per rad and radius along the axis; the scale converts radii to rows
    share = element.area / (cylinder.stretch / (1 - cylinder.nearness * jnp.cos(u)))
    return _through(material, element, lamp, share if square is None else share / square)


def _through(material: Material, element: Element, lamp: Vector, factor: jax.Array) -> jax.Array:
    light = material.reflected(shading(element.normal, element.tangent, lamp, element.view))
    factor = jnp.asarray(factor)
    if light.ndim <= max(jnp.ndim(element.x), *map(jnp.ndim, lamp)):
        light = light[..., None]
    return light * (factor[..., None] if factor.ndim else factor)


def _channels(material: Material, cylinder: Cylinder) -> int:
    light = PlacedLamps((jnp.zeros(1), jnp.zeros(1), jnp.ones(1)), None)
    return jax.eval_shape(lambda: _sent(material, cylinder, light, jnp.zeros(1), jnp.zeros(1))).shape[-1]


def light_at(material: Material, cylinder: Cylinder, places: CylinderPlaces) -> jax.Array:
    """Compute the radiance at positions of a sharp image, 1/sr, (positions, channels); 0 where there is none."""
    element, visible = cylinder.at(jnp.asarray(places.x), jnp.asarray(places.y))
    light = PlacedLamps(places.lamp, places.nearness)
    u, _ = cylinder.coordinates(element)
    low, high = ends_of_light(cylinder, light)
    lit = visible & (u > low) & (u < high)
    _, lamp, square = seen_at(cylinder, light, u, jnp.asarray(places.y))
    sent = _through(material, element, lamp, element.area if square is None else element.area / square)
    return jnp.where(lit[:, None], sent, 0.0)


@kept_program
def _record_smooth(material: Material, cylinder: Cylinder, through: BlurTerms, places: CylinderPlaces) -> jax.Array:
    blur, line = through.blur, is_line(cylinder, places)

    def integral(at: CylinderPlaces) -> jax.Array:
        total: jax.Array | float = 0.0
        x, y = (jnp.asarray(a)[:, None] for a in (at.x, at.y))
        light = PlacedLamps(at.lamp, at.nearness).beside(1)
        for term in through.terms:
            offset, weight = blur.rule(term, jnp.zeros(()))
            dx, dy = offset, jnp.zeros_like(offset)
            if not line:
                dx, dy = (a.ravel() for a in jnp.meshgrid(offset, offset))
                weight = jnp.outer(weight, weight).ravel()
            element, _ = cylinder.at(x + dx, y + dy)
            u, _ = cylinder.coordinates(element)
            _, lamp, square = seen_at(cylinder, light, u, y + dy)
            sent = _through(material, element, lamp, element.area if square is None else element.area / square)
            total += blur.weights[term] * jnp.sum(sent * weight[:, None], axis=1)
        return jnp.asarray(total)

    return in_batches(integral, (places,), _SMOOTH if line else _SMOOTH // _RULE)


class _Nodes(NamedTuple):
    """Nodes of an integral in one direction, and their weights; the nodes on the last axis."""

    at: jax.Array
    weight: jax.Array


@kept_program
def _record_rough(
    material: Material,
    cylinder: Cylinder,
    through: BlurTerms,
    places: CylinderPlaces,
    elongation: AnyArray,
    rough_rows: bool,
) -> jax.Array:
    blur, line = through.blur, is_line(cylinder, places)
    count = 1 if line else _RULE

    def integral(at: CylinderPlaces) -> jax.Array:
        light, x, y = PlacedLamps(at.lamp, at.nearness), jnp.asarray(at.x), jnp.asarray(at.y)
        reach = _reach(cylinder, through, x)
        low, high = ends_of_light(cylinder, light)
        window = _Window(low, high, reach, x, elongation)
        total: jax.Array | float = 0.0
        if rough_rows:
            rows = _rows_about(material, cylinder, through, light, window, y)
            return _sum_over(material, cylinder, through, light, window, rows, y)
        for term in through.terms:
            offset, weight = (jnp.zeros(1), jnp.ones(1)) if line else blur.rule(term, jnp.zeros(()))
            rows = _Nodes(y[:, None] + offset, jnp.broadcast_to(weight, (*y.shape, offset.size)))
            total += _sum_over(material, cylinder, BlurTerms(blur, (term,)), light, window, rows, None)
        return jnp.asarray(total)

    return in_batches(integral, (places,), _BOTH if rough_rows else _ROUGH // count)


class _Window(NamedTuple):
    """Window of pixels across the cylinder; arrays (positions,): ends of the light, support radius of the kernel, px,
    columns.
    """

    low: jax.Array
    high: jax.Array
    reach: jax.Array
    x: jax.Array
    elongation: AnyArray


def _reach(cylinder: Cylinder, through: BlurTerms, x: jax.Array) -> jax.Array:
    """Compute the support radius of kernels, px, with the largest disc out of focus about each column."""
    blur = through.blur
    reach = _REACH * jnp.max(blur.stds[np.array(through.terms)]) + blur.pixel.half_width
    discs = [_spread(blur, cylinder, jnp.cos(_at_column(cylinder, x + side * reach))).disc for side in (-1, 0, 1)]
    return reach + jnp.maximum(jnp.maximum(*discs[:2]), discs[2]) + jnp.zeros_like(x)


def _spread(blur: Blur, cylinder: Cylinder, normal_z: jax.Array) -> Spread:
    return blur.spread(cylinder, normal_z, jnp.zeros(()))


def _rows_about(
    material: Material, cylinder: Cylinder, through: BlurTerms, light: PlacedLamps, window: _Window, y: jax.Array
) -> _Nodes:
    """Compute rows about pixels, (positions, rows), denser where the cylinder mirrors the lamp, on the scale of the lobe."""
    mirror, own = mirror_row(cylinder, light, window.low, window.high)[:, None], y[:, None]
    first, last = own - window.reach[:, None], own + window.reach[:, None]
    middle = jnp.clip(mirror, first, last)
    u, _ = ridge_of(cylinder, light, middle[:, 0], window.low, window.high)
    per_px = turn_along(cylinder, light, u, middle[:, 0])[:, None]
    angle = jnp.hypot(material.finest, per_px * (middle - mirror) / window.elongation)
    scale = jnp.minimum(angle / per_px, 1e9)
    steps = np.array([-1.0, 1.0]), np.arange(1, _EVEN) / _EVEN
    sides = [
        (
            end,
            jnp.concatenate(
                [own + steps[0] * through.blur.pixel.half_width, middle + (end - middle) * steps[1]], axis=1
            ),
        )
        for end in (first, last)
    ]
    return _graded(middle, sides, scale[:, 0])


def _graded(middle: jax.Array, sides: list[tuple[jax.Array, jax.Array]], scale: jax.Array) -> _Nodes:
    """Compute nodes that become denser towards a position, on a scale, on either side of it.

    sides: end of each side, and borders of panels up to it.
    """
    found = []
    for end, cuts in sides:
        way = jnp.where(end < middle, -1.0, 1.0)
        borders = way * (jnp.concatenate([middle, cuts, end], axis=-1) - middle)
        borders = jnp.sort(jnp.clip(borders, 0.0, jnp.abs(end - middle)), axis=-1)
        distance, weight = graded_nodes(borders, scale, _GRADED, _ORDER)
        found.append((middle + way * distance, weight))
    # an integral does not depend on the positions of its nodes
    return _Nodes(*(jax.lax.stop_gradient(jnp.concatenate(parts, axis=-1)) for parts in zip(*found, strict=True)))


def _sum_over(
    material: Material,
    cylinder: Cylinder,
    through: BlurTerms,
    light: PlacedLamps,
    window: _Window,
    rows: _Nodes,
    y: jax.Array | None,
) -> jax.Array:
    """Integrate the light in rows (positions, rows) through the kernel.

    y: y of the pixels, px; None: the weights of the rows include the kernel, or light is constant.
    """
    low, high, reach, x = (a[:, None, None] for a in window[:4])
    beside, row = light.beside(1), rows.at
    peak, miss = (a[..., None] for a in ridge_of(cylinder, beside, row, low[..., 0], high[..., 0]))
    blur, finest = through.blur, material.finest

    def along(column: jax.Array) -> jax.Array:
        return jnp.clip(_at_column(cylinder, column), low, high)

    first, last = along(x - reach), along(x + reach)
    middle = jnp.clip(peak, first, last)
    layers = [jnp.broadcast_to(a, middle.shape) for a in (low + _ENDS * finest, high - _ENDS * finest)]
    steps = np.array([-1.0, 1.0]), np.arange(1, _EVEN) / _EVEN
    # uniform on the sensor, as is the kernel
    centre = cylinder.surface(middle, jnp.zeros(())).x
    pixel = jnp.broadcast_to(x + steps[0] * blur.pixel.half_width, (*middle.shape[:-1], 2))
    sides = []
    for end in (first, last):
        even = centre + (cylinder.surface(end, jnp.zeros(())).x - centre) * steps[1]
        cuts = along(jnp.concatenate([pixel, even], axis=-1))
        sides.append((end, jnp.concatenate([cuts, *layers], axis=-1)))
    # a lobe that is long across the line is narrow along it at any distance of the line from its peak
    scale = jnp.sqrt(finest**2 + (miss**2 + (middle - peak) ** 2) / window.elongation**2)
    u, weight = _graded(middle, [(jnp.broadcast_to(end, middle.shape), cuts) for end, cuts in sides], scale[..., 0])
    sent = _sent(material, cylinder, light.beside(2), u, row[..., None])
    offset, spread = x - cylinder.surface(u, jnp.zeros(())).x, _spread(blur, cylinder, jnp.cos(u))
    beyond = None if y is None else y[:, None, None] - row[..., None]

    def recorded(across: Line, along: Line) -> jax.Array:
        return across(offset) if beyond is None else across(offset) * along(beyond)

    kernel = sum(blur.weights[term] * blur.through_disc(term, spread, recorded) for term in through.terms)
    share = kernel * weight * rows.weight[..., None]
    return jnp.sum(sent * share[..., None], axis=(1, 2))
