"""Inverse Fourier transforms of transfer functions that end at a known frequency, by Gauss-Legendre on panels.

Used where an effective kernel has no closed form. All transforms are of even functions (zero phase), so cosines and
the positive half of the frequencies are enough. The error is that of Gauss-Legendre with 16 nodes to at most one
period: below 1e-12 of the kernel's peak.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.numerics.quadrature import nodes_between, nodes_in_panels

ORDER = 16
"""Nodes to a panel."""

_DEFAULT_REACH = 64.0  # px; assumed for traced positions, whose extent is not known
_POINTS_AT_ONCE = 64


Transfer = Callable[[jax.Array, jax.Array], jax.Array]
Wave = Callable[[jax.Array, jax.Array], jax.Array]


class Rule(NamedTuple):
    """Hold nodes f (cycles/px, >= 0) and weights of a quadrature over the band of a transfer function."""

    frequency: AnyArray
    weight: AnyArray


def piecewise_rule(edges: np.ndarray, order: int = ORDER) -> Rule:
    """Return Gauss-Legendre nodes, `order` of them on each panel between consecutive edges."""
    return Rule(*nodes_in_panels(edges, order))


def split_rule(borders: np.ndarray, knots: np.ndarray) -> Rule:
    """Return `piecewise_rule` on panels that are split at knots; a piece gets nodes for its share of the panel."""
    edges = np.union1d(borders, knots)
    left, right, widths = edges[:-1], edges[1:], np.diff(edges)
    panel = np.clip(np.searchsorted(borders, left, side="right") - 1, 0, borders.size - 2)
    orders = np.clip(np.ceil(ORDER * widths / np.diff(borders)[panel]) + 3, 0, ORDER).astype(int)
    parts = [nodes_between(left[orders == n], right[orders == n], n) for n in np.unique(orders)]
    return Rule(*(np.concatenate([a.ravel() for a in arrays]) for arrays in zip(*parts, strict=True)))


def panels_for(reach: float, band: float) -> int:
    """Return the number of panels over [0, band] cycles/px that resolve positions out to `reach` px."""
    return 6 + int(np.ceil(reach * band))


def reach_of(*positions: jax.Array) -> float:
    """Return the largest distance (px) among positions, or a default for traced ones."""
    if not all(is_concrete(p) for p in positions):
        return _DEFAULT_REACH
    return float(max((np.max(np.abs(p)) for p in positions if p.size), default=0.0))


def line_kernel(rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Integrate transfer(f, angle) exp(2 pi i f x) df: the kernel on a line. x px and angle rad broadcast."""
    return _over_frequencies(_line_wave, rule, transfer, x, angle)


def step_response(rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Integrate the line kernel from -infinity to x."""
    return 0.5 + _over_frequencies(_step_wave, rule, transfer, x, angle)


def plane_kernel(rule: Rule, transfer: Transfer, x: jax.Array, y: jax.Array, turns: int) -> jax.Array:
    """Integrate a transfer(f, angle) that is even in fx and fy: the kernel in the plane.

    The nodes are polar, with `turns` angles to a quarter turn.
    """
    # the trapezoid rule on a full period is exact to rounding; over the quarter its two ends count half
    angle = jnp.linspace(0, jnp.pi / 2, turns + 1)
    ends = jnp.ones(turns + 1).at[jnp.array([0, -1])].set(0.5)
    frequency = jnp.asarray(rule.frequency)[:, None]
    area = (rule.weight * rule.frequency)[:, None] * ends * (jnp.pi / 2 / turns)
    amplitude = 4 * area * transfer(frequency, angle)
    return _plane_sum(frequency * jnp.cos(angle), frequency * jnp.sin(angle), amplitude, *jnp.broadcast_arrays(x, y))


def turns_for(reach: float, band: float) -> int:
    """Return the number of angles to a quarter turn that resolve positions out to `reach` px.

    By the Jacobi-Anger expansion the order must pass 2 pi f r.
    """
    return 16 + int(np.ceil((2 * np.pi * band * reach) / 4 * 1.1))


def _line_wave(f: jax.Array, x: jax.Array) -> jax.Array:
    return 2 * jnp.cos(2 * jnp.pi * f * x)


def _step_wave(f: jax.Array, x: jax.Array) -> jax.Array:
    # sin(2 pi f x) / (pi f), written so that f = 0 is no special case
    return 2 * x * jnp.sinc(2 * f * x)


def _over_frequencies(wave: Wave, rule: Rule, transfer: Transfer, x: jax.Array, angle: jax.Array) -> jax.Array:
    frequency, weight = jnp.asarray(rule.frequency), jnp.asarray(rule.weight)
    if angle.ndim == 0:
        return _line_sum(wave, frequency, weight * transfer(frequency, angle), x)

    def at(pair: tuple[jax.Array, jax.Array]) -> jax.Array:
        return wave(frequency, pair[0]) @ (weight * transfer(frequency, pair[1]))

    return _at_each(at, *jnp.broadcast_arrays(x, angle))


# The sums are functions of arrays alone, so that what was compiled for one lens serves the next.


@partial(jax.jit, static_argnums=0)
def _line_sum(wave: Wave, frequency: jax.Array, amplitude: jax.Array, x: jax.Array) -> jax.Array:
    return _at_each(lambda point: wave(frequency, point[0]) @ amplitude, x)


@jax.jit
def _plane_sum(fx: jax.Array, fy: jax.Array, amplitude: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    def at(point: tuple[jax.Array, jax.Array]) -> jax.Array:
        return jnp.sum(jnp.cos(2 * jnp.pi * fx * point[0]) * jnp.cos(2 * jnp.pi * fy * point[1]) * amplitude)

    return _at_each(at, x, y)


def _at_each(function: Callable[[Any], jax.Array], *positions: jax.Array) -> jax.Array:
    flat = tuple(p.ravel() for p in positions)
    return jax.lax.map(function, flat, batch_size=_POINTS_AT_ONCE).reshape(positions[0].shape)
