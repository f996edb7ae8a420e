"""Quadrature rule for an isotropic lobe in one pixel of a cylinder, whose normals lie in one plane (docs/model.md 3).

Each cell has its own lamp azimuth, at which the normal of the cell is perpendicular to the axis of the cylinder
(`forward/cylinder_cells.py`). Across the cylinder the angle between normal and half vector decreases to a minimum and
increases again. The two arms on either side of the minimum have separate nodes, at which masking is evaluated exactly.
They are Gauss-Legendre nodes in asinh(turn / scale), where the turn of a normal is its angle from the normal at the minimum.
A lobe is smooth in this variable for any angle between the half vector and the plane of the normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.inverse.operator.theta_nodes import NODES, NodeSpacing, Scale, cos_azimuth, onto_nodes
from matcam.numerics.approximation import nodes_in_panels

_PANEL = 24
"""Number of Gauss-Legendre nodes of the panel between two neighbouring cuts of an arm."""
_BLOCK = 128
"""Number of pixels that are computed at a time. It divides `PIECE`, and limits the memory of the arrays."""
LEAST_ARM = 1e-12
"""Smallest length of an arm, rad. An arm outside the window has this length, and weights of 0."""
ARMS = (1.0, -1.0)
"""Signs of the two arms. From the normal closest to the half vector, the column increases on the first and decreases on the
second.
"""


class ImagePositions(NamedTuple):
    """Image positions on a sphere that represent pixels of a cylinder.

    The distance of a position from the optical axis is the distance of the pixel from the axis of the cylinder. All arrays
    have one shape.

    Attributes:
        x: distance from the optical axis towards the lamp, px.
        y: distance from the optical axis perpendicular to x, px.
        theta_d: difference angle, rad.
        factor: factor by which the record is multiplied, no unit.
    """

    x: np.ndarray
    y: np.ndarray
    theta_d: np.ndarray
    factor: np.ndarray


class LineRule(NamedTuple):
    """Quadrature rule for one arm in each pixel. The arrays have shape (pixels, nodes).

    Attributes:
        theta: angle between normal and half vector, rad.
        weight: weight of each node.
        cos_psi: cosine of the azimuth of the normal about the half vector.
    """

    theta: jax.Array
    weight: jax.Array
    cos_psi: jax.Array


@partial(jit_plainly, static=("arm",))
def line_rule(
    radius: jax.Array,
    blur: Blur,
    variance: jax.Array,
    pixels: ImagePositions,
    reach: jax.Array,
    onto: jax.Array,
    scale_of: Scale,
    arm: float,
) -> LineRule:
    """Compute the quadrature rule of one arm for a blur.

    The rule is differentiable with respect to its numerical arguments.

    Args:
        radius: radius of the cylinder in the image, px.
        blur: the blur.
        variance: variance that is added to the blur, px^2, (pixels,).
        pixels: positions on a sphere with the lamp towards +x. Their number is a multiple of `_BLOCK`, see
            `padded`.
        reach: half width of the window of each pixel, px, (pixels,).
        onto: half width of the range that the nodes cover, px, (pixels,).
        scale_of: scale of the nodes.
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
            """Compute the turns, rad, of the normals at columns `at`, px; 0 on the other arm."""
            u = jnp.clip(jnp.arcsin(jnp.clip(at / radius, -1, 1)), *lit)
            return jnp.maximum(arm * (u - closest), 0.0)

        nearest = turns(column - arm * onto)
        farthest = jnp.maximum(turns(column + arm * onto), nearest + LEAST_ARM)
        spacing = NodeSpacing.of(nearest, farthest, scale_of.limit(farthest))
        own = [turns(column + arm * at) for at in (-reach, -blur.pixel.half_width, blur.pixel.half_width, reach)]
        t, step = arm_nodes([turn[:, 0] for turn in own], spacing.scale[:, 0], _PANEL)
        at = closest + arm * spacing.scale * jnp.sinh(t)
        offset = column - radius * jnp.sin(at)
        spread = Spread(variance, variance, jnp.abs(blur.defocus(radius, jnp.cos(at))))
        # the radiance is uniform along the axis, so the kernel depends on the column of each chord only
        kernel = sum(blur.weights[j] * blur.through_disc(j, spread, lambda along, _: along(offset)) for j in blur.terms)
        weight = onto_nodes(spacing.share(t), factor * radius / 4 * kernel * step)
        turn = spacing.angle(NODES[0])
        u = closest + arm * turn
        theta = jnp.arctan2(jnp.hypot(half[1], along * jnp.sin(turn)), along * jnp.cos(turn))
        cos_i, cos_o = light[0] * jnp.sin(u) + light[2] * jnp.cos(u), jnp.cos(u)
        return theta, weight, cos_azimuth(cos_i, cos_o, theta, theta_d)

    arguments = (*pixels, variance, reach, onto)
    found = jax.lax.map(block, tuple(a.reshape(-1, _BLOCK) for a in arguments))
    return LineRule(*(a.reshape(-1, a.shape[-1]) for a in found))


def arm_nodes(turns: Sequence[jax.Array], scale: jax.Array, order: int) -> tuple[jax.Array, jax.Array]:
    """Compute asinh(turn / scale) of the nodes of an arm, and the weights of the nodes, rad, (..., nodes) each.

    The arm is cut at the borders of the pixel and in the middle.

    Args:
        turns: turns of the ends of the arm and of the borders of the pixel between them, rad.
        scale: scale of the nodes, rad.
        order: number of nodes between two cuts.
    """
    cuts = jnp.stack([jnp.arcsinh(turn / scale) for turn in turns], axis=-1)
    middle = (cuts[..., :1] + cuts[..., -1:]) / 2
    t, step = nodes_in_panels(jnp.sort(jnp.concatenate([cuts, middle], axis=-1), axis=-1), order)
    return t, step * scale[..., None] * jnp.cosh(t)
