"""The rules of chosen cells as arrays: what they read of a lobe at each node, and how that changes along the rig's axes."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jnp
from matcam.core.threads import available_cores, in_order
from matcam.forward.integral.blur import Blur, blur_of, groups_of
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lamp_lines import LampDisc, lamp_discs
from matcam.inverse.operator.line_rule import ARMS, line_rule
from matcam.inverse.operator.near_rule import (
    NearPixels,
    NearRule,
    near_masking_samples,
    near_rule,
    near_window,
)
from matcam.inverse.operator.polar_rule import (
    PIECE,
    Pixels,
    PolarWindow,
    disc_rule,
    kernel_reach,
    masking_samples,
    padded,
    polar_rule,
    polar_window,
    transfer,
)
from matcam.inverse.operator.rig_axes import SHAPE, SHAPE_SHARE, SHAPE_SPREAD, Axis, rig_with
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.rigs import Rig


class _Blurs(NamedTuple):
    """Hold the blurs of a rig's own and of all points of its axes, and what lamp and focus add to each in the pixels.

    Attributes:
        blurs: the rig's own first.
        spreads: for each, the variances along x and y, (pixels,), px^2.
        reaches: for each, the half sides of what a pixel sees, (2, pixels), px along its axes.
        terms: of the blurs, those that are looked at.
        discs: for each, the lamp's disc, where it is not in the spreads.
    """

    blurs: list[Blur]
    spreads: list[tuple[np.ndarray, ...]]
    reaches: list[np.ndarray]
    terms: tuple[int, ...]
    discs: list[LampDisc | None]

    def of(self, piece: slice) -> _Blurs:
        """Return what is held of some pixels."""
        return self._replace(
            spreads=[tuple(v[piece] for v in spread) for spread in self.spreads],
            reaches=[reach[:, piece] for reach in self.reaches],
            discs=[disc and LampDisc._make(a[piece] for a in disc) for disc in self.discs],
        )


class _Found(NamedTuple):
    """Hold the nodes of pixels, their weights for each blur, and where masking is taken: arrays by name."""

    theta: np.ndarray
    weights: list[np.ndarray]
    samples: dict[str, np.ndarray]


def rule_arrays(rig: Rig, cells: ChosenCells, axes: tuple[Axis, ...]) -> dict[str, np.ndarray]:
    """Return the nodes, weights and masking samples of cells by name; what changes along the axes is along0, along1 ..."""
    ways = cells.x.shape[-1]
    flat = np.flatnonzero(np.repeat(cells.valid.ravel(), ways))
    view = sample_view(rig)
    theta_d = np.broadcast_to(cells.theta_d[:, None, None], cells.x.shape)
    factor = cells.weight / (cells.cos_i * view.irradiance(cells.cos_i))
    x, y, theta_d, factor = (padded(a.ravel()[flat]) for a in (cells.x, cells.y, theta_d, factor))
    if view.distant:
        lamp_angle = 2 * theta_d
    else:
        lamp_angle = padded(view.lamp_angles(cells.theta_h, cells.theta_d[:, None], cells.phi_d).ravel()[flat])
    own = blur_of(rig, in_discs=True)
    blurs = [own, *(blur for axis in axes for blur in _blurs_along(rig, own, axis))]
    depth, nearness = view.normals(x, y)[2], rig.lamp.nearness

    discs, moved = lamp_discs(view, blurs, lamp_angle, x, y)
    chords = max(blur.chords for blur in blurs)
    if any(disc is not None for disc in discs):
        blurs, chords = [blur.of_point() for blur in blurs], 0
    elif view.azimuth and any(float(blur.lamp_radius) > 0 for blur in blurs):
        chords = 0  # what a small lamp adds is a Gaussian along turned axes: so is what focus adds
    if any(blur.varies for blur in blurs):  # one program for all
        blurs = [dataclasses.replace(blur, varies=True, chords=chords) for blur in blurs]
    spreads = [
        tuple(np.broadcast_to(v, x.shape) for v in blur.spread(rig.sample, depth, lamp_angle, nearness)[:2])  # type: ignore[arg-type]
        for blur in blurs
    ]

    def full(part: np.ndarray) -> np.ndarray:
        result = np.zeros((cells.x.size, *part.shape[1:]))
        result[flat] = part[: flat.size]
        return result.reshape(-1, ways, *part.shape[1:])

    half_width = float(rig.camera.pixel.half_width)
    columns: list[dict[str, np.ndarray]] = []
    for terms, _ in groups_of(blurs[0], rig.sample):  # type: ignore[arg-type]
        widths = [np.asarray(blur.stds)[list(terms)].max() for blur in blurs]
        reaches = [
            kernel_reach(half_width, np.sqrt(s**2 + np.maximum(*v))) + m + _widest_disc(view, blur, x, y, s)
            for s, v, m, blur in zip(widths, spreads, moved, blurs, strict=True)
        ]
        through = _Blurs(blurs, spreads, reaches, terms, discs)
        for rules in _in_pieces(view, (x, y, theta_d, lamp_angle, factor), through):
            weight, *others = rules.weights
            named = {"theta": rules.theta, "weight": weight, **{name: a[:, None] for name, a in rules.samples.items()}}
            for n, changes in enumerate(_changes_along(axes, weight, others)):
                named |= {f"along{n}.{point}": change for point, change in enumerate(changes)}
            columns.append({name: full(part) for name, part in named.items()})
    arrays = {name: np.concatenate([column[name] for column in columns], axis=2) for name in columns[0]}
    for n, axis in enumerate(axes):
        arrays[f"along{n}"] = np.stack([arrays.pop(f"along{n}.{point}") for point in range(len(axis.points))])
    return arrays


def _in_pieces(view: SampleView, pixels: tuple[np.ndarray, ...], through: _Blurs) -> list[_Found]:
    """Return the rules of pixels, piece by piece on all cores; a cylinder's are two. pixels: see `_rules`."""
    pieces = [slice(first, first + PIECE) for first in range(0, pixels[0].size, PIECE)]

    def rules(piece: slice) -> list[_Found]:
        return _rules(view, tuple(a[piece] for a in pixels), through.of(piece))

    return [_joined(parts) for parts in zip(*in_order(rules, pieces, available_cores()), strict=True)]


def _joined(parts: tuple[_Found, ...]) -> _Found:
    """Return the rules of all pixels of some pieces."""
    return _Found(
        np.concatenate([part.theta for part in parts]),
        [np.concatenate(weights) for weights in zip(*(part.weights for part in parts), strict=True)],
        {name: np.concatenate([part.samples[name] for part in parts]) for name in parts[0].samples},
    )


def _rules(view: SampleView, pixels: tuple[np.ndarray, ...], through: _Blurs) -> list[_Found]:
    """Return the rules of pixels, given by x, y, theta_d, the lamp's angle, and the record's factor."""
    x, y, theta_d, lamp_angle, factor = pixels
    if view.line:
        return _line_rules(view.radius, Pixels(x, y, theta_d, factor), through)
    if view.plain:
        return [_far_rules(view.radius, Pixels(x, y, theta_d, factor), through)]
    return [_near_rules(view, NearPixels(x, y, lamp_angle, view.highlight(lamp_angle), factor), through)]


def _widest_disc(view: SampleView, blur: Blur, x: np.ndarray, y: np.ndarray, std: float) -> np.ndarray:
    """Return the radius of the largest disc out of focus that a pixel sees anything of, px."""
    if not blur.chords:
        return np.zeros(x.shape)

    def disc(off: np.ndarray) -> np.ndarray:
        depth = view.normals(np.clip(off, 0, _INSIDE * view.radius), np.zeros(off.shape))[2]
        return np.abs(np.asarray(blur.defocus(view.radius, depth)))

    off, everywhere = np.hypot(x, y), disc(np.array([0.0, view.radius])).max()
    reach = kernel_reach(float(blur.pixel.half_width), np.asarray(std)) + everywhere
    return np.maximum(disc(off - reach), disc(off + reach))


def _far_rules(radius: float, pixels: Pixels, through: _Blurs) -> _Found:
    blurs, spreads, reaches, terms, discs = through

    def rule(n: int, window: PolarWindow):  # type: ignore[no-untyped-def]
        program = polar_rule if discs[n] is None else disc_rule
        return program(jnp.asarray(radius), blurs[n], tuple(spreads[n]), terms, pixels, window, discs[n])

    rules = [rule(n, polar_window(radius, pixels, *reach)) for n, reach in enumerate(reaches)]
    shown, weights = rules[0], [rules[0].weight]
    if len(blurs) > 1:  # all on the nodes of the widest
        widest = polar_window(radius, pixels, *np.max(reaches, axis=0))._replace(
            reach=reaches[0][0], rows=reaches[0][1]
        )
        shown = rule(0, widest)
        weights = [transfer(rule, widest) for rule in rules]
    samples = dict(zip(("sample_theta", "sample_cos_psi", "sample_share"), masking_samples(shown), strict=True))
    return _Found(np.asarray(shown.theta), [np.asarray(w) for w in weights], samples)


def _line_rules(radius: float, pixels: Pixels, through: _Blurs) -> list[_Found]:
    """Return the rules of a cylinder's two arms."""
    blurs, spreads, reaches, terms, _ = through
    onto = np.max([along for along, _ in reaches], axis=0)
    arms = []
    for arm in ARMS:
        rules = [
            line_rule(jnp.asarray(radius), blur, jnp.asarray(spread[0]), terms, pixels, reach[0], onto, arm)
            for blur, spread, reach in zip(blurs, spreads, reaches, strict=True)
        ]
        theta, cos_psi = np.asarray(rules[0].theta), np.asarray(rules[0].cos_psi)
        samples = {"sample_theta": theta, "sample_cos_psi": cos_psi[:, :, None]}
        arms.append(_Found(theta, [np.asarray(rule.weight) for rule in rules], samples))
    return arms


def _near_rules(view: SampleView, pixels: NearPixels, through: _Blurs) -> _Found:
    blurs, spreads, reaches, terms, discs = through
    onto = near_window(view, pixels, *np.max(reaches, axis=0)).theta
    nodes = _pixel_nodes(blurs, terms) if view.azimuth else 0
    rules: list[NearRule] = [
        near_rule(
            view, blur, spread, terms, pixels, near_window(view, pixels, *reach), onto, pixel_nodes=nodes, disc=disc
        )
        for blur, spread, reach, disc in zip(blurs, spreads, reaches, discs, strict=True)
    ]
    names = "sample_theta", "sample_cos_psi", "sample_theta_d", "sample_share"
    samples = dict(zip(names, near_masking_samples(rules[0]), strict=True))
    return _Found(np.asarray(rules[0].theta), [np.asarray(rule.weight) for rule in rules], samples)


def _pixel_nodes(blurs: list[Blur], terms: tuple[int, ...]) -> int:
    """Return how many nodes over a turned pixel serve all blurs: more where the pixel's borders show."""
    sharpest = min(float(np.min(np.asarray(blur.stds)[list(terms)])) for blur in blurs)
    ratio = float(blurs[0].pixel.half_width) / max(sharpest, 1e-3)
    return 1 if not blurs[0].varies else next(n for most, n in _PIXEL_NODES if ratio <= most)


_INSIDE = 1 - 1e-9
"""Share of a sample's radius within which it is seen."""
_PIXEL_NODES = ((1.7, 5), (5.0, 10), (np.inf, 20))
"""(half width of the pixel over the lens's standard deviation, nodes); few counts, as each is a program."""


def _blurs_along(rig: Rig, own: Blur, axis: Axis) -> list[Blur]:
    """Return the blurs whose rules an axis needs. own: that of the rig."""
    if axis.name == SHAPE:
        scales = (1 + SHAPE_SPREAD, 1 - SHAPE_SPREAD)
        return [dataclasses.replace(own, stds=own.stds * np.sqrt(scale)) for scale in scales]
    return [blur_of(rig_with(rig, {axis.name: axis.value(point)}), in_discs=True) for point in axis.points if point]


def _changes_along(axes: tuple[Axis, ...], weight: np.ndarray, others: list[np.ndarray]) -> list[list[np.ndarray]]:
    """Return by how much the weights differ at every point of every axis. others: weights of `_blurs_along`, in order."""
    changes = (other - weight for other in others)
    along = []
    for axis in axes:
        if axis.name == SHAPE:
            along.append([0 * weight, SHAPE_SHARE * (next(changes) + next(changes))])
        else:
            along.append([next(changes) if point else 0 * weight for point in axis.points])
    return along
