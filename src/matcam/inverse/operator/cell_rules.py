"""Operators of chosen cells as arrays: weights of a lobe at nodes, and their changes along the axes of rig parameters.

With a near camera or lamp each node has its own theta_d. The weights times the deviation of theta_d from its value for
the cell are a second set of weights, the moments.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.threads import available_cores, in_order
from matcam.forward.integral.blur import Blur, blur_of, std_of_half
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.pixel_grid import turned
from matcam.forward.sampler.windows import Windows
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.cylinder_rule import LinePixels, cylinder_rule, line_window
from matcam.inverse.operator.line_rule import ARMS, ImagePositions, line_rule
from matcam.inverse.operator.pixel_blurs import PixelBlurs, gaussian_blurs, residual_blurs
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.inverse.operator.sphere_rule import Kernel, WindowArcs, sphere_range, sphere_rules
from matcam.inverse.operator.theta_nodes import (
    NODES,
    PIECE,
    PIECES,
    PixelRule,
    Scale,
    masking_angles,
    padded,
)
from matcam.inverse.rig.rig_axes import Axis
from matcam.inverse.rig.rig_blurs import RigBlurs
from matcam.rigs import Rig


class _Found(NamedTuple):
    """Nodes of pixels, their weights for each blur, and the arrays for masking by name.

    The moments have the shape of the weights; they are empty for a distant rig.
    """

    theta: np.ndarray
    weights: Sequence[np.ndarray]
    masked: dict[str, np.ndarray]
    moments: Sequence[np.ndarray] = ()


def rule_arrays(rig: Rig, cells: ChosenCells, axes: tuple[Axis, ...]) -> dict[str, np.ndarray]:
    """Compute nodes, weights and the angles for masking of cells by name.

    The arrays along0, along1, ... are the changes of the weights along the axes. For a near rig, the result also contains the
    moments (moment) and the changes of the moments (moment_along0, moment_along1, ...). Changes have single precision, which
    is accurate to 6e-8 of a change and halves their size, most of that of the rule.
    """
    directions = cells.x.shape[-1]
    flat = np.flatnonzero(np.repeat(cells.valid.ravel(), directions))
    view = sample_view(rig)
    theta_d = np.broadcast_to(cells.theta_d[:, None, None], cells.x.shape)
    factor = cells.weight / (cells.cos_i * view.irradiance(cells.cos_i))
    x, y, theta_d, factor = (padded(a.ravel()[flat]) for a in (cells.x, cells.y, theta_d, factor))
    if view.distant:
        lamp_angle = 2 * theta_d
    else:
        lamp_angle = padded(view.lamp_angles(cells.theta_h, cells.theta_d[:, None], cells.phi_d).ravel()[flat])
    own = blur_of(rig, in_discs=True, whole=not view.line)
    all_blurs = RigBlurs.of(rig, own, axes)
    moved, changes = all_blurs.along, all_blurs.changes
    count = len(moved) + len(changes)

    def full(part: np.ndarray) -> np.ndarray:
        result = np.zeros((cells.x.size, *part.shape[1:]))
        result[flat] = part[: flat.size]
        return result.reshape(-1, directions, *part.shape[1:])

    columns: list[dict[str, np.ndarray]] = []
    widths: list[PixelBlurs] = []
    groups = [group.terms for group in groups_of(own, rig.sample)]  # type: ignore[arg-type]
    if view.line and float(own.lamp_radius) and not view.distant:  # each term has its own rule along the rows
        groups = [(term,) for terms in groups for term in terms]
    for terms in groups:
        parts = [one._replace(blur=one.blur.only(terms)) for one in moved]
        if parts[0].blur.residual is not None:
            widths.append(residual_blurs(view, rig, parts, (x, y, lamp_angle)))
        else:
            lenses = [one.blur.std_of_half for one in moved]
            widths.append(gaussian_blurs(view, rig, parts, (x, y, lamp_angle), lenses))
    widths.sort(key=lambda through: np.max(through.reaches[0]))
    together = [[through] for through in widths] if view.line else _on_the_same_nodes(widths)
    if changes:
        lenses = [one.blur.std_of_half for one in changes]
        change = gaussian_blurs(view, rig, changes, (x, y, lamp_angle), lenses)
        change = change._replace(columns=tuple(range(len(moved), count)))
        together = [*together, [change]] if view.line else [[*together[0], change], *together[1:]]
    scale = Scale.of(view.radius, float(np.min(widths[0].reaches[0])), single=len(widths) == 1)
    for some in together:
        for rules in _in_pieces(view, (x, y, theta_d, lamp_angle, factor), some, scale, count):
            named = {"theta": rules.theta, **rules.masked}
            named |= all_blurs.differences("weight", "along", rules.weights)
            if rules.moments:
                named |= all_blurs.differences("moment", MOMENT_ALONG, rules.moments)
            columns.append({name: full(part) for name, part in named.items()})
    arrays = {name: np.concatenate([column[name] for column in columns], axis=2) for name in columns[0]}
    for name in ("along", MOMENT_ALONG) if "moment" in arrays else ("along",):
        for n, axis in enumerate(axes):
            points = [arrays.pop(f"{name}{n}.{point}") for point in range(len(axis.points))]
            arrays[f"{name}{n}"] = np.stack(points, axis=1, dtype=np.float32, casting="same_kind")
    return arrays


def _by_window(through: PixelBlurs, numbers: Sequence[int]) -> list[list[int]]:
    """Group the indices `numbers` of blurs with equal windows and the same compiled program."""
    groups: dict[tuple, list[int]] = {}
    for n in numbers:
        groups.setdefault((through.reaches[n].tobytes(), jax.tree.structure(through.blurs[n])), []).append(n)
    return list(groups.values())


def _in_pieces(
    view: SampleView, pixels: tuple[np.ndarray, ...], widths: list[PixelBlurs], scale: Scale, count: int
) -> list[_Found]:
    """Compute the rules of pixels in pieces on all cores: one rule on a sphere, or one for each arm of a cylinder.

    There are `count` blurs in total. Blurs that are not in `widths` have weights of 0.
    """
    step = PIECE if view.line else PIECES * PIECE
    pieces = [slice(first, first + step) for first in range(0, pixels[0].size, step)]

    def rules(piece: slice) -> list[_Found]:
        return _rules(view, tuple(a[piece] for a in pixels), [through.of(piece) for through in widths], scale)

    columns = sorted({column for through in widths for column in through.columns})
    joined = (_joined(parts) for parts in zip(*in_order(rules, pieces, available_cores()), strict=True))
    return [
        found._replace(
            weights=_in_columns(found.weights, columns, count), moments=_in_columns(found.moments, columns, count)
        )
        for found in joined
    ]


def _in_columns(arrays: Sequence[np.ndarray], columns: list[int], count: int) -> list[np.ndarray]:
    if not arrays:
        return []
    by_column = dict(zip(columns, arrays, strict=True))
    return [by_column.get(column, np.zeros_like(arrays[0])) for column in range(count)]


def _joined(parts: tuple[_Found, ...]) -> _Found:
    return _Found(
        np.concatenate([part.theta for part in parts]),
        [np.concatenate(weights) for weights in zip(*(part.weights for part in parts), strict=True)],
        {name: np.concatenate([part.masked[name] for part in parts]) for name in parts[0].masked},
        tuple(np.concatenate(moments) for moments in zip(*(part.moments for part in parts), strict=True)),
    )


def _rules(view: SampleView, pixels: tuple[np.ndarray, ...], widths: list[PixelBlurs], scale: Scale) -> list[_Found]:
    """Compute the quadrature rules of pixels for groups of terms.

    On a cylinder there is one group. On a sphere, several groups have common nodes.

    pixels: x and y, px, theta_d and lamp angle, rad, and factor of the record of each pixel.
    """
    x, y, theta_d, lamp_angle, factor = pixels
    if not view.line:
        cosine, sine = (np.full(x.shape, part(view.azimuth)) for part in (np.cos, np.sin))
        largest = np.max([reach for through in widths for reach in through.reaches], axis=0)
        peak = view.highlight(lamp_angle)
        windows = Windows(*turned(x, y, view.azimuth), lamp_angle, peak, cosine, sine, largest)
        return [_sphere_rules(view, windows, theta_d, factor, widths, scale)]
    (through,) = widths
    if any(through.lamps) or not view.distant:
        pixels = LinePixels(np.hypot(x, y), lamp_angle, np.arctan2(-y, x), factor)
        return _cylinder_rules(view, pixels, through, scale, None if view.distant else theta_d)
    return _line_rules(view.radius, ImagePositions(x, y, theta_d, factor), through, scale)


def _on_the_same_nodes(widths: list[PixelBlurs]) -> list[list[PixelBlurs]]:
    """Divide groups of terms by support radius into the core of a lens, its surroundings, and wide tails.

    `widths` contains the groups in the order of increasing support radius.
    """
    reach = np.array([np.max(through.reaches[0]) for through in widths])
    ends = np.searchsorted(reach, np.maximum(_SURROUNDINGS, reach[0]), side="right")
    return [widths[a:b] for a, b in zip([0, *ends], [*ends, len(widths)], strict=True) if b > a]


def _sphere_rules(
    view: SampleView, windows: Windows, theta_d: np.ndarray, factor: np.ndarray, widths: list[PixelBlurs], scale: Scale
) -> _Found:
    """Compute the rules of groups of terms on common nodes. `windows` contains the windows of the widest group."""
    sphere = view.on_sphere
    own = scale if np.min(widths[0].reaches[0]) > _SURROUNDINGS[0] else scale._replace(largest=np.inf)
    widest, onto = (one.scaled(scale) for one in sphere_range(sphere, windows))

    def rules(through: PixelBlurs, numbers: Sequence[int], at: WindowArcs) -> list[PixelRule]:
        kernels = [
            Kernel(
                through.blurs[n],
                through.spreads[n],
                through.discs[n],
                _pixel_nodes(through.blurs, n) if view.azimuth else 0,
            )
            for n in numbers
        ]
        return sphere_rules(sphere, at, kernels, onto, theta_d, factor)

    def parts(through: PixelBlurs) -> list[list[PixelRule]]:
        """Compute one rule for each angular range and blur.

        The sum over the ranges is the rule of a blur. Blurs with the residual of the first blur share the rules of that blur.
        """
        common = through.blurs[0].residual
        found: dict[int, list[PixelRule]] = {}
        own_rule = [n for n, blur in enumerate(through.blurs) if not n or common is None or blur.residual is not common]
        for numbers in _by_window(through, own_rule):
            seen_in = windows._replace(half=through.reaches[numbers[0]])
            seen = sphere_range(sphere, seen_in)[0]
            ranges = [seen.scaled(own)] if common is None else seen.parts()
            of_ranges = [rules(through, numbers, WindowArcs.of(sphere, seen_in, one)) for one in ranges]
            found |= {n: list(of_blur) for n, of_blur in zip(numbers, zip(*of_ranges, strict=True), strict=True)}
        return [found[n] if n in found else found[0] for n in range(len(through.blurs))]

    first: list[PixelRule] = []
    by_column: dict[int, list[tuple[np.ndarray, ...]]] = {}
    for through in widths:
        of_blurs = parts(through)
        first = first or of_blurs[0]
        for column, of_ranges in zip(through.columns, of_blurs, strict=True):
            by_column.setdefault(column, []).append(_summed(of_ranges))
    found = [
        tuple(np.sum(arrays, axis=0) for arrays in zip(*by_column[column], strict=True)) for column in sorted(by_column)
    ]
    weights, *moments = zip(*found, strict=True)
    lens = [through for through in widths if through.columns[0] == 0]
    if len(lens) == len(first) == 1 and own == scale and np.array_equal(lens[0].reaches[0], windows.half):
        shown = first[0]  # its circles cover the whole range
    else:
        by = lens[0] if len(lens) == 1 else _standing_for(lens)
        (shown,) = rules(by, [0], WindowArcs.of(sphere, windows._replace(half=lens[-1].reaches[0]), widest))
    theta = onto.nodes(NODES)[0]
    return _Found(theta, list(weights), masking_angles(shown.circles), *(tuple(one) for one in moments))


def _summed(rules: list[PixelRule]) -> tuple[np.ndarray, ...]:
    arrays = zip(*((one.weight, one.moment) for one in rules), strict=True)
    return tuple(np.sum(one, axis=0) for one in arrays if one[0] is not None)


def _standing_for(widths: list[PixelBlurs]) -> PixelBlurs:
    """Build the Gaussian that replaces a blur in the average over azimuths for masking.

    The blur itself has negative weights, so an average could lie outside the range of the averaged values. The transfer
    functions of blur and Gaussian agree where they are one half, unless this Gaussian is too narrow for the azimuths of the
    rule.
    """
    own = [through.blurs[0] for through in widths]
    weights, stds = (np.concatenate([np.asarray(getattr(blur, name)) for blur in own]) for name in ("weights", "stds"))
    std = max(std_of_half(weights, stds), np.max(widths[-1].reaches[0]) / _RESOLVED)
    stand_in = dataclasses.replace(own[0], weights=jnp.ones(1), stds=jnp.array([std]), residual=None)
    return widths[0]._replace(blurs=[stand_in])


def _line_rules(radius: float, pixels: ImagePositions, through: PixelBlurs, scale: Scale) -> list[_Found]:
    blurs, spreads, reaches, *_ = through
    onto = np.max([along for along, _ in reaches], axis=0)
    arms = []
    for arm in ARMS:
        rules = [
            line_rule(jnp.asarray(radius), blur, jnp.asarray(spread[0]), pixels, reach[0], onto, scale, arm)
            for blur, spread, reach in zip(blurs, spreads, reaches, strict=True)
        ]
        theta, cos_psi = np.asarray(rules[0].theta), np.asarray(rules[0].cos_psi)
        arms.append(_Found(theta, [np.asarray(rule.weight) for rule in rules], {"cos_psi": cos_psi[:, :, None]}))
    return arms


def _cylinder_rules(
    view: SampleView, pixels: LinePixels, through: PixelBlurs, scale: Scale, theta_d: np.ndarray | None
) -> list[_Found]:
    """Compute the rules of the two arms of a cylinder where a single row and lamp direction are insufficient.

    theta_d: theta_d of the cells, rad, at which the moments are 0; None: no moments.
    """
    blurs, spreads, reaches, _, lamps, _ = through
    widest = np.max([along for along, _ in reaches], axis=0)
    onto = line_window(view.cylinder, view.lamp, pixels, widest, max(lamps))
    onto = onto._replace(largest_scale=scale.limit(onto.high))
    near = jnp.asarray(view.lamp) if view.lamp else None
    arms = []
    for arm in ARMS:
        rules = [
            cylinder_rule(
                view.cylinder,
                blur,
                jnp.asarray(spread[0]),
                pixels,
                near,
                reach[0],
                jnp.asarray(disc),
                onto,
                scale,
                arm,
                any(lamps),
                theta_d,
            )
            for blur, spread, reach, disc in zip(blurs, spreads, reaches, lamps, strict=True)
        ]
        weights, circles, moments = zip(*jax.device_get(rules), strict=True)
        angles = masking_angles(circles[0])
        arms.append(_Found(onto.nodes(NODES)[0], weights, angles, () if theta_d is None else moments))
    return arms


def _pixel_nodes(blurs: list[Blur], n: int) -> int:
    """Choose the number of nodes over a rotated pixel for the n-th blur. A sharper lens requires more nodes."""
    if not blurs[n].varies or not blurs[n].stds.size:
        return 1
    sharpest = min(float(np.min(np.asarray(blur.stds))) for blur in blurs)
    ratio = float(blurs[0].pixel.half_width) / max(sharpest, 1e-3)
    return next(n for most, n in _PIXEL_NODES if ratio <= most)


MOMENT_ALONG = "moment_along"
"""Prefix of the names of the changes of the moments along each axis. The index of the axis follows."""
_SURROUNDINGS = np.array([9.0, 45.0])
"""Largest support radii of the terms that form the core of a lens and its surroundings, px."""
_RESOLVED = 10
"""Ratio of the support radius of a blur to the smallest standard deviation that the azimuths of a rule resolve."""
_PIXEL_NODES = ((1.7, 5), (5.0, 10), (np.inf, 20))
"""Pairs (largest ratio of pixel half width to lens standard deviation, nodes). There are three, because each number of nodes
requires a compiled program.
"""
