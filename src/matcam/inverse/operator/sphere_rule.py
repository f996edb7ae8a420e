"""Quadrature rule for the record of an isotropic lobe in one pixel of a sphere.

A pixel records the integral over the visible, lit part of the sphere, in polar coordinates about the normal of the highlight,

    R cos_i = 1/4 integral of  k(x - x(n)) F D(theta_h) G |v| |l|^-2 (1 - q n_z)^-3 s^2  over the solid angle of normals n  ,

where R is the recorded value of the pixel at x, cos_i the cosine of the angle of incidence there, and x(n) the image position
of the normal n, whose component along the optical axis is n_z. F, D and G are Fresnel term, density of facet normals and
masking. k is the kernel, s the scale of the image, px, and q the inverse distance of the camera, 1/radii. |v| and |l| are the
distances of camera and lamp from the point, divided by their distances from the centre of the sphere (docs/model.md 3 and 10).
In a distant rig q is 0, and |v| and |l| are 1.

The integration nodes lie on arcs of circles about the highlight inside the window of the pixel (`forward/sampler/arcs.py`).
Their weights are transferred to a few nodes in theta_h (`theta_nodes.py`), at which a lobe is evaluated. The weights depend on
the rig only.

In a distant rig all nodes on a circle have the same theta_h. With a near camera or lamp, theta_h, theta_d and irradiance
differ between the nodes. The weights times the deviation of theta_d from its value for the cell (`rise_of`) then represent
the variation of F over the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from matcam.core.arrays.elementary import angle_of, sine
from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.forward.integral.blur_groups import fineness_of
from matcam.forward.sampler.arc_nodes import nodes_on_arcs
from matcam.forward.sampler.arc_rules import MOST_NODES, arc_rules
from matcam.forward.sampler.arcs import CHUNK, Arcs, Clips, gaps_of
from matcam.forward.sampler.circles import (
    CircleLayout,
    Circles,
    about_highlight,
    above_ends,
    ends_inside,
    from_highlight,
    touching_angles,
)
from matcam.forward.sampler.windows import SphereView, Windows
from matcam.inverse.operator.lamp_lines import LampDisc, chord_points, lamp_kernel, of_gaussians
from matcam.inverse.operator.theta_nodes import (
    FROM_MOMENTS,
    NODES,
    CircleSums,
    NodeSpacing,
    PixelRule,
    ThetaRange,
    cos_azimuth,
    legendre_sums,
    rise_of,
)
from matcam.numerics.blocks import in_blocks, repeated_sum

_GROUP = 4
"""Number of nodes of an arc that are computed at once. It divides `MOST_NODES`."""
_MIDPOINT = MOST_NODES // _GROUP + 1
"""Index of the first midpoint rule in `_tabulated_rules`."""
_KERNELS = 2
"""Largest number of kernels that one call of the compiled program evaluates at the same nodes. The two Gaussians that are
stretched along and across the plane of camera and lamp have the same windows.
"""
_CALL, _BLOCK = 16384, 256
"""Numbers of arcs in one call of the compiled program, and in one of its blocks. The arrays of a block fit into the cache of
a processor.
"""
_MORE_CIRCLES = np.polynomial.legendre.leggauss(2 * NODES[0].size)
"""Rule for the circles on either side of a circle that touches limb or terminator. With 40 circles, the error of records at the
limb is up to 4e-4.
"""
_STEEP = 0.5
"""Ratio of the smallest to the largest cosine in a window below which its circles have the rule `_MORE_CIRCLES`. At larger
ratios, 40 circles are accurate to 1e-5.
"""
_REACH = 6.2
"""Support radius of a Gaussian, in standard deviations. At this distance the Gaussian is 5e-9 of its maximum. Such a small
value is required, because highlights are up to 1e6 times brighter than their surroundings.
"""
_SLACK = 0.02
"""Share by which the range of angles is widened, because the border of a window is sampled at single points."""


class Kernel(NamedTuple):
    """Kernel of a blur in some pixels.

    Attributes:
        blur: the blur.
        variances: variances that lamp and defocus add along the plane of camera and lamp and across it, two arrays (pixels,),
            px^2.
        disc: source disc; None: a point source, or a disc that is part of the variances.
        pixel_nodes: number of nodes over a pixel that is rotated relative to the plane of camera and lamp, see
            `Blur.turned_kernel`; 0: not rotated.
    """

    blur: Blur
    variances: tuple[np.ndarray, ...]
    disc: LampDisc | None = None
    pixel_nodes: int = 0

    def disc_at(self, index: np.ndarray) -> LampDisc | None:
        return self.disc and LampDisc._make(np.asarray(a)[index] for a in self.disc)


def kernel_reach(half_width: float, stds: np.ndarray) -> np.ndarray:
    """Compute the half side of the window of a pixel, px.

    Args:
        half_width: half width of the pixel, px.
        stds: standard deviations of the Gaussians of the blur, px.
    """
    return half_width + _REACH * stds


def sphere_range(view: SphereView, windows: Windows) -> tuple[ThetaRange, ThetaRange]:
    """Compute the ranges of angles in the windows of pixels.

    The first range is that of the angle from the normal of the highlight. The second is that of theta_h. The extremes
    lie on the border of a window, or on the limb if the window extends beyond the sphere.
    """
    inside, border = windows.contains(view, about_highlight(windows).axis), windows.border(view)

    def between(angle_of: Callable[[Windows, np.ndarray], np.ndarray]) -> ThetaRange:
        low, high = windows.extremes(view, border, angle_of)
        slack = _SLACK * (high - low)
        return ThetaRange(np.where(inside, 0.0, np.maximum(low - slack, 0.0)), np.minimum(high + slack, np.pi / 2))

    def half_angles(some: Windows, normals: np.ndarray) -> np.ndarray:
        lamp = some.lamp[:, None]
        return np.asarray(directions(normals, np.sin(lamp), np.cos(lamp), view.camera, view.lamp).theta_h)

    own = between(from_highlight)
    return own, own if view.distant else between(half_angles)


class Directions(NamedTuple):
    """Directions to camera and lamp at normals of a sample.

    Attributes:
        view: length of the vector to the camera, divided by the distance of the camera from the centre.
        light: length of the vector to the lamp, divided by the distance of the lamp from the centre.
        cos_i: cosine of the angle of incidence.
        cos_o: cosine of the viewing angle.
        theta_h: half angle, rad.
        theta_d: difference angle, rad.
    """

    view: Any
    light: Any
    cos_i: Any
    cos_o: Any
    theta_h: Any
    theta_d: Any


def directions(normal: Any, sin: Any, cos: Any, q: Any, w: Any) -> Directions:
    """Compute the directions at normals of a sphere.

    Args:
        normal: components of the normals.
        sin: sine of the lamp angle.
        cos: cosine of the lamp angle.
        q: inverse distance of the camera, 1/radii.
        w: inverse distance of the lamp, 1/radii.
    """
    xp: Any = np if isinstance(normal[0], np.ndarray) else jnp
    n_x, n_y, n_z = normal
    up = n_x * sin + n_z * cos
    view, light = xp.sqrt(1 + q**2 - 2 * q * n_z), xp.sqrt(1 + w**2 - 2 * w * up)
    cos_o, cos_i = (n_z - q) / view, (up - w) / light
    # cross product of half vector and normal, without loss of digits near the highlight, where it is 0
    cross = -n_y / view - cos * n_y / light, n_x / view + (cos * n_x - sin * n_z) / light, sin * n_y / light
    theta_h = angle_of(xp.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2), cos_i + cos_o)
    v = -q * n_x / view, -q * n_y / view, (1 - q * n_z) / view
    i = (sin - w * n_x) / light, -w * n_y / light, (cos - w * n_z) / light
    apart, together = (sum((a + side * b) ** 2 for a, b in zip(v, i, strict=True)) for side in (-1, 1))
    return Directions(view, light, cos_i, cos_o, theta_h, angle_of(xp.sqrt(apart), xp.sqrt(together)))


class WindowArcs(NamedTuple):
    """Arcs of circles about the highlight in the windows of pixels.

    The arcs are valid for all kernels whose support is in the windows.

    Attributes:
        windows: windows of the pixels.
        layout: circles about the highlights, and their arcs. The weights of the circles are those of an integral over the
            angle, rad.
    """

    windows: Windows
    layout: CircleLayout

    @classmethod
    def of(cls, view: SphereView, windows: Windows, circles: ThetaRange) -> WindowArcs:
        """Find the arcs.

        Args:
            view: the sphere and the distances of camera and lamp.
            windows: windows of the pixels.
            circles: range of the angle from the normal of the highlight in which the circles lie.
        """
        angle, step = circles.nodes(NODES)
        foreshortened = _foreshortened(view, windows, circles.low > 0)[:, None]
        if np.any(foreshortened):
            # the length of arcs varies with the square root of the distance to a circle that touches limb or terminator; in a
            # distant rig both touch the same circle
            touching = np.sort(touching_angles(view, windows, about_highlight(windows))[:, [0, 2]], axis=1)
            divided = circles.nodes(_MORE_CIRCLES, list(touching.T[: 1 if view.distant else 2]))
            wider = (0, 0), (0, divided[0].shape[1] - angle.shape[1])
            angle = np.where(foreshortened, divided[0], np.pad(angle, wider, mode="edge"))
            step = np.where(foreshortened, divided[1], np.pad(step, wider))
        found = []
        for begin in range(0, angle.shape[0], CHUNK):
            part = slice(begin, begin + CHUNK)
            own = windows.at(part)
            clips = Clips.of(own.half_spaces(view), about_highlight(own))
            index, _ = used = np.nonzero(step[part])
            found.append(gaps_of(clips, index, angle[part][used]))
        arcs = Arcs.of(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
        arcs = arcs._replace(circle=np.flatnonzero(step)[arcs.circle])
        window, everywhere = np.repeat(np.arange(windows.x.size), angle.shape[1]), np.full(windows.x.size, np.inf)
        circles_of = Circles(window, angle.ravel(), step.ravel())
        return cls(windows, CircleLayout(about_highlight(windows), everywhere, circles_of, arcs))


def _foreshortened(view: SphereView, windows: Windows, outside: np.ndarray) -> np.ndarray:
    """Check whether foreshortening varies strongly in each window: limb or terminator are inside, or close.

    Close is sufficient only for windows whose highlight is `outside`. In other windows the circles of `NODES` are more
    accurate, because they are at the nodes, so that the weights of narrow lobes are not transferred.
    """
    border = windows.border(view)
    cosines = above_ends(view, windows, border)
    steep = np.any([np.min(one, axis=1) < _STEEP * np.max(one, axis=1) for one in cosines], axis=0)
    return np.logical_or.reduce([*ends_inside(view, windows, border), steep & outside])


def sphere_rules(
    view: SphereView,
    at: WindowArcs,
    kernels: Sequence[Kernel],
    onto: ThetaRange,
    theta_d: np.ndarray,
    factor: np.ndarray,
) -> list[PixelRule]:
    """Compute the quadrature rule in theta_h for each kernel and pixel.

    Args:
        view: the sphere and the distances of camera and lamp.
        at: arcs in windows that contain the support of the kernels.
        kernels: kernels of blurs with the same numbers of terms. Kernels without a source disc are evaluated at the same nodes.
        onto: range of theta_h in which the nodes lie.
        theta_d: theta_d of the cells, (pixels,), rad.
        factor: factors by which the records are multiplied, (pixels,), no unit.
    """
    together = _KERNELS if all(kernel.disc is None for kernel in kernels) else 1
    rules: list[PixelRule] = []
    for first in range(0, len(kernels), together):
        sums = _kernel_sums(view, at, kernels[first : first + together], onto, theta_d)
        rules += [_from_sums(view, at, own, onto, theta_d, factor) for own in sums]
    return rules


def _kernel_sums(
    view: SphereView, at: WindowArcs, kernels: Sequence[Kernel], onto: ThetaRange, theta_d: np.ndarray
) -> np.ndarray:
    """Compute the sums of `_arc_sums` for a few kernels, (kernels, sums, arcs)."""
    windows, layout = at
    (window, angle, _), arcs = layout.circles, layout.arcs
    kernel, count = kernels[0], len(kernels)
    filled = [*kernels, *[kernel] * (_KERNELS - count)] if kernel.disc is None else kernels
    blurs = jax.tree.map(lambda *leaves: np.stack(leaves), *(one.blur for one in filled))
    spread = np.stack([variance for one in filled for variance in one.variances])
    spacing = onto.spacing()
    pixel = window[arcs.circle]
    per_pixel = (
        windows.x, windows.y, windows.cosine, windows.sine, windows.lamp, windows.peak, theta_d, *spacing,
    )  # fmt: skip
    near = not view.distant
    with_borders = np.zeros(arcs.circle.size, dtype=bool)
    if kernel.disc is not None:
        with_borders = ~of_gaussians(view, kernel.disc)[pixel]
    reach = windows.half.max(axis=0)
    fineness = np.max([fineness_of(one.blur, reach) for one in kernels], axis=0)
    nodes, evenly = nodes_on_arcs(view, windows, layout, fineness, 1.0)
    # the borders of the image of a disc that is described by chords may cross short arcs, too
    nodes = np.where(with_borders & ~evenly, np.maximum(nodes, 24), nodes)
    rule = -(-nodes // _GROUP) + evenly * _MIDPOINT
    per_arc = angle[arcs.circle], arcs.middle, arcs.half
    sums = np.zeros((count, 7 + 2 * NODES[0].size if near else 4, arcs.circle.size))
    # all arcs of a block have one rule and one description of the disc, so the sums of an arc do not depend on the others
    described = rule + 2 * _MIDPOINT * with_borders
    of_rules = np.split(np.argsort(described, kind="stable"), np.cumsum(np.bincount(described))[:-1])
    order = np.concatenate(
        [np.pad(own, (0, -own.size % _BLOCK), mode="edge") for own in of_rules if own.size] or of_rules
    )
    for begin in range(0, order.size, _CALL):
        some = order[begin : begin + _CALL]
        index = np.pad(some, (0, _CALL - some.size), mode="edge")
        seen_by = pixel[index]
        found = _arc_sums(
            np.array(-(-some.size // _BLOCK)), np.array(count), np.array(view), np.stack([a[seen_by] for a in per_pixel]),
            np.stack([a[index] for a in per_arc]), spread[:, seen_by], rule[index].reshape(-1, _BLOCK)[:, 0],
            _tabulated_rules(), blurs, kernel.disc_at(seen_by), near, kernel.pixel_nodes,
        )  # fmt: skip
        sums[..., some] = np.asarray(found)[:count, :, : some.size]
    return sums


def _from_sums(
    view: SphereView, at: WindowArcs, sums: np.ndarray, onto: ThetaRange, theta_d: np.ndarray, factor: np.ndarray
) -> PixelRule:
    """Compute the rule of a kernel from `sums`, the result of `_kernel_sums` for this kernel, (sums, arcs)."""
    circles, arcs = at.layout.circles, at.layout.arcs
    angle, step = (a.reshape(factor.size, -1) for a in (circles.angle, circles.weight))
    near, spacing = not view.distant, onto.spacing()
    through = factor[:, None] * view.stretch**2 / 4 * np.sin(angle) * step
    powers, moments = np.split(sums, [len(sums) - 2 * NODES[0].size * near])
    total, *others = (np.bincount(arcs.circle, power, angle.size).reshape(angle.shape) for power in powers)
    if not near:
        others += [total * spacing.by_pixel().position(angle), total * theta_d[:, None], others[0] * theta_d[:, None]]
    seen = CircleSums(total, np.stack(others[:3]), *others[3:])
    if not near:
        return PixelRule(onto.carry(angle, through * total), seen)
    own, pixel = np.zeros((2, factor.size, NODES[0].size)), circles.window[arcs.circle]
    begins = np.flatnonzero(np.diff(pixel, prepend=-1))
    if not begins.size:
        return PixelRule(own[0], seen, own[1])
    for weight, moment in zip(own, np.split(moments, 2), strict=True):
        by_pixel = np.add.reduceat(moment * through.ravel()[arcs.circle], begins, axis=1)
        weight[pixel[begins]] = (FROM_MOMENTS @ by_pixel).T
    return PixelRule(own[0], seen, own[1])


@cache
def _tabulated_rules() -> np.ndarray:
    """Tabulate Gauss-Legendre rules, followed by midpoint rules, (rules, 2, groups, nodes).

    The rules of each type are in the order of increasing number of groups.
    """
    rules = np.concatenate([arc_rules(even, MOST_NODES, _GROUP)[:, ::_GROUP] for even in (False, True)], axis=1)
    return np.moveaxis(rules, 1, 0).reshape(-1, 2, MOST_NODES // _GROUP, _GROUP)


@partial(jit_plainly, runs="mostly", static=("near", "pixel_nodes"))
def _arc_sums(
    used: Any,
    kernels: Any,
    of_view: Any,
    of_pixel: Any,
    of_arc: Any,
    spread: Any,
    rule: Any,
    rules: Any,
    blurs: Blur,
    disc: LampDisc | None,
    near: bool,
    pixel_nodes: int,
) -> jax.Array:
    """Compute sums over the nodes of each arc, for each kernel, (kernels, sums, arcs).

    The first 4 rows, or 7 rows in a near rig, are the sums of `CircleSums`. A near rig also has 40 sums of Legendre polynomials
    for weights, and 40 for moments.

    Only the first `used` blocks contain arcs, and only the first `kernels` kernels are evaluated. `spread` contains two
    variances of each kernel, see `Kernel`, (2 kernels, arcs). `rule` contains the index of the rule of each block in `rules`,
    the result of `_tabulated_rules`. The first axis of the arrays of `blurs` is that of the kernels.
    """
    view = SphereView(*of_view) if near else SphereView(of_view[0], 0.0, 0.0)
    most = len(spread) // 2

    def block(arguments):  # type: ignore[no-untyped-def]
        of_pixel, of_arc, spread, disc, own = arguments
        variances = jnp.stack(spread).reshape(most, 2, -1)
        circle, middle, half = of_arc
        angles = middle, circle, of_pixel[5], of_pixel[4]
        arc = half, *(function(angle) for angle in angles for function in (jnp.sin, jnp.cos))
        nothing = jnp.zeros((most, 7 + 2 * NODES[0].size if near else 4, circle.shape[0]))
        rule = rules[own, 0], rules[own, 1]
        points = disc and chord_points(view, disc)
        return repeated_sum(
            lambda node: sums(of_pixel, arc, variances, disc, points, nothing, *node), own % _MIDPOINT, rule, nothing
        )

    def sums(pixel, arc, variances, disc, points, nothing, node, node_weight):  # type: ignore[no-untyped-def]
        # the first axis is that of the nodes, because XLA computes sums over the first axis in vectors
        node, node_weight = node[:, None], node_weight[:, None]
        x, y, cosine, sine_, _, _, cell, *spacing = pixel
        half, sin_m, cos_m, s, c, sin_p, cos_p, *lamp = arc
        off = half * node
        chord = sine(off / 2)
        haversine, sin_off = chord**2, 2 * chord * jnp.sqrt(1 - chord**2)
        cos_a = cos_m - sin_m * sin_off - 2 * cos_m * haversine
        sin_a = sin_m + cos_m * sin_off - 2 * sin_m * haversine
        normal = c * sin_p + s * cos_a * cos_p, s * sin_a, c * cos_p - s * cos_a * sin_p
        depth = 1 - view.camera * normal[2]
        image = view.stretch * normal[0] / depth, view.stretch * normal[1] / depth
        offset = x - (image[0] * cosine - image[1] * sine_), y - (image[0] * sine_ + image[1] * cosine)

        def in_plane(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Resolve vectors along the plane of camera and lamp and across it."""
            return x * cosine + y * sine_, y * cosine - x * sine_

        def through(blur: Blur, term: int, var_x: jax.Array, var_y: jax.Array) -> jax.Array:
            out_of_focus = jnp.abs(blur.defocus(view.radius, normal[2]))
            if pixel_nodes and not blur.is_residual(term):
                added = Spread(var_x, var_y, out_of_focus)
                return blur.turned_kernel(*in_plane(*offset), term, added, (cosine, sine_), pixel_nodes)
            # the residual of a lens is small: in a rotated pixel its widening is treated as isotropic
            widths = ((var_x + var_y) / 2,) * 2 if pixel_nodes else (var_x, var_y)
            return blur.at(term, Spread(widths[0], widths[1], out_of_focus), *offset)

        if near:
            at = directions(normal, *lamp, view.camera, view.lamp)
            # area in the image divided by the cosine of the viewing angle, times the irradiance of a surface that faces the
            # lamp
            measure = half * node_weight * at.view / depth**3 / at.light**2
            position = NodeSpacing(*spacing).position(at.theta_h)
            cos_psi = cos_azimuth(at.cos_i, at.cos_o, at.theta_h, at.theta_d)
            factors = 1, cos_psi, cos_psi**2, cos_psi**3, position, at.theta_d, at.theta_d * cos_psi
        else:
            measure, factors = half * node_weight, (1.0, cos_a, cos_a**2, cos_a**3)

        def of_kernel(number: jax.Array, found: jax.Array) -> jax.Array:
            blur = jax.tree.map(lambda a: a[number], blurs)
            var_x, var_y = variances[number]
            if disc is None:
                seen = sum((blur.share(term) * through(blur, term, var_x, var_y) for term in blur.terms), jnp.zeros(()))
            else:
                normals = tuple(jnp.broadcast_to(n, off.shape).T for n in normal)
                per_arc = (tuple(a[:, None] for a in pair) for pair in (in_plane(x, y), (var_x, var_y)))
                seen = lamp_kernel(view, blur, disc, points, normals, *per_arc).T
            share = jax.lax.optimization_barrier(seen * measure)
            own = jnp.stack([jnp.sum(share * one, axis=0) for one in factors])
            if near:
                own = jnp.concatenate([own, *legendre_sums(position, (share, share * rise_of(at.theta_d, cell)))])
            return found.at[number].set(own)

        return jax.lax.fori_loop(0, kernels, of_kernel, nothing)

    def blocks(array: jax.Array) -> jax.Array:
        return array.reshape(-1, _BLOCK, *array.shape[1:])

    of_blocks = jax.tree.map(blocks, (tuple(of_pixel), tuple(of_arc), tuple(spread), disc))
    found = in_blocks(block, used, (*of_blocks, rule))
    return jnp.moveaxis(found, 0, 2).reshape(*found.shape[1:3], -1)
