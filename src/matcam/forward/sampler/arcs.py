"""Arcs of circles of normals inside windows: the intersection of circles with half-spaces, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp

LONGEST = 2 * np.pi / 3 + 1e-9
"""Length of an arc, rad, above which it is divided."""
_SHORTEST = 1e-14
"""Length of an arc, rad, below which it is dropped as a rounding error."""
_TINY = 1e-300
_TURN = 2 * np.pi
_WHOLE = np.pi - 1e-9
"""Half length of an excluded interval, rad, that covers a whole circle."""


class Frame(NamedTuple):
    """Axis of circles, and the directions of azimuth 0 and pi/2: orthogonal unit vectors, arrays (3, windows)."""

    axis: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Clips(NamedTuple):
    """Half-spaces in the frame of the circles, arrays of shape (windows, half-spaces).

    Attributes:
        axial: component of a along the axis.
        radial: length of the component across the axis.
        azimuth: azimuth of that component, rad.
        offset: b.
    """

    axial: np.ndarray
    radial: np.ndarray
    azimuth: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, half_spaces: tuple[np.ndarray, np.ndarray], frame: Frame) -> Clips:
        """Convert half-spaces a . n <= b; a: (3, windows, half-spaces)."""
        normal, offset = half_spaces
        axial, along, across = (np.sum(normal * vector[:, :, None], axis=0) for vector in frame)
        return cls(axial, np.hypot(along, across), np.arctan2(across, along), offset)


def gaps(
    axial: jax.Array, radial: jax.Array, azimuth: jax.Array, offset: jax.Array, circle: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute start and length of the parts of circles inside all half-spaces, (..., half-spaces), rad; length 0: none.

    On a circle a half-space excludes one interval. A part starts at the end of an interval that no other interval
    covers, and ends at the next start of an interval.

    Args:
        axial: see `Clips`, (..., half-spaces).
        radial: the same.
        azimuth: the same.
        offset: the same.
        circle: angle of the circle from its axis, (...,), rad.
    """
    excess = offset - jnp.cos(circle)[..., None] * axial
    cosine = excess / jnp.maximum(jnp.sin(circle)[..., None] * radial, _TINY)
    half = jnp.arccos(jnp.clip(cosine, -1, 1))
    excludes = half > 0
    end, begin = azimuth + half, azimuth - half
    length = jnp.full_like(half, _TURN)
    for other in range(half.shape[-1]):
        own = excludes[..., other, None]
        since = end - begin[..., other, None]
        since -= _TURN * jnp.floor(since / _TURN)
        # the start of the interval itself is a turn less its length away
        covered = own & (since < 2 * half[..., other, None]) & (np.arange(half.shape[-1]) != other)
        length = jnp.where(own, jnp.minimum(length, _TURN - since), length)
        length = jnp.where(covered | (own & (half[..., other, None] > _WHOLE)), 0.0, length)
    free = ~jnp.any(excludes, axis=-1, keepdims=True) & (np.arange(half.shape[-1]) == 0)
    length = jnp.where(excludes | free, length, 0.0)
    return end, jnp.where(length > _SHORTEST, length, 0.0)


class Pieces(NamedTuple):
    """Arcs of at most `LONGEST`, arrays of shape (arcs,).

    Attributes:
        circle: index of the circle.
        middle: azimuth of the middle, rad.
        half: half length, rad.
    """

    circle: np.ndarray
    middle: np.ndarray
    half: np.ndarray


def divided(start: np.ndarray, length: np.ndarray) -> Pieces:
    """Divide the parts of circles, (circles, half-spaces), into arcs."""
    circle, part = np.nonzero(length)
    start, length = start[circle, part], length[circle, part]
    count = np.ceil(length / LONGEST).astype(int)
    circle, start, step = (np.repeat(a, count) for a in (circle, start, length / count))
    number = np.arange(circle.size) - np.repeat(np.cumsum(count) - count, count)
    return Pieces(circle, start + (number + 0.5) * step, step / 2)
