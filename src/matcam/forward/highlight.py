"""The record around a highlight, however narrow: an integral over normals about the half vector (MODEL 3).

The nodes crowd towards the half vector on the lobe's own scale and are nowhere further apart than the kernel allows, so a
highlight of a thousandth of a pixel is neither missed nor noisy. They are a product of u and v nodes, and so is a
separable kernel: all targets of a rectangle come out of two matrix products.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from matcam._jax import jax, jnp
from matcam.forward.blur import Blur
from matcam.forward.panels import graded_nodes
from matcam.forward.scene import Scene


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
