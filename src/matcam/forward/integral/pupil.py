"""Defocused record of smooth radiance: the mean over points of the pupil of the lens.

Let s be the position of the sharp image of a surface element on the sensor. The pupil is the unit disc. Light through the
point p of the pupil arrives at s + c(s) p, where c is the radius of the disc out of focus, px. The position s is found by
iteration. The radiance is divided by the Jacobian determinant of s + c(s) p with respect to s.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from matcam.core.jax import jax, jnp


@cache
def _points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute x, y and weights of a rule of 12 points on the unit disc, exact to degree 7 (Stroud 1971, S2: 7-1)."""
    near, far = (np.sqrt((27 + side * 3 * np.sqrt(29)) / 104) for side in (-1, 1))
    low, high = ((551 - side * 41 * np.sqrt(29)) / 6264 for side in (1, -1))
    axis, signs = np.array([1.0, 0.0, -1.0, 0.0]), np.array([1.0, 1.0, -1.0, -1.0])
    x = np.concatenate([np.sqrt(3) / 2 * axis, near * signs, far * signs])
    y = np.concatenate([np.sqrt(3) / 2 * np.roll(axis, 1), near * np.roll(signs, 1), far * np.roll(signs, 1)])
    return x, y, np.repeat([2 / 27, high, low], 4)


def mean_over_pupil(
    sent: Callable[[jax.Array, jax.Array], jax.Array],
    disc: Callable[[jax.Array, jax.Array], jax.Array],
    x: jax.Array,
    y: jax.Array,
) -> jax.Array:
    """Compute the defocused radiance at positions on the sensor, 1/sr, channels last.

    Args:
        sent: function that returns the radiance of the sharp image at positions, 1/sr, channels last.
        disc: function that returns the radius of the disc out of focus at positions, px.
        x: positions along the rows of the sensor, px.
        y: positions along the columns of the sensor, px.
    """

    def of_point(point: tuple[jax.Array, ...]) -> jax.Array:
        p_x, p_y, share = point
        at_x, at_y = x, y
        for _ in range(3):  # each iteration multiplies the error by the derivative of c with respect to s
            radius = disc(at_x, at_y)
            at_x, at_y = x - radius * p_x, y - radius * p_y
        ones = jnp.ones_like(x)
        _, change = jax.jvp(disc, (at_x, at_y), (p_x * ones, p_y * ones))
        return share * sent(at_x, at_y) / jnp.abs(1 + change)[..., None]

    points = tuple(jnp.asarray(a) for a in _points())
    first, others = tuple(a[0] for a in points), tuple(a[1:] for a in points)
    return jax.lax.scan(lambda total, point: (total + of_point(point), None), of_point(first), others)[0]
