"""Radiance of a scene: a material on a curved sample, under a lamp (docs/model.md 3)."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx

from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading, Vector, shading, towards_source
from matcam.material.material import Material
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Curved, Element


class Turn(NamedTuple):
    """Cosine and sine of the azimuth of the lamp about the optical axis, from +x towards +y on the sensor."""

    cosine: jax.Array
    sine: jax.Array

    def beside_nodes(self, axes: int) -> Turn:
        return Turn(*(beside_nodes(a, axes) for a in self))


class Scene(eqx.Module):
    """Material on a curved sample under a lamp; radiance is in 1/sr.

    The irradiance is 1 at the sample's centre, on a surface that faces the lamp. For a sphere, the x axis of the scene
    points towards the lamp. Positions in the scene then differ from positions on the sensor if the lamp has an azimuth.
    For a cylinder, scene and sensor have the same axes, and the direction of the lamp is rotated instead.

    Attributes:
        material: the material.
        sample: the sample.
        lamp_angle: angle between lamp and optical axis, towards +x, rad; it broadcasts with the surface elements.
        lamp_nearness: inverse of the lamp's distance, 1/radii; None: a distant lamp.
        turn: cosine and sine of the azimuth of the lamp, each of the shape of `lamp_angle`; None: the azimuth is 0.
        towards_lamp: sine and cosine of `lamp_angle`, each of its shape. None: both are computed; in a loop over nodes, XLA
            would compute both again for every node, which takes as long as the radiance.
    """

    material: Material
    sample: Curved
    lamp_angle: jax.Array
    lamp_nearness: jax.Array | None = None
    turn: Turn | None = None
    towards_lamp: tuple[jax.Array, jax.Array] | None = None

    def beside_nodes(self, axes: int) -> Scene:
        """Reshape a scene with one lamp per pixel to broadcast against `axes` further axes of nodes."""
        turn = None if self.turn is None else self.turn.beside_nodes(axes)
        return Scene(self.material, self.sample, beside_nodes(self.lamp_angle, axes), self.lamp_nearness, turn)

    @property
    def uniform_rows(self) -> bool:
        """True if the radiance is constant along y."""
        return isinstance(self.sample, Cylinder) and self.sample.distant and self.lamp_nearness is None

    @property
    def _pixels_turn(self) -> bool:
        """True if scene and sensor have different axes."""
        return self.turn is not None and not isinstance(self.sample, Cylinder)

    def from_sensor(self, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Transform a position on the sensor to a position in the scene, px."""
        if self.turn is None or not self._pixels_turn:
            return x, y
        return x * self.turn.cosine + y * self.turn.sine, y * self.turn.cosine - x * self.turn.sine

    def on_sensor(self, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Transform a position in the scene to a position on the sensor, px."""
        if self.turn is None or not self._pixels_turn:
            return x, y
        return x * self.turn.cosine - y * self.turn.sine, y * self.turn.cosine + x * self.turn.sine

    def shown(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """Compute the surface elements at positions on the sensor, px, and a mask of visible and lit elements."""
        element, visible = self.sample.at(*self.from_sensor(x, y))
        return element, visible & (self.seen(element).cos_i > 0)

    def seen(self, element: Element) -> Shading:
        light, _ = self._light(element)
        return shading(element.normal, self._tangent(element), light, element.view)

    def _light(self, element: Element) -> tuple[Vector, jax.Array | None]:
        """Compute the direction to the lamp, and the relative irradiance of a surface that faces the lamp.

        The irradiance is relative to the irradiance at the centre of the sample; None: 1 everywhere.
        """
        sine, cosine = self.towards_lamp or (jnp.sin(self.lamp_angle), jnp.cos(self.lamp_angle))
        light = sine, jnp.zeros(()), cosine
        if self.turn is not None and not self._pixels_turn:
            light = sine * self.turn.cosine, sine * self.turn.sine, cosine
        if self.lamp_nearness is None:
            return light, None
        light, square = towards_source(light, self.sample.point(element), self.lamp_nearness)
        return light, 1 / square

    def _tangent(self, element: Element) -> Vector:
        """Compute the first tangent, which lies in the plane of the x axis of the sensor and the optical axis."""
        if self.turn is None or not self._pixels_turn:
            return element.tangent
        (x, y, z), (cosine, sine) = element.normal, self.turn
        length = jnp.sqrt(z**2 + (sine * y - cosine * x) ** 2)
        return cosine * z / length, -sine * z / length, (sine * y - cosine * x) / length

    def sent(self, element: Element) -> jax.Array:
        """Compute the light that surface elements send to the camera, channels last.

        It is the product of the BRDF, the cosines of the angles of incidence and view, `element.area` and the relative
        irradiance of the lamp.
        For an element at (x, y) on the sensor, this is the radiance, 1/sr. For an element at (u, v), it is the integral of
        the radiance over the sensor per du dv, px^2/sr.
        """
        direction, strength = self._light(element)
        seen = shading(element.normal, self._tangent(element), direction, element.view)
        light = self.material.reflected(seen)
        if light.ndim == (seen.cos_i * seen.cos_o).ndim:
            light = light[..., None]
        area = element.area if strength is None else element.area * strength
        return light * (area[..., None] if jnp.ndim(area) else area)

    def channels(self) -> int:
        return jax.eval_shape(_sent_at_centre, self.material, self.sample, self.lamp_nearness).shape[-1]


def _sent_at_centre(material: Material, sample: Curved, lamp_nearness: jax.Array | None) -> jax.Array:
    # a function of the module, so that JAX traces it only once for each kind of scene
    middle = jnp.zeros(())
    return Scene(material, sample, middle, lamp_nearness).sent(sample.surface(middle, middle))


@jax.jit
def highlight_x(sample: Curved, lamp_angle: jax.Array, lamp_nearness: jax.Array | None = None) -> jax.Array:
    """Compute the position of the highlight on the x axis of the scene, px."""
    return sample.surface(sample.highlight(lamp_angle, lamp_nearness), jnp.zeros(())).x


def beside_nodes(lamp_angle: jax.Array, axes: int) -> jax.Array:
    """Reshape lamp angles to broadcast against `axes` further axes of nodes.

    A single angle is unchanged.
    """
    return lamp_angle.reshape(*lamp_angle.shape, *([1] * axes)) if jnp.ndim(lamp_angle) else lamp_angle
