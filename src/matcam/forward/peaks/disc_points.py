"""Discs of lamp and lens in the tangent plane, as points over which the record of a highlight is averaged.

A source disc spreads a highlight over an ellipse, and a lens out of focus spreads it over a disc (docs/model.md 3). In
the tangent plane, ellipse and disc are constant over the lobe. The record is therefore the mean of records in focus under
a point lamp, shifted by the points of both discs. The points are Gauss-Legendre nodes in the squared radius, at equal
steps of the azimuth.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.camera.optics.gaussian import finest_width
from matcam.camera.pixel import PIXELS_SHARE
from matcam.core.arrays import constant, is_concrete, xp
from matcam.lamp.lamps import STEEPEST, rings_and_spokes
from matcam.sample.shape import Curved

if TYPE_CHECKING:
    from matcam.core.jax import jax
    from matcam.rigs import Rig

_LOBE = 0.5
"""Standard deviation by which a lobe is assumed to blur a disc, as a share of the roughness of the lobe. The complex
singularities of a GGX lobe, which limit the convergence of a quadrature, are at a distance of its roughness.
"""
_UNKNOWN_FINENESS = 6.0
"""Ratio of the radius of a disc to the standard deviation of its blur that is assumed for traced parameters."""


class DiscPoints(NamedTuple):
    """Points of the discs about some highlights.

    Attributes:
        x: offsets towards the limb, px, (slices, points).
        y: offsets perpendicular to the direction of `x`, px, (slices, points).
        share: shares of the points, (points,); their sum is 1.
        aside: angle by which a point rotates the half vector out of the plane of camera and lamp, rad, (slices, points).
    """

    x: jax.Array
    y: jax.Array
    share: np.ndarray
    aside: jax.Array


class Discs(NamedTuple):
    """Sizes of the discs about some highlights, (slices,) each.

    Attributes:
        lamp_x: half axis of the ellipse of the source disc towards the limb, px.
        lamp_y: half axis of the same ellipse perpendicular to the direction of `lamp_x`, px.
        lens: radius of the disc of a lens out of focus, px.
        turned: largest angle by which the source disc rotates the half vector out of the plane of camera and lamp, rad.
    """

    lamp_x: jax.Array
    lamp_y: jax.Array
    lens: jax.Array
    turned: jax.Array


def disc_sizes(rig: Rig, theta: jax.Array) -> Discs | None:
    """Compute the sizes of the discs of a rig; None if the rig has no discs. theta: viewing angles, shape (slices,), rad."""
    sample, nearness = rig.sample, rig.lamp.nearness
    if not has_discs(rig) or not isinstance(sample, Curved):
        return None
    cosine = xp.cos(theta)
    squeezed = cosine / xp.maximum(cosine, STEEPEST)
    along, across = (
        2 * xp.where(xp.isinf(scale), 0.0, scale) * xp.where(xp.isinf(scale), 0.0, spread)
        for scale, spread in zip(rig.px_per_rad(theta), rig.lamp_spread(theta), strict=True)
    )
    normal = xp.cos(sample.highlight(sample.lamp_angle(theta, nearness), nearness))
    lens = xp.abs(sample.radius * rig.aperture * (normal - xp.cos(rig.focus)) / 2)
    return Discs(along, across * squeezed, lens, 2 * rig.lamp_spread(theta)[1] * squeezed)


def mean_over_discs(
    rig: Rig,
    theta: jax.Array,
    record: Callable[[np.ndarray, DiscPoints], jax.Array],
    roughness: jax.Array | None = None,
) -> jax.Array:
    """Average a record over the points of the discs of a rig.

    Args:
        rig: a rig with discs.
        theta: viewing angles of the highlights, rad, (slices,).
        record: function of indices of `theta` and of the points at these angles, which returns the mean record over the
            points. The first axis of the result is over these angles.
        roughness: roughness of the lobe if the record depends on `DiscPoints.aside`. Default: None, for a record that is
            independent of `aside`.
    """
    discs = disc_sizes(rig, theta)
    assert discs is not None
    finest = np.inf
    if roughness is not None and is_concrete(known := constant(xp.asarray(roughness))):
        finest = _LOBE * float(known)
    lamp, focus, turned = (discs.lamp_x, discs.lamp_y), discs.lens, discs.turned
    std = xp.hypot(xp.hypot(finest_width(rig.camera.optics), rig.jitter), PIXELS_SHARE * rig.camera.pixel.half_width)
    of_lamp, of_lens = (
        _levels(size / width)
        for size, width in (
            (xp.maximum(xp.maximum(*lamp), turned * std / finest), std),
            (focus, xp.hypot(std, xp.minimum(*lamp) / 2)),
        )
    )
    found: list[tuple[np.ndarray, jax.Array]] = []
    # slices with equal numbers of points share a program
    for level in np.unique(np.stack([of_lamp, of_lens]), axis=1).T:
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
    return xp.concatenate([records for _, records in found])[order]


def has_discs(rig: Rig) -> bool:
    return isinstance(rig.sample, Curved) and not (_is_zero(rig.lamp_radius) and _is_zero(rig.aperture))


def _levels(fineness: jax.Array) -> np.ndarray:
    """Round values of the fineness up to powers of 2, at least 1/2. 0 remains 0; traced values become `_UNKNOWN_FINENESS`."""
    fineness = constant(fineness)
    if not is_concrete(fineness):
        return np.full(fineness.shape, _UNKNOWN_FINENESS)
    known = np.asarray(fineness)
    return np.where(known < 1e-9, 0.0, np.exp2(np.ceil(np.log2(np.maximum(known, 0.5)))))


def _unit_points(fineness: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute x, y and shares of points of the unit disc.

    fineness: radius of the disc divided by the standard deviation of its blur.
    """
    if fineness == 0:
        return np.zeros(1), np.zeros(1), np.ones(1)
    rings, spokes = rings_and_spokes(fineness)
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius = np.sqrt((1 + node) / 2)[:, None]
    turn = 2 * np.pi * (np.arange(spokes) + np.arange(rings)[:, None] % 2 / 2) / spokes
    share = np.broadcast_to(weight[:, None] / 2 / spokes, turn.shape)
    return (radius * np.cos(turn)).ravel(), (radius * np.sin(turn)).ravel(), share.ravel()


def _is_zero(value: jax.Array) -> bool:
    value = constant(value)
    return is_concrete(value) and float(value) == 0
