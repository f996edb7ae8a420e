"""Detection of the dots of a grid in a region, their assignment to a lattice, and the fit of every dot.

A dot is modelled as the convolution of a disc, a Gaussian and a square pixel. The size of the disc follows from the
lattice. The pixel values are computed by quadrature over the disc. Gaussian and square are separable, so that each node
of the disc contributes a product of two differences of normal distribution functions. Derivatives with respect to the
position are those of the Gaussian, and the derivative with respect to the variance is half the sum of its second
derivatives. All are computed from one table of derivatives along x and y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.special import ndtr

from matcam.calibration.photograph.linear_image import smoothed
from matcam.calibration.targets.wave_fit import noise_from_residuals
from matcam.core.arrays import FloatArray
from matcam.core.errors import FitError
from matcam.numerics.linalg import scaled_inverse
from matcam.numerics.normal import SIGNIFICANT, normal_density, robust_std
from matcam.numerics.polynomials import plane_fit

FEWEST = 9
"""Smallest number of dots of a grid or of a zone."""
SHARED = [(2, 0), (0, 2), (4, 0), (2, 2), (0, 4)]
"""Orders in (x, y) of the derivatives that describe the common deviation of the dots of a zone from the model."""

_RANGE = (0.15, 6.0)
"""Smallest and largest lens width, px."""
_AT_ONCE = 512
"""Number of dots that are processed together. It limits the memory for the tables of derivatives."""


class DotLattice(NamedTuple):
    """Positions of n dots in an image and on the page.

    Attributes:
        x: (n,) x in the image, px.
        y: (n,) y in the image, px.
        u: (n,) x on the page, in mm if a chart describes the dots, else in pitches.
        v: (n,) y on the page, in the unit of `u`.
    """

    x: FloatArray
    y: FloatArray
    u: FloatArray
    v: FloatArray

    def subset(self, mask: np.ndarray) -> DotLattice:
        return DotLattice(*(column[mask] for column in self))

    @property
    def pitch(self) -> float:
        """Median distance to the nearest neighbour, px."""
        points = np.stack([self.x, self.y], axis=-1)
        return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))

    @property
    def shapes(self) -> FloatArray:
        """Jacobian matrices (n, 2, 2) of a smooth map from the page to the image at the dots, px per page unit."""
        size = max(float(np.ptp(self.u)), float(np.ptp(self.v)), 1e-9) / 2
        u, v = (self.u - self.u.mean()) / size, (self.v - self.v.mean()) / size
        degree = 4 if len(u) >= 60 else 3 if len(u) >= 30 else 2 if len(u) >= 15 else 1
        maps = plane_fit(u, v, np.stack([self.x, self.y], axis=-1), degree)
        slopes = [polyval2d(u, v, polyder(maps, axis=axis)) / size for axis in (0, 1)]
        return np.stack(slopes).transpose(2, 1, 0)


@dataclass(frozen=True, eq=False)
class DotFit:
    """Fits of n dots, with the derivatives of the last iteration.

    Attributes:
        lattice: initial positions of the dots.
        parameters: (n, 7) background, slopes of the background along x and y (per px), content (sum of the deviation of
            the pixels from the background), x and y (px), and sigma^2 (px^2).
        std: (n, 7) standard deviations of `parameters`.
        design: (n, pixels, 7) derivatives with respect to `parameters`.
        shared: (n, pixels, 5) derivatives of the orders in `SHARED` with respect to (x, y), times the contents.
        residual: (n, pixels) residuals.
        weight: (n, pixels) inverse variances.
        radius: mean radius of the dots in the image without blur, px.
        gain: variance of a pixel divided by its value, without read noise.
        read_variance: variance of a dark pixel, in squared units of the values.
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
        arrays = {
            name: getattr(self, name)[mask] for name in ("parameters", "std", "design", "shared", "residual", "weight")
        }
        return replace(self, lattice=self.lattice.subset(mask), **arrays)


def fit_dots(values: FloatArray, lattice: DotLattice, size: float, half_width: float) -> DotFit:
    """Fit every dot of a lattice in a region.

    `values`: (height, width), NaN for missing pixels. `size`: radius of the dots in page units. `half_width`: half width
    of the pixel, px. A FitError is raised if too few dots can be measured.
    """
    shape, pitch = size * lattice.shapes, lattice.pitch
    # The square of pixels of a dot has at most 15 x 15 px.
    half_size = int(min(7, max(3, np.floor(pitch / 2 - 0.5))))
    # The blur of closer dots overlaps.
    if pitch < 6.0:
        raise FitError(
            f"the dots are {pitch:.1f} px apart, but must be at least 6 px apart: photograph the grid at a larger scale"
        )
    columns, rows = (
        np.round(c).astype(int)[:, None] + np.arange(-half_size, half_size + 1) for c in (lattice.x, lattice.y)
    )
    whole = (np.minimum(columns[:, 0], rows[:, 0]) >= 0) & (columns[:, -1] < values.shape[1])
    whole &= rows[:, -1] < values.shape[0]
    if whole.sum() < FEWEST:
        raise FitError(
            f"only {whole.sum()} of the {len(whole)} dots lie entirely inside the region, but at least {FEWEST} are needed: "
            "give a larger region"
        )
    lattice, shape, columns, rows = lattice.subset(whole), shape[whole], columns[whole], rows[whole]
    value = values[rows[:, :, None], columns[:, None, :]]
    # Offsets of the pixels from the position of the dot in the lattice.
    du, dv = (
        np.broadcast_to(off, value.shape).reshape(len(value), -1)
        for off in ((columns - lattice.x[:, None])[:, None, :], (rows - lattice.y[:, None])[:, :, None])
    )
    value = value.reshape(du.shape)
    known, ground = np.isfinite(value), np.nanmedian(value, axis=1)
    value = np.where(known, value, 0.0)
    # In a mosaic, only some of the pixels of a dot are known.
    content = (known * (value - ground[:, None])).sum(1) / np.maximum(known.mean(1), 0.05)
    state = np.column_stack(
        [ground, 0 * ground, 0 * ground, content, lattice.x, lattice.y, np.full(len(ground), 0.6**2)]
    )
    mean_radius = float(np.sqrt(np.abs(np.linalg.det(shape))).mean())
    gain, read, weight = 0.0, 1.0, known.astype(float)
    bow, change = np.zeros_like(du), np.zeros_like(state)
    weighted = 4  # Gauss-Newton step after which the weights follow from the noise
    for step in range(16):
        state = state + change
        state[:, 6] = np.clip(state[:, 6], _RANGE[0] ** 2, _RANGE[1] ** 2)
        if step == weighted:
            bow = _bow(lattice, state[:, 0], du, dv)
            # The fitted positions determine the lattice and the sizes of the dots more accurately than the initial ones.
            shape = size * lattice._replace(x=state[:, 4], y=state[:, 5]).shapes
        u, v = columns - state[:, 4:5], rows - state[:, 5:6]
        table = dot_derivatives(u, v, shape, np.sqrt(state[:, 6]), half_width, [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2)])
        flat = table.reshape(len(table), len(state), -1)
        c = state[:, 3, None]
        model = state[:, :1] + state[:, 1:2] * du + state[:, 2:3] * dv + bow + c * flat[0]
        design = np.stack(
            [np.ones_like(du), du, dv, flat[0], -c * flat[1], -c * flat[2], c * (flat[3] + flat[4]) / 2], axis=-1
        )
        residual = np.where(known, value - model, 0.0)
        if step > weighted:
            # Correct for the noise that the fitted parameters absorb.
            found = noise_from_residuals(residual[known], model[known])
            gain, read = (k * known.sum() / (known.sum() - state.size) for k in found)
            weight = known / (gain * np.maximum(model, 0) + read)
        across = design.transpose(0, 2, 1)
        inverse = scaled_inverse((across * weight[:, None]) @ design)
        change = (inverse @ (across @ (weight * residual)[..., None]))[..., 0]
        change[:, 4:6] = np.clip(change[:, 4:6], -0.7, 0.7)
        change[:, 6] = np.clip(change[:, 6], -0.5 * state[:, 6], state[:, 6])
        std = np.sqrt(np.einsum("nii->ni", inverse))
        # The fit of a dot has converged if the variance changes by less than 0.01 standard deviations.
        if step > weighted + 2 and (np.abs(change[:, 6]) < 0.01 * std[:, 6]).mean() > 0.98:
            break
    if not np.isfinite(state).all():
        raise FitError("the pixels of the dots do not determine their blur: give a sharper or larger image of the grid")
    # The higher derivatives for the common deviation of the dots are computed only once.
    flat = dot_derivatives(u, v, shape, np.sqrt(state[:, 6]), half_width, SHARED).reshape(len(SHARED), len(state), -1)
    shared = state[:, 3, None, None] * flat.transpose(1, 2, 0)
    fit = DotFit(lattice, state, std, design, shared, residual, weight, mean_radius, gain, read)
    return _without_outliers(fit)


def find_dots(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the positions x and y (n,) of the dots in a region, px.

    `values`: (height, width), NaN for missing pixels. A FitError is raised if there are fewer than 9 dots.
    """
    smooth = smoothed(values)
    # Most pixels are background, which changes slowly.
    ground = ndimage.gaussian_filter(ndimage.median_filter(smooth[::2, ::2], 15), 2)
    off = smooth - ground.repeat(2, 0).repeat(2, 1)[: values.shape[0], : values.shape[1]]
    spread = robust_std(off - np.median(off))
    sign = -1.0 if np.quantile(off, 0.001) < -np.quantile(off, 0.999) else 1.0
    # A dot exceeds the smoothed background by 6 standard deviations.
    label, count = ndimage.label(sign * off > max(6 * spread, 0.25 * float(np.quantile(sign * off, 0.999))))
    if count < FEWEST:
        raise FitError(
            f"the region contains no grid of dots: the number of spots is {count}, but at least {FEWEST} are needed; "
            "give a region of dots alone"
        )
    every = np.arange(1, count + 1)
    flux = ndimage.sum_labels(sign * off, label, every)
    y, x = np.array(ndimage.center_of_mass(np.maximum(sign * off, 0), label, every)).T
    # All dots of a grid have the same size, and therefore similar fluxes.
    usual = np.median(flux)
    whole = (flux > 0.3 * usual) & (flux < 3 * usual)
    if whole.sum() < FEWEST:
        raise FitError(
            "the region contains no grid of dots: the spots differ too much in brightness; give a region of dots alone"
        )
    return x[whole], y[whole]


def square_lattice(x: FloatArray, y: FloatArray) -> DotLattice:
    """Assign dots to a square lattice in perspective, with page positions in pitches.

    A FitError is raised if there is no lattice.
    """
    points = np.stack([x, y], axis=-1)
    tree = cKDTree(points)
    neighbour = tree.query(points, k=min(5, len(points)))[1]
    # A central dot has four neighbours in nearly perpendicular directions.
    central = int(np.argmin(np.hypot(*(points - np.median(points, axis=0)).T)))
    first = points[neighbour[central, 1]] - points[central]
    steps = points[neighbour[central, 1:]] - points[central]
    across = np.abs(steps @ np.array([-first[1], first[0]])) / (np.hypot(*steps.T) * np.hypot(*first))
    second = steps[int(np.argmax(across))]
    if np.abs(across).max() < 0.7 or not 0.5 < np.hypot(*second) / np.hypot(*first) < 2:
        raise FitError("the spots in the region do not form a square grid: give a region of dots alone")
    position: dict[int, tuple[int, int]] = {central: (0, 0)}
    basis: dict[int, FloatArray] = {central: np.stack([first, second])}
    queue = [central]
    while queue:
        at = queue.pop(0)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = sign * basis[at][axis]
            off, other = tree.query(points[at] + step)
            # A dot is less than a quarter of the pitch from the position that its neighbour predicts.
            if off > 0.25 * np.hypot(*step) or int(other) in position:
                continue
            where = list(position[at])
            where[axis] += sign
            position[int(other)] = (where[0], where[1])
            # In perspective, the lattice vectors change slowly: each dot provides initial vectors for its neighbours.
            moved = basis[at].copy()
            moved[axis] = 0.7 * moved[axis] + 0.3 * sign * (points[other] - points[at])
            basis[int(other)] = moved
            queue.append(int(other))
    index = np.array(sorted(position))
    where_all = np.array([position[i] for i in index], dtype=float)
    if len(index) < FEWEST or len({tuple(w) for w in where_all}) != len(index):
        raise FitError(
            f"the spots in the region do not form a square grid: only {len(index)} of {len(points)} fit a lattice; "
            "give a region of dots alone"
        )
    return DotLattice(x[index], y[index], where_all[:, 0], where_all[:, 1])


def dot_derivatives(
    x: FloatArray, y: FloatArray, shape: FloatArray, sigma: FloatArray, half_width: float, orders: list[tuple[int, int]]
) -> FloatArray:
    """Compute derivatives with respect to (x, y) of the pixel values of n dots with unit content.

    The result has the shape (orders, n, height, width). `x`, `y`: (n, width) and (n, height) distances from the centres
    of the dots to those of the pixels, px. `shape`: (n, 2, 2) linear maps from the unit disc to the dots, px. `sigma`:
    (n,) lens widths, px. `half_width`: half the side of the sensitive area of a pixel, px. `orders`: orders of the
    derivatives.
    """
    if len(x) > _AT_ONCE:
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(x), _AT_ONCE)]
        return np.concatenate(
            [dot_derivatives(x[p], y[p], shape[p], sigma[p], half_width, orders) for p in parts], axis=1
        )
    # Nodes (2, 70) and weights of a quadrature over the unit disc: the squared radii are Gauss-Legendre nodes, and every
    # second of the 5 rings of 14 nodes is rotated by half a step.
    nodes, weights = np.polynomial.legendre.leggauss(5)
    turn = 2 * np.pi * (np.arange(14) + 0.5 * (np.arange(5)[:, None] % 2)) / 14
    disc = (np.sqrt((nodes + 1) / 2)[:, None] * np.stack([np.cos(turn), np.sin(turn)])).reshape(2, -1)
    share = np.repeat(weights / 2 / 14, 14)
    offset = np.einsum("nij,jk->nik", shape, disc)
    along = [_axis(g[:, :, None] - o[:, None, :], sigma, half_width, max(w)) for g, o, w in (
        (x, offset[:, 0], [i for i, _ in orders]), (y, offset[:, 1], [j for _, j in orders]),
    )]  # fmt: skip
    return np.stack([np.matmul(along[1][j] * share, along[0][i].transpose(0, 2, 1)) for i, j in orders])


def _axis(t: FloatArray, sigma: FloatArray, half_width: float, highest: int) -> list[FloatArray]:
    """Compute the one-dimensional kernel, a Gaussian convolved with a box, and its derivatives.

    `t`: (n, pixels, nodes) distances, px.
    """
    s = sigma[:, None, None]
    ends = [(t + half_width) / s, (t - half_width) / s]
    table = [(ndtr(ends[0]) - ndtr(ends[1])) / (2 * half_width)]
    if highest:
        bell = [normal_density(z) for z in ends]
        # The derivative d^k/dz^k of the normal density is (-1)^k He_k(z) times the density.
        for order in np.eye(highest):
            below, above = (hermeval(-z, order) * density for z, density in zip(ends, bell, strict=True))
            table.append((below - above) / (2 * half_width * s ** len(table)))
    return table


def _bow(lattice: DotLattice, ground: FloatArray, du: FloatArray, dv: FloatArray) -> FloatArray:
    """Estimate the deviation of the background of every dot from its tangent plane.

    The deviation, for example by vignetting, follows from the backgrounds of all dots. For a single dot, the curvature of the
    background could not be separated from the wings of the blur.
    """
    scale = max(float(np.ptp(lattice.x)), float(np.ptp(lattice.y))) / 2
    x, y = (lattice.x - lattice.x.mean()) / scale, (lattice.y - lattice.y.mean()) / scale
    du, dv = du / scale, dv / scale
    light = plane_fit(x, y, ground, 4 if len(x) >= 60 else 2 if len(x) >= 15 else 0)
    by_x, by_y = (polyval2d(x, y, polyder(light, axis=axis)) for axis in (0, 1))
    tangent = polyval2d(x, y, light)[:, None] + by_x[:, None] * du + by_y[:, None] * dv
    return polyval2d(x[:, None] + du, y[:, None] + dv, light) - tangent


def _without_outliers(fit: DotFit) -> DotFit:
    square, std = fit.parameters[:, 6], fit.std[:, 6]
    content = fit.parameters[:, 3]
    centre = np.median(square)
    # Deviations of sigma^2 by 2 % are always accepted.
    spread = np.sqrt(std**2 + robust_std(square - centre) ** 2 + (0.02 * centre) ** 2)
    moved = np.hypot(fit.parameters[:, 4] - fit.lattice.x, fit.parameters[:, 5] - fit.lattice.y)
    good = (
        (np.abs(square - centre) < SIGNIFICANT * spread)
        & (np.abs(content - np.median(content)) < 0.5 * np.abs(np.median(content)))
        & (moved < 2)
    )
    good &= np.isfinite(std) & (square > 1.01 * _RANGE[0] ** 2) & (np.abs(content) > SIGNIFICANT * fit.std[:, 3])
    if good.sum() < FEWEST:
        raise FitError(
            f"only {good.sum()} of {len(good)} dots can be measured, but at least {FEWEST} are needed: give a sharper or "
            "larger image"
        )
    return fit.subset(good)
