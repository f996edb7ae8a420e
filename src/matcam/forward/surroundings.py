"""The record away from the highlight, target by target: nodes about each pixel, not about the half vector.

There the light is smooth on the scale of the kernel, except where it ends: at the limb, at the terminator. Inside, a few
nodes on the sensor do (`record_inside`). Along the ends, the integral is taken over (u, v), in which what is visible and
lit is one interval whose ends are known, and smooth up to them (`record_in_window`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.panels import nodes_in_panels
from matcam.forward.scene import Scene

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
