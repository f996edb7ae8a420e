"""The record of an isotropic lobe in one pixel of a sphere, before a near camera or under a near lamp (docs/model.md 10).

The half vector turns over the picture, so that a circle about the highlight's normal is none of a constant theta_h. Nodes lie
on such circles, as in `polar_rule`: what the camera sees, the lamp lights and the kernel reaches is an arc in closed form on
each. Every node has its own theta_h, theta_d and irradiance. A polynomial in asinh(theta_h / scale) carries their weights over
to few nodes in theta_h, at which a lobe is asked for. The polynomials are Legendre's, and those nodes are Gauss's. In the same
way come the weights times the difference of theta_d from the cell's (`rise_of`), by which F is read at each node's own
theta_d.

A lamp at an azimuth turns the pixel against the plane of camera and lamp (docs/model.md 10). The arcs are those of the square
about the turned pixel then, and its kernel is different on either side of that plane. Here a distant rig is one whose camera
and lamp are infinitely far.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.forward.pixel_grid import turned
from matcam.inverse.operator.lamp_lines import LampDisc, both_sides, lamp_kernel
from matcam.inverse.operator.polar_rule import (
    AZIMUTHS,
    NODES,
    PolarWindow,
    nearest_seen,
    onto_nodes,
    skewed_pair,
    stretched,
)
from matcam.inverse.operator.sample_view import SampleView, angles_between, square_border
from matcam.numerics.sine import sine_and_cosine

_BLOCK = 32
_STEEPNESS = 7.0
"""1/rad."""
RISE = f"exp({_STEEPNESS:g} theta_d)"
"""What F is taken to be linear in; rules that are kept say so."""
_MORE_AZIMUTHS = np.polynomial.legendre.leggauss(30)
"""A turned pixel is met over up to sqrt(2) times its side."""
_LEAST_SPREAD = 1e-7
"""Standard deviation of the cosine of an azimuth below which all azimuths are one."""


def rise_of(theta_d: jax.Array, cell: jax.Array) -> jax.Array:
    """Return the difference of theta_d from the cell's as F takes it, rad: for small ones itself.

    F is about linear in it: where it rises steeply, towards grazing angles, it does so as exp(7 theta_d).
    """
    return jnp.expm1(_STEEPNESS * (theta_d - cell)) / _STEEPNESS


class NearPixels(NamedTuple):
    """Hold pixels of a sphere's pictures, arrays of one shape; each may be under a lamp of its own.

    Attributes:
        x: px from the optical axis, the lamp towards +x.
        y: the same across.
        lamp_angle: between lamp and optical axis, rad.
        highlight: angle of the highlight's normal from the optical axis, rad.
        factor: factor of the record.
    """

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    highlight: np.ndarray
    factor: np.ndarray


class NearWindow(NamedTuple):
    """Hold what a kernel can see; arrays of shape (pixels,).

    Attributes:
        circles: angles from the highlight's normal.
        theta: angles between normal and half vector.
    """

    circles: PolarWindow
    theta: PolarWindow


class NearRule(NamedTuple):
    """Hold the rule of each pixel.

    Attributes:
        theta: (pixels, nodes), angle between normal and half vector, rad.
        weight: (pixels, nodes).
        circle: (pixels, circles), mean place of each circle among the nodes, in [-1, 1]; NaN where nothing is seen.
        cos_psi: (pixels, circles, 2), cosine of the two azimuths at which G is taken.
        theta_d: (pixels, circles, 2), theta_d there, rad.
        share: (pixels, circles, 2), their shares.
        moment: (pixels, nodes), weights of the difference of theta_d from the cell's, rad; None: it is not asked for.
    """

    theta: jax.Array
    weight: jax.Array
    circle: jax.Array
    cos_psi: jax.Array
    theta_d: jax.Array
    share: jax.Array
    moment: jax.Array | None = None


def near_window(view: SampleView, pixels: NearPixels, reach: np.ndarray, rows: np.ndarray) -> NearWindow:
    """Return what is seen under a kernel of half sides `reach` and `rows` px, along the pixel's axes.

    The extremes lie on the border of the kernel's rectangle, or on the limb where it leaves the sphere.
    """
    normal = view.normals(*square_border(view.radius, pixels.x, pixels.y, reach, rows, view.azimuth))
    peak = np.sin(pixels.highlight), 0 * pixels.x, np.cos(pixels.highlight)
    circle = angles_between(normal, tuple(a[..., None] for a in peak))  # type: ignore[arg-type]
    lamp, q, w = pixels.lamp_angle[..., None], view.camera, view.lamp
    theta = _directions(normal, np.sin(lamp), np.cos(lamp), q, w).theta_h
    at = view.stretch * peak[0] / (1 - q * peak[2])
    first, second = np.abs(turned(at - pixels.x, -pixels.y, view.azimuth))
    inside = (first < reach) & (second < rows)
    cosine, sine = np.cos(view.azimuth), np.sin(view.azimuth)
    around = reach * cosine + rows * sine, reach * sine + rows * cosine  # along the plane of camera and lamp
    return NearWindow(*(_between(angle, inside, *around) for angle in (circle, theta)))


def _between(angle: np.ndarray, inside: np.ndarray, reach: np.ndarray, rows: np.ndarray) -> PolarWindow:
    low, high = angle.min(-1), angle.max(-1)
    slack = 0.02 * (high - low)
    low = np.where(inside, 0.0, np.maximum(low - slack, 0.0))
    return PolarWindow(low, np.minimum(high + slack, np.pi / 2), reach, rows)


class Directions(NamedTuple):
    """Hold what a piece of surface sees of camera and lamp; `view` and `light` are over the distances of these."""

    view: Any
    light: Any
    cos_i: Any
    cos_o: Any
    theta_h: Any
    theta_d: Any


def _directions(normal: Any, sin: Any, cos: Any, q: Any, w: Any) -> Directions:
    """Return the lengths of view and light, cosines and angles at normals; sin, cos: of the lamp's angle."""
    xp: Any = np if isinstance(normal[0], np.ndarray) else jnp
    n_x, n_y, n_z = normal
    up = n_x * sin + n_z * cos
    view, light = xp.sqrt(1 + q**2 - 2 * q * n_z), xp.sqrt(1 + w**2 - 2 * w * up)
    cos_o, cos_i = (n_z - q) / view, (up - w) / light
    # half vector x normal, which vanishes at the highlight without a loss of digits
    cross = -n_y / view - cos * n_y / light, n_x / view + (cos * n_x - sin * n_z) / light, sin * n_y / light
    theta_h = xp.arctan2(xp.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2), cos_i + cos_o)
    v = -q * n_x / view, -q * n_y / view, (1 - q * n_z) / view
    i = (sin - w * n_x) / light, -w * n_y / light, (cos - w * n_z) / light
    apart, together = (sum((a + side * b) ** 2 for a, b in zip(v, i, strict=True)) for side in (-1, 1))
    return Directions(view, light, cos_i, cos_o, theta_h, xp.arctan2(xp.sqrt(apart), xp.sqrt(together)))


@partial(jit_plainly, static=("terms", "pixel_nodes"))
def near_rule(
    view: SampleView,
    blur: Blur,
    variances: tuple,
    terms: tuple[int, ...],
    pixels: NearPixels,
    window: NearWindow,
    onto: PolarWindow,
    pixel_nodes: int = 0,
    disc: LampDisc | None = None,
    theta_d: jax.Array | np.ndarray | None = None,
) -> NearRule:
    """Return the rule for some terms of a blur; differentiable in its parameters.

    variances: px^2, (pixels,), that the blur's spread adds along x and y. window: what this blur sees. onto: the theta_h
    between which the rule's nodes lie; all that is seen, or more. pixels: a multiple of the block, see `padded`.
    pixel_nodes: of a pixel that is turned against the plane of camera and lamp, see `Blur.turned_kernel`; 0: it is not.
    disc: of a lamp whose disc is not in the variances. theta_d: of the cells, rad, from which moments count; None: none do.
    """
    radius, stretch, q, w = view.radius, view.stretch, view.camera, view.lamp
    turn = jnp.cos(view.azimuth), jnp.sin(view.azimuth)
    around = _MORE_AZIMUTHS if pixel_nodes else AZIMUTHS

    def block(arguments):  # type: ignore[no-untyped-def]
        arguments, disc, cell = arguments
        x, y, lamp, peak, factor, low, high, reach, high_rows, from_theta, to_theta, var_x, var_y = (
            a[:, None, None] for a in arguments
        )
        scale, first, last = stretched(low, high)
        along = first + (last - first) * (NODES[0][:, None] + 1) / 2
        circle = scale * jnp.sinh(along)
        step = scale * jnp.cosh(along) * (last - first) / 2 * NODES[1][:, None]
        s, c = jnp.sin(circle), jnp.cos(circle)
        sin_p, cos_p, sin_l, cos_l = jnp.sin(peak), jnp.cos(peak), jnp.sin(lamp), jnp.cos(lamp)
        aside = lamp - peak
        own_y, y = y, jnp.abs(y)  # the mirror's other half shows the same
        # whatever is linear in the normal is an arc of a circle: what the camera sees, what the lamp lights, columns
        horizon = (c * cos_p - q) / jnp.maximum(s * sin_p, 1e-300)
        shade = (w - c * jnp.cos(aside)) / jnp.maximum(s * jnp.sin(aside), 1e-300)
        columns = [jnp.clip(x + side * reach, -radius, radius) for side in (-1, 1)]
        seen = [
            (at - c * (stretch * sin_p + at * q * cos_p)) / (s * (stretch * cos_p - at * q * sin_p)) for at in columns
        ]
        from_ = jnp.arccos(jnp.clip(jnp.minimum(seen[1], horizon), -1, 1))
        to = jnp.arccos(jnp.clip(jnp.maximum(seen[0], shade), -1, 1))
        # rows: the sine of the azimuth less a lean
        rows = [jnp.clip(y + side * high_rows, 0.0, radius) for side in (-1, 1)]
        lean = [jnp.arctan2(at * q * sin_p, stretch) for at in rows]
        rise = [
            jnp.arcsin(jnp.clip(at * (1 - q * c * cos_p) / (s * jnp.hypot(stretch, at * q * sin_p)), 0, 1))
            for at in rows
        ]
        psi, share = [], []
        for begin, end in (
            (lean[0] + rise[0], lean[1] + rise[1]),
            (jnp.pi + lean[1] - rise[1], jnp.pi + lean[0] - rise[0]),
        ):
            begin, end = jnp.maximum(begin, from_), jnp.minimum(end, to)
            half = jnp.maximum(end - begin, 0.0) / 2
            psi.append(begin + half * (around[0] + 1))
            share.append(half * around[1])
        azimuth, share = jnp.concatenate(psi, -1), jnp.concatenate(share, -1)
        sin_a, cos_a = (-a for a in sine_and_cosine(azimuth - jnp.pi))  # a lean takes azimuths beyond pi
        normal = c * sin_p + s * cos_a * cos_p, s * sin_a, c * cos_p - s * cos_a * sin_p
        at = _directions(normal, sin_l, cos_l, q, w)
        depth = 1 - q * normal[2]
        dx, dy = stretch * normal[0] / depth - x, stretch * normal[1] / depth
        out_of_focus = jnp.abs(blur.defocus(radius, normal[2]))
        if disc is not None:
            kernel = lamp_kernel(view, blur, terms, disc, normal, (x, own_y), (var_x, var_y))
        elif pixel_nodes:
            added = Spread(var_x, var_y, out_of_focus)
            kernel = sum(
                blur.weights[j] * blur.turned_kernel(dx, side * dy - own_y, j, added, turn, pixel_nodes)
                for j in terms
                for side in (1, -1)
            )
        else:
            kernel = both_sides(blur, terms, Spread(var_x, var_y, out_of_focus), (dx, dy), y)
        # area in the picture over the cosine of the view, times the irradiance across the light
        share = share * kernel * at.view / depth**3 / at.light**2
        scale, first, last = stretched(from_theta, to_theta)
        place = jnp.clip(2 * (jnp.arcsinh(at.theta_h / scale) - first) / (last - first) - 1, -1.1, 1.1)
        through = factor[..., 0] * stretch**2 / 4 * (s * step)[..., 0]
        weight = onto_nodes(place, through[..., None] * share)
        moment = None
        if cell is not None:
            moment = onto_nodes(place, through[..., None] * share * rise_of(at.theta_d, cell[:, None, None]))
        nodes = scale * jnp.sinh(first + (last - first) * (NODES[0] + 1) / 2)
        return nodes[:, 0], weight, *azimuths_seen(at, place, share), moment

    circles, theta = window.circles, onto
    arguments = (*pixels, circles.low, circles.high, circles.reach, circles.rows, theta.low, theta.high, *variances)
    blocks = jax.tree.map(lambda a: a.reshape(-1, _BLOCK, *a.shape[1:]), (arguments, disc, theta_d))
    found = jax.lax.map(block, blocks)
    return NearRule(*jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), found))


def azimuths_seen(at: Directions, place: jax.Array, share: jax.Array) -> tuple[jax.Array, ...]:
    """Return each circle's mean place, and the cosine, theta_d and share of two azimuths that stand for what it shows."""
    total = jnp.sum(share, -1)
    safe = jnp.where(total == 0, 1.0, total)

    def mean(of: jax.Array) -> jax.Array:
        return jnp.sum(share * of, -1) / safe

    cos_psi = (at.cos_i - at.cos_o) / jnp.maximum(2 * jnp.sin(at.theta_h) * jnp.sin(at.theta_d), 1e-300)
    cos_psi = jnp.clip(cos_psi, -1, 1)
    middle, beside = mean(cos_psi), mean(at.theta_d)
    off = cos_psi - middle[..., None]
    spread = jnp.sqrt(jnp.maximum(mean(off**2), _LEAST_SPREAD**2))
    slope = mean(off * (at.theta_d - beside[..., None])) / spread
    nodes, shares = skewed_pair(mean(off**3) / spread**3)
    pair = jnp.clip(middle[..., None] + spread[..., None] * nodes, -1, 1)
    here = jnp.where(total == 0, jnp.nan, mean(place))
    return here, pair, beside[..., None] + slope[..., None] * nodes, shares


def near_masking_samples(rule: NearRule) -> tuple[np.ndarray, ...]:
    """Return (theta, cos psi, theta_d, shares) at the nodes, from the circles next to them.

    Where nothing is seen, they are those of the nearest circle that sees any.
    """
    circle, *sampled = (np.asarray(a) for a in (rule.circle, rule.cos_psi, rule.theta_d, rule.share))
    seen = np.isfinite(circle)
    nearest = nearest_seen(seen)
    circle = np.nan_to_num(np.take_along_axis(circle, nearest, axis=1))
    sampled = [np.take_along_axis(a, nearest[..., None], axis=1) for a in sampled]
    at = NODES[0]
    low = np.clip((circle[:, None] <= at[:, None]).sum(-1) - 1, 0, seen.shape[1] - 2)
    left, right = (np.take_along_axis(circle, low + n, axis=1) for n in (0, 1))
    gap = right - left
    part = np.clip((at - left) / np.where(gap > 0, gap, 1.0), 0, 1)[..., None]

    def between(values: np.ndarray) -> np.ndarray:
        one, other = (np.take_along_axis(values, (low + n)[..., None], axis=1) for n in (0, 1))
        return one + part * (other - one)

    return np.asarray(rule.theta), *(between(a) for a in sampled)
