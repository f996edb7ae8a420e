"""Blurs for which quadrature rules are computed: at points of the axes of a rig, and for changes of its lens."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jnp
from matcam.forward.integral.blur import Blur, blur_of
from matcam.inverse.rig.lens_changes import CHANGES, VARIANCES
from matcam.inverse.rig.rig_axes import LENS, Axis, lens_coordinate, rig_with
from matcam.rigs import Rig


class MovedBlur(NamedTuple):
    """Blur at one point of an axis.

    Attributes:
        blur: the blur.
        rough: True if, in all pixels, a source disc is replaced by a Gaussian with the variance of the disc. Default: False.
        stretch: variances that are added to the blur along the plane of camera and lamp and across it, px^2. Default: 0.
    """

    blur: Blur
    rough: bool = False
    stretch: tuple[float, float] = (0.0, 0.0)


class RigBlurs(NamedTuple):
    """Blurs for which rules are computed: of the rig itself, along its axes, and for changes of its lens.

    Attributes:
        axes: parameters of the rig that may change.
        along: the blur of the rig, and the blurs at the points of the axes that are not changes of the lens. For a Gaussian
            lens it also contains the isotropic Gaussians for changes of the lens, because one program evaluates them all.
        changes: other Gaussians for changes of the lens.
        columns: index of each Gaussian for changes of the lens among all blurs. The key is a pair of variances, along the plane
            of camera and lamp and across it, relative to the variance of the lens.
    """

    axes: tuple[Axis, ...]
    along: list[MovedBlur]
    changes: list[MovedBlur]
    columns: Mapping[tuple[float, float], int]

    @classmethod
    def of(cls, rig: Rig, own: Blur, axes: tuple[Axis, ...]) -> RigBlurs:
        """Compute the blurs of a rig.

        own: blur of the rig without changes.
        """
        # the dependence of the residual on lens parameters is second order and is neglected
        residual = own.residual if own.residual is not None and own.residual.even else None
        whole = own.residual is not None
        gaussian = own.residual is None and own.stds.size == 1
        along, columns = [MovedBlur(own)], {(1.0, 1.0): 0} if gaussian else {}
        for axis in axes:
            if axis.name in CHANGES:
                continue
            variances = (
                {lens_coordinate(own, variance): variance for variance in VARIANCES} if axis.name == LENS else {}
            )
            for point in filter(None, axis.points):
                if point in variances:
                    columns[variances[point], variances[point]] = len(along)
                blur = blur_of(
                    rig_with(rig, {axis.name: axis.value(point)}), in_discs=True, whole=whole, residual=residual
                )
                along.append(MovedBlur(blur, axis.by_variance))
        changed = (CHANGES[axis.name] for axis in axes if axis.name in CHANGES)
        wanted = {(x, y) for change in changed for terms in change.points.values() for x, y, _ in terms}
        missing = sorted(wanted - columns.keys(), key=lambda pair: (pair[0] != pair[1], pair))
        columns |= {pair: len(along) + n for n, pair in enumerate(missing)}
        changes = [_changed(own, *pair) for pair in missing]
        shared = sum(not any(one.stretch) for one in changes) if gaussian else 0
        return cls(axes, along + changes[:shared], changes[shared:], columns)

    def differences(self, name: str, along: str, values: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Compute the differences between values at the points of all axes and the values of the rig.

        The result contains the values of the rig and the differences by name.

        Args:
            name: name of the values.
            along: prefix of the names of the differences.
            values: values of each blur.
        """
        own, moved = values[0], iter(values[1:])
        named = {name: own}
        for n, axis in enumerate(self.axes):
            change = CHANGES.get(axis.name)
            for number, point in enumerate(axis.points):
                if not point:
                    difference = 0 * own
                elif change:
                    terms = change.points[point]
                    difference = np.add.reduce([share * values[self.columns[x, y]] for x, y, share in terms])
                else:
                    difference = next(moved) - own
                named[f"{along}{n}.{number}"] = difference
        return named


def _changed(own: Blur, along: float, across: float) -> MovedBlur:
    """Build a Gaussian for changes of the lens from `own`, the blur of the rig.

    `along` and `across` are the variances of the Gaussian along the plane of camera and lamp and across it, relative to the
    variance of the lens.
    """
    variance, least = own.std_of_half**2, min(along, across)
    one = dataclasses.replace(own, weights=jnp.ones(1), stds=jnp.full(1, np.sqrt(least * variance)), residual=None)
    return MovedBlur(one, stretch=((along - least) * variance, (across - least) * variance))
