"""One picture's worth of light: a material on a curved sample, under a lamp, on its way to the camera (docs/model.md 3).

What reaches a pixel is radiance rho cos_i, not rho. With dx dy = area cos_o du dv, the record is

    R(x) = integral over the visible, lit surface of  k(x - x(u, v)) rho cos_i cos_o area du dv.

Every cosine that could vanish has cancelled: nothing is singular at the limb.
"""

from __future__ import annotations

import equinox as eqx

from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, shading
from matcam.material.material import Material
from matcam.sample.shape import Curved, Element


class Scene(eqx.Module):
    """A material on a curved sample under a distant lamp of irradiance 1; radiance is in 1/sr.

    Attributes:
        material: the material.
        sample: the sample.
        lamp_angle: angle between lamp and optical axis, towards +x, rad; it broadcasts with the elements asked for.
    """

    material: Material
    sample: Curved
    lamp_angle: jax.Array

    def seen(self, element: Element) -> Shading:
        """Return the angles under which a piece of surface sees lamp and camera."""
        light = (jnp.sin(self.lamp_angle), jnp.zeros(()), jnp.cos(self.lamp_angle))
        return shading(element.normal, element.tangent, light, element.view)

    def sent(self, element: Element) -> jax.Array:
        """Return rho cos_i cos_o area, channels last.

        It is the light of a piece of surface per unit of its coordinates.
        """
        seen = self.seen(element)
        light = self.material.reflected(seen)
        if light.ndim == (seen.cos_i * seen.cos_o).ndim:
            light = light[..., None]
        return light * (element.area[..., None] if jnp.ndim(element.area) else element.area)

    def flat_field(self, element: Element) -> jax.Array:
        """Return the same for a surface of radiance 1 all over.

        It has no channels, and light need not reach it.
        """
        return self.seen(element).cos_o * element.area

    def channels(self) -> int:
        """Return the count of channels."""
        at_centre = Scene(self.material, self.sample, jnp.zeros(()))
        return jax.eval_shape(lambda: at_centre.sent(self.sample.surface(jnp.zeros(()), jnp.zeros(())))).shape[-1]


@jax.jit
def highlight_x(sample: Curved, lamp_angle: jax.Array) -> jax.Array:
    """Return the position of the highlight on the x axis, px."""
    return sample.surface(sample.highlight(lamp_angle), jnp.zeros(())).x
