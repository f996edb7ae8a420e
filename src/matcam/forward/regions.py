"""Which of three ways a target's record is integrated in: near the highlight, along the ends of the light, inside.

All lengths follow from the kernel, in units of its own standard deviation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import is_concrete, jax, jnp
from matcam.errors import ArgumentError
from matcam.forward.blur import STEEPEST, Blur
from matcam.sample.shape import Curved


class Scale(NamedTuple):
    """Lengths on the sensor, px, that the widest narrow term of a blur sets."""

    near: float
    """Half the side of the square around the highlight in which the nodes go about the half vector."""
    margin: float
    """Distance from the ends of the light from which on a pixel's surroundings are smooth."""
    reach: float
    """How far the kernel is followed."""
    spacing: float
    """Grid on which a record is known everywhere: it holds nothing finer."""


class Group(NamedTuple):
    """Terms of a blur of about one width."""

    terms: tuple[int, ...]
    scale: Scale


def groups_of(blur: Blur, sample: Curved) -> tuple[Group, ...]:
    """The terms of a blur, those within a factor of two of each other together. Needs numbers: ArgumentError inside jit."""
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
        together = [j for j in left if stds[j] <= 2 * stds[left[0]]]
        groups.append(Group(tuple(int(j) for j in together), _scale(half, stds[together], widened[together])))
        left = left[len(together) :]
    return tuple(groups)


def _scale(half: float, stds: np.ndarray, widened: np.ndarray) -> Scale:
    widest, narrowest = float(np.max(widened)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    return Scale(
        near=10 * std,
        margin=4.8 * std,
        reach=half + 5.2 * widest,
        spacing=min(0.4 * narrowest, 0.36 * finest),
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


@jax.jit
def away_from_ends(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, margin: float) -> jax.Array:
    """Whether the square of half side `margin` px about (x, y) is visible and lit all over (to its corners)."""
    equator = sample.across(x, jnp.zeros_like(x))
    inside = jnp.ones(jnp.broadcast_shapes(x.shape, y.shape), dtype=bool)
    for row in (y - margin, y, y + margin):
        v, _ = sample.window(row, row, equator)
        low, high = sample.lit(v, lamp_angle)
        left, right = sample.surface(low, v).x, sample.surface(high, v).x
        inside &= (x - margin > left) & (x + margin < right)
    return inside


@jax.jit
def crowded(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, reach: float) -> jax.Array:
    """Whether the surface under a kernel at (x, y) turns by more than its own angle from the half vector."""
    v, _ = sample.window(y, y, sample.across(x, jnp.zeros_like(x)))
    low, high = sample.lit(v, lamp_angle)
    first, last = (jnp.clip(sample.across(x + side * reach, v), low, high) for side in (-1, 1))
    middle = sample.across(x, v) - sample.highlight(lamp_angle)
    return jnp.hypot(middle, v) < 1.0 * (last - first)


@jax.jit
def turn_along_v(sample: Curved, x: jax.Array, y: jax.Array, reach: float) -> jax.Array:
    """How far, in px along the surface, a kernel at (x, y) reaches in v: twice its own reach, more where it is seen aslant."""
    first, last = sample.rows(x, y, reach)
    return (last - first) * sample.stretch


class Sorted(NamedTuple):
    """Indices of targets by the way in which their record is integrated."""

    near: np.ndarray
    ridge: np.ndarray
    pole: np.ndarray
    slanted: np.ndarray
    ends: np.ndarray
    inside: np.ndarray


def sorted_targets(sample: Curved, x: np.ndarray, y: np.ndarray, lamp_angle: np.ndarray, scale: Scale) -> Sorted:
    """Sort targets at (x, y) px, each under its own lamp; those that no light reaches are in no kind."""
    px, py, lamp = jnp.asarray(x), jnp.asarray(y), jnp.asarray(lamp_angle)
    peak = np.asarray(_highlight_x(sample, lamp))
    near = (np.abs(x - peak) < scale.near) & (np.abs(y) < scale.near)
    away = np.asarray(away_from_ends(sample, px, py, lamp, scale.margin)) & ~near
    turned = np.asarray(turn_along_v(sample, px, py, scale.reach))
    pole = (turned > 5 * scale.reach) & ~near & ~away
    ridge = np.asarray(crowded(sample, px, py, lamp, scale.reach)) & ~near & ~pole
    ends = np.asarray(lit_within(sample, px, py, lamp, scale.reach)) & ~near & ~ridge & ~pole & ~away
    slanted = ends & (turned > 2.6 * scale.reach)
    return Sorted(*(np.flatnonzero(kind) for kind in (near, ridge, pole, slanted, ends & ~slanted, away & ~ridge)))


@jax.jit
def _highlight_x(sample: Curved, lamp_angle: jax.Array) -> jax.Array:
    return sample.surface(sample.highlight(lamp_angle), jnp.zeros(())).x


@jax.jit
def lit_within(sample: Curved, x: jax.Array, y: jax.Array, lamp_angle: jax.Array, reach: float) -> jax.Array:
    """Whether light within `reach` px of (x, y) can reach it."""
    any_light = jnp.zeros(jnp.broadcast_shapes(x.shape, y.shape), dtype=bool)
    first, last = sample.rows(x, y, reach)
    for v in (first, (first + last) / 2, last):
        low, high = sample.lit(v, lamp_angle)
        left, right = sample.surface(low, v).x, sample.surface(high, v).x
        any_light |= (right > left) & (x - reach < right) & (x + reach > left)
    return any_light
