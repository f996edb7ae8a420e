"""Quadrature rule for an isotropic lobe in one pixel of a cylinder, under a source disc or in a near rig.

A single row and lamp direction (`line_rule.py`) are insufficient in these cases: the smallest angle between normals and
half vector differs between points of a disc, and between rows in a near rig. The rule is a sum over samples. A sample is a
row of the image under one lamp direction, and has one smallest angle. Polynomials in asinh(theta_h / scale) transfer the
weights of all samples, and the moments of theta_d, to a few nodes in theta_h, as in `theta_nodes.py`.

A disc is divided into chords. Along a chord the half vector rotates about the axis of the cylinder only, and the kernel is
integrated in closed form. Samples are denser where the smallest angle may be 0.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam.core.arrays.elementary import angle_of
from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.forward.sampler.cylinder_ridge import PlacedLamps, ends_of_light, ridge_of, seen_at, towards
from matcam.inverse.operator.line_rule import LEAST_ARM, arm_nodes
from matcam.inverse.operator.sphere_rule import Directions
from matcam.inverse.operator.theta_nodes import (
    CircleSums,
    NodeSpacing,
    PixelRule,
    Scale,
    ThetaRange,
    cos_azimuth,
    onto_nodes,
    rise_of,
)
from matcam.numerics.approximation import nodes_in_panels
from matcam.sample.curved import Cylinder

_PANEL, _ACROSS = 16, 10
"""Numbers of Gauss-Legendre nodes between two neighbouring cuts of an arm, and between two samples' borders along the axis."""
_BLOCK = 8
_SLACK = 0.02
"""Share by which the range of theta_h is widened, because it is computed from single points."""


class LinePixels(NamedTuple):
    """Pixels at height 0 on a cylinder, each with its own lamp. All arrays have one shape.

    Attributes:
        x: distance from the axis of the cylinder, px.
        lamp_angle: angle between lamp and optical axis, rad.
        azimuth: azimuth of the lamp about the optical axis, rad.
        factor: factor by which the record is multiplied, no unit.
    """

    x: np.ndarray
    lamp_angle: np.ndarray
    azimuth: np.ndarray
    factor: np.ndarray


class _Samples(NamedTuple):
    """Rows of the image, each under one lamp direction. The arrays have shape (pixels, samples).

    Attributes:
        light: lamp of each sample.
        row: position of each row along the axis of the cylinder, px.
        share: weight of each sample in the record.
        shift: differences of the closest normals at the two ends of a chord from that at its middle, rad, two arrays.
    """

    light: PlacedLamps
    row: jax.Array
    share: jax.Array
    shift: tuple[jax.Array, jax.Array]


def lamp_of(pixels: LinePixels, nearness: float) -> PlacedLamps:
    """Build the lamps of pixels, (pixels, 1).

    nearness: inverse distance of the lamps, 1/radii; 0: distant.
    """
    lamp = tuple(jnp.asarray(a)[:, None] for a in towards(pixels.lamp_angle, pixels.azimuth))
    near = jnp.full((pixels.x.size, 1), nearness) if nearness else None
    return PlacedLamps(lamp, near)  # type: ignore[arg-type]


def line_window(cylinder: Cylinder, nearness: float, pixels: LinePixels, reach: np.ndarray, disc: float) -> ThetaRange:
    """Compute the range of theta_h in the window of each pixel.

    Args:
        cylinder: the cylinder.
        nearness: inverse distance of the lamps, 1/radii; 0: distant.
        pixels: the pixels.
        reach: support radius of the kernel, px, (pixels,).
        disc: angular radius of the source disc, rad.
    """
    turns = np.linspace(-1, 1, 9)
    light, bound = lamp_of(pixels, nearness), jnp.asarray(reach)[:, None]
    rows = bound * (turns if nearness or not cylinder.distant else np.zeros(1))
    ends = ends_of_light(cylinder, light)
    own = jnp.asarray(pixels.x)[:, None]
    first, last = (jnp.clip(cylinder.across(own + s * bound, jnp.zeros(())), *ends) for s in (-1, 1))
    # along a chord the closest normal also moves across the cylinder
    first, last = (jnp.clip(at + side * disc, *ends) for at, side in ((first, -1), (last, 1)))
    misses, aside, angles = [], [], []
    for part in turns if disc else np.zeros(1):
        lamp, _ = _moved(light, disc, jnp.full_like(own, part), jnp.zeros_like(own))
        misses.append(_miss(cylinder, lamp, rows, ends))
        aside.append(ridge_of(cylinder, lamp, rows, *ends)[0])
        for u in (first + 0 * rows, last + 0 * rows, jnp.clip(aside[-1], first, last)):
            angles.append(_angles(*seen_at(cylinder, lamp, u, rows)[:2]).theta_h)
    miss, closest = (jnp.concatenate(parts, axis=1) for parts in (misses, aside))
    angle = np.concatenate([np.asarray(a) for a in angles], axis=1)
    meets = np.asarray((miss.min(1) <= 0) & (miss.max(1) >= 0) & jnp.any((closest > first) & (closest < last), axis=1))
    low, high = angle.min(1), angle.max(1)
    slack = _SLACK * (high - low) + LEAST_ARM
    # nodes below the smallest angle would have to resolve the peak of the lobe, which is not in the window
    return ThetaRange(np.where(meets, 0.0, (1 - _SLACK) * low), np.minimum(high + slack, np.pi / 2))


@partial(jit_plainly, static=("arm", "discs"))
def cylinder_rule(
    cylinder: Cylinder,
    blur: Blur,
    variance: jax.Array,
    pixels: LinePixels,
    nearness: jax.Array | None,
    reach: jax.Array,
    disc: jax.Array,
    onto: ThetaRange,
    scale_of: Scale,
    arm: float,
    discs: bool,
    theta_d: jax.Array | np.ndarray | None = None,
) -> PixelRule:
    """Compute the quadrature rule of one arm for a blur.

    Args:
        cylinder: the cylinder.
        blur: blur for a point source.
        variance: variance that is added to the blur, (pixels,), px^2.
        pixels: the pixels. Their number is a multiple of `_BLOCK`, see `padded`.
        nearness: inverse of the lamp's distance, 1/radii; None: distant.
        reach: half width of the window of each pixel, (pixels,), px.
        disc: angular radius of the source disc, rad.
        onto: range of theta_h in which the nodes lie.
        scale_of: scale of the nodes on the arm.
        arm: one of `line_rule.ARMS`.
        discs: True if the lamp is a disc, False for a point source.
        theta_d: theta_d of the cells, (pixels,), rad, at which the moments are 0; None: no moments.
    """

    def block(arguments):  # type: ignore[no-untyped-def]
        arguments, cell = arguments
        x, angle, azimuth, factor, variance, reach, *ends = (a[:, None] for a in arguments)
        sine, rows = jnp.sin(angle), not discs and (nearness is not None or not cylinder.distant)
        lamp = sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), jnp.cos(angle)
        light = PlacedLamps(lamp, None if nearness is None else jnp.full_like(x, nearness))
        low, high = ends_of_light(cylinder, light)
        samples = _samples(cylinder, blur, variance, light, reach, ends[2], disc if discs else None)
        closest, _ = ridge_of(cylinder, samples.light, samples.row, low, high)

        def turns(column: jax.Array) -> jax.Array:
            u = jnp.clip(cylinder.across(column, jnp.zeros(())), low, high)
            return jnp.maximum(arm * (u - closest), 0.0)

        wide = reach + jnp.zeros_like(closest)
        if discs:
            moved = jnp.maximum(jnp.abs(samples.shift[0]), jnp.abs(samples.shift[1]))
            wide = wide + cylinder.stretch * moved * 1.5
        half = blur.pixel.half_width
        own = [turns(x + arm * at) for at in (-wide, -half, half, wide)]
        farthest = jnp.maximum(own[3], own[0] + LEAST_ARM)
        scale = NodeSpacing.of(own[0], farthest, scale_of.limit(farthest)).scale
        t, step = arm_nodes(own, scale, _PANEL)
        u = closest[..., None] + arm * scale[..., None] * jnp.sinh(t)
        row = samples.row[..., None] + jnp.zeros_like(u)
        element, to_lamp, square = seen_at(cylinder, samples.light.beside(1), u, row)
        at = _angles(element, to_lamp)
        kernel = _kernel(
            cylinder, blur, variance[..., None], (x[..., None], u, row), samples.shift if discs else None, rows
        )
        area = element.area / (cylinder.stretch / (1 - cylinder.nearness * jnp.cos(u)))
        share = kernel * step * samples.share[..., None] * area * factor[..., None] / 4
        if square is not None:
            share = share / square
        share = jnp.where((at.cos_i > 0) & (at.cos_o > 0), share, 0.0)
        position = NodeSpacing.of(*ends).by_pixel().position(at.theta_h)
        weight = onto_nodes(position, share)
        moment = None if cell is None else onto_nodes(position, share * rise_of(at.theta_d, cell[:, None, None]))
        # nodes of all samples at about the same angle from the closest normal form a circle
        cos_psi = cos_azimuth(at.cos_i, at.cos_o, at.theta_h, at.theta_d)
        sums = [
            jnp.sum(share * one, axis=1)
            for one in (1.0, cos_psi, cos_psi**2, cos_psi**3, position, at.theta_d, at.theta_d * cos_psi)
        ]
        return weight, CircleSums(sums[0], jnp.stack(sums[1:4], 1), *sums[4:]), moment

    arguments = (*pixels, variance, reach, *onto), theta_d
    found = jax.lax.map(block, jax.tree.map(lambda a: jnp.asarray(a).reshape(-1, _BLOCK), arguments))
    weight, circles, moment = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), found)
    return PixelRule(weight, circles._replace(cosine=jnp.moveaxis(circles.cosine, 1, 0)), moment)


def _samples(
    cylinder: Cylinder,
    blur: Blur,
    variance: jax.Array,
    light: PlacedLamps,
    reach: jax.Array,
    flat: jax.Array,
    disc: jax.Array | None,
) -> _Samples:
    """Build the samples of each pixel.

    `flat` is the angle from the half vector below which samples have a constant density, rad, (pixels, 1). `disc` is the
    angular radius of the source disc, rad, or None for a point source.
    """
    ends = ends_of_light(cylinder, light)
    half, zero = blur.pixel.half_width, jnp.zeros_like(reach)
    row, share = zero, jnp.ones_like(reach)
    if light.nearness is not None or not cylinder.distant:
        if disc is None:
            middle, slope = _meeting(*(_miss(cylinder, light, at, ends) for at in (-reach, zero, reach)))
            row, share = _crowded(middle * reach, (-reach, -half + zero, half + zero, reach), flat * reach / slope)
        else:
            offset, weight = blur.rule(0, variance[:, 0])
            row, share = zero + offset, jnp.broadcast_to(weight, (reach.shape[0], offset.shape[-1]))
    if disc is None:
        many = PlacedLamps(tuple(a + 0 * row for a in light.towards), _beside(light.nearness, row))  # type: ignore[arg-type]
        return _Samples(many, row, share, (0 * row, 0 * row))
    one = jnp.ones_like(row)
    middle, slope = _meeting(
        *(_miss(cylinder, _moved(light, disc, m * one, 0 * one)[0], row, ends) for m in (-1.0, 0.0, 1.0))
    )
    # the variable is the angle whose sine is the position of a chord, so that the share of a chord is smooth in it
    quarter = jnp.full_like(middle, jnp.pi / 2)
    middle, quarter, core = (a.reshape(-1, 1) for a in (jnp.arcsin(middle), quarter, flat / slope))
    at, step = _crowded(middle, (-quarter, quarter), core)
    at, step = (a.reshape(row.shape[0], -1) for a in (at, step))
    each = at.shape[1] // row.shape[1]
    row, share = (jnp.repeat(a, each, axis=1) for a in (row, share))
    position, length = jnp.sin(at), jnp.cos(at)
    lamps = [_moved(light, disc, position, side * length) for side in (0.0, 1.0, -1.0)]
    closest, *others = (ridge_of(cylinder, lamp, row, *ends)[0] for lamp, _ in lamps)
    share = share * step * 2 / jnp.pi * length**2 * lamps[0][1]
    return _Samples(lamps[0][0], row, share, (others[0] - closest, others[1] - closest))


def _beside(nearness, row):  # type: ignore[no-untyped-def]
    return None if nearness is None else nearness + 0 * row


def _miss(cylinder: Cylinder, light: PlacedLamps, row: jax.Array, ends: tuple[jax.Array, jax.Array]) -> jax.Array:
    """Compute the signed smallest angle between the half vector and the normals in a row, rad.

    The angle is positive where the half vector points upwards, and negative where it points downwards.
    """
    u, miss = ridge_of(cylinder, light, row, *ends)
    element, lamp, _ = seen_at(cylinder, light, u, row)
    return jnp.where(lamp[1] + element.view[1] < 0, -miss, miss)


def _meeting(first: jax.Array, middle: jax.Array, last: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Estimate the position in [-1, 1] at which an angle is closest to 0, and the magnitude of the slope of the angle.

    The arguments are the angles at -1, 0 and 1, rad.
    """
    slope = (last - first) / 2
    safe = jnp.where(jnp.abs(slope) > LEAST_ARM, slope, LEAST_ARM)
    return jnp.clip(-middle / safe, -1, 1), jnp.abs(safe)


def _crowded(middle: jax.Array, borders: tuple[jax.Array, ...], scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute nodes between the first and the last border, and their weights. Nodes are denser towards `middle`.

    scale: distance from `middle` below which the density of the nodes is constant.
    """
    cuts = jnp.concatenate([jnp.arcsinh((at - middle) / scale) for at in (*borders, middle)], axis=1)
    cuts = jnp.sort(cuts, axis=1)
    t, step = nodes_in_panels(cuts, _ACROSS)
    return middle + scale * jnp.sinh(t), step * scale * jnp.cosh(t)


def _moved(light: PlacedLamps, disc: ArrayLike, position: jax.Array, along: jax.Array) -> tuple[PlacedLamps, jax.Array]:
    """Move the lamp to a point of its disc, and compute the irradiance relative to that from the middle of the disc.

    `disc` is the angular radius of the disc, rad. `position` and `along` are the coordinates of the point in radii of the disc.
    The half vector rotates towards the axis of the cylinder with `position`, and about this axis with `along`.
    """
    x, y, z = light.towards
    across = jnp.maximum(jnp.hypot(x, z), 1e-12)
    first, second = (z / across, 0 * x, -x / across), (-x * y / across, across, -y * z / across)
    square = position**2 + along**2
    if light.nearness is None:  # the radiance is uniform over the solid angle of the disc
        sunk = square * 2 * jnp.sin(disc / 2) ** 2
        up, aside, length = 1 - sunk, np.sqrt(2) * jnp.sin(disc / 2) * jnp.sqrt(2 - sunk), jnp.ones_like(square)
    else:  # a flat disc that faces the centre of the cylinder
        up, aside = jnp.ones_like(square), jnp.tan(disc) * jnp.ones_like(square)
        length = jnp.sqrt(1 + square * aside**2)
    lamp = [
        (up * a + aside * (along * b + position * c)) / length for a, b, c in zip((x, y, z), first, second, strict=True)
    ]
    near = None if light.nearness is None else light.nearness / length
    return PlacedLamps((lamp[0], lamp[1], lamp[2]), near), 1 / length**2


def _angles(element, lamp) -> Directions:  # type: ignore[no-untyped-def]
    half, apart = ([a + side * b for a, b in zip(lamp, element.view, strict=True)] for side in (1, -1))
    normal, tangent = element.normal, element.tangent
    cos_i, cos_o = (normal[0] * one[0] + normal[2] * one[2] for one in (lamp, element.view))
    along = tangent[0] * half[0] + tangent[2] * half[2]
    theta_h = angle_of(jnp.hypot(along, half[1]), cos_i + cos_o)
    theta_d = angle_of(*(jnp.sqrt(sum(a**2 for a in part)) for part in (apart, half)))
    return Directions(jnp.ones(()), jnp.ones(()), cos_i, cos_o, theta_h, theta_d)


def _kernel(cylinder, blur: Blur, variance, at, shift, rows: bool):  # type: ignore[no-untyped-def]
    """Evaluate the kernel at nodes, 1/px, or 1/px^2 if `rows` is True.

    `at` contains the column of the pixel, px, and two coordinates of the nodes: angle, rad, and row, px. `shift` contains the
    shifts of the normal, rad, at the two ends of a chord, over which the kernel is averaged; None for a point source.
    """
    x, u, row = at
    spread = Spread(variance, variance, jnp.abs(blur.defocus(cylinder.radius, jnp.cos(u))))
    offset = x - cylinder.surface(u, jnp.zeros(())).x
    if shift is None:
        return sum(
            blur.weights[j]
            * blur.through_disc(j, spread, lambda across, along: across(offset) * (along(-row) if rows else 1.0))
            for j in blur.terms
        )
    ends = [x - cylinder.surface(u + a[..., None], jnp.zeros(())).x for a in shift]
    length = ends[0] - ends[1]
    # the closed form would lose digits for an image of a chord that is nearly a point
    short = jnp.abs(length) < 1e-3 * blur.stds[0]
    total = jnp.zeros(())
    for j in blur.terms:
        mean = blur.kernel_until(ends[0], j, variance) - blur.kernel_until(ends[1], j, variance)
        mean = jnp.where(short, blur.kernel(offset, j, variance), mean / jnp.where(short, 1.0, length))
        total += blur.weights[j] * mean
    return total
