"""The discs of lamp and lens in the tangent plane, as points on the sensor over which a highlight's record is a mean.

A lamp's disc moves a highlight over an ellipse; a lens out of focus spreads it over a disc (docs/model.md 3). In the tangent
plane both are the same all over the lobe. So the record is the mean of records in focus under a point lamp, each moved by one
point of each: Gauss-Legendre in the squared radius times equal steps round the disc.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.core.jax import is_concrete, jax, jnp
from matcam.forward.integral.blur import PIXELS_SHARE, STEEPEST, blur_of
from matcam.lamp.lamps import rings_and_spokes
from matcam.rigs import Rig
from matcam.sample.shape import Curved

_UNKNOWN_FINENESS = 6.0
"""Radius of a disc over the standard deviation of its blur that is reckoned with inside jit."""


class DiscPoints(NamedTuple):
    """Hold points about some highlights.

    Attributes:
        x: px towards the limb, (slices, points).
        y: px across, the same.
        share: of the points, (points,); their sum is 1.
        aside: angle by which a point turns the half vector across, rad, (slices, points).
    """

    x: jax.Array
    y: jax.Array
    share: np.ndarray
    aside: jax.Array


def mean_over_discs(
    rig: Rig,
    theta: jax.Array,
    record: Callable[[np.ndarray, DiscPoints], jax.Array],
    finest: float = np.inf,
) -> jax.Array:
    """Return the mean of a record over the points of a rig's discs.

    Args:
        rig: a rig with a curved sample.
        theta: viewing angles of the highlights, rad, (slices,).
        record: takes which of the angles, and returns the mean over their points, slices first.
        finest: angle across over which the record changes much, rad. Default: infinite, it does not depend on `aside`.
    """
    cosine = jnp.cos(theta)
    lamp = [
        2 * jnp.where(jnp.isinf(scale), 0.0, scale) * jnp.where(jnp.isinf(scale), 0.0, spread)
        for scale, spread in zip(rig.px_per_rad(theta), rig.lamp_spread(theta), strict=True)
    ]
    lamp[1] *= cosine / jnp.maximum(cosine, STEEPEST)
    turned = 2 * rig.lamp_spread(theta)[1] * cosine / jnp.maximum(cosine, STEEPEST)
    blur, nearness = blur_of(rig), rig.lamp.nearness
    normal = jnp.cos(rig.sample.highlight(rig.sample.lamp_angle(theta, nearness), nearness))  # type: ignore[attr-defined]
    focus = jnp.abs(blur.defocus(rig.sample.radius, normal))  # type: ignore[attr-defined]
    std = jnp.hypot(jnp.min(blur.stds), PIXELS_SHARE * blur.pixel.half_width)
    of_lamp, of_lens = (
        _levels(size / width)
        for size, width in (
            (jnp.maximum(jnp.maximum(*lamp), turned * std / finest), std),
            (focus, jnp.hypot(std, jnp.minimum(*lamp) / 2)),
        )
    )
    found: list[tuple[np.ndarray, jax.Array]] = []
    for level in np.unique(np.stack([of_lamp, of_lens]), axis=1).T:  # the same count of points in one program
        slices = np.flatnonzero((of_lamp == level[0]) & (of_lens == level[1]))
        lamps, lens = (_unit_points(float(fineness)) for fineness in level)
        x, y = (
            (axis[slices, None, None] * at[:, None] + focus[slices, None, None] * own).reshape(slices.size, -1)
            for axis, at, own in ((lamp[0], lamps[0], lens[0]), (lamp[1], lamps[1], lens[1]))
        )
        share = np.outer(lamps[2], lens[2]).ravel()
        aside = (turned[slices, None, None] * lamps[1][:, None] + 0 * lens[0]).reshape(slices.size, -1)
        found.append((slices, record(slices, DiscPoints(x, y, share, aside))))
    order = np.argsort(np.concatenate([slices for slices, _ in found]))
    return jnp.concatenate([records for _, records in found])[order]


def has_discs(rig: Rig) -> bool:
    """Say whether a rig's lamp or lens makes discs."""
    return isinstance(rig.sample, Curved) and not (_is_zero(rig.lamp_radius) and _is_zero(rig.aperture))


def _levels(fineness: jax.Array) -> np.ndarray:
    """Return radii over the standard deviation of their blur as powers of 2 that are no smaller; 0 stays."""
    fineness = jax.lax.stop_gradient(fineness)
    if not is_concrete(fineness):
        return np.full(fineness.shape, _UNKNOWN_FINENESS)
    known = np.asarray(fineness)
    return np.where(known < 1e-9, 0.0, np.exp2(np.ceil(np.log2(np.maximum(known, 0.5)))))


def _unit_points(fineness: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y and shares of the points of the unit disc. fineness: its radius over the standard deviation of its blur."""
    if fineness == 0:
        return np.zeros(1), np.zeros(1), np.ones(1)
    rings, spokes = rings_and_spokes(fineness)
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius = np.sqrt((1 + node) / 2)[:, None]
    turn = 2 * np.pi * (np.arange(spokes) + np.arange(rings)[:, None] % 2 / 2) / spokes
    share = np.broadcast_to(weight[:, None] / 2 / spokes, turn.shape)
    return (radius * np.cos(turn)).ravel(), (radius * np.sin(turn)).ravel(), share.ravel()


def _is_zero(value: jax.Array) -> bool:
    value = jax.lax.stop_gradient(value)
    return is_concrete(value) and float(value) == 0
