"""The record around a highlight, however narrow: an integral over normals about the half vector (MODEL 3).

The nodes crowd towards the half vector on the lobe's own scale and are nowhere further apart than the kernel allows, so a
highlight of a thousandth of a pixel is neither missed nor noisy. They are a product of u and v nodes, and so is a
separable kernel: all targets of a rectangle come out of two matrix products.

The record away from the highlight, target by target: nodes about each pixel, not about the half vector.

There the light is smooth on the scale of the kernel, except where it ends: at the limb, at the terminator. Inside, a few
nodes on the sensor do (`record_inside`). Along the ends, the integral is taken over (u, v), in which what is visible and
lit is one interval whose ends are known, and smooth up to them (`record_in_window`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur
from matcam.forward.integral.scene import Scene
from matcam.numerics.quadrature import graded_nodes, nodes_in_panels


class Detail(NamedTuple):
    """How finely to integrate."""

    graded: int
    even: int
    order: int


def record_around(
    scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array, reach: ArrayLike, detail: Detail
) -> jax.Array:
    """Record at the rectangle of targets x (columns,), y (rows,) px, which holds the highlight or lies next to it.

    reach: how far the kernel's terms reach, px. One lamp. Shape (rows, columns, channels + 1), radiance per unit
    irradiance; the last channel is that of a flat field of radiance 1 wherever light falls.
    """
    sample, lamp = scene.sample, scene.lamp_angle
    peak, finest = sample.highlight(lamp), scene.material.finest
    shares = np.arange(detail.even + 1) / detail.even
    _, lines = sample.window(jnp.zeros(()), (jnp.max(jnp.abs(y)) + reach) * shares, peak)
    v, v_weight = graded_nodes(lines, finest, detail.graded, detail.order)
    low, high = sample.lit(v, lamp)
    middle = jnp.clip(peak, low, high)
    centre = sample.surface(middle, v).x
    sides = []
    for end in (jnp.min(x) - reach, jnp.max(x) + reach):
        at = sample.across(centre[:, None] + (end - centre)[:, None] * shares, v[:, None])
        borders = jnp.clip(at.at[:, 0].set(middle), low[:, None], high[:, None])
        sides.append(graded_nodes(borders, finest, detail.graded, detail.order))
    u = jnp.concatenate([nodes for nodes, _ in sides], axis=1)
    # on the lower side the nodes run downwards, and their weights are negative
    weight = jnp.concatenate([-sides[0][1], sides[1][1]], axis=1) * v_weight[:, None]
    element = sample.surface(u, v[:, None])
    light = jnp.concatenate([scene.sent(element), scene.flat_field(element)[..., None]], axis=-1) * weight[..., None]
    spread_x, spread_y = blur.spread(sample, element.normal[2], lamp)
    total = jnp.zeros((y.size, x.size, light.shape[-1]))
    for term in terms:
        columns = blur.kernel(x[:, None, None] - element.x, term, spread_x)
        # the surface is the same on either side of the plane of camera and lamp
        above, below = (y[:, None, None] - sign * element.y for sign in (1, -1))
        rows = blur.kernel(above, term, spread_y) + blur.kernel(below, term, spread_y)
        if rows.shape[-1] == 1:
            by_line = jnp.einsum("xvu,vuc->vxc", columns, light)
            recorded = jnp.einsum("yv,vxc->yxc", rows[..., 0], by_line)
        else:
            recorded = jnp.einsum("yvu,xvu,vuc->yxc", rows, columns, light)
        total += blur.weights[term] * recorded
    return total


_ORDER_V = 9
_ORDER_V_RIDGE = 7
_ORDER_U = 10
_RIDGE_PANELS = 4
_RIDGE_CUTS = np.array([-2.0, 0.0, 2.0])
_ORDER_RIDGE = 6
_LAYERS = np.array([3.0])


def record_inside(scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array) -> jax.Array:
    """Record at targets (x, y), shape (targets,), whose kernel meets neither highlight nor an end of the light; the scene
    has one lamp or one per target. Shape (targets, channels), radiance per unit irradiance."""
    total: jax.Array | float = 0.0
    centre, _ = scene.sample.at(x, y)
    spread_x, spread_y = blur.spread(scene.sample, centre.normal[2], scene.lamp_angle)
    scene = Scene(scene.material, scene.sample, _beside_nodes(scene.lamp_angle, 1))
    for term in terms:
        (dx, x_weight), (dy, y_weight) = (blur.rule(term, spread) for spread in (spread_x, spread_y))
        shape = (*jnp.broadcast_shapes(dx.shape[:-1], dy.shape[:-1]), -1)
        dx, dy = (a.reshape(shape) for a in jnp.broadcast_arrays(dx[..., None, :], dy[..., :, None]))
        share = (y_weight[..., :, None] * x_weight[..., None, :]).reshape(shape)
        element, _ = scene.sample.at(x[:, None] + dx, y[:, None] + dy)
        total += blur.weights[term] * jnp.sum(scene.sent(element) * share[..., None], axis=1)
    return jnp.asarray(total)


class Division(NamedTuple):
    """How a window about a kernel is cut into panels."""

    reach: jax.Array
    """How far the kernel is followed, px."""
    cuts: jax.Array
    """Offsets, px, at which the kernel must be cut to be smooth in between; none where it is smooth."""
    panels: int
    """Along v."""
    ridge: bool
    """Whether a squeezed lobe runs through it: towards the limb the surface turns within a pixel, and even far from its
    peak a lobe is a narrow ridge along the half vector's u."""


def record_in_window(
    scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array, division: Division
) -> jax.Array:
    """The same at targets whose kernel may cross the limb or the terminator, or a squeezed lobe; a flat field of radiance 1
    as the last channel."""
    sample = scene.sample
    first, last = (end[:, None] for end in sample.rows(x, y, division.reach))
    borders = first + (last - first) * np.linspace(0, 1, division.panels + 1)
    if division.cuts.size:
        at = y[:, None] + division.cuts
        stepped, _ = sample.window(at, at, sample.across(x, jnp.zeros_like(x))[:, None])
        borders = jnp.sort(jnp.concatenate([borders, jnp.clip(stepped, first, last)], axis=-1), axis=-1)
    v, v_weight = nodes_in_panels(borders, _ORDER_V_RIDGE if division.ridge else _ORDER_V)
    low, high = sample.lit(v, _beside_nodes(scene.lamp_angle, 1))
    low, high = (jnp.clip(sample.across(x[:, None] + side * division.reach, v), low, high) for side in (-1, 1))
    inner = [low[..., None], high[..., None], *_cuts_along_u(scene, x, v, (low, high), division)]
    along = jnp.sort(jnp.clip(jnp.concatenate(inner, axis=-1), low[..., None], high[..., None]), axis=-1)
    u, u_weight = nodes_in_panels(along, _ORDER_RIDGE if division.ridge else _ORDER_U)
    return _through_kernel(scene, blur, terms, x, y, u, v[..., None], u_weight * v_weight[..., None])


def _cuts_along_u(scene, x, v, ends, division: Division) -> list[jax.Array]:  # type: ignore[no-untyped-def]
    """Places in u, on a trailing axis, at which the integrand must be cut for its panels to be smooth."""
    sample, finest = scene.sample, scene.material.finest
    cuts = division.reach * np.linspace(-1, 1, _RIDGE_PANELS + 1)[1:-1] if division.ridge else jnp.zeros(1)
    if division.cuts.size:
        cuts = jnp.concatenate([cuts, division.cuts])
    by_kernel = sample.across(x[:, None, None] + cuts, v[..., None])
    if not division.ridge:
        return [by_kernel]
    ridge = sample.highlight(_beside_nodes(scene.lamp_angle, 1))
    # no wider, close to the ridge, than the lobe is
    by_lobe = (ridge + 0 * v)[..., None] + jnp.hypot(finest, v)[..., None] * _RIDGE_CUTS
    # masking takes effect within the lobe's own width of the ends
    low, high = (end[..., None] for end in ends)
    return [by_kernel, by_lobe, low + finest * _LAYERS, high - finest * _LAYERS]


def _through_kernel(scene, blur, terms, x, y, u, v, weight):  # type: ignore[no-untyped-def]
    element = scene.sample.surface(u, v)
    lit = Scene(scene.material, scene.sample, _beside_nodes(scene.lamp_angle, 2))
    light, flat = lit.sent(element), lit.flat_field(element)
    spread_x, spread_y = blur.spread(scene.sample, element.normal[2], lit.lamp_angle)
    total: jax.Array | float = 0.0
    for term in terms:
        along = blur.kernel(x[:, None, None] - element.x, term, spread_x)
        across = blur.kernel(y[:, None, None] - element.y, term, spread_y)
        through = along * across * weight
        seen = jnp.sum(light * through[..., None], axis=(1, 2)), jnp.sum(flat * through, axis=(1, 2))[:, None]
        total += blur.weights[term] * jnp.concatenate(seen, axis=-1)
    return jnp.asarray(total)


def _beside_nodes(lamp_angle: jax.Array, axes: int) -> jax.Array:
    """One lamp per target, against arrays with `axes` further axes of nodes; a single lamp as it is."""
    return lamp_angle.reshape(*lamp_angle.shape, *([1] * axes)) if jnp.ndim(lamp_angle) else lamp_angle
