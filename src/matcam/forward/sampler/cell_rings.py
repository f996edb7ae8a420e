"""Rings of cells around a highlight. The records of the cells are interpolated between fewer positions.

A record is a smooth function of the position on the sensor, also across limb and terminator, because the kernel limits its
frequencies. The cells of one theta_h lie on a ring about the highlight. A ring close to the highlight has many more cells
than the kernel resolves, so a trigonometric polynomial through few positions yields the values of all cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import AnyArray

_LEAST = 10
"""Smallest number of positions on half a ring."""
_HIGHEST = 0.65
"""Highest frequency of an interpolated record, in periods per standard deviation of the lens. A Gaussian lens attenuates this
frequency to 2e-4, and the pixel attenuates it further.
"""
_SAVED = 0.75
"""Largest ratio of positions to cells for which a ring is interpolated."""
_COUNTS = (12, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
"""Available numbers of positions on half a ring."""


class Rings(NamedTuple):
    """Rings with the same number of positions.

    Attributes:
        cells: indices of the cells on all rings in the flattened arrays of a table.
        first: index of the first position of these rings among the positions of all rings.
        matrix: weights of the positions of a ring in the values of its cells, (cells of one ring, positions).
    """

    cells: np.ndarray
    first: int
    matrix: np.ndarray

    def interpolated(self, radiance: AnyArray) -> AnyArray:
        """Compute the radiance at the cells, (cells, channels), 1/sr.

        radiance: radiance at the positions of all rings, (positions, channels), 1/sr.
        """
        rings = self.cells.size // self.matrix.shape[0]
        count = self.matrix.shape[1]
        own = radiance[self.first : self.first + rings * count].reshape(rings, count, -1)
        return (self.matrix @ own).reshape(self.cells.size, -1)


def rings_of(
    theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray, seen: np.ndarray, per_radian: float, mirrored: bool
) -> tuple[tuple[Rings, ...], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Find the rings of a table that are interpolated.

    Args:
        theta_h: half angles of the points of all cells, (theta_d, theta_h, phi_d, point, point), rad.
        theta_d: difference angles, of the same shape, rad.
        phi_d: azimuths of the difference vector, of the same shape, rad.
        seen: True for points with a position on the sensor, of the same shape.
        per_radian: shift of the image per rotation of the normal, in standard deviations of the lens per rad. 0: the
            shift is unknown, and no ring is interpolated.
        mirrored: True if phi_d covers half a turn, and a record is an even function of phi_d.

    Returns:
        The rings; and theta_h, theta_d and phi_d of their positions, rad.
    """
    index = np.arange(theta_h.size).reshape(theta_h.shape)
    # one row for each ring: the points along phi_d are on axes 2 and 4
    rows, angles_h, angles_d, whole = (
        np.moveaxis(a, 3, 2).reshape(-1, a.shape[2] * a.shape[4]) for a in (index, theta_h, theta_d, seen)
    )
    azimuths = phi_d[0, 0, :, 0].ravel()
    needed = _LEAST + 2 * np.pi * _HIGHEST * per_radian * np.sin(angles_h[:, 0])
    level = np.searchsorted(_COUNTS, needed)
    rings: list[Rings] = []
    positions: list[tuple[np.ndarray, ...]] = [(np.zeros(0),) * 3]
    first = 0
    for number, half in enumerate(_COUNTS):
        count = half if mirrored else 2 * half
        chosen = np.flatnonzero((level == number) & whole.all(axis=1))
        if not per_radian or not chosen.size or count > _SAVED * azimuths.size:
            continue
        own = np.pi * (np.arange(count) + 0.5) / half
        order = np.arange(half)
        factor = np.where(order == 0, 1.0, 2.0) / count
        matrix = np.cos(azimuths[:, None] * order) * factor @ np.cos(own[:, None] * order).T
        if not mirrored:
            matrix += np.sin(azimuths[:, None] * order) * factor @ np.sin(own[:, None] * order).T
        rings.append(Rings(rows[chosen].ravel(), first, matrix))
        repeated = [np.repeat(a[chosen, 0], count) for a in (angles_h, angles_d)]
        positions.append((*repeated, np.tile(own, chosen.size)))
        first += chosen.size * count
    return tuple(rings), tuple(np.concatenate(parts) for parts in zip(*positions, strict=True))  # type: ignore[return-value]
