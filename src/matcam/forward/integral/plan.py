"""Plan of a record: assignment of pixels to integrals, from the geometry alone.

Lengths and assignment depend on the parameters of the camera, but a record must not be discontinuous in them. A plan is
therefore frozen: under one plan a record is a smooth function of material and camera. Index lists are padded to few
lengths, so that rigs that differ only in values share compiled programs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur, Imaging
from matcam.forward.integral.blur_groups import BlurGroup, BlurScale, groups_of
from matcam.forward.integral.disc_stamps import margin_for, shares_for
from matcam.forward.integral.rest_at_limb import LimbRule, limb_rule
from matcam.forward.integral.scene import Turn, highlight_x
from matcam.numerics.approximation import POINTS
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved

_PANELS_ALONG_V = ((2.6, 2), (5.0, 4), (np.inf, 10))
"""Rows of (extent along the surface over that of the kernel, panels in v). The first sufficient row is used."""
_OCTAGON = np.sqrt(2) - 1
_ONE_LAMP = 1e-12  # rad
_FAINT = 0.1
"""Share of the terms of a lens below which fewer nodes suffice."""
_NO_CRESCENT = 0.6
"""Share of the support radius of a residual within which all surface must be lit for smooth light up to the limb."""
_FINER = 1.4
"""Factor of the length of a window along v that includes the corners of a turned pixel, for the number of panels."""
_SHORTEST, _SHORT, _MEDIUM = 16, 1024, 8192  # places


class RecordPlaces(NamedTuple):
    """Pixel centres in images, arrays of shape (places,).

    Attributes:
        x: column from the optical axis, px.
        y: row from the optical axis, upwards, px.
        lamp_angle: angle between lamp and optical axis, rad.
        picture: index of the image.
        azimuth: azimuth of the lamp of each position, rad; None: every lamp is towards +x.
    """

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    picture: np.ndarray
    azimuth: np.ndarray | None = None

    @property
    def turn(self) -> Turn | None:
        """Return cosine and sine of the azimuth; None if it is None."""
        return None if self.azimuth is None else Turn(np.cos(self.azimuth), np.sin(self.azimuth))


class PixelWindow(eqx.Module):
    """Positions with a window about the kernel, in which the light ends or a lobe is squeezed.

    Attributes:
        index: indices of the positions, padded.
        whole: True if the kernel contains no end of the light, so that a flat field is complete.
        ridge: True if a squeezed lobe crosses the window.
        panels: number of panels along v.
    """

    index: np.ndarray
    whole: np.ndarray
    ridge: bool = eqx.field(static=True)
    panels: int = eqx.field(static=True)


class PlanPart(eqx.Module):
    """Plan for the terms of a blur that share a scale. Indices refer to the positions, padded.

    Attributes:
        terms: indices of the terms.
        reach: support radius of the kernel, px.
        reach_in_focus: the same without the discs of a lens out of focus, px.
        cuts: offsets between which the kernel is smooth, px; () if it is smooth everywhere.
        spacing: step of the grid around a highlight, px.
        steps: number of points of that grid from the highlight to its border.
        even: number of panels that the kernel requires between the highlight and the border.
        margin: number of grid points beyond its border for discs of a lens out of focus; 0: no discs.
        shares: number of shares of the light by disc out of focus; 0: no discs.
        lamps: lamps whose highlights are recorded, (pictures, 1 or 3), rad.
        turns: azimuth of the lamps of each image, (pictures,), rad; None: 0.
        inside: indices of positions in smooth light.
        limb: indices of positions with the limb in the support of the residual of a lens.
        limb_rule: weights of their nodes; None: no such positions.
        near: indices of positions around the highlight.
        near_whole: True for positions in `near` whose kernel contains no end of the light.
        windows: positions with their own window.
        faint: True if the share of the terms in the blur is so small that fewer nodes suffice.
        place: for each position, its index in the concatenated records of inside, limb, windows and near. The last
            index is the value 0.
    """

    terms: tuple[int, ...] = eqx.field(static=True)
    reach: np.ndarray
    reach_in_focus: np.ndarray
    cuts: np.ndarray
    spacing: np.ndarray
    steps: int = eqx.field(static=True)
    even: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)
    shares: int = eqx.field(static=True)
    lamps: np.ndarray
    turns: np.ndarray | None
    inside: np.ndarray
    limb: np.ndarray
    limb_rule: LimbRule | None
    near: np.ndarray
    near_whole: np.ndarray
    windows: tuple[PixelWindow, ...]
    faint: bool = eqx.field(static=True)
    place: np.ndarray


class IntegrationPlan(NamedTuple):
    """Positions of a record, and a part of the plan for each scale of the blur."""

    places: RecordPlaces
    parts: tuple[PlanPart, ...]

    def turned(self, by: jax.Array) -> IntegrationPlan:
        """Return the plan with lamps turned away from the optical axis by a small angle, rad."""
        places = self.places._replace(lamp_angle=self.places.lamp_angle + by)
        parts = (eqx.tree_at(lambda one: one.lamps, part, part.lamps + by) for part in self.parts)
        return IntegrationPlan(places, tuple(parts))


def integration_plan(
    imaging: Imaging,
    lamp_angles: np.ndarray,
    places: RecordPlaces,
    azimuths: np.ndarray | None = None,
    elongation: float = 1.0,
) -> IntegrationPlan:
    """Plan a record. ArgumentError inside jax.jit.

    Args:
        imaging: sample, blur and the lamp's nearness.
        lamp_angles: lamp of each picture, (pictures,), rad.
        places: positions to record.
        azimuths: azimuth of each picture's lamp, (pictures,), rad; None, as in `places`: 0.
        elongation: elongation of the lobe, no unit: factor of the distance from a highlight within which a lobe may be
            narrow on the scale of the kernel. Default: 1, a round lobe.

    Returns:
        The plan. It is valid for any material, and for cameras whose parameters differ little.
    """
    imaging = jax.lax.stop_gradient(imaging)
    groups = groups_of(imaging.blur, imaging.sample, turned=azimuths is not None)
    return IntegrationPlan(
        places, tuple(_part(imaging, g, (lamp_angles, azimuths), places, elongation) for g in groups)
    )


def pad_indices(index: np.ndarray) -> np.ndarray:
    """Repeat the last index up to one of few lengths."""
    return np.pad(index, (0, few_lengths(index.size) - index.size), mode="edge") if index.size else index


def few_lengths(size: int) -> int:
    """Round up to one of few lengths, because each requires a compilation, and programs of 10 to 20 MB.

    A compilation takes longer than a thousand positions, so up to that number each length is four times the previous
    one. Beyond it there are two lengths per power of two, and eight beyond several thousand.
    """
    length = _SHORTEST
    while length < min(size, _SHORT):
        length *= 4
    if size <= length:
        return length
    return _round_up(size, 2 ** (size - 1).bit_length() // 2 // (2 if size <= _MEDIUM else 8))


def _part(
    imaging: Imaging,
    group: BlurGroup,
    lamps: tuple[np.ndarray, np.ndarray | None],
    places: RecordPlaces,
    elongation: float,
) -> PlanPart:
    scale, sample, lamp_angles = group.scale, imaging.sample, lamps[0]
    padded = _padded(places)
    x, y, aside = _in_the_scene(imaging, padded)
    lamp = _SceneLamp(jnp.asarray(padded.lamp_angle), imaging.lamp_nearness)
    near, whole, smooth, ridge, lit, turn = (
        np.asarray(a)[: places.x.size]
        for a in (
            aside < scale.near,
            _away_from_ends(sample, x, y, lamp, scale.reach),
            _away_from_ends(sample, x, y, lamp, scale.margin),
            _crowded(sample, x, y, lamp, scale.squeezed),
            _lit_within(sample, x, y, lamp, scale.reach),
            _turn_along_v(sample, x, y, scale.reach),
        )
    )
    aside, turn = aside[: places.x.size], turn / scale.reach
    turn *= _FINER if lamps[1] is not None else 1.0
    away = ~near & (aside >= scale.near * (elongation if elongation > 1 else 0.0))
    inside, limb = smooth & ~ridge & away, np.zeros_like(near)
    limb_rule = _limb_rule(imaging) if imaging.blur.is_rest(group.terms[0]) else None
    if limb_rule is not None:
        aslant, places_beside = turn > _PANELS_ALONG_V[0][0], lit & away & ~inside
        limb, dim = _rest_beside(sample, float(limb_rule.reach), (x, y, lamp), aslant, places_beside)
        inside |= dim
    beside = lit & ~near & ~inside & ~limb
    windows, least = [], 0.0
    for most, panels in _PANELS_ALONG_V:
        for squeezed in (False, True):
            index = np.flatnonzero(beside & (turn > least) & (turn <= most) & (ridge == squeezed))
            if index.size:
                index = pad_indices(index)
                windows.append(PixelWindow(index, whole[index], squeezed, panels))
        least = most
    near_index, inside_index = pad_indices(np.flatnonzero(near)), pad_indices(np.flatnonzero(inside))
    limb_index = pad_indices(np.flatnonzero(limb))
    lists = [inside_index, limb_index, *(window.index for window in windows), near_index]
    count = sum(map(len, lists))
    place = np.full(places.x.size, count, dtype=np.int32)
    place[np.concatenate(lists)] = np.arange(count)
    return PlanPart(
        terms=group.terms,
        reach=np.asarray(scale.reach),
        reach_in_focus=np.asarray(scale.reach_in_focus),
        cuts=np.asarray(scale.cuts),
        spacing=np.asarray(scale.spacing),
        steps=_round_up(int(np.ceil(scale.near / scale.spacing)) + POINTS // 2, 4),
        even=_even_panels(scale, np.sqrt(2) if lamps[1] is not None else 1.0),
        margin=_round_up(margin_for(scale.disc, float(scale.spacing)), 4) if scale.disc else 0,
        shares=_shares(imaging, scale, np.sqrt(2) if lamps[1] is not None else 1.0) if scale.disc else 0,
        lamps=_lamps_around(lamp_angles, places, near),
        turns=lamps[1],
        inside=inside_index,
        limb=limb_index,
        limb_rule=limb_rule,
        near=near_index,
        near_whole=whole[near_index],
        windows=tuple(windows),
        faint=_faint(imaging.blur, group.terms),
        place=place,
    )


def _limb_rule(imaging: Imaging) -> LimbRule | None:
    """Build the rule for the residual at the limb; None if lamp or focus blur it, or there is no residual."""
    rest, sample = imaging.blur.rest, imaging.sample
    if rest is None or imaging.blur.varies or not isinstance(sample, Sphere):
        return None
    return limb_rule(rest, float(sample.radius))


def _rest_beside(
    sample: Curved,
    reach: float,
    at: tuple[jax.Array, jax.Array, _SceneLamp],
    aslant: np.ndarray,
    places: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Select positions with the limb in the support of a residual that require no window, and those in smooth light.

    The effect of a terminator, where light starts at 0, or of a squeezed lobe away from the limb on the residual is at
    most 2e-5 of the peak. A terminator beside the limb counts only if the light is a thin crescent.

    Args:
        sample: the sphere.
        reach: support radius of the residual, px.
        at: x and y, px, and lamp of all positions.
        aslant: True for positions near the poles of the sphere, where crescents are dim.
        places: candidates.
    """
    index = np.flatnonzero(places)
    limb, dim = np.zeros_like(places), np.zeros_like(places)
    if not index.size:
        return limb, dim
    x, y, lamp = at
    padded = pad_indices(index)
    own = _SceneLamp(lamp.angle[padded], lamp.nearness)
    bright = np.asarray(_lit_around(sample, x[padded], y[padded], own, _NO_CRESCENT * reach))[: index.size]
    sees = np.hypot(np.asarray(x)[index], np.asarray(y)[index]) > float(sample.radius) - reach
    limb[index], dim[index] = sees & (bright | aslant[index]), ~sees
    return limb, dim


def _faint(blur: Blur, terms: tuple[int, ...]) -> bool:
    """Check whether terms are a small share of a non-Gaussian lens: the surroundings of its core, and its tails."""
    shares = [abs(float(blur.share(term))) for term in terms if not blur.is_rest(term)]
    return blur.rest is not None and 0 < sum(shares) < _FAINT


class _SceneLamp(NamedTuple):
    """Lamp of each position, in the axes of the scene: angle, rad, and nearness, 1/radii or None."""

    angle: jax.Array
    nearness: jax.Array | None


def _padded(places: RecordPlaces) -> RecordPlaces:
    """Pad the positions with the last one up to one of few lengths."""
    more = few_lengths(places.x.size) - places.x.size if places.x.size else 0
    fields: list[Any] = [a if a is None else np.pad(np.asarray(a), (0, more), mode="edge") for a in places]
    return RecordPlaces(*fields)


def _in_the_scene(imaging: Imaging, places: RecordPlaces) -> tuple[jax.Array, jax.Array, np.ndarray]:
    """Transform positions to the axes of camera and lamp, px, and compute their distances from the highlight, by the
    larger axis.
    """
    peak = np.asarray(highlight_x(imaging.sample, jnp.asarray(places.lamp_angle), imaging.lamp_nearness))
    turn = places.turn
    if turn is None:
        aside = np.abs(places.x - peak), np.abs(places.y)
        x, y = places.x, places.y
    else:  # the rectangle around a highlight is aligned with the sensor
        aside = np.abs(places.x - peak * turn.cosine), np.abs(places.y - peak * turn.sine)
        x, y = places.x * turn.cosine + places.y * turn.sine, places.y * turn.cosine - places.x * turn.sine
    return jnp.asarray(x), jnp.asarray(y), np.asarray(np.maximum(*aside))


def _shares(imaging: Imaging, scale: BlurScale, longer: float) -> int:
    """Compute the number of shares of light around a highlight at the limb, where depth changes most.

    `longer`: factor for the corners of a turned square.
    """
    radius = float(imaging.sample.radius)
    deepest = np.sqrt(1 - max(1 - 2 * longer * (scale.near + scale.reach) / radius, 0) ** 2)
    return shares_for(radius * float(imaging.blur.aperture) * deepest / 4 / scale.finest)


def _even_panels(scale: BlurScale, longer: float) -> int:
    """Count the panels of one length around a highlight.

    Their width is at most 2.2 standard deviations of the narrowest term. `longer`: factor for the corners of a turned square.
    """
    return max(8, _round_up(int(np.ceil(longer * (scale.near + scale.reach) / (2.2 * scale.finest))), 2))


def _lamps_around(lamp_angles: np.ndarray, places: RecordPlaces, near: np.ndarray) -> np.ndarray:
    """Choose the lamps whose highlights are recorded.

    There is one lamp per image, or three that span the lamps of its positions, because with a near camera a slice of a
    table comes from images of many lamps.
    """
    offset = np.abs(places.lamp_angle[near] - lamp_angles[places.picture[near]])
    if not near.any() or offset.max() < _ONE_LAMP:
        return lamp_angles[:, None]
    widest = np.full(lamp_angles.size, 1e-6)
    np.maximum.at(widest, places.picture[near], offset)
    return lamp_angles[:, None] + widest[:, None] * np.array([-1.0, 0.0, 1.0])


def _round_up(number: int, unit: int) -> int:
    return -(-number // unit) * unit


@jax.jit
def _away_from_ends(sample: Curved, x: jax.Array, y: jax.Array, lamp: _SceneLamp, margin: float) -> jax.Array:
    """Find positions whose surroundings within `margin` px are visible and lit.

    The circle is replaced by its circumscribed octagon.
    """
    equator = sample.across(x, jnp.zeros_like(x))
    inside = jnp.ones(jnp.broadcast_shapes(x.shape, y.shape), dtype=bool)
    for up, aside in ((-1.0, _OCTAGON), (-_OCTAGON, 1.0), (0.0, 1.0), (_OCTAGON, 1.0), (1.0, _OCTAGON)):
        row = y + up * margin
        v, _ = sample.window(row, row, equator)
        low, high = sample.lit(v, *lamp)
        left, right = sample.surface(low, v).x, sample.surface(high, v).x
        inside &= (x - aside * margin > left) & (x + aside * margin < right)
    return inside


@jax.jit
def _crowded(sample: Curved, x: jax.Array, y: jax.Array, lamp: _SceneLamp, reach: float) -> jax.Array:
    """Find positions where foreshortening squeezes a lobe into the kernel.

    There, the normal varies under the kernel by more than its angle from the half vector.
    """
    v, _ = sample.window(y, y, sample.across(x, jnp.zeros_like(x)))
    low, high = sample.lit(v, *lamp)
    first, last = (jnp.clip(sample.across(x + side * reach, v), low, high) for side in (-1, 1))
    middle = sample.across(x, v) - sample.highlight(*lamp)
    return jnp.hypot(middle, v) < 1.0 * (last - first)


@jax.jit
def _turn_along_v(sample: Curved, x: jax.Array, y: jax.Array, reach: float) -> jax.Array:
    """Compute the length in v, px, under a kernel at (x, y).

    Along the surface the length is twice the support radius of the kernel, and larger where the surface is
    foreshortened.
    """
    first, last = sample.rows(x, y, reach)
    return (last - first) * sample.stretch


@jax.jit
def _lit_within(sample: Curved, x: jax.Array, y: jax.Array, lamp: _SceneLamp, reach: float) -> jax.Array:
    """Find positions with lit surface within `reach` px.

    Errors are rare, and a lit position is never classified as dark.
    """
    first, last = sample.rows(x, y, reach)
    if lamp.nearness is not None:
        most = sample.lit_rows(lamp.angle, lamp.nearness)
        first, last = jnp.clip(first, -most, most), jnp.clip(last, -most, most)
    # terminator and limb approach the axis towards the poles, so their extreme positions are in these rows
    left, right = jnp.full(first.shape, jnp.inf), jnp.full(first.shape, -jnp.inf)
    for v in (first, jnp.clip(0.0, first, last), last):
        low, high = sample.lit(v, *lamp)
        left = jnp.minimum(left, sample.surface(low, v).x)
        right = jnp.maximum(right, sample.surface(high, v).x)
    return (last > first) & (x - reach < right) & (x + reach > left)


@jax.jit
def _lit_around(sample: Curved, x: jax.Array, y: jax.Array, lamp: _SceneLamp, reach: float) -> jax.Array:
    """Find positions whose visible surroundings within `reach` px are lit, by points on two circles."""
    limb = sample.radius * (1 - 1e-9)
    lit = jnp.ones(x.shape, dtype=bool)
    for angle in np.arange(24) * (np.pi / 12):
        for share in (0.5, 1.0):
            at_x, at_y = (a + share * reach * part for a, part in ((x, np.cos(angle)), (y, np.sin(angle))))
            back = jnp.minimum(limb / jnp.maximum(jnp.hypot(at_x, at_y), limb), 1.0)
            normal = sample.at(at_x * back, at_y * back)[0].normal
            up = normal[0] * jnp.sin(lamp.angle) + normal[2] * jnp.cos(lamp.angle)
            lit &= up > (0.0 if lamp.nearness is None else lamp.nearness)
    return lit
