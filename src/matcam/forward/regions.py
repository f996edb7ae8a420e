"""Which parts of a picture a kernel there meets: the highlight, a lobe squeezed by foreshortening, the ends of the light."""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp
from matcam.sample.shape import Curved

_OCTAGON = np.sqrt(2) - 1


@jax.jit
def highlight_x(sample: Curved, lamp_angle: jax.Array) -> jax.Array:
    """Where on the x axis the highlight lies, px."""
    return sample.surface(sample.highlight(lamp_angle), jnp.zeros(())).x


@jax.jit
def away_from_ends(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, margin: float) -> jax.Array:
    """Whether all within `margin` px of (x, y), to the corners of the octagon about that circle, is visible and lit."""
    equator = sample.across(x, jnp.zeros_like(x))
    inside = jnp.ones(jnp.broadcast_shapes(x.shape, y.shape), dtype=bool)
    for up, aside in ((-1.0, _OCTAGON), (-_OCTAGON, 1.0), (0.0, 1.0), (_OCTAGON, 1.0), (1.0, _OCTAGON)):
        row = y + up * margin
        v, _ = sample.window(row, row, equator)
        low, high = sample.lit(v, lamp_angle)
        left, right = sample.surface(low, v).x, sample.surface(high, v).x
        inside &= (x - aside * margin > left) & (x + aside * margin < right)
    return inside


@jax.jit
def crowded(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, reach: float) -> jax.Array:
    """Whether the surface under a kernel at (x, y) turns by more than its own angle from the half vector."""
    v, _ = sample.window(y, y, sample.across(x, jnp.zeros_like(x)))
    low, high = sample.lit(v, lamp_angle)
    first, last = (jnp.clip(sample.across(x + side * reach, v), low, high) for side in (-1, 1))
    middle = sample.across(x, v) - sample.highlight(lamp_angle)
    return jnp.hypot(middle, v) < 1.0 * (last - first)


@jax.jit
def turn_along_v(sample: Curved, x: jax.Array, y: jax.Array, reach: float) -> jax.Array:
    """How far, in px along the surface, a kernel at (x, y) reaches in v: twice its own reach, more where it is seen aslant."""
    first, last = sample.rows(x, y, reach)
    return (last - first) * sample.stretch


@jax.jit
def lit_within(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, reach: float) -> jax.Array:
    """Whether light may come from within `reach` px of (x, y); seldom true where none does, never the other way."""
    first, last = sample.rows(x, y, reach)
    # terminator and limb lie ever closer to the axis towards the poles: their furthest places are those of these rows
    left, right = jnp.full(first.shape, jnp.inf), jnp.full(first.shape, -jnp.inf)
    for v in (first, jnp.clip(0.0, first, last), last):
        low, high = sample.lit(v, lamp_angle)
        left = jnp.minimum(left, sample.surface(low, v).x)
        right = jnp.maximum(right, sample.surface(high, v).x)
    return (last > first) & (x - reach < right) & (x + reach > left)
