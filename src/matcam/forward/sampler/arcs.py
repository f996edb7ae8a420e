"""Arcs of circles of normals inside windows: the intersection of circles with half-spaces, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.numerics.blocks import in_blocks, in_calls

CHUNK = 1024
"""Largest number of windows of one call."""
_TURN = 2 * np.pi
_LIGHT_ENDS = 2
"""Number of half-spaces at whose borders the integrand does not vanish: limb and terminator, which come first
(`Windows.half_spaces`).
"""
_WHOLE = np.pi - 1e-9
"""Half length of an excluded interval, rad, above which the interval covers a whole circle."""


class Frame(NamedTuple):
    """Axis of circles, and the directions of azimuth 0 and pi/2: orthogonal unit vectors, arrays (3, windows)."""

    axis: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Clips(NamedTuple):
    """Half-spaces a . n <= b of normals n in the frame of the circles, arrays of shape (windows, half-spaces).

    Attributes:
        axial: component of the vector `a` along the axis.
        radial: length of the part of the vector `a` that is perpendicular to the axis.
        azimuth: azimuth of the perpendicular part, rad.
        offset: the number `b`.
    """

    axial: np.ndarray
    radial: np.ndarray
    azimuth: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, half_spaces: tuple[np.ndarray, np.ndarray], frame: Frame) -> Clips:
        """Express half-spaces a . n <= b of normals n in the frame of the circles.

        half_spaces: a, shape (3, windows, half-spaces), and b, shape (windows, half-spaces).
        """
        normal, offset = half_spaces
        axial, along, across = (np.sum(normal * vector[:, :, None], axis=0) for vector in frame)
        return cls(axial, np.hypot(along, across), np.arctan2(across, along), offset)


def _gaps(
    axial: jax.Array, radial: jax.Array, azimuth: jax.Array, offset: jax.Array, circle: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Compute the start and the length of the parts of circles inside all half-spaces, (..., half-spaces), rad.

    Entries without a part have the length 0. On a circle, a half-space excludes one interval. The end of an interval is the
    start of a part if no other interval covers it. The part extends to the next start of an interval. The sign
    of the length is a flag: the length is negative if both ends of the part lie on sides of the window, or if the part is a
    whole circle. This avoids a separate array of flags, which would increase the computing time.

    Args:
        axial: see `Clips`, (..., half-spaces).
        radial: see `Clips`, (..., half-spaces).
        azimuth: see `Clips`, (..., half-spaces), rad.
        offset: see `Clips`, (..., half-spaces).
        circle: angle of the circle from its axis, (...,), rad.
    """
    excess = offset - jnp.cos(circle)[..., None] * axial
    cosine = excess / jnp.maximum(jnp.sin(circle)[..., None] * radial, 1e-300)
    half = jnp.arccos(jnp.clip(cosine, -1, 1))
    excludes = half > 0
    end, begin = azimuth + half, azimuth - half
    length, until_dark = jnp.full_like(half, _TURN), jnp.full_like(half, jnp.inf)
    for other in range(half.shape[-1]):
        own = excludes[..., other, None]
        since = end - begin[..., other, None]
        since -= _TURN * jnp.floor(since / _TURN)
        # the distance from the end to the start of the same interval is a full turn minus its length
        covered = own & (since < 2 * half[..., other, None]) & (np.arange(half.shape[-1]) != other)
        length = jnp.where(own, jnp.minimum(length, _TURN - since), length)
        if other < _LIGHT_ENDS:
            until_dark = jnp.where(own, jnp.minimum(until_dark, _TURN - since), until_dark)
        length = jnp.where(covered | (own & (half[..., other, None] > _WHOLE)), 0.0, length)
    free = ~jnp.any(excludes, axis=-1, keepdims=True) & (np.arange(half.shape[-1]) == 0)
    vanishes = (length < until_dark) & (free | (np.arange(half.shape[-1]) >= _LIGHT_ENDS))
    length = jnp.where((excludes | free) & (length > 1e-14), length, 0.0)  # shorter arcs are rounding errors
    return end, jnp.where(vanishes, -length, length)


@kept_program
def _gap_blocks(used: jax.Array, rows: tuple[jax.Array, ...], clips: Clips) -> tuple[jax.Array, jax.Array]:
    def block(arguments):  # type: ignore[no-untyped-def]
        window, circle = arguments
        return _gaps(*(a[window] for a in clips), circle)

    return in_blocks(block, used, rows)


def gaps_of(clips: Clips, window: np.ndarray, circle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the parts of circles inside their windows, see `_gaps`, (circles, half-spaces)."""
    if not circle.size:
        return (np.zeros((0, clips.axial.shape[1])),) * 2
    more = CHUNK - clips.axial.shape[0]
    padded = Clips(*(np.pad(a, ((0, more), (0, 0)), mode="edge") for a in clips))
    start, length = in_calls(_gap_blocks, (window, circle), padded)
    return start, length


class Arcs(NamedTuple):
    """Parts of circles, arrays of shape (arcs,).

    Attributes:
        circle: index of the circle.
        middle: azimuth of the middle of the arc, rad.
        half: half length of the arc, rad.
        vanishes: True if the integrand vanishes at both ends of the arc, or if the arc is a whole circle.
    """

    circle: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    vanishes: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, length: np.ndarray) -> Arcs:
        """List the parts of circles. The arguments are the result of `gaps_of`."""
        circle, part = np.nonzero(length)
        start, length = start[circle, part], length[circle, part]
        half = np.abs(length) / 2
        return cls(circle, start + half, half, length < 0)
