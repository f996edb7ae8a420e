"""Record of an isotropic lobe in one pixel of a cylinder, which shows the normals of one line (docs/model.md 3).

Each cell has its own lamp, turned about the optical axis until the normal of the cell lies across the axis of the
cylinder (`forward/cylinder_cells.py`). Along the line the angle to the half vector falls to a minimum and rises again.
Both arms have their own nodes, at which the masking is exact. Nodes are even in asinh(turn / scale), where the turn is
the angle from the minimum. A lobe is smooth in it for any distance of the line from the half vector.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.inverse.operator.theta_nodes import NODES, onto_nodes, stretched

_PANEL = np.polynomial.legendre.leggauss(24)
_HALVES = np.array([0.5])
_BLOCK = 128
_LEAST = 1e-12
"""Length of an arm outside the window, rad: its weights are 0."""
ARMS = (1.0, -1.0)
"""Sides of the normal closest to the half vector: away from the axis, and towards it."""


class ImagePlaces(NamedTuple):
    """Positions in the images of a sphere, at the same distance from the axis as on the cylinder; arrays of one shape.

    Attributes:
        x: distance from the optical axis, the lamp towards +x, px.
        y: the same across, px.
        theta_d: rad.
        factor: factor of the record.
    """

    x: np.ndarray
    y: np.ndarray
    theta_d: np.ndarray
    factor: np.ndarray


class LineRule(NamedTuple):
    """Rule of one arm of each pixel; arrays of shape (pixels, nodes).

    Attributes:
        theta: angle between normal and half vector, rad.
        weight: weight of each node.
        cos_psi: cosine of the azimuth of the normal about the half vector.
    """

    theta: jax.Array
    weight: jax.Array
    cos_psi: jax.Array


@partial(jit_plainly, static=("terms", "arm"))
def line_rule(
    radius: jax.Array,
    blur: Blur,
    variance: jax.Array,
    terms: tuple[int, ...],
    pixels: ImagePlaces,
    reach: jax.Array,
    onto: jax.Array,
    arm: float,
) -> LineRule:
    """Compute the rule of one arm for some terms of a blur; differentiable in its parameters.

    Args:
        radius: radius of the cylinder in the picture, px.
        blur: the blur.
        variance: px^2, (pixels,), that the blur's spread adds.
        terms: terms of the blur.
        pixels: places as on a sphere under a lamp towards +x; a multiple of the block, see `padded`.
        reach: half width of the window of a pixel, (pixels,), px.
        onto: the same of the range of all nodes.
        arm: one of `ARMS`.
    """

    def block(arguments):  # type: ignore[no-untyped-def]
        x, y, theta_d, factor, variance, reach, onto = (a[:, None] for a in arguments)
        column = jnp.hypot(x, y)
        safe = jnp.where(column > 0, column, 1.0)
        cosine, sine = jnp.where(column > 0, x / safe, 1.0), jnp.where(column > 0, -y / safe, 0.0)
        light = jnp.sin(2 * theta_d) * cosine, jnp.sin(2 * theta_d) * sine, jnp.cos(2 * theta_d)
        half = jnp.sin(theta_d) * cosine, jnp.sin(theta_d) * sine, jnp.cos(theta_d)
        closest, along = jnp.arctan2(half[0], half[2]), jnp.hypot(half[0], half[2])
        middle = jnp.arctan2(light[0], light[2])
        lit = jnp.maximum(-jnp.pi / 2, middle - jnp.pi / 2), jnp.minimum(jnp.pi / 2, middle + jnp.pi / 2)

        def turns(at: jax.Array) -> jax.Array:
            """Compute the angle along the arm of the normals at columns, rad."""
            u = jnp.clip(jnp.arcsin(jnp.clip(at / radius, -1, 1)), *lit)
            return jnp.maximum(arm * (u - closest), 0.0)

        nearest = turns(column - arm * onto)
        scale, first, last = stretched(nearest, jnp.maximum(turns(column + arm * onto), nearest + _LEAST))
        own = [turns(column + arm * at) for at in (-reach, -blur.pixel.half_width, blur.pixel.half_width, reach)]
        cuts = jnp.concatenate([jnp.arcsinh(turn / scale) for turn in own], axis=1)
        cuts = jnp.sort(jnp.concatenate([cuts, cuts[:, :1] + _HALVES * (cuts[:, 3:] - cuts[:, :1])], axis=1), axis=1)
        low, high = cuts[:, :-1, None], cuts[:, 1:, None]
        t = ((low + high) / 2 + (high - low) / 2 * _PANEL[0]).reshape(x.shape[0], -1)
        step = ((high - low) / 2 * _PANEL[1]).reshape(t.shape) * scale * jnp.cosh(t)
        at = closest + arm * scale * jnp.sinh(t)
        offset = column - radius * jnp.sin(at)
        spread = Spread(variance, variance, jnp.abs(blur.defocus(radius, jnp.cos(at))))
        # light is uniform along the axis, so only the column of each chord matters
        kernel = sum(blur.weights[j] * blur.through_disc(j, spread, lambda along, _: along(offset)) for j in terms)
        place = 2 * (t - first) / (last - first) - 1
        weight = onto_nodes(place, factor * radius / 4 * kernel * step)
        turn = scale * jnp.sinh(first + (last - first) * (NODES[0] + 1) / 2)
        u = closest + arm * turn
        theta = jnp.arctan2(jnp.hypot(half[1], along * jnp.sin(turn)), along * jnp.cos(turn))
        cos_i, cos_o = light[0] * jnp.sin(u) + light[2] * jnp.cos(u), jnp.cos(u)
        cos_psi = (cos_i - cos_o) / jnp.maximum(2 * jnp.sin(theta) * jnp.sin(theta_d), 1e-300)
        return theta, weight, jnp.clip(cos_psi, -1, 1)

    arguments = (*pixels, variance, reach, onto)
    found = jax.lax.map(block, tuple(a.reshape(-1, _BLOCK) for a in arguments))
    return LineRule(*(a.reshape(-1, a.shape[-1]) for a in found))
