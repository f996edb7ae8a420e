"""Many cells of a table at once, for any isotropic lobe, and their noise (docs/model.md 3, 8): truth for fits.

Imports nothing of the package. Two rules: near the highlight a fixed polar grid of slopes about the half vector, graded
towards it, over whose nodes each pixel's kernel is a sparse row; elsewhere the trapezoid rule on the sensor, at a
third of a pixel, which converges exponentially for what is smooth there. Pixels that the limb or the terminator comes within
`END` px of are left out (NaN).
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.sparse import csr_matrix
from scipy.special import erfc, gamma, j1, jn_zeros

END = 4.5
NEAR = 8.0
_STEP, _HALF = 0.35, 11
_AZIMUTHS = 220
_RADIAL = np.polynomial.legendre.leggauss(6)
_PANEL_PX = 1.3  # the widest, on the sphere


class GGX(NamedTuple):
    alpha: float

    def p22(self, s2):
        return self.alpha**2 / (np.pi * (self.alpha**2 + s2) ** 2)

    def smith(self, cos):
        return np.sqrt(1 + self.alpha**2 * (1 / cos**2 - 1)) / 2 - 0.5


class EPD(NamedTuple):
    beta: float
    power: float

    def p22(self, s2):
        p, b = self.power, self.beta
        return p / (np.pi * b**2 * gamma(1 / p)) * np.exp(-((s2 / b**2) ** p))

    def smith(self, cos):
        return _smith(self.p22, self.beta, cos)


class Tails(NamedTuple):
    """Student's t distribution of slopes: GGX at gamma = 2, longer tails below (Ribardiere et al. 2017)."""

    alpha: float
    gamma: float

    def p22(self, s2):
        return (self.gamma - 1) / (np.pi * self.alpha**2) * (1 + s2 / self.alpha**2) ** -self.gamma

    def smith(self, cos):
        return _smith(self.p22, self.alpha, cos, 30)


def _smith(p22, width, cos, last=5):
    """Lambda: spline through the integral over slopes, in logarithms. last: of the slope's over width's."""
    mu = width * np.geomspace(1e-3, 300, 260)
    x, w = np.polynomial.legendre.leggauss(12)
    cuts = np.concatenate([[-30], np.arange(-14, last, 0.5)])
    log_s = (cuts[:-1, None] + np.diff(cuts)[:, None] * (x + 1) / 2).ravel()
    weight = (np.diff(cuts)[:, None] / 2 * w).ravel()
    y = np.hypot(width, mu[:, None]) * np.exp(log_s)  # y^2 = r^2 - mu^2, r dr = y dy
    ratio = y / mu[:, None]
    excess = np.where(ratio < 0.02, mu[:, None] * ratio**3 * (1 / 3 - ratio**2 / 5 + ratio**4 / 7),
                      y - mu[:, None] * np.arctan(ratio))  # fmt: skip
    value = 2 / mu * ((p22(mu[:, None] ** 2 + y**2) * excess * y**2) @ weight)
    good = value > 1e-13
    spline = CubicSpline(np.log(mu[good]), np.log(value[good]))
    cot = cos / np.sqrt(np.maximum(1 - cos**2, 1e-30))
    inside = np.exp(spline(np.log(np.clip(cot, mu[0], mu[good][-1]))))
    # towards the horizon Lambda goes as 1 / mu
    inside = np.where(cot < mu[0], inside * mu[0] / np.maximum(cot, 1e-300), inside)
    return np.where(cot > mu[good][-1], 0.0, inside)


class Lobes(NamedTuple):
    """A surface of several lobes: their shares of facets add up to 1. Smith's Lambda of each is weighted alike."""

    parts: tuple

    def p22(self, s2):
        return sum(share * lobe.p22(s2) for share, lobe in self.parts)

    def smith(self, cos):
        return sum(share * lobe.smith(cos) for share, lobe in self.parts)


class Setup(NamedTuple):
    """radius, lens and pixel in px; lamp: angular radius, rad; lens: rows (share, x, y) of points, px, each a Gaussian of
    sigma, that make a lens of any shape, before a point lamp; none: the Gaussian itself."""

    sigma: float = 0.5
    half_width: float = 0.5
    radius: float = 256.0
    lamp: float = 0.0
    lens: tuple = ()


POINT = 0.25
"""px; Gaussian round each point of a lens."""


def disc(sigma=0.5):
    """A defocused lens of this standard deviation along each axis."""
    radius = 2 * np.sqrt(sigma**2 - POINT**2)
    x, w = np.polynomial.legendre.leggauss(4)
    rings = [
        (w0 / 2 / 10, radius * np.sqrt((1 + x0) / 2), 0.3 * n) for n, (x0, w0) in enumerate(zip(x, w, strict=True))
    ]
    turn = 2 * np.pi * np.arange(10) / 10
    return Setup(POINT, lens=tuple((s, r * np.cos(t), r * np.sin(t)) for s, r, a in rings for t in turn + a))


def coma(sigma=0.5, angle=0.0):
    """A lens with third-order coma whose mean variance along the axes is sigma^2; its tail points to `angle`, rad."""
    x, w = np.polynomial.legendre.leggauss(5)
    turn = 2 * np.pi * (np.arange(9) + 0.5) / 9
    rows = np.array(
        [
            (w0 / 2 / 9, (1 + x0) / 2 * (2 + np.cos(t)), (1 + x0) / 2 * np.sin(t))
            for x0, w0 in zip(x, w, strict=True)
            for t in turn
        ]
    )
    rows[:, 1] -= rows[:, 0] @ rows[:, 1]
    scale = np.sqrt((sigma**2 - POINT**2) / (rows[:, 0] @ (rows[:, 1:] ** 2).sum(1) / 2))
    x, y = scale * rows[:, 1], scale * rows[:, 2]
    x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    return Setup(POINT, lens=tuple(zip(rows[:, 0], x, y, strict=True)))


def airy(sigma=0.5):
    """Diffraction by a round pupil up to its second dark ring (91 % of the light), of this standard deviation, scaled."""
    x, w = np.polynomial.legendre.leggauss(14)
    v = jn_zeros(1, 2)[1] * (1 + x) / 2
    share = w * v * (2 * j1(v) / v) ** 2
    share /= share.sum()
    v *= np.sqrt(2 * (sigma**2 - POINT**2) / (share @ v**2))
    turn = 2 * np.pi * np.arange(12) / 12
    rings = [(s / 12, r, turn + 0.3 * n) for n, (s, r) in enumerate(zip(share, v, strict=True))]
    return Setup(POINT, lens=tuple((s, r * np.cos(t), r * np.sin(t)) for s, r, angles in rings for t in angles))


class Cells:
    """Cells (i, j, k as angles) of some pictures. theta_h, phi_d: (slices, cells); theta_d: (slices,). turns: of phi_d, for
    each way that a cell is seen. finest: slope below which the lobe has no structure: it saves nodes."""

    def __init__(self, theta_h, theta_d, phi_d, setup=None, turns=(0, np.pi), finest=0.0):
        self.setup, self._table, self._finest = setup or Setup(), None, finest
        r = self.setup.radius
        th, td, psi = theta_h[..., None], theta_d[:, None, None], np.pi - phi_d[..., None] + np.array(turns)
        self.theta_d = theta_d
        self.x = r * (np.cos(th) * np.sin(td) + np.sin(th) * np.cos(psi) * np.cos(td))
        self.y = r * np.sin(th) * np.sin(psi)
        a, b = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(psi)
        self.cos_i, self.cos_o = a + b, a - b
        limb = r - np.hypot(self.x, self.y)
        # distance to the terminator: an ellipse of half axes r |cos 2 theta_d| and r, on the side away from the lamp
        dark = -np.cos(2 * td) * np.sqrt(np.maximum(r**2 - self.y**2, 0))
        self.good = (self.cos_i > 0) & (self.cos_o > 0) & (limb > END) & (self.x - dark > END)
        distance = np.abs(np.sin(th)) * r * np.cos(td)
        self.near = self.good & (np.broadcast_to(distance, self.good.shape) < NEAR)
        self.far = self.good & ~self.near
        self._polar()
        self._trapezoid()

    def _spread(self, j):
        """Standard deviations of lens and lamp along x and y."""
        lamp = self.setup.lamp * self.setup.radius / 4
        cos = np.cos(self.theta_d[j])
        return np.hypot(self.setup.sigma, lamp * cos), np.hypot(self.setup.sigma, lamp / cos)

    def _polar(self):
        graded = np.exp(np.concatenate([[-16, -13, -11], np.arange(-10, 0, 0.3)]))
        graded = graded[graded > self._finest]
        even = np.arange(_PANEL_PX, 200, _PANEL_PX) / self.setup.radius
        cuts = np.concatenate([graded[graded * 0.3 < _PANEL_PX / self.setup.radius], even])
        cuts = np.unique(np.concatenate([[0], cuts[cuts < 1.45]]))
        slopes = (cuts[:-1, None] + np.diff(cuts)[:, None] * (_RADIAL[0] + 1) / 2).ravel()
        weight = (np.diff(cuts)[:, None] / 2 * _RADIAL[1]).ravel()
        azimuth = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
        self.grids, self.rows = [], []
        for j, td in enumerate(self.theta_d):
            span = (NEAR + 6) / self.setup.radius / np.cos(td)
            used = slopes < np.tan(min(span, 1.4))
            t, phi = (g.ravel() for g in np.meshgrid(slopes[used], azimuth, indexing="ij"))
            area = np.repeat(weight[used] * slopes[used], _AZIMUTHS) * 2 * np.pi / _AZIMUTHS
            length = np.sqrt(1 + t**2)
            along, across, up = t * np.cos(phi) / length, t * np.sin(phi) / length, 1 / length
            x = self.setup.radius * (up * np.sin(td) + along * np.cos(td))
            cos_o, cos_i = up * np.cos(td) - along * np.sin(td), up * np.cos(td) + along * np.sin(td)
            seen = (cos_o > 0) & (cos_i > 0)
            grid = t[seen] ** 2, cos_i[seen], cos_o[seen], (area / length**3)[seen] * self.setup.radius**2 / 4
            x, y = x[seen], self.setup.radius * across[seen]
            self.grids.append(grid)
            order = np.argsort(y)
            sorted_x, sorted_y = x[order], y[order]
            s_x, s_y = self._spread(j)
            reach = [self.setup.half_width + self._wings() + 7.5 * s for s in (s_x, s_y)]
            data, index, pointer = [], [], [0]
            for px, py in zip(self.x[j][self.near[j]], self.y[j][self.near[j]], strict=True):
                a, b = np.searchsorted(sorted_y, [py - reach[1], py + reach[1]])
                inside = order[a:b][np.abs(sorted_x[a:b] - px) < reach[0]]
                data.append(self._both(x[inside] - px, y[inside] - py, s_x, s_y))
                index.append(inside)
                pointer.append(pointer[-1] + inside.size)
            joined = (np.concatenate(data), np.concatenate(index), pointer) if data else ([], [], [0])
            self.rows.append(csr_matrix(joined, shape=(len(pointer) - 1, x.size)))

    def _trapezoid(self):
        r, offsets = self.setup.radius, _STEP * np.arange(-_HALF, _HALF + 1)
        self.far_nodes = []
        for j, td in enumerate(self.theta_d):
            s_x, s_y = self._spread(j)
            stretch_x, stretch_y = max(1.0, s_x / 0.5), max(1.0, s_y / 0.5)  # a lens of points has its wings inside
            x0, y0 = self.x[j][self.far[j]], self.y[j][self.far[j]]
            dx, dy = stretch_x * offsets, stretch_y * offsets
            x, y = x0[:, None, None] + dx[:, None], y0[:, None, None] + dy
            z2 = r**2 - x**2 - y**2
            n_x, n_z = x / r, np.sqrt(np.maximum(z2, 0)) / r
            cos_i = n_x * np.sin(2 * td) + n_z * np.cos(2 * td)
            cos_h = n_x * np.sin(td) + n_z * np.cos(td)
            lit = (z2 > 0) & (cos_i > 0) & (n_z > 0)
            # slope of the half vector without cancellation
            sin2 = (n_x * np.cos(td) - n_z * np.sin(td)) ** 2 + (y / r) ** 2
            kernel = self._both(dx[:, None], dy, s_x, s_y) * (dx[1] - dx[0]) * (dy[1] - dy[0])
            weight = np.where(lit, kernel / (4 * np.where(lit, n_z, 1)), 0.0)
            self.far_nodes.append(
                (np.where(lit, sin2 / cos_h**2, 1.0), np.where(lit, cos_i, 1.0), np.where(lit, n_z, 1.0), weight)
            )

    def _wings(self):
        return max((np.hypot(x, y) for _, x, y in self.setup.lens), default=0.0)

    def _both(self, x, y, s_x, s_y):
        """The effective kernel in the plane."""
        if not self.setup.lens:
            return self._kernel(x, s_x) * self._kernel(y, s_y)
        x, y = np.broadcast_arrays(x, y)
        return np.where(np.maximum(abs(x), abs(y)) < self._table_reach(), self._lens_table().ev(x, y), 0.0)

    def _table_reach(self):
        return self.setup.half_width + self._wings() + 7.5 * self.setup.sigma

    def _lens_table(self):
        """The kernel of a lens of points, which is smooth on the scale of one: a spline through a fine table."""
        if self._table is None:
            x = np.arange(-self._table_reach() - 0.1, self._table_reach() + 0.1, POINT / 5)
            rows = [
                w * self._kernel(x - a, self.setup.sigma)[:, None] * self._kernel(x - b, self.setup.sigma)
                for w, a, b in self.setup.lens
            ]
            self._table = RectBivariateSpline(x, x, sum(rows))
        return self._table

    def _kernel(self, x, sigma):
        x, unit, p = np.abs(x), np.sqrt(2) * sigma, self.setup.half_width
        return (erfc((x - p) / unit) - erfc((x + p) / unit)) / (4 * p)

    def directions(self, lobe):
        """What is recorded one way and the other, 1/sr at F = 1: (slices, cells, 2), NaN where left out."""
        return self._seen(
            lambda s2, cos_i, cos_o: lobe.p22(s2) * (1 + s2) ** 2 / (1 + lobe.smith(cos_i) + lobe.smith(cos_o))
        )

    def body(self, crossed=lambda cosine: 1.0):
        """The same of a Lambertian surface of albedo 1. crossed: share of the light that a coat transmits at a cosine."""
        return self._seen(lambda s2, cos_i, cos_o: 4 * cos_i * cos_o * crossed(cos_i) * crossed(cos_o) / np.pi)

    def _seen(self, light):
        """light: of (squared slope of the half vector, both cosines): the BRDF times 4 cos_i cos_o."""
        out = np.full(self.x.shape, np.nan)
        for j in range(self.theta_d.size):
            for chosen, (s2, cos_i, cos_o, weight), apply in (
                (self.near[j], self.grids[j], lambda light, w, j=j: self.rows[j] @ (light * w)),
                (self.far[j], self.far_nodes[j], lambda light, w: (light * w).sum((1, 2))),
            ):
                out[j][chosen] = apply(light(s2, cos_i, cos_o), weight)
        return out / self.cos_i

    def pixel_numbers(self):
        """Of the pixel that holds each place, unique within its picture."""
        return np.rint(self.x) * 4096 + np.rint(self.y)

    def noisy(self, directions, rng, relative=0.01, floor=1e-4, gain=0.01):
        """Cells (slices, cells): mean of both places, each with its pixel's noise, under one gain for each picture."""
        out = np.empty(directions.shape[:2])
        number = self.pixel_numbers()
        for j, pair in enumerate(directions):
            _, index = np.unique(number[j], return_inverse=True)
            index = index.reshape(pair.shape)
            e = rng.standard_normal((2, index.max() + 1))
            peak = np.max(pair.mean(-1), initial=0, where=np.isfinite(pair.mean(-1)))
            out[j] = (pair * (1 + relative * e[0][index]) + floor * peak * e[1][index]).mean(-1)
            out[j] *= 1 + gain * rng.standard_normal()
        return out
