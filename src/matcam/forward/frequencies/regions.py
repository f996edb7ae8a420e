"""Division of the light of a sphere among quadratures: smooth weights of the position, which add up to 1.

    light = (1 - limb) (1 - highlight) light      by the grid's own points       (`light_grid.py`)
          + limb (1 - highlight) light            along lines that end at the limb   (`limb_lines.py`)
          + highlight light                       around the half vector         (`highlight_patch.py`)

The border of a weight is as steep as possible: its aliased frequencies are below 1e-6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.numerics.elementary import plane_length

STEEPEST = 0.1
"""Smallest cosine of the viewing angle by which a patch around a highlight is stretched."""
_SMOOTH = 0.84
"""Standard deviation of a border, times the lowest aliased frequency."""
_ENDS = 4.9
"""Number of standard deviations from the middle of a border to a weight of 0 or 1 within 1e-6."""
_NEAR = 6.65
"""Number of standard deviations from a highlight to the middle of its border. Narrower lobes are smooth beyond it."""
_MORE = 4.4
"""Number of standard deviations by which a crescent within the region of the limb may exceed it."""
_NO_BORDER = 1e9


class RegionWidths(NamedTuple):
    """Widths of the regions, which depend on the grid and not on the scene.

    Attributes:
        sigma: standard deviation of the smooth transition of a weight at a border, px.
    """

    sigma: float

    @classmethod
    def above(cls, frequency: float) -> RegionWidths:
        """Choose regions whose borders have negligible content above a frequency, cycles/px."""
        return cls(_SMOOTH / frequency)

    @property
    def depth(self) -> float:
        """Return the depth of the region of the limb, px."""
        return 2 * _ENDS * self.sigma

    @property
    def around(self) -> float:
        """Return the radius of the region of a highlight, px."""
        return (_NEAR + _ENDS) * self.sigma

    @property
    def widest_line(self) -> float:
        """Return the largest length, px, of a line inside the region of the limb."""
        return self.depth + _MORE * self.sigma


class Regions(NamedTuple):
    """Regions of the light of a scene.

    Attributes:
        scene: a sphere in front of a distant camera, under one lamp.
        widths: widths of the regions.
        peak: position of the highlight on the scene's x axis, px.
        squeezed: cosine of the viewing angle at the highlight, at least `STEEPEST`.
        all_limb: True if the light is a thin crescent that belongs entirely to the region of the limb.
        depth: depth of the region of the limb, px.
    """

    scene: Scene
    widths: RegionWidths
    peak: jax.Array
    squeezed: jax.Array
    all_limb: jax.Array
    depth: jax.Array

    @classmethod
    def of(cls, scene: Scene, widths: RegionWidths) -> Regions:
        """Build the regions of a scene."""
        radius = scene.sample.radius
        peak = highlight_x(scene.sample, scene.lamp_angle, scene.lamp_nearness)
        end = jnp.maximum(scene.lamp_angle - jnp.arccos(horizon(scene)), 0.0)
        width = radius * (1 - jnp.sin(end))
        thin = width < widths.widest_line
        return cls(
            scene,
            widths,
            peak,
            jnp.maximum(jnp.sqrt(jnp.maximum(1 - (peak / radius) ** 2, 0.0)), STEEPEST),
            thin,
            jnp.where(thin, width, widths.depth),
        )

    def limb(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate the weight of the limb at a position in the scene, px, without a highlight."""
        middle = jnp.where(self.all_limb, _NO_BORDER, _ENDS * self.widths.sigma)
        radius = self.scene.sample.radius
        return self.fall(radius - plane_length(x, y) - middle)

    def highlight(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate the weight of the highlight at a position in the scene, px."""
        return self.fall(plane_length(x - self.peak, self.squeezed * y) - _NEAR * self.widths.sigma)

    def fall(self, at: jax.Array) -> jax.Array:
        """Evaluate a weight that falls from 1 to 0 about 0, px."""
        return falling(at, self.widths.sigma)

    def inside(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate the weight of the regular points at a position on the sensor, px."""
        at = self.scene.from_sensor(x, y)
        return (1 - self.limb(*at)) * (1 - self.highlight(*at))

    def lit(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Check whether the surface is lit at positions on the sensor, px, without computing all angles."""
        radius, angle = self.scene.sample.radius, self.scene.lamp_angle
        n_x, n_y = (at / radius for at in self.scene.from_sensor(x, y))
        depth2 = 1 - n_x**2 - n_y**2
        cosine = n_x * jnp.sin(angle) + jnp.sqrt(jnp.maximum(depth2, 0.0)) * jnp.cos(angle)
        return (depth2 > 0) & (cosine > horizon(self.scene))

    def sent(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Compute the radiance at positions on the sensor, px: 1/sr, channels last; 0 where there is no light."""
        element, lit = self.scene.shown(x, y)
        return jnp.where(lit[..., None], self.scene.sent(element), 0.0)


def falling(at: jax.Array, sigma: float) -> jax.Array:
    """Evaluate a weight that falls from 1 to 0 about 0, as the integral of a Gaussian of that standard deviation."""
    return jax.scipy.special.erfc(at / (np.sqrt(2) * sigma)) / 2


def horizon(scene: Scene) -> jax.Array:
    """Compute the cosine between normal and lamp, seen from the centre of the sample, at which light ends."""
    return jnp.zeros(()) if scene.lamp_nearness is None else scene.lamp_nearness
