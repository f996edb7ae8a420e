"""The record away from the highlight, target by target: nodes about each pixel, not about the half vector.

There the light is smooth on the scale of the kernel, except where it ends: at the limb, at the terminator. Inside, a few
nodes on the sensor do (`record_inside`). Along the ends, the integral is taken over (u, v), in which what is visible and
lit is one interval whose ends are known, and smooth up to them (`record_at_ends`).
"""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.panels import nodes_in_panels
from matcam.forward.scene import Scene

_ORDER_V = 7
_ORDER_U = 8
_RIDGE_PANELS = 5
_RIDGE_CUTS = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
_RIDGE_ORDER = 6
_LAYERS = np.array([1.0, 5.0])


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


def record_at_ends(
    scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array, reach: float, panels: int
) -> jax.Array:
    """The same at targets whose kernel may cross the limb or the terminator; reach: how far it is followed, px."""
    v, v_weight, low, high = _window(scene, x, y, reach, panels)
    middle = jnp.clip(scene.sample.across(x[:, None], v), low, high)
    u = nodes_in_panels(jnp.stack([low, middle, high], axis=-1), _ORDER_U)
    return _through_kernel(scene, blur, terms, x, y, u, (v, v_weight))


def record_across_ridge(
    scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array, reach: float, panels: int
) -> jax.Array:
    """The same where a lobe that foreshortening has squeezed runs through the kernel: towards the limb the surface turns
    within a pixel, and even far from its peak the lobe is a narrow ridge along the half vector's u."""
    v, v_weight, low, high = _window(scene, x, y, reach, panels)
    lamp = _beside_nodes(scene.lamp_angle, 1)
    ridge = scene.sample.highlight(lamp)
    # panels no wider than the kernel allows, nor, close to the ridge, than the lobe does
    steps = np.linspace(-1, 1, _RIDGE_PANELS + 1)
    by_kernel = scene.sample.across(x[:, None, None] + reach * steps, v[..., None])
    by_lobe = (ridge + 0 * v)[..., None] + jnp.hypot(scene.material.finest, v)[..., None] * _RIDGE_CUTS
    # masking takes effect within the lobe's own width of the ends
    layer = scene.material.finest * _LAYERS
    at_ends = jnp.concatenate([low[..., None] + layer, high[..., None] - layer], axis=-1)
    cuts = jnp.concatenate([by_kernel, by_lobe, at_ends], axis=-1)
    cuts = jnp.sort(jnp.clip(cuts, low[..., None], high[..., None]), axis=-1)
    return _through_kernel(scene, blur, terms, x, y, nodes_in_panels(cuts, _RIDGE_ORDER), (v, v_weight))


def _window(scene: Scene, x: jax.Array, y: jax.Array, reach: float, panels: int):  # type: ignore[no-untyped-def]
    """Nodes and weights in v, and the visible and lit interval of u at each, within `reach` of the targets."""
    sample = scene.sample
    first, last = sample.rows(x, y, reach)
    borders = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, panels + 1)
    v, v_weight = nodes_in_panels(borders, _ORDER_V)
    lamp = _beside_nodes(scene.lamp_angle, 1)
    low, high = sample.lit(v, lamp)
    ends = (jnp.clip(sample.across(x[:, None] + side * reach, v), low, high) for side in (-1, 1))
    return v, v_weight, *ends


def _through_kernel(scene, blur, terms, x, y, u, v):  # type: ignore[no-untyped-def]
    element = scene.sample.surface(u[0], v[0][..., None])
    lamp = _beside_nodes(scene.lamp_angle, 2)
    light = Scene(scene.material, scene.sample, lamp).sent(element) * (u[1] * v[1][..., None])[..., None]
    spread_x, spread_y = blur.spread(scene.sample, element.normal[2], lamp)
    total: jax.Array | float = 0.0
    for term in terms:
        along = blur.kernel(x[:, None, None] - element.x, term, spread_x)
        across = blur.kernel(y[:, None, None] - element.y, term, spread_y)
        total += blur.weights[term] * jnp.sum(light * (along * across)[..., None], axis=(1, 2))
    return jnp.asarray(total)


def _beside_nodes(lamp_angle: jax.Array, axes: int) -> jax.Array:
    """One lamp per target, against arrays with `axes` further axes of nodes; a single lamp as it is."""
    return lamp_angle.reshape(*lamp_angle.shape, *([1] * axes)) if jnp.ndim(lamp_angle) else lamp_angle
