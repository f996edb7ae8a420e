"""How the record at given places is to be integrated: decided once, from numbers, by geometry alone.

The lengths and the sorting depend on the camera's numbers, but the record must not jump where they do: a plan is frozen, and
all that is computed by it is a smooth function of material and camera. Index lists are filled up to few lengths, so that
rigs that differ in their numbers only share what is compiled.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.integral import scene as regions
from matcam.forward.integral.blur import Blur, Group, Scale, groups_of
from matcam.numerics.interpolate import POINTS
from matcam.sample.shape import Curved

_PANELS_ALONG_V = ((2.6, 2), (5.0, 4), (np.inf, 10))
"""Panels in v for kernels that reach up to so many times their own reach along the surface."""


class Targets(NamedTuple):
    """Places in pictures, shape (targets,): position px, the lamp's angle rad, and the number of the picture."""

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    picture: np.ndarray


class Window(eqx.Module):
    """Targets whose record is integrated over a window about the kernel, in which the light ends or a lobe is squeezed."""

    chosen: np.ndarray
    whole: np.ndarray
    """Whether the kernel meets no end of the light: then it sees a flat field whole."""
    ridge: bool = eqx.field(static=True)
    panels: int = eqx.field(static=True)


class Part(eqx.Module):
    """The plan for the terms of a blur that share a scale. Index arrays into the targets, filled up with their last."""

    terms: tuple[int, ...] = eqx.field(static=True)
    reach: np.ndarray
    cuts: np.ndarray
    """Offsets at which the kernel must be cut, px; () where it is smooth."""
    spacing: np.ndarray
    """Of the grid around a highlight, px."""
    steps: int = eqx.field(static=True)
    """Points of that grid from the highlight to its border."""
    even: int = eqx.field(static=True)
    """Panels that the kernel asks for between the highlight and the border."""
    lamps: np.ndarray
    """Lamps whose highlights are recorded, (pictures, 1 or 3), rad."""
    inside: np.ndarray
    near: np.ndarray
    near_whole: np.ndarray
    windows: tuple[Window, ...]
    place: np.ndarray
    """Of each target, where in the results of inside, windows and near, one after the other, its record stands; the last
    place is that of darkness."""


class Plan(NamedTuple):
    """How to integrate the record at targets: a part for each scale of the blur."""

    targets: Targets
    parts: tuple[Part, ...]


def planned(sample: Curved, blur: Blur, lamp_angles: np.ndarray, targets: Targets) -> Plan:
    """The plan for a record. lamp_angles: of each picture, (pictures,), rad. ArgumentError inside jax.jit."""
    return Plan(targets, tuple(_part(sample, group, lamp_angles, targets) for group in groups_of(blur, sample)))


def _part(sample: Curved, group: Group, lamp_angles: np.ndarray, targets: Targets) -> Part:
    scale = group.scale
    x, y, lamp = (jnp.asarray(a) for a in (targets.x, targets.y, targets.lamp_angle))
    sample = jax.lax.stop_gradient(sample)
    near = np.abs(targets.x - np.asarray(regions.highlight_x(sample, lamp))) < scale.near
    near &= np.abs(targets.y) < scale.near
    whole = np.asarray(regions.away_from_ends(sample, x, y, lamp, scale.reach))
    smooth = np.asarray(regions.away_from_ends(sample, x, y, lamp, scale.margin))
    ridge = np.asarray(regions.crowded(sample, x, y, lamp, scale.reach))
    lit = np.asarray(regions.lit_within(sample, x, y, lamp, scale.reach))
    turned = np.asarray(regions.turn_along_v(sample, x, y, scale.reach)) / scale.reach
    inside = smooth & ~ridge & ~near
    window = lit & ~near & ~inside
    windows, least = [], 0.0
    for most, panels in _PANELS_ALONG_V:
        for squeezed in (False, True):
            chosen = np.flatnonzero(window & (turned > least) & (turned <= most) & (ridge == squeezed))
            if chosen.size:
                chosen = filled(chosen)
                windows.append(Window(chosen, whole[chosen], squeezed, panels))
        least = most
    near_list, inside_list = filled(np.flatnonzero(near)), filled(np.flatnonzero(inside))
    lists = [inside_list, *(window.chosen for window in windows), near_list]
    place = np.full(x.size, sum(map(len, lists)), dtype=np.int32)
    place[np.concatenate(lists)] = np.arange(sum(map(len, lists)))
    return Part(
        terms=group.terms,
        reach=np.asarray(scale.reach),
        cuts=np.asarray(scale.cuts),
        spacing=np.asarray(scale.spacing),
        steps=_round(int(np.ceil(scale.near / scale.spacing)) + POINTS // 2, 4),
        even=_panels_for(scale),
        lamps=_lamps_around(lamp_angles, targets, near),
        inside=inside_list,
        near=near_list,
        near_whole=whole[near_list],
        windows=tuple(windows),
        place=place,
    )


def _panels_for(scale: Scale) -> int:
    """Panels of the grid around a highlight, none wider than 2.2 standard deviations of the narrowest term."""
    return max(8, _round(int(np.ceil((scale.near + scale.reach) / (2.2 * scale.finest))), 2))


def _lamps_around(lamp_angles: np.ndarray, targets: Targets, near: np.ndarray) -> np.ndarray:
    """A target's own lamp may differ a little from that of its picture (before a near camera a slice of a table is taken
    from pictures of many lamps): three lamps that span them."""
    offset = np.abs(targets.lamp_angle[near] - lamp_angles[targets.picture[near]])
    if not near.any() or offset.max() < 1e-12:
        return lamp_angles[:, None]
    widest = np.full(lamp_angles.size, 1e-6)
    np.maximum.at(widest, targets.picture[near], offset)
    return lamp_angles[:, None] + widest[:, None] * np.array([-1.0, 0.0, 1.0])


def filled(chosen: np.ndarray) -> np.ndarray:
    """Indices with their last repeated up to the next of 8 to 15 times a power of two: few lengths, few compilations."""
    if not chosen.size:
        return chosen
    unit = max(1, 2 ** (int(chosen.size - 1).bit_length() - 4))
    return np.pad(chosen, (0, _round(chosen.size, unit) - chosen.size), mode="edge")


def _round(number: int, unit: int) -> int:
    return -(-number // unit) * unit
