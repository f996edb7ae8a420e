"""Which of three ways a target's record is integrated in: near the highlight, along the ends of the light, inside.

All lengths follow from the kernel, in units of its own standard deviation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import AnyArray, jax, jnp
from matcam.camera.pixel import PixelResponse
from matcam.sample.shape import Curved


class Scale(NamedTuple):
    """Lengths on the sensor, px, that the widest narrow term of a blur sets."""

    near: float
    """Half the side of the square around the highlight in which the nodes go about the half vector."""
    margin: float
    """Distance from the ends of the light from which on a pixel's surroundings are smooth."""
    reach: float
    """How far the kernel is followed."""
    spacing: float
    """Grid on which a record is known everywhere: it holds nothing finer."""


def scale_of(pixel: PixelResponse, stds: np.ndarray) -> Scale:
    """Lengths for Gaussian terms of these standard deviations, px, seen by the pixel."""
    half = float(jax.lax.stop_gradient(pixel.half_width))
    widest, narrowest = float(np.max(stds)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    return Scale(
        near=10 * std,
        margin=5.5 * std,
        reach=half + 5.2 * widest,
        spacing=min(0.5 * narrowest, 0.45 * finest),
    )


@jax.jit
def away_from_ends(sample: Curved, x: AnyArray, y: AnyArray, lamp_angle: AnyArray, margin: AnyArray) -> jax.Array:
    """Whether the square of half side `margin` px about (x, y) is visible and lit all over (to its corners)."""
    equator = sample.across(x, jnp.zeros_like(x))
    inside = jnp.ones(jnp.broadcast_shapes(x.shape, y.shape), dtype=bool)
    for row in (y - margin, y, y + margin):
        v, _ = sample.window(row, row, equator)
        low, high = sample.lit(v, lamp_angle)
        left, right = sample.surface(low, v).x, sample.surface(high, v).x
        inside &= (x - margin > left) & (x + margin < right)
    return inside


@jax.jit
def crowded(sample: Curved, x: AnyArray, y: AnyArray, lamp_angle: AnyArray, reach: AnyArray) -> jax.Array:
    """Whether the surface under a kernel at (x, y) turns by more than its own angle from the half vector."""
    v, _ = sample.window(y, y, sample.across(x, jnp.zeros_like(x)))
    low, high = sample.lit(v, lamp_angle)
    first, last = (jnp.clip(sample.across(x + side * reach, v), low, high) for side in (-1, 1))
    middle = sample.across(x, v) - sample.highlight(lamp_angle)
    return jnp.hypot(middle, v) < 1.3 * (last - first)


@jax.jit
def towards_a_pole(sample: Curved, x: AnyArray, y: AnyArray, reach: AnyArray) -> jax.Array:
    """Whether the surface under a kernel at (x, y) turns so fast in v that few panels would not do."""
    first, _, last = sample.rows(x, y, reach)
    return (last - first) * sample.stretch > 4 * reach
