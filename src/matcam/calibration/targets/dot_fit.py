"""What pixels read of a round dot: disc, Gaussian and square pixel, by quadrature over the disc; and its derivatives.

A Gaussian and a square are separable, so a node of the disc is a product of two erf differences. Derivatives by the place are
those of the Gaussian; by the variance, half the second ones. All of them come from one table of the derivatives along x and y.

The fit of single dots: disc x Gaussian x square pixel, all dots of a picture side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr

from matcam.calibration.targets import dot_lattice
from matcam.calibration.targets.dot_lattice import FEWEST, Lattice
from matcam.calibration.targets.wave_fit import noise_of
from matcam.core.errors import FitError
from matcam.core.jax import FloatArray
from matcam.numerics.linalg import scaled_inverse

_RADIAL, _ROUND = 5, 14
_AT_ONCE = 512  # dots: their tables fit into memory, whatever the grid
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_RADIAL)
_TURN = 2 * np.pi * (np.arange(_ROUND)[None] + 0.5 * (np.arange(_RADIAL)[:, None] % 2)) / _ROUND
_RADIUS = np.sqrt((_NODES + 1) / 2)[:, None]
_DISC = np.stack([(_RADIUS * np.cos(_TURN)).ravel(), (_RADIUS * np.sin(_TURN)).ravel()])
_SHARE = np.repeat(_WEIGHTS / 2 / _ROUND, _ROUND)


def derivatives(
    x: FloatArray, y: FloatArray, shape: FloatArray, sigma: FloatArray, half_width: float, orders: list[tuple[int, int]]
) -> FloatArray:
    """(orders, n, height, width): derivatives by (x, y), of the given orders, of what pixels read of dots of unit content.

    x, y: (n, width), (n, height) px from the dots' centres to the pixels'. shape: (n, 2, 2) px: takes the unit disc to the
    dot. sigma: (n,) px.
    """
    if len(x) > _AT_ONCE:
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(x), _AT_ONCE)]
        return np.concatenate([derivatives(x[p], y[p], shape[p], sigma[p], half_width, orders) for p in parts], axis=1)
    offset = np.einsum("nij,jk->nik", shape, _DISC)
    along = [_axis(g[:, :, None] - o[:, None, :], sigma, half_width, max(w)) for g, o, w in (
        (x, offset[:, 0], [i for i, _ in orders]), (y, offset[:, 1], [j for _, j in orders]),
    )]  # fmt: skip
    return np.stack([np.matmul(along[1][j] * _SHARE, along[0][i].transpose(0, 2, 1)) for i, j in orders])


def _axis(t: FloatArray, sigma: FloatArray, half_width: float, highest: int) -> list[FloatArray]:
    """The one-dimensional kernel, Gaussian times box, at t px (n, pixels, nodes), and its derivatives."""
    s = sigma[:, None, None]
    ends = [(t + half_width) / s, (t - half_width) / s]
    table = [(ndtr(ends[0]) - ndtr(ends[1])) / (2 * half_width)]
    if highest:
        bell = [np.exp(-z * z / 2) / np.sqrt(2 * np.pi) for z in ends]
        # d^k/dz^k of the normal density: (-1)^k He_k(z) times it
        hermite = [lambda z: 1.0, lambda z: -z, lambda z: z * z - 1, lambda z: -(z * z * z) + 3 * z]
        for k in range(highest):
            table.append(
                (hermite[k](ends[0]) * bell[0] - hermite[k](ends[1]) * bell[1]) / (2 * half_width * s ** (k + 1))
            )
    return table


SHARED = [(2, 0), (0, 2), (4, 0), (2, 2), (0, 4)]
"""Derivatives by (x, y) in which the dots of a zone may differ from disc x Gaussian x square, all in the same way."""
_OWN = [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2)]
_START = 0.6  # px
_RANGE = (0.15, 6.0)  # px of sigma
_STEPS, _WEIGHTED = 16, 4  # Gauss-Newton; from where on weights are those of the noise
_SETTLED = 0.01  # standard deviations
_REACH = 7  # px of a stamp at most
_CLOSEST = 6.0  # px between dots
_OUTLIER, _SAME = 5.0, 0.02  # standard deviations; of sigma^2: by less no dot is another


@dataclass(frozen=True, eq=False)
class DotFit:
    """State of all dots' fits, and what the last step saw."""

    lattice: Lattice
    parameters: FloatArray
    """(n, 7): ground, its slopes, content, x, y, sigma^2."""
    std: FloatArray
    design: FloatArray
    """(n, pixels, 7)"""
    shared: FloatArray
    """(n, pixels, 5) derivatives times contents, of what zones have in common."""
    residual: FloatArray
    weight: FloatArray
    radius: float
    gain: float
    read: float


def fit_dots(values: FloatArray, lattice: Lattice, size: float, half_width: float) -> DotFit:
    """Fit every dot of a lattice in a region (height, width), NaN where there are no data. size: radius of the dots in the
    lattice's own units. FitError where there are too few dots that can be measured."""
    shape = size * dot_lattice.shapes_of(lattice)
    pitch = float(np.median(_nearest(lattice)))
    reach = int(min(_REACH, max(3, np.floor(pitch / 2 - 0.5))))
    if pitch < _CLOSEST:
        raise FitError(
            f"the dots are {pitch:.1f} px apart: at least {_CLOSEST:g} are needed to tell them from one another"
        )
    columns, rows = (np.round(c).astype(int)[:, None] + np.arange(-reach, reach + 1) for c in (lattice.x, lattice.y))
    whole = (
        (columns[:, 0] >= 0) & (columns[:, -1] < values.shape[1]) & (rows[:, 0] >= 0) & (rows[:, -1] < values.shape[0])
    )
    lattice, shape = Lattice(*(a[whole] for a in lattice)), shape[whole]
    columns, rows = columns[whole], rows[whole]
    if len(columns) < FEWEST:
        raise FitError(f"{len(columns)} whole dots are too few: {FEWEST} are needed")
    stamp = values[rows[:, :, None], columns[:, None, :]]
    there = np.isfinite(stamp)
    area = (len(rows), rows.shape[1], columns.shape[1])
    du, dv = (np.broadcast_to(a, area).reshape(len(rows), -1) for a in (
        columns[:, None, :] - lattice.x[:, None, None], rows[:, :, None] - lattice.y[:, None, None],
    ))  # fmt: skip
    stamp, there = stamp.reshape(du.shape), there.reshape(du.shape)
    ground = np.nanmedian(stamp, axis=1)
    stamp = np.where(there, stamp, 0.0)
    # mosaics see a part of a dot's content
    content = (there * (stamp - ground[:, None])).sum(1) / np.maximum(there.mean(1), 0.05)
    state = np.column_stack(
        [ground, 0 * ground, 0 * ground, content, lattice.x, lattice.y, np.full(len(ground), _START**2)]
    )
    mean_radius = float(np.sqrt(np.abs(np.linalg.det(shape))).mean())
    fit: DotFit | None = None
    gain, read, weight = 0.0, 1.0, there.astype(float)
    bow = np.zeros_like(du)
    for step in range(_STEPS):
        if step == _WEIGHTED:
            bow = _bow(lattice, state[:, 0], du, dv)
            # fitted places know the lattice, and with it the dots' sizes, better than those that were found
            shape = size * dot_lattice.shapes_of(Lattice(state[:, 4], state[:, 5], lattice.u, lattice.v))
        u, v = columns - state[:, 4:5], rows - state[:, 5:6]
        table = derivatives(u, v, shape, np.sqrt(state[:, 6]), half_width, [*_OWN, *SHARED[2:]])
        flat = table.reshape(len(table), len(state), -1)
        c = state[:, 3, None]
        model = state[:, :1] + state[:, 1:2] * du + state[:, 2:3] * dv + bow + c * flat[0]
        design = np.stack(
            [np.ones_like(du), du, dv, flat[0], -c * flat[1], -c * flat[2], c * (flat[3] + flat[4]) / 2], axis=-1
        )
        residual = np.where(there, stamp - model, 0.0)
        if step > _WEIGHTED:
            # numbers that were fitted have taken their share of the noise
            gain, read = (k * there.sum() / (there.sum() - state.size) for k in noise_of(residual[there], model[there]))
            weight = there / (gain * np.maximum(model, 0) + read)
        normal = np.einsum("npi,np,npj->nij", design, weight, design)
        inverse = scaled_inverse(normal)
        change = np.einsum("nij,npj,np->ni", inverse, design, weight * residual)
        change[:, 4:6] = np.clip(change[:, 4:6], -0.7, 0.7)
        change[:, 6] = np.clip(change[:, 6], -0.5 * state[:, 6], state[:, 6])
        shared = c[..., None] * np.stack([flat[3], flat[4], *flat[5:]], axis=-1)
        fit = DotFit(
            lattice,
            state,
            np.sqrt(np.einsum("nii->ni", inverse)),
            design,
            shared,
            residual,
            weight,
            mean_radius,
            gain,
            read,
        )
        state = state + change
        state[:, 6] = np.clip(state[:, 6], _RANGE[0] ** 2, _RANGE[1] ** 2)
        if step > _WEIGHTED + 2 and (np.abs(change[:, 6]) < _SETTLED * fit.std[:, 6]).mean() > 0.98:
            break
    if fit is None or not np.isfinite(fit.parameters).all():
        raise FitError("the dots' pixels do not determine their blur")
    return _without_outliers(fit)


def _bow(lattice: Lattice, ground: FloatArray, du: FloatArray, dv: FloatArray) -> FloatArray:
    """How far the ground of every dot's pixels is off its tangent plane: vignetting, seen by all dots together.

    A dot's own ground cannot tell: its curvature would be taken for the blur's wings.
    """
    scale = max(float(np.ptp(lattice.x)), float(np.ptp(lattice.y))) / 2
    x, y = (lattice.x - lattice.x.mean()) / scale, (lattice.y - lattice.y.mean()) / scale
    degree = 4 if len(x) >= 60 else 2 if len(x) >= 15 else 0
    orders = [(n - j, j) for n in range(degree + 1) for j in range(n + 1)]
    found = np.linalg.lstsq(np.stack([x**i * y**j for i, j in orders], axis=-1), ground, rcond=None)[0]
    bow = np.zeros_like(du)
    for c, (i, j) in zip(found, orders, strict=True):
        for a, b, factor in ((2, 0, i * (i - 1) / 2), (1, 1, i * j), (0, 2, j * (j - 1) / 2)):
            if factor:
                bow += c * factor * (x ** (i - a) * y ** (j - b))[:, None] * (du / scale) ** a * (dv / scale) ** b
    return bow


def _without_outliers(fit: DotFit) -> DotFit:
    """Dots that are there, and like the others."""
    square, std = fit.parameters[:, 6], fit.std[:, 6]
    content = fit.parameters[:, 3]
    centre = np.median(square)
    spread = np.sqrt(std**2 + (1.4826 * np.median(np.abs(square - centre))) ** 2 + (_SAME * centre) ** 2)
    moved = np.hypot(fit.parameters[:, 4] - fit.lattice.x, fit.parameters[:, 5] - fit.lattice.y)
    good = (
        (np.abs(square - centre) < _OUTLIER * spread) & (np.abs(content / np.median(content) - 1) < 0.5) & (moved < 2)
    )
    good &= np.isfinite(std) & (square > 1.01 * _RANGE[0] ** 2) & (np.abs(content) > _OUTLIER * fit.std[:, 3])
    if good.sum() < FEWEST:
        raise FitError(f"{good.sum()} of {len(good)} dots can be measured: {FEWEST} are needed")
    return DotFit(
        Lattice(*(a[good] for a in fit.lattice)), fit.parameters[good], fit.std[good], fit.design[good], fit.shared[good],
        fit.residual[good], fit.weight[good], fit.radius, fit.gain, fit.read,
    )  # fmt: skip


def _nearest(lattice: Lattice) -> FloatArray:
    points = np.stack([lattice.x, lattice.y], axis=-1)
    return np.asarray(cKDTree(points).query(points, k=2)[0][:, 1])
