"""The dots of a grid: found in a region, assigned to a lattice, and fitted one by one.

A dot is disc x Gaussian x square pixel. Its size comes from the lattice. The pixel values are a quadrature over the
disc: a Gaussian and a square are separable, so a node of the disc is a product of two erf differences. Derivatives by
the position are those of the Gaussian, by the variance half the second ones. All of them come from one table of the
derivatives along x and y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtr

from matcam.calibration.photograph.linear_image import smoothed
from matcam.calibration.targets.wave_fit import noise_from_residuals
from matcam.core.arrays import FloatArray
from matcam.core.errors import FitError
from matcam.numerics.linalg import scaled_inverse
from matcam.numerics.normal import robust_std
from matcam.numerics.polynomials import plane_fit

FEWEST = 9
SHARED = [(2, 0), (0, 2), (4, 0), (2, 2), (0, 4)]
"""Derivatives by (x, y) for the common deviation of the dots of a zone from disc x Gaussian x square."""

_CLEAR = 6.0  # standard deviations of the smoothed background
_SIMILAR_FLUX = (0.3, 3.0)  # relative to the median flux: dots are all of one kind
_OFF = 0.25  # relative to the pitch: largest distance of a dot from the position that its neighbour predicts
_OWN = [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2)]
_START = 0.6  # px
_RANGE = (0.15, 6.0)  # px of sigma
_STEPS, _WEIGHTED = 16, 4  # Gauss-Newton steps; step from which the weights are those of the noise
_SETTLED = 0.01  # standard deviations
_LARGEST_HALF_SIZE = 7  # px, largest size of a stamp
_CLOSEST = 6.0  # px between dots
_OUTLIER, _SAME = (
    5.0,
    0.02,
)  # standard deviations, and relative difference of sigma^2 below which a dot is not an outlier
_AT_ONCE = 512  # number of dots whose tables fit into memory, for any grid


def _disc_nodes(radii: int = 5, turns: int = 14) -> tuple[FloatArray, FloatArray]:
    """Return positions (2, n) and weights (n,) of a quadrature over the unit disc: Gauss's on rings, which alternate."""
    nodes, weights = np.polynomial.legendre.leggauss(radii)
    turn = 2 * np.pi * (np.arange(turns) + 0.5 * (np.arange(radii)[:, None] % 2)) / turns
    places = np.sqrt((nodes + 1) / 2)[:, None] * np.stack([np.cos(turn), np.sin(turn)])
    return places.reshape(2, -1), np.repeat(weights / 2 / turns, turns)


_DISC, _SHARE = _disc_nodes()


class DotLattice(NamedTuple):
    """Positions of n dots, in an image and printed.

    Attributes:
        x: (n,) px.
        y: (n,) px.
        u: (n,) position on the page, in pitches, or in mm if a chart says so.
        v: (n,).
    """

    x: FloatArray
    y: FloatArray
    u: FloatArray
    v: FloatArray

    def subset(self, mask: np.ndarray) -> DotLattice:
        """Return some of the dots."""
        return DotLattice(*(column[mask] for column in self))

    @property
    def pitch(self) -> float:
        """Return the median distance to the nearest neighbour, px."""
        points = np.stack([self.x, self.y], axis=-1)
        return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))

    @property
    def shapes(self) -> FloatArray:
        """Return px per page unit at every dot, (n, 2, 2).

        They are derivatives of a smooth map through all dots.
        """
        size = max(float(np.ptp(self.u)), float(np.ptp(self.v)), 1e-9) / 2
        u, v = (self.u - self.u.mean()) / size, (self.v - self.v.mean()) / size
        degree = 4 if len(u) >= 60 else 3 if len(u) >= 30 else 2 if len(u) >= 15 else 1
        maps = plane_fit(u, v, np.stack([self.x, self.y], axis=-1), degree)
        slopes = [polyval2d(u, v, polyder(maps, axis=axis)) / size for axis in (0, 1)]
        return np.asarray(np.stack(slopes).transpose(2, 1, 0))


@dataclass(frozen=True, eq=False)
class DotFit:
    """Fits of n dots, and their last derivatives.

    Attributes:
        lattice: where the dots were thought to be.
        parameters: (n, 7) ground, its slopes, content, x, y, sigma^2.
        std: (n, 7) standard deviations of `parameters`.
        design: (n, pixels, 7) derivatives by `parameters`.
        shared: (n, pixels, 5) derivatives times contents, in what the dots of a zone have in common.
        residual: (n, pixels).
        weight: (n, pixels) inverse variances.
        radius: mean of the dots' radii as they should be in the image, px.
        gain: variance of a pixel over its value.
        read_variance: variance of a dark pixel.
    """

    lattice: DotLattice
    parameters: FloatArray
    std: FloatArray
    design: FloatArray
    shared: FloatArray
    residual: FloatArray
    weight: FloatArray
    radius: float
    gain: float
    read_variance: float

    def subset(self, mask: np.ndarray) -> DotFit:
        """Return some of the dots."""
        arrays = {
            name: getattr(self, name)[mask] for name in ("parameters", "std", "design", "shared", "residual", "weight")
        }
        return replace(self, lattice=self.lattice.subset(mask), **arrays)


def fit_dots(values: FloatArray, lattice: DotLattice, size: float, half_width: float) -> DotFit:
    """Fit every dot of a lattice in a region.

    values: (height, width), NaN where there are no data.
    size: radius of the dots in the lattice's own units. half_width: of the pixel, px. FitError if there are too few dots that
    can be measured.
    """
    shape, pitch = size * lattice.shapes, lattice.pitch
    half_size = int(min(_LARGEST_HALF_SIZE, max(3, np.floor(pitch / 2 - 0.5))))
    if pitch < _CLOSEST:
        raise FitError(f"the dots are {pitch:.1f} px apart: at least {_CLOSEST:g} are needed to separate them")
    columns, rows = (
        np.round(c).astype(int)[:, None] + np.arange(-half_size, half_size + 1) for c in (lattice.x, lattice.y)
    )
    whole = (np.minimum(columns[:, 0], rows[:, 0]) >= 0) & (columns[:, -1] < values.shape[1])
    whole &= rows[:, -1] < values.shape[0]
    if whole.sum() < FEWEST:
        raise FitError(f"{whole.sum()} whole dots are too few: {FEWEST} are needed")
    lattice, shape, columns, rows = lattice.subset(whole), shape[whole], columns[whole], rows[whole]
    value = values[rows[:, :, None], columns[:, None, :]]
    # from the position of a dot in the lattice to its pixels
    du, dv = (
        np.broadcast_to(off, value.shape).reshape(len(value), -1)
        for off in ((columns - lattice.x[:, None])[:, None, :], (rows - lattice.y[:, None])[:, :, None])
    )
    value = value.reshape(du.shape)
    known, ground = np.isfinite(value), np.nanmedian(value, axis=1)
    value = np.where(known, value, 0.0)
    # in a mosaic only a part of the sites of a dot are measured
    content = (known * (value - ground[:, None])).sum(1) / np.maximum(known.mean(1), 0.05)
    state = np.column_stack(
        [ground, 0 * ground, 0 * ground, content, lattice.x, lattice.y, np.full(len(ground), _START**2)]
    )
    mean_radius = float(np.sqrt(np.abs(np.linalg.det(shape))).mean())
    gain, read, weight = 0.0, 1.0, known.astype(float)
    bow, change = np.zeros_like(du), np.zeros_like(state)
    for step in range(_STEPS):
        state = state + change
        state[:, 6] = np.clip(state[:, 6], _RANGE[0] ** 2, _RANGE[1] ** 2)
        if step == _WEIGHTED:
            bow = _bow(lattice, state[:, 0], du, dv)
            # the fitted positions determine the lattice, and the sizes of the dots, more accurately than the first ones
            shape = size * lattice._replace(x=state[:, 4], y=state[:, 5]).shapes
        u, v = columns - state[:, 4:5], rows - state[:, 5:6]
        table = dot_derivatives(u, v, shape, np.sqrt(state[:, 6]), half_width, _OWN)
        flat = table.reshape(len(table), len(state), -1)
        c = state[:, 3, None]
        model = state[:, :1] + state[:, 1:2] * du + state[:, 2:3] * dv + bow + c * flat[0]
        design = np.stack(
            [np.ones_like(du), du, dv, flat[0], -c * flat[1], -c * flat[2], c * (flat[3] + flat[4]) / 2], axis=-1
        )
        residual = np.where(known, value - model, 0.0)
        if step > _WEIGHTED:
            # the fitted parameters have absorbed their share of the noise
            found = noise_from_residuals(residual[known], model[known])
            gain, read = (k * known.sum() / (known.sum() - state.size) for k in found)
            weight = known / (gain * np.maximum(model, 0) + read)
        across = design.transpose(0, 2, 1)
        inverse = scaled_inverse((across * weight[:, None]) @ design)
        change = (inverse @ (across @ (weight * residual)[..., None]))[..., 0]
        change[:, 4:6] = np.clip(change[:, 4:6], -0.7, 0.7)
        change[:, 6] = np.clip(change[:, 6], -0.5 * state[:, 6], state[:, 6])
        std = np.sqrt(np.einsum("nii->ni", inverse))
        if step > _WEIGHTED + 2 and (np.abs(change[:, 6]) < _SETTLED * std[:, 6]).mean() > 0.98:
            break
    if not np.isfinite(state).all():
        raise FitError("the dots' pixels do not determine their blur: give a sharper or larger image of the grid")
    # the common deviation of the dots needs higher derivatives, but only once
    flat = dot_derivatives(u, v, shape, np.sqrt(state[:, 6]), half_width, SHARED).reshape(len(SHARED), len(state), -1)
    shared = state[:, 3, None, None] * flat.transpose(1, 2, 0)
    fit = DotFit(lattice, state, std, design, shared, residual, weight, mean_radius, gain, read)
    return _without_outliers(fit)


def find_dots(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x and y (n,) of the dots in a region, px.

    values: (height, width), NaN where there are no data. FitError if there are not 9 dots.
    """
    smooth = smoothed(values)
    # most pixels are background, which changes slowly
    ground = ndimage.gaussian_filter(ndimage.median_filter(smooth[::2, ::2], 15), 2)
    off = smooth - ground.repeat(2, 0).repeat(2, 1)[: values.shape[0], : values.shape[1]]
    spread = robust_std(off - np.median(off))
    sign = -1.0 if np.quantile(off, 0.001) < -np.quantile(off, 0.999) else 1.0
    label, count = ndimage.label(sign * off > max(_CLEAR * spread, 0.25 * float(np.quantile(sign * off, 0.999))))
    if count < FEWEST:
        raise FitError(f"region contains no grid of dots: {count} spots in it, {FEWEST} are needed")
    every = np.arange(1, count + 1)
    flux = ndimage.sum_labels(sign * off, label, every)
    y, x = np.array(ndimage.center_of_mass(np.maximum(sign * off, 0), label, every)).T
    usual = np.median(flux)
    whole = (flux > _SIMILAR_FLUX[0] * usual) & (flux < _SIMILAR_FLUX[1] * usual)
    if whole.sum() < FEWEST:
        raise FitError("region contains no grid of dots: its spots are not similar")
    return x[whole], y[whole]


def square_lattice(x: FloatArray, y: FloatArray) -> DotLattice:
    """Return the dots that lie on a lattice, counted in pitches.

    The lattice is square, and seen in perspective. FitError if there is none.
    """
    points = np.stack([x, y], axis=-1)
    tree = cKDTree(points)
    neighbour = tree.query(points, k=min(5, len(points)))[1]
    # a dot in the centre has four neighbours nearly at right angles
    central = int(np.argmin(np.hypot(*(points - np.median(points, axis=0)).T)))
    first = points[neighbour[central, 1]] - points[central]
    steps = points[neighbour[central, 1:]] - points[central]
    across = np.abs(steps @ np.array([-first[1], first[0]])) / (np.hypot(*steps.T) * np.hypot(*first))
    second = steps[int(np.argmax(across))]
    if np.abs(across).max() < 0.7 or not 0.5 < np.hypot(*second) / np.hypot(*first) < 2:
        raise FitError("the spots in the region do not form a square grid: give a region of dots alone")
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
            # the lattice in a perspective view changes slowly: each dot passes its basis on to its neighbours
            moved = basis[at].copy()
            moved[axis] = 0.7 * moved[axis] + 0.3 * sign * (points[other] - points[at])
            basis[int(other)] = moved
            queue.append(int(other))
    index = np.array(sorted(place))
    where_all = np.array([place[i] for i in index], dtype=float)
    if len(index) < FEWEST or len({tuple(w) for w in where_all}) != len(index):
        raise FitError(f"the spots in the region do not form a square grid: {len(index)} of {len(points)} fit into one")
    return DotLattice(x[index], y[index], where_all[:, 0], where_all[:, 1])


def dot_derivatives(
    x: FloatArray, y: FloatArray, shape: FloatArray, sigma: FloatArray, half_width: float, orders: list[tuple[int, int]]
) -> FloatArray:
    """Return the derivatives by (x, y) of the pixel values of dots.

    There are n dots of unit content; the result is (orders, n, height, width).
    x, y: (n, width) and (n, height) px from the dots' centres to the pixels'. shape: (n, 2, 2) px, from the unit disc to the
    dot. sigma: (n,) px. half_width: px. orders: of the derivatives.
    """
    if len(x) > _AT_ONCE:
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(x), _AT_ONCE)]
        return np.concatenate(
            [dot_derivatives(x[p], y[p], shape[p], sigma[p], half_width, orders) for p in parts], axis=1
        )
    offset = np.einsum("nij,jk->nik", shape, _DISC)
    along = [_axis(g[:, :, None] - o[:, None, :], sigma, half_width, max(w)) for g, o, w in (
        (x, offset[:, 0], [i for i, _ in orders]), (y, offset[:, 1], [j for _, j in orders]),
    )]  # fmt: skip
    return np.stack([np.matmul(along[1][j] * _SHARE, along[0][i].transpose(0, 2, 1)) for i, j in orders])


def _axis(t: FloatArray, sigma: FloatArray, half_width: float, highest: int) -> list[FloatArray]:
    """Return the one-dimensional kernel, Gaussian times box, and its derivatives.

    t: (n, pixels, nodes) px.
    """
    s = sigma[:, None, None]
    ends = [(t + half_width) / s, (t - half_width) / s]
    table = [(ndtr(ends[0]) - ndtr(ends[1])) / (2 * half_width)]
    if highest:
        bell = [np.exp(-z * z / 2) / np.sqrt(2 * np.pi) for z in ends]
        # d^k/dz^k of the normal density is (-1)^k He_k(z) times the density
        hermite = [lambda z: 1.0, lambda z: -z, lambda z: z * z - 1, lambda z: -(z * z * z) + 3 * z]
        for k in range(highest):
            table.append(
                (hermite[k](ends[0]) * bell[0] - hermite[k](ends[1]) * bell[1]) / (2 * half_width * s ** (k + 1))
            )
    return table


def _bow(lattice: DotLattice, ground: FloatArray, du: FloatArray, dv: FloatArray) -> FloatArray:
    """Return the deviation of the background of every dot from its tangent plane.

    It is estimated from all dots together, as vignetting. For a single dot the curvature of the background could not be
    separated from the wings of the blur.
    """
    scale = max(float(np.ptp(lattice.x)), float(np.ptp(lattice.y))) / 2
    x, y = (lattice.x - lattice.x.mean()) / scale, (lattice.y - lattice.y.mean()) / scale
    du, dv = du / scale, dv / scale
    light = plane_fit(x, y, ground, 4 if len(x) >= 60 else 2 if len(x) >= 15 else 0)
    by_x, by_y = (polyval2d(x, y, polyder(light, axis=axis)) for axis in (0, 1))
    tangent = polyval2d(x, y, light)[:, None] + by_x[:, None] * du + by_y[:, None] * dv
    return np.asarray(polyval2d(x[:, None] + du, y[:, None] + dv, light) - tangent)


def _without_outliers(fit: DotFit) -> DotFit:
    """Return the dots that were found and are similar to the others."""
    square, std = fit.parameters[:, 6], fit.std[:, 6]
    content = fit.parameters[:, 3]
    centre = np.median(square)
    spread = np.sqrt(std**2 + robust_std(square - centre) ** 2 + (_SAME * centre) ** 2)
    moved = np.hypot(fit.parameters[:, 4] - fit.lattice.x, fit.parameters[:, 5] - fit.lattice.y)
    good = (
        (np.abs(square - centre) < _OUTLIER * spread) & (np.abs(content / np.median(content) - 1) < 0.5) & (moved < 2)
    )
    good &= np.isfinite(std) & (square > 1.01 * _RANGE[0] ** 2) & (np.abs(content) > _OUTLIER * fit.std[:, 3])
    if good.sum() < FEWEST:
        raise FitError(f"{good.sum()} of {len(good)} dots can be measured: {FEWEST} are needed")
    return fit.subset(good)
