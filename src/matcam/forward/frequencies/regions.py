"""Division of the radiance of a sphere among quadratures, by smooth weights that depend on the position and add up to 1.

    radiance = (1 - limb) (1 - highlight) radiance     at the points of the grid             (`light_grid.py`)
             + limb (1 - highlight) radiance           along rows and columns to the limb    (`limb_lines.py`)
             + highlight radiance                      around the half vector                (`highlight_patch.py`)

The weight `limb` is 1 at the limb, and the weight `highlight` is 1 about the highlight. Each weight decreases smoothly to 0.
The transition is as narrow as possible for an amplitude of the aliased frequencies below 1e-6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.arrays.elementary import erfc, plane_length
from matcam.core.jax import jax, jnp
from matcam.forward.integral.scene import Scene, highlight_x

STEEPEST = 0.1
"""Lower limit of the cosine of the viewing angle in the stretch of a patch around a highlight."""
_SMOOTH = 0.84
"""Standard deviation of the transition of a weight, px, times the lowest aliased frequency, cycles/px."""
_ENDS = 4.9
"""Distance from the middle of a transition to a weight of 0 or 1 within 1e-6, in standard deviations of the transition."""
_NEAR = 6.65
"""Distance from a highlight to the middle of its transition, in standard deviations of the transition. Lobes that are
narrower than this distance are smooth beyond it.
"""
_MORE = 4.4
"""Largest width of a lit crescent minus the depth of the region of the limb, in standard deviations of the transition. A
narrower crescent belongs entirely to this region.
"""


class RegionWidths(NamedTuple):
    """Widths of the regions, which depend on the grid and not on the scene.

    Attributes:
        sigma: standard deviation of the smooth transition of a weight at a border, px.
    """

    sigma: float

    @classmethod
    def above(cls, frequency: float) -> RegionWidths:
        """Choose the widths of regions whose transitions have negligible content above a frequency, cycles/px."""
        return cls(_SMOOTH / frequency)

    @property
    def depth(self) -> float:
        """Depth of the region of the limb, px."""
        return 2 * _ENDS * self.sigma

    @property
    def around(self) -> float:
        """Radius of the region of a highlight, px."""
        return (_NEAR + _ENDS) * self.sigma

    @property
    def widest_line(self) -> float:
        """Largest depth of the region of the limb, px: the width of the widest crescent that belongs entirely to the region."""
        return self.depth + _MORE * self.sigma


class Regions(NamedTuple):
    """Regions of the radiance of a scene.

    Attributes:
        scene: a sphere in front of a distant camera, under one lamp.
        widths: widths of the regions.
        peak: position of the highlight on the scene's x axis, px.
        squeezed: cosine of the viewing angle at the highlight, at least `STEEPEST`.
        all_limb: True if the lit part is a thin crescent that belongs entirely to the region of the limb.
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
        """Evaluate the weight `limb` at a position in the scene, px, without the factor (1 - highlight)."""
        # a border outside any sphere, if the lit part belongs entirely to the region of the limb
        middle = jnp.where(self.all_limb, 1e9, _ENDS * self.widths.sigma)
        radius = self.scene.sample.radius
        return self.fall(radius - plane_length(x, y) - middle)

    def highlight(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate the weight `highlight` at a position in the scene, px."""
        return self.fall(plane_length(x - self.peak, self.squeezed * y) - _NEAR * self.widths.sigma)

    def fall(self, at: jax.Array) -> jax.Array:
        """Evaluate a weight that decreases from 1 to 0 at a border.

        at: distance from the border, px; positive on the side where the weight decreases to 0.
        """
        return falling(at, self.widths.sigma)

    def inside(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Evaluate the weight of the quadrature over the grid at a position on the sensor, px."""
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
        """Compute the radiance, 1/sr, channels last; 0 where no lit surface is visible. x, y: positions on the sensor, px."""
        element, lit = self.scene.shown(x, y)
        return jnp.where(lit[..., None], self.scene.sent(element), 0.0)


def falling(at: jax.Array, sigma: float) -> jax.Array:
    """Evaluate a weight that decreases from 1 to 0 about the position 0.

    The weight is the integral from `at` to infinity of a normalised Gaussian of standard deviation `sigma`. `at`
    and `sigma` are in px.
    """
    return erfc(at / (np.sqrt(2) * sigma)) / 2


def horizon(scene: Scene) -> jax.Array:
    """Compute the cosine of the angle between the normal at the terminator and the direction to the lamp.

    The direction to the lamp is taken at the centre of the sample.
    """
    return jnp.zeros(()) if scene.lamp_nearness is None else scene.lamp_nearness
