"""One picture's worth of light: a material on a curved sample, under a lamp, on its way to the camera (MODEL 3).

What reaches a pixel is radiance rho cos_i, not rho. With dx dy = area cos_o du dv, the record is

    R(x) = integral over the visible, lit surface of  k(x - x(u, v)) rho cos_i cos_o area du dv,

in which every cosine that could vanish has cancelled: nothing is singular at the limb.

Which parts of a picture a kernel there meets: the highlight, a lobe squeezed by foreshortening, the ends of the light.
"""

from __future__ import annotations

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, shading
from matcam.material.material import Material
from matcam.sample.shape import Curved, Element


class Scene(eqx.Module):
    """A material on a curved sample, lit from `lamp_angle` rad off the optical axis, towards +x. The lamp's irradiance
    is 1: radiance is in 1/sr. lamp_angle: a number, or an array that broadcasts with the elements asked for."""

    material: Material
    sample: Curved
    lamp_angle: jax.Array

    def seen(self, element: Element) -> Shading:
        """The angles under which a piece of surface sees lamp and camera."""
        light = (jnp.sin(self.lamp_angle), jnp.zeros(()), jnp.cos(self.lamp_angle))
        return shading(element.normal, element.tangent, light, element.view)

    def sent(self, element: Element) -> jax.Array:
        """rho cos_i cos_o area: what a piece of surface adds to the picture per unit of its coordinates; shape of the
        element, and channels behind it."""
        seen = self.seen(element)
        light = self.material.reflected(seen)
        if light.ndim == (seen.cos_i * seen.cos_o).ndim:
            light = light[..., None]
        return light * (element.area[..., None] if jnp.ndim(element.area) else element.area)

    def flat_field(self, element: Element) -> jax.Array:
        """The same, without channels, for a surface of radiance 1 all over, lit or not."""
        return self.seen(element).cos_o * element.area

    def channels(self) -> int:
        """How many channels its light has."""
        at_centre = Scene(self.material, self.sample, jnp.zeros(()))
        return jax.eval_shape(lambda: at_centre.sent(self.sample.surface(jnp.zeros(()), jnp.zeros(())))).shape[-1]


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
