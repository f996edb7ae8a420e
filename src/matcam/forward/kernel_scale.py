"""The lengths that a blur sets for an integral over it, and the terms of a blur that share them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import is_concrete, jax
from matcam.errors import ArgumentError
from matcam.forward.blur import STEEPEST, Blur
from matcam.sample.shape import Curved

_TOGETHER = 1.4
_SHARP = 0.7
"""Standard deviation, in half widths of the pixel, below which its borders show as steps."""


class Scale(NamedTuple):
    """Lengths on the sensor, px, that a blur's terms of about one width set."""

    near: float
    """Half the side of the square around the highlight in which the nodes go about the half vector."""
    margin: float
    """Distance from the ends of the light from which on a pixel's surroundings are smooth."""
    reach: float
    """How far the kernel is followed."""
    finest: float
    """Standard deviation of the narrowest term without the pixel."""
    spacing: float
    """Grid on which a record is known everywhere: it holds nothing finer."""
    cuts: tuple[float, ...]
    """Offsets inside its reach at which the kernel must be cut to be smooth in between; () where it is smooth."""


class Group(NamedTuple):
    """Terms of a blur of about one width."""

    terms: tuple[int, ...]
    scale: Scale


def groups_of(blur: Blur, sample: Curved) -> tuple[Group, ...]:
    """The terms of a blur, those of about one width together. Needs numbers: ArgumentError inside jit."""
    numbers = [jax.lax.stop_gradient(a) for a in (blur.stds, blur.pixel.half_width, sample.radius, blur.lamp_radius)]
    if not all(is_concrete(a) for a in numbers):
        raise ArgumentError(
            "the rig's numbers set how its picture is integrated: call this outside of jax.jit and vmap"
        )
    stds, half = np.asarray(numbers[0]), float(numbers[1])
    widened = np.sqrt(stds**2 + _widest_spread(blur, sample))
    radius = float(numbers[2])
    if np.min(stds) >= radius:
        raise ArgumentError(
            f"the sample's radius must exceed the camera's blur, of standard deviation {np.min(stds):g} px, got {radius:g} px"
        )
    groups, left = [], list(np.argsort(stds))
    while left:
        together = [j for j in left if stds[j] <= _TOGETHER * stds[left[0]]]
        groups.append(Group(tuple(int(j) for j in together), _scale(half, stds[together], widened[together])))
        left = left[len(together) :]
    return tuple(groups)


def _scale(half: float, stds: np.ndarray, widened: np.ndarray) -> Scale:
    widest, narrowest = float(np.max(widened)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    reach = half + 5.2 * widest
    inner = max(half - 5.2 * widest, half / 4)
    return Scale(
        near=10 * std,
        margin=4.8 * std,
        reach=reach,
        finest=narrowest,
        spacing=min(0.4 * narrowest, 0.36 * finest),
        cuts=(-half, -inner, inner, half) if narrowest < _SHARP * half else (),
    )


def _widest_spread(blur: Blur, sample: Curved) -> float:
    """Largest variance, px^2, that focus and lamp add anywhere."""
    if not blur.varies:
        return 0.0
    aperture, focus, lamp, radius = (
        float(jax.lax.stop_gradient(a)) for a in (blur.aperture, blur.focus, blur.lamp_radius, sample.radius)
    )
    depth = max(np.cos(focus), 1 - np.cos(focus))
    return (radius * aperture * depth / 4) ** 2 + (radius * lamp / 4 / STEEPEST) ** 2
