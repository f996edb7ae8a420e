"""Where the dots of a grid lie in a picture, and how large a dot should be there: the lattice that they form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from matcam.calibration.photograph.region import local_mean
from matcam.core.errors import FitError
from matcam.core.jax import FloatArray

FEWEST = 9
_CLEAR = 6.0  # standard deviations of the smoothed background
_ALIKE = (0.3, 3.0)  # of the usual flux: dots are all of one kind
_OFF = 0.25  # of the pitch: how far a dot may lie from where its neighbour expects it


class Lattice(NamedTuple):
    """Dots in a picture and their places on the page, in any unit."""

    x: FloatArray
    y: FloatArray
    """(n,) px."""
    u: FloatArray
    v: FloatArray
    """(n,) on the page, in pitches, or mm if a chart says so."""


def find_dots(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) x and y, px, of the dots in a region (height, width); NaN where there are no data. FitError if there are not 9."""
    smooth = local_mean(values, 0.8 if np.isfinite(values).mean() > 0.9 else 1.3)
    # most pixels are background, which changes slowly
    ground = ndimage.gaussian_filter(ndimage.median_filter(smooth[::2, ::2], 15), 2)
    ground = ndimage.zoom(ground, 2, order=1)[: values.shape[0], : values.shape[1]]
    ground = np.pad(ground, [(0, n - m) for n, m in zip(values.shape, ground.shape, strict=True)], mode="edge")
    off = smooth - ground
    spread = 1.4826 * np.median(np.abs(off - np.median(off)))
    sign = -1.0 if np.quantile(off, 0.001) < -np.quantile(off, 0.999) else 1.0
    label, count = ndimage.label(sign * off > max(_CLEAR * spread, 0.25 * float(np.quantile(sign * off, 0.999))))
    if count < FEWEST:
        raise FitError(f"region holds no grid of dots: {count} spots in it, {FEWEST} are needed")
    every = np.arange(1, count + 1)
    flux = ndimage.sum_labels(sign * off, label, every)
    y, x = np.array(ndimage.center_of_mass(np.maximum(sign * off, 0), label, every)).T
    usual = np.median(flux)
    whole = (flux > _ALIKE[0] * usual) & (flux < _ALIKE[1] * usual)
    if whole.sum() < FEWEST:
        raise FitError("region holds no grid of dots: its spots are not alike")
    return x[whole], y[whole]


def lattice_of(x: FloatArray, y: FloatArray) -> Lattice:
    """The square lattice, seen in perspective, that dots lie on: those that belong to it, counted in pitches."""
    points = np.stack([x, y], axis=-1)
    tree = cKDTree(points)
    neighbour = tree.query(points, k=min(5, len(points)))[1]
    # in the middle a dot has four neighbours at right angles, nearly
    central = int(np.argmin(np.hypot(*(points - np.median(points, axis=0)).T)))
    first = points[neighbour[central, 1]] - points[central]
    steps = points[neighbour[central, 1:]] - points[central]
    across = np.abs(steps @ np.array([-first[1], first[0]])) / (np.hypot(*steps.T) * np.hypot(*first))
    second = steps[int(np.argmax(across))]
    if np.abs(across).max() < 0.7 or not 0.5 < np.hypot(*second) / np.hypot(*first) < 2:
        raise FitError("the spots in the region do not form a square grid")
    place: dict[int, tuple[int, int]] = {central: (0, 0)}
    basis: dict[int, FloatArray] = {central: np.stack([first, second])}
    queue = [central]
    while queue:
        at = queue.pop(0)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = sign * basis[at][axis]
            off, other = tree.query(points[at] + step)
            if off > _OFF * np.hypot(*step) or int(other) in place:
                continue
            where = list(place[at])
            where[axis] += sign
            place[int(other)] = (where[0], where[1])
            # a pinhole's lattice changes slowly: each dot hands on what it has learnt
            moved = basis[at].copy()
            moved[axis] = 0.7 * moved[axis] + 0.3 * sign * (points[other] - points[at])
            basis[int(other)] = moved
            queue.append(int(other))
    index = np.array(sorted(place))
    where_all = np.array([place[i] for i in index], dtype=float)
    if len(index) < FEWEST or len({tuple(w) for w in where_all}) != len(index):
        raise FitError(f"the spots in the region do not form a square grid: {len(index)} of {len(points)} fit into one")
    return Lattice(x[index], y[index], where_all[:, 0], where_all[:, 1])


def shapes_of(lattice: Lattice) -> FloatArray:
    """(n, 2, 2): px by page units at every dot, from a smooth map through all of them."""
    powers, by_u, by_v = _powers(lattice)
    maps = np.linalg.lstsq(powers, np.stack([lattice.x, lattice.y], axis=-1), rcond=None)[0]
    return np.stack([by_u @ maps, by_v @ maps], axis=-1)


def _powers(lattice: Lattice) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Polynomials of the page's coordinates, and their derivatives."""
    size = max(float(np.ptp(lattice.u)), float(np.ptp(lattice.v)), 1e-9) / 2
    u, v = (lattice.u - lattice.u.mean()) / size, (lattice.v - lattice.v.mean()) / size
    degree = 4 if len(u) >= 60 else 3 if len(u) >= 30 else 2 if len(u) >= 15 else 1
    orders = [(n - j, j) for n in range(degree + 1) for j in range(n + 1)]
    zero = np.zeros_like(u)
    return (
        np.stack([u**i * v**j for i, j in orders], axis=-1),
        np.stack([i * u ** (i - 1) * v**j / size if i else zero for i, j in orders], axis=-1),
        np.stack([j * u**i * v ** (j - 1) / size if j else zero for i, j in orders], axis=-1),
    )
