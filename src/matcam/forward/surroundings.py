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


def record_inside(scene: Scene, blur: Blur, terms: tuple[int, ...], x: jax.Array, y: jax.Array) -> jax.Array:
    """Record at targets (x, y), shape (targets,), whose kernel meets neither highlight nor an end of the light; the scene
    has one lamp or one per target. Shape (targets, channels), radiance per unit irradiance."""
    total: jax.Array | float = 0.0
    scene = _one_lamp_each(scene)
    for term in terms:
        offsets, weights = blur.rule(term)
        dx, dy = (a.ravel() for a in jnp.meshgrid(offsets, offsets))
        share = jnp.outer(weights, weights).ravel()
        element, _ = scene.sample.at(x[:, None] + dx, y[:, None] + dy)
        total += blur.weights[term] * jnp.einsum("tnc,n->tc", scene.sent(element), share)
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
    lamp = scene.lamp_angle[..., None] if jnp.ndim(scene.lamp_angle) else scene.lamp_angle
    ridge = scene.sample.highlight(lamp)
    # panels no wider than the kernel allows, nor, close to the ridge, than the lobe does
    steps = np.linspace(-1, 1, _RIDGE_PANELS + 1)
    by_kernel = scene.sample.across(x[:, None, None] + reach * steps, v[..., None])
    by_lobe = (ridge + 0 * v)[..., None] + jnp.hypot(scene.material.finest, v)[..., None] * _RIDGE_CUTS
    cuts = jnp.concatenate([by_kernel, by_lobe], axis=-1)
    cuts = jnp.sort(jnp.clip(cuts, low[..., None], high[..., None]), axis=-1)
    return _through_kernel(scene, blur, terms, x, y, nodes_in_panels(cuts, _RIDGE_ORDER), (v, v_weight))


def _window(scene: Scene, x: jax.Array, y: jax.Array, reach: float, panels: int):  # type: ignore[no-untyped-def]
    """Nodes and weights in v, and the visible and lit interval of u at each, within `reach` of the targets."""
    sample = scene.sample
    first, between, last = sample.rows(x, y, reach)
    equal = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, panels + 1)
    v, v_weight = nodes_in_panels(jnp.sort(jnp.append(equal, between[:, None], axis=1), axis=1), _ORDER_V)
    lamp = scene.lamp_angle[..., None] if jnp.ndim(scene.lamp_angle) else scene.lamp_angle
    low, high = sample.lit(v, lamp)
    ends = (jnp.clip(sample.across(x[:, None] + side * reach, v), low, high) for side in (-1, 1))
    return v, v_weight, *ends


def _through_kernel(scene, blur, terms, x, y, u, v):  # type: ignore[no-untyped-def]
    element = scene.sample.surface(u[0], v[0][..., None])
    lamp = scene.lamp_angle[..., None, None] if jnp.ndim(scene.lamp_angle) else scene.lamp_angle
    light = Scene(scene.material, scene.sample, lamp).sent(element) * (u[1] * v[1][..., None])[..., None]
    total: jax.Array | float = 0.0
    for term in terms:
        kernel = blur.kernel(x[:, None, None] - element.x, term) * blur.kernel(y[:, None, None] - element.y, term)
        total += blur.weights[term] * jnp.einsum("tvuc,tvu->tc", light, kernel)
    return jnp.asarray(total)


def _one_lamp_each(scene: Scene) -> Scene:
    lamp = scene.lamp_angle
    return Scene(scene.material, scene.sample, lamp[..., None] if jnp.ndim(lamp) else lamp)
