"""One picture's worth of light: a material on a curved sample, under a lamp, on its way to the camera (MODEL 3).

What reaches a pixel is radiance rho cos_i, not rho. With dx dy = area cos_o du dv, the record is

    R(x) = integral over the visible, lit surface of  k(x - x(u, v)) rho cos_i cos_o area du dv,

in which every cosine that could vanish has cancelled: nothing is singular at the limb.
"""

from __future__ import annotations

import equinox as eqx

from matcam._jax import jax, jnp
from matcam.material.material import Material
from matcam.sample.shape import Curved, Element
from matcam.shading import Shading, shading


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
