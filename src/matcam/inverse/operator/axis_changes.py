"""Changes of a rule along the axes of a rig: the blurs that an axis needs, and the differences of their weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from matcam.forward.integral.blur import Blur, blur_of
from matcam.inverse.operator.rig_axes import SHAPE, SHAPE_SHARE, SHAPE_SPREAD, STRETCH, STRETCH_SPREAD, Axis, rig_with
from matcam.rigs import Rig


def blurs_along(rig: Rig, own: Blur, axis: Axis) -> list[Blur]:
    """Return the blurs whose rules an axis needs. own: that of the rig."""
    if axis.name == STRETCH:
        return [own, own]
    if axis.name == SHAPE:
        scales = (1 + SHAPE_SPREAD, 1 - SHAPE_SPREAD)
        return [dataclasses.replace(own, stds=own.stds * np.sqrt(scale)) for scale in scales]
    moved = (rig_with(rig, {axis.name: axis.value(point)}) for point in axis.points if point)
    # rings that come and go with a lens's numbers are small of the small
    rest = own.rest if own.rest is not None and own.rest.even else None
    return [blur_of(one, in_discs=True, whole=own.rest is not None, rest=rest) for one in moved]


def stretches(own: Blur, axes: list[Axis]) -> np.ndarray:
    """Return what stretches the rig's own blur and each of `blurs_along`, (blurs, 2), px^2. axes: of the latter."""
    added = np.zeros((1 + len(axes), 2))
    stretched = [n for n, axis in enumerate(axes, start=1) if axis.name == STRETCH]
    added[stretched] = np.diag([STRETCH_SPREAD * own.std_of_half**2] * 2)[: len(stretched)]
    return added


def along_axes(axes: tuple[Axis, ...], name: str, along: str, values: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the rig's own values by name, and by how much they differ at every point of every axis."""
    own, *others = values
    named = {name: own}
    for n, changes in enumerate(_changes_along(axes, own, others)):
        named |= {f"{along}{n}.{point}": change for point, change in enumerate(changes)}
    return named


def _changes_along(axes: tuple[Axis, ...], weight: np.ndarray, others: list[np.ndarray]) -> list[list[np.ndarray]]:
    """Return by how much the weights differ at every point of every axis. others: weights of `blurs_along`, in order."""
    changes = (other - weight for other in others)
    along = []
    for axis in axes:
        if axis.name == SHAPE:
            along.append([0 * weight, SHAPE_SHARE * (next(changes) + next(changes))])
        elif axis.name == STRETCH:
            along.append([0 * weight, (next(changes) - next(changes)) / (2 * STRETCH_SPREAD)])
        else:
            along.append([next(changes) if point else 0 * weight for point in axis.points])
    return along
