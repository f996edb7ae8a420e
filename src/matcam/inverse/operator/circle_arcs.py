"""Arcs of circles of normals in a pixel of a sphere's image (docs/model.md 3 and 10).

The integration domain of a pixel is bounded by half-spaces of normals, a . n <= b: the visible part of the sphere, its lit part
and the four sides of the kernel's window, for any position of camera and lamp and any rotation of the pixel. The intersection
of each with a circle of normals about the normal of the highlight has a closed form. The result is a list of arcs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.pixel_grid import turned
from matcam.inverse.operator.sample_view import SampleView

_LONGEST = 2 * np.pi / 3 + 1e-9
"""Length of an arc, rad, above which it is divided: the nodes of one arc resolve the kernel along a third of a circle."""
_SHORTEST = 1e-14
"""Length of an arc, rad, below which it is dropped as a rounding error."""
_TINY = 1e-300
_TURN = 2 * np.pi
_WHOLE = np.pi - 1e-9
"""Half length of an excluded interval, rad, that covers a whole circle."""


class SpherePixels(NamedTuple):
    """Pixels of images of a sphere, arrays of shape (pixels,).

    Attributes:
        x: distance from the optical axis along the plane of camera and lamp, towards the lamp, px.
        y: the same across that plane, px.
        lamp_angle: angle between lamp and optical axis, rad.
        highlight: angle between the normal of the highlight and the optical axis, rad.
        factor: factor of the record, no unit.
    """

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    highlight: np.ndarray
    factor: np.ndarray


class Arcs(NamedTuple):
    """Arcs in the order of pixels and circles, arrays of shape (arcs,).

    Attributes:
        pixel: index of the pixel.
        circle: index of the circle among those of the pixel.
        middle: azimuth of the middle about the highlight, from the plane of camera and lamp, rad.
        half: half length, rad.
    """

    pixel: np.ndarray
    circle: np.ndarray
    middle: np.ndarray
    half: np.ndarray


def circle_arcs(view: SampleView, pixels: SpherePixels, circles: np.ndarray, reach: np.ndarray) -> Arcs:
    """Find the arcs of circles about the highlight that pixels see.

    Args:
        view: the sphere and the distances of camera and lamp.
        pixels: the pixels.
        circles: angle of each circle from the normal of the highlight, (pixels, circles), rad.
        reach: half sides of the kernel's window along the pixel's two axes, (2, pixels), px.
    """
    normal, offset = _half_spaces(view, pixels, reach)
    sin, cos = np.sin(pixels.highlight)[:, None], np.cos(pixels.highlight)[:, None]
    # components along the axis of the circles, and along azimuths 0 and pi / 2
    axial = normal[0] * sin + normal[2] * cos
    along, across = normal[0] * cos - normal[2] * sin, normal[1]
    start, length = (
        np.asarray(a)
        for a in _gaps(axial, np.hypot(along, across), np.arctan2(across, along), offset, circles)  # type: ignore[arg-type]
    )
    pixel, circle, gap = np.nonzero(length > _SHORTEST)
    start, length = start[pixel, circle, gap], length[pixel, circle, gap]
    pieces = np.ceil(length / _LONGEST).astype(int)
    pixel, circle, start, step = (np.repeat(a, pieces) for a in (pixel, circle, start, length / pieces))
    piece = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return Arcs(pixel, circle, start + (piece + 0.5) * step, step / 2)


def _half_spaces(view: SampleView, pixels: SpherePixels, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute a, (3, pixels, 6), and b, (pixels, 6), of the half-spaces a . n <= b."""
    zero, one = np.zeros(pixels.x.size), np.ones(pixels.x.size)
    visible = (zero, zero, -one), -view.camera * one
    lit = (-np.sin(pixels.lamp_angle), zero, -np.cos(pixels.lamp_angle)), -view.lamp * one
    sides = []
    scale, nearness = view.stretch, view.camera
    for centre, axis, half in zip(
        turned(pixels.x, pixels.y, view.azimuth),
        (turned(1.0, 0.0, -view.azimuth), turned(0.0, 1.0, -view.azimuth)),  # type: ignore[arg-type]
        reach,
        strict=True,
    ):
        for side in (1, -1):
            # the image of a normal lies at scale (n_x, n_y) / (1 - nearness n_z)
            end = side * centre + half
            sides.append(((side * scale * axis[0] * one, side * scale * axis[1] * one, nearness * end), end))
    normals, offsets = zip(visible, lit, *sides, strict=True)
    return np.stack([np.stack(part, -1) for part in zip(*normals, strict=True)]), np.stack(offsets, -1)


@jit_plainly
def _gaps(
    axial: jax.Array, radial: jax.Array, azimuth: jax.Array, offset: jax.Array, circles: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return start and length of the gaps that half-spaces leave of circles, (pixels, circles, half-spaces), rad;
    length 0: none.

    On a circle a half-space excludes one interval. A gap starts at the end of an interval that no other interval
    covers, and ends at the next start of an interval.
    """
    excess = offset[:, None] - jnp.cos(circles)[..., None] * axial[:, None]
    cosine = excess / jnp.maximum(jnp.sin(circles)[..., None] * radial[:, None], _TINY)
    half = jnp.arccos(jnp.clip(cosine, -1, 1))
    excludes = half > 0
    end, begin = azimuth[:, None] + half, azimuth[:, None] - half
    length = jnp.full_like(half, _TURN)
    for other in range(half.shape[-1]):
        own = excludes[..., other, None]
        since = jnp.mod(end - begin[..., other, None], _TURN)
        # the start of the interval itself is a turn less its length away
        covered = own & (since < 2 * half[..., other, None]) & (np.arange(half.shape[-1]) != other)
        length = jnp.where(own, jnp.minimum(length, _TURN - since), length)
        length = jnp.where(covered | (own & (half[..., other, None] > _WHOLE)), 0.0, length)
    free = ~jnp.any(excludes, axis=-1, keepdims=True) & (np.arange(half.shape[-1]) == 0)
    return end, jnp.where(excludes | free, length, 0.0)
