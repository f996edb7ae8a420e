"""The edge response without a model: a free core, a diffraction tail and glare, as closed forms (MODEL 7).

    E(d) = P(d) + sum of c_k [B_k(d) - P(d)] + sum of o_k O_k(d)

P is the best Gaussian lens through the exact pixel; what it gets wrong is free. Lengths are in units of s, the standard
deviation of P's line spread function, so that one setting serves every blur:

- core: pairs of Gaussian bumps of the line spread function, 0.6 s wide and 0.6 s apart, to 3.9 s on both sides; their even
  combinations B_k carry the MTF, their odd ones O_k a lens that is not symmetric (coma); the last O_k moves the edge;
- tail: a Cauchy line spread function, which falls as 1/d^2 as that of every lens with an edge to its pupil does;
- glare: a wide Gaussian, used where it is found.

All are Gaussian or rational, so that ESF, LSF and MTF are closed forms at any distance and frequency, and the spread of a
cell's distances is one more blur. There are no bins and no windows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.camera.kernel import edge_and_slopes
from matcam.core.jax import jax, jnp

PAIRS = 7
PLACES = 0.6 * (np.arange(PAIRS) + 0.5)
"""Of the bumps, in s."""
_WIDTH = 0.6  # s
_TAIL = 1.5  # s, half width at half maximum of the Cauchy
EVEN = PAIRS + 2
"""Strengths that shape the MTF: the core's, the tail's, the glare's."""
TAIL, GLARE = PAIRS, PAIRS + 1
"""Where in them the last two stand."""
ODD = PAIRS + 1


class Shape(NamedTuple):
    """What the basis is made of: scalars."""

    sigma: jax.Array
    """px, of the pilot P."""
    angle: jax.Array
    """rad, of the edge's normal to the grid."""
    half_width: jax.Array
    """px, of the pixel."""
    radius: jax.Array
    """px, standard deviation of the glare."""


class Basis(NamedTuple):
    """P (n,), the even B_k (EVEN, n) and the odd O_k (ODD, n)."""

    pilot: jax.Array
    even: jax.Array
    odd: jax.Array


def scale(shape: Shape) -> jax.Array:
    """s, px: a square's variance along any direction is that along its side."""
    return jnp.sqrt(shape.sigma**2 + shape.half_width**2 / 3)


def edge_basis(shape: Shape, distance: jax.Array, spread: jax.Array) -> Basis:
    """As edge responses at `distance` px, over cells of a given spread (px^2)."""
    places, width = _bumps(shape)
    blurred = jnp.sqrt(shape.sigma**2 + spread)
    pilot, line, _ = edge_and_slopes(distance, shape.angle, shape.half_width, blurred)
    wide = jnp.sqrt(width**2 + spread)
    right, left = (_step((distance - sign * places[:, None]) / wide) for sign in (1, -1))
    reach = _TAIL * scale(shape)
    # no Gaussian: for the spread its second derivative has to do
    bend = -2 * distance * reach / (jnp.pi * (distance**2 + reach**2) ** 2)
    tail = 0.5 + jnp.arctan(distance / reach) / jnp.pi + spread / 2 * bend
    moved = scale(shape) * line
    even = jnp.concatenate([(right + left) / 2, tail[None], glare_edge(shape.radius, distance, spread)[None]])
    return Basis(pilot, even, jnp.concatenate([(left - right) / 2, moved[None]]))


def glare_edge(radius: jax.Array, distance: jax.Array, spread: jax.Array) -> jax.Array:
    """Edge response of a Gaussian glare."""
    return _step(distance / jnp.sqrt(radius**2 + spread))


def line_basis(shape: Shape, distance: jax.Array) -> Basis:
    """As line spread functions at `distance` px, 1/px."""
    places, width = _bumps(shape)
    normal = jax.scipy.stats.norm.pdf

    def line(x: jax.Array) -> jax.Array:
        return edge_and_slopes(x, shape.angle, shape.half_width, shape.sigma)[1]

    pilot, moved = jax.jvp(line, (distance,), (jnp.broadcast_to(scale(shape), distance.shape),))
    right, left = (normal(distance, sign * places[:, None], width) for sign in (1, -1))
    reach = _TAIL * scale(shape)
    tail = reach / (jnp.pi * (distance**2 + reach**2))
    even = jnp.concatenate([(right + left) / 2, tail[None], normal(distance, 0.0, shape.radius)[None]])
    return Basis(pilot, even, jnp.concatenate([(left - right) / 2, moved[None]]))


def transfer_basis(shape: Shape, f: jax.Array) -> Basis:
    """As Fourier transforms at f cycles/px: the real part of P and B_k, the imaginary part of O_k."""
    places, width = _bumps(shape)
    gauss = lambda std: jnp.exp(-2 * (jnp.pi * std * f) ** 2)  # noqa: E731
    box = 2 * shape.half_width * f
    pilot = gauss(shape.sigma) * jnp.sinc(box * jnp.cos(shape.angle)) * jnp.sinc(box * jnp.sin(shape.angle))
    turn, bump = 2 * jnp.pi * f * places[:, None], gauss(width)
    tail = jnp.exp(-2 * jnp.pi * _TAIL * scale(shape) * jnp.abs(f))
    moved = 2 * jnp.pi * f * scale(shape) * pilot
    even = jnp.concatenate([bump * jnp.cos(turn), tail[None], gauss(shape.radius)[None]])
    return Basis(pilot, even, jnp.concatenate([bump * jnp.sin(turn), moved[None]]))


def _bumps(shape: Shape) -> tuple[jax.Array, jax.Array]:
    """Places of the right-hand bumps, and their width, px."""
    s = scale(shape)
    return jnp.asarray(PLACES) * s, _WIDTH * s


def _step(t: jax.Array) -> jax.Array:
    return (1 + jax.scipy.special.erf(t / jnp.sqrt(2.0))) / 2
