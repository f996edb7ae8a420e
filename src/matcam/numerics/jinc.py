"""Fourier transform of a uniform disc."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from matcam.core.arrays import compiled_by_jax, first_axis_map, has_jax, special, xp

if TYPE_CHECKING:
    from matcam.core.jax import jax

_SMALL = 1e-4  # argument below which 1 - v^2 / 8 is accurate to rounding


def jinc(v: jax.Array, largest: float) -> jax.Array:
    """Compute 2 J1(v) / v, where J1 is the Bessel function of order 1. The value at v = 0 is 1.

    The Bessel function of JAX is inaccurate for large arguments. For JAX arrays, the result is therefore the mean of 2
    cos^2 t cos(v sin t) over nodes t in [0, pi/2], which correspond to chords of the disc. This mean is exact if the number
    of nodes exceeds v.

    Args:
        v: argument, no unit, >= 0, any shape.
        largest: upper limit of v.
    """
    if has_jax(v):
        return _over_chords(24 + int(np.ceil(largest)), v)
    small = v < _SMALL
    return xp.where(small, 1 - v**2 / 8, 2 * special.j1(v) / np.where(small, 1.0, v))


@partial(compiled_by_jax, static=(0,))
def _over_chords(nodes: int, v: jax.Array) -> jax.Array:
    t = (np.arange(nodes) + 0.5) * (np.pi / 2 / nodes)  # the trapezoidal rule requires only a quarter turn
    chord = 2 * np.cos(t) ** 2 / nodes
    return first_axis_map(lambda value: xp.cos(value[:, None] * np.sin(t)) @ chord, (v.ravel(),), 256).reshape(v.shape)
