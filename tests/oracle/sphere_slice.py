"""Records of a sphere at many positions of one slice (docs/model.md 2, 3), for any isotropic reflectance.

Imports nothing of the package. The camera is distant, and so is the point lamp, at the angle 2 theta_d from it. The nodes
of the quadrature are placed on the sphere once a slice, on regular grids of the sensor. Each record is a sum over a grid.

- Away from the highlight the nodes are the points of the grid (trapezoid rule). Each row ends with Gregory's weights one
  pixel before limb and terminator. What lies beyond is integrated over normals, graded towards the edge, and distributed
  along the row by polynomials of degree 5, which preserve its moments.
- Near the highlight, and where limb and terminator meet, the nodes are polar about the half vector, between limb and
  terminator, and graded towards highlight and edges. The Gaussian of the lens is split into two of half the variance: one
  distributes a node's light to a fine grid, the other belongs to the kernel that reads this grid. All weights are positive,
  so small records keep their relative accuracy.
- A smooth window passes from one rule to the other. Where the lit part of the sphere is a narrow crescent, the polar rule
  covers all of it.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline
from scipy.special import erfc

WINDOW = 7.0
"""Distance from the highlight, px along x, at which the rules change: beyond, lobes are smooth on a pixel's scale."""
CAP = 16.0
"""Distance from y = r, px, at which the rules change: beyond, rows cross the limb too obliquely for their step."""
CRESCENT = 16.0
"""Width of the lit part, px, up to which the polar rule covers all of it: the window does not fit into less."""
MARGIN = 1.0
"""Distance from limb and terminator, px along a row, where the trapezoid rule ends: 1 / cos(theta_o) is too steep beyond."""
BULK_STEP, NEAR_STEP = 0.8, 0.55
"""Steps of both grids in standard deviations of the lens: aliasing is below 1e-6 (Poisson's summation formula)."""
BULK_LONGEST, BULK_OF_POINTS = 0.4, 0.3
"""Longest step of the first grid, px, and its step for a lens of points, whose shape is wider than one point's Gaussian."""
REACH = 7.5
"""Standard deviations of a Gaussian up to which it is followed."""
TILE = 8
"""Steps of the fine grid in a tile whose nodes are distributed together: larger tiles are slower."""
_GREGORY = np.array([3 / 8, 7 / 6, 23 / 24])
_UNIT, _SHARE = np.polynomial.legendre.leggauss(6)
_EDGE = np.array([0, 0.004, 0.02, 0.08, 0.3, 1.0])
"""Panels of an angle that is counted from an edge: masking ends in a layer as thin as the lobe."""
_BOTH_EDGES = np.array([0, 0.003, 0.02, 0.08, 0.2, 0.35, 0.5])
_CHUNK = 3_000_000


class Grid(NamedTuple):
    """Light (terms, rows, columns) on a regular grid, and the kernel that reads it. x, y: its first point, px."""

    light: np.ndarray
    x: float
    y: float
    step: float
    kernel: "Kernel"


class Kernel:
    """Effective kernel as a sum of products of functions of x and y. sigma: of the Gaussian of each point of the lens, px."""

    def __init__(self, setup, sigma):
        self.half_width, self.sigma = setup.half_width, sigma
        wings = max((max(abs(x), abs(y)) for _, x, y in setup.lens), default=0.0)
        self.reach = setup.half_width + wings + REACH * sigma
        self.mirrored = not setup.lens
        self._splines = None
        if setup.lens:
            x = np.arange(-self.reach - 0.1, self.reach + 0.1, sigma / 6)
            share, a, b = np.array(setup.lens).T
            table = (self._one(x - a[:, None]).T * share) @ self._one(x - b[:, None])
            u, s, v = np.linalg.svd(table)
            kept = np.count_nonzero(s > 1e-10 * s[0])
            self._splines = CubicSpline(x, u[:, :kept] * s[:kept]), CubicSpline(x, v[:kept].T)

    def factors(self, x, y):
        """Functions of x and of y, (..., products): their products add up to the kernel."""
        if self._splines is None:
            return self._one(x)[..., None], self._one(y)[..., None]
        return tuple(
            np.where(np.abs(u)[..., None] < self.reach, spline(u), 0.0)
            for spline, u in zip(self._splines, (x, y), strict=True)
        )

    def _one(self, x):
        x, unit, p = np.abs(x), np.sqrt(2) * self.sigma, self.half_width
        return (erfc((x - p) / unit) - erfc((x + p) / unit)) / (4 * p)


class Slices:
    """Rules for the slices of one setup. light: (s2, cos_i, cos_o) to (terms, nodes), the BRDF times 4 cos_i cos_o.

    finest: slope below which no lobe has structure.
    """

    def __init__(self, setup, light, finest):
        assert not setup.lamp, "the lamp is a point here"
        self.setup, self.light, self.finest = setup, light, finest
        self.bulk_kernel = Kernel(setup, setup.sigma)
        self.near_kernel = Kernel(setup, setup.sigma / np.sqrt(2))
        self.bulk_step = BULK_OF_POINTS if setup.lens else min(BULK_STEP * setup.sigma, BULK_LONGEST)

    def records(self, theta_d, x, y):
        """Records (terms, positions, 2) at positions (x, y) and (x, -y), y >= 0: radiance per unit irradiance, 1/sr."""
        if 2 * self.setup.radius * np.cos(theta_d) ** 2 < CRESCENT:
            grids = [self._near(theta_d, 0, np.pi / 2, 0)]
        else:
            near = np.arctan((WINDOW + 6) / (self.setup.radius * np.cos(theta_d)))
            cap = self.setup.radius - CAP - 6
            grids = [
                self._near(theta_d, 0, near, 0, self._near_share),
                self._near(theta_d, max(near, np.arcsin(cap / self.setup.radius)), np.pi / 2, cap, self._near_share),
                self._bulk(theta_d),
            ]
        return sum(_read(grid, x, y) for grid in grids)

    def _near_share(self, theta_d, s2, y):
        """Share of the polar rule in the light of a normal: smooth on the sensor."""
        bulk = _rise(self.setup.radius * np.cos(theta_d) * np.sqrt(s2) - WINDOW) * _rise(self.setup.radius - y - CAP)
        return 1 - bulk

    # near the highlight, and where limb and terminator meet

    def _near(self, theta_d, first, last, lowest, share=None):
        """Grid of the nodes at angles from first to last to the half vector, at y >= lowest."""
        r, cos = self.setup.radius, np.cos(theta_d)
        theta, phi, omega = self._polar(theta_d, first, last, lowest)
        along, across, up = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        cos_o, cos_i = up * cos - along * np.sin(theta_d), up * cos + along * np.sin(theta_d)
        s2 = (np.sin(theta) / up) ** 2
        weight = omega * r**2 / 4
        if share:
            weight = weight * share(theta_d, s2, r * across)
        light = self.light(s2, np.maximum(cos_i, 1e-12), np.maximum(cos_o, 1e-12)) * weight
        return self._distributed(r * (up * np.sin(theta_d) + along * cos), r * across, light)

    def _polar(self, theta_d, begin, last, lowest):
        """Angles to the half vector, azimuths about it from 0 to pi, and solid angles of nodes."""
        r, panel = self.setup.radius, min(2.0, 4 * self.setup.sigma)
        spacing = 0.9 * min(1.4 * self.setup.sigma, 0.5)
        ends = np.pi / 2 - theta_d  # the angle at which limb and terminator begin
        graded = self.finest * np.exp(np.arange(0, np.log(panel / 0.3 / r / self.finest), 0.3))
        even = np.arange(graded[-1] if graded.size else 0, last, panel / r)
        edges = ends * (1 + np.array([-0.2, -0.05, -0.01, 0, 0.01, 0.05, 0.2]))
        cuts = np.unique(np.concatenate([[begin, last], graded, even, edges]))
        cuts = cuts[(cuts >= begin) & (cuts <= last)]
        nodes = []
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            theta = (a + b) / 2 + (b - a) / 2 * _UNIT
            weight = (b - a) / 2 * _SHARE * np.sin(theta)
            if b <= ends and not lowest:
                count = int(max(24, np.ceil(np.pi * r * np.sin(b) / spacing), 64 * (b > ends / 2)))
                phi, share = np.broadcast_to((np.arange(count) + 0.5) * np.pi / count, (6, count)), np.pi / count
            else:
                low = np.maximum(
                    np.arccos(np.minimum(np.tan(ends) / np.tan(theta), 1)),
                    np.arcsin(np.minimum(lowest / r / np.sin(theta), 1)),
                )[:, None]
                unit, share = _gauss(_subdivided(_BOTH_EDGES, r * (np.pi - 2 * low.min()) * np.sin(b) / panel))
                phi, share = low + (np.pi - 2 * low) * unit, (np.pi - 2 * low) * share
            nodes.append((np.broadcast_to(theta[:, None], phi.shape), phi, weight[:, None] * share + 0 * phi))
        return (np.concatenate([part.ravel() for part in parts]) for parts in zip(*nodes, strict=True))

    def _distributed(self, x, y, light):
        """Grid of nodes with y >= 0 and their mirror images."""
        sigma, step = self.near_kernel.sigma, NEAR_STEP * self.setup.sigma
        half = int(np.ceil(REACH * sigma / step))
        pad = half + TILE + int(np.ceil(self.near_kernel.reach / step)) + 2
        left, right = int(np.floor(x.min() / step)) - pad, int(np.ceil(x.max() / step)) + pad
        bottom = int(np.floor(y.min() / step)) - pad
        mirrored = bottom <= pad
        bottom = -pad if mirrored else bottom
        rows, columns = int(np.ceil(y.max() / step)) + 1 + pad - bottom, right - left + 1
        grid = np.zeros((len(light), rows, columns))
        # nodes of one tile of the grid are distributed together, by a matrix product
        at_column, at_row = (np.rint(u / step).astype(int) // TILE * TILE for u in (x, y))
        order = np.lexsort((at_column, at_row))
        tile = at_row[order] * columns + at_column[order]
        size = np.arange(-half, TILE + half + 1)
        for part in np.split(order, np.flatnonzero(np.diff(tile)) + 1):
            column, row = at_column[part[0]], at_row[part[0]]
            over = _gaussian((column + size) * step - x[part, None], sigma) * step
            down = _gaussian((row + size) * step - y[part, None], sigma) * step
            left_end, low_end = column - half - left, row - half - bottom
            block = grid[:, low_end : low_end + size.size, left_end : left_end + size.size]
            for values, target in zip(light, block, strict=True):
                target += (down * values[part, None]).T @ over
        if mirrored:
            upper = grid[:, pad:].copy()
            upper[:, : pad + 1] += grid[:, pad::-1]
            grid[:, pad:], grid[:, :pad] = upper, upper[:, pad:0:-1]
        return Grid(grid, left * step, bottom * step, step, self.near_kernel)

    # elsewhere

    def _bulk(self, theta_d):
        r, step = self.setup.radius, self.bulk_step
        pad = int(np.ceil(self.bulk_kernel.reach / step)) + 4
        left = int(np.floor(min(0.0, -r * np.cos(2 * theta_d)) / step)) - pad
        columns = int(np.ceil(r / step)) + pad - left + 1
        y = np.arange(int((r - CAP + 6) / step) + 1) * step
        light = _integrals(self._row_nodes(theta_d, y, left, columns), (y.size, columns), self.light)
        grid = np.zeros((light.shape[0], 2 * pad + int(np.ceil(r / step)) + 1, columns))
        grid[:, pad : pad + y.size] = light * step
        grid[:, :pad] = grid[:, 2 * pad : pad : -1]
        return Grid(grid, left * step, -pad * step, step, self.bulk_kernel)

    def _row_nodes(self, theta_d, y, left, columns):
        """Integration nodes of rows over x: row, columns and their shares, arguments of the light, weights."""
        r, step, begins = self.setup.radius, self.bulk_step, 2 * theta_d - np.pi / 2
        rho = np.sqrt(np.maximum(r**2 - y**2, 0))
        first = np.ceil((rho * np.sin(begins) + MARGIN) / step).astype(int)
        last = np.floor((rho - MARGIN) / step).astype(int)
        whole = last - first >= 2 * len(_GREGORY)
        # the trapezoid rule
        column = np.arange(columns) + left
        inside = (column >= first[:, None]) & (column <= last[:, None]) & whole[:, None]
        row, at = np.nonzero(inside)
        x = column[at] * step
        n_z = np.sqrt(rho[row] ** 2 - x**2) / r
        ends = np.concatenate([_GREGORY, [1.0]])
        weight = ends[np.minimum(column[at] - first[row], 3)] * ends[np.minimum(last[row] - column[at], 3)] * step
        yield row, at[:, None], np.ones((1, 1)), self._seen(theta_d, x, y[row], n_z), weight / (4 * n_z)
        # from there to limb and terminator, over the longitude
        rows = np.flatnonzero(whole)
        limb = 2 * np.arcsin(np.sqrt((rho - last * step)[rows] / rho[rows] / 2))
        unit, share = _gauss(_EDGE)
        longitude = np.pi / 2 - limb[:, None] * unit
        yield self._on_longitudes(theta_d, rows, y, rho, longitude, limb[:, None] * share, left)
        terminator = np.arcsin(np.clip(first[rows] * step / rho[rows], -1, 1)) - begins
        longitude = begins + terminator[:, None] * unit
        yield self._on_longitudes(theta_d, rows, y, rho, longitude, terminator[:, None] * share, left)
        # rows that are too short
        rows = np.flatnonzero(~whole)
        unit, share = _gauss(_subdivided(_BOTH_EDGES, 12))
        longitude = np.broadcast_to(begins + (np.pi / 2 - begins) * unit, (rows.size, unit.size))
        yield self._on_longitudes(theta_d, rows, y, rho, longitude, (np.pi / 2 - begins) * share, left)

    def _on_longitudes(self, theta_d, rows, y, rho, longitude, weight, left):
        """Nodes on rows: normals whose angles to the camera in the plane of camera and lamp are given."""
        row = np.broadcast_to(rows[:, None], longitude.shape).ravel()
        weight, longitude = np.broadcast_to(weight, longitude.shape).ravel(), longitude.ravel()
        base, shares = _lagrange(rho[row] * np.sin(longitude) / self.bulk_step)
        r, cos = self.setup.radius, rho[row] / self.setup.radius
        cos_o, cos_i = cos * np.cos(longitude), cos * np.cos(2 * theta_d - longitude)
        cos_h = cos * np.cos(longitude - theta_d)
        s2 = ((cos * np.sin(longitude - theta_d)) ** 2 + (y[row] / r) ** 2) / cos_h**2
        seen = self._windowed(theta_d, s2, cos_i, cos_o, y[row])
        return row, base[:, None] - left + np.arange(6), shares, seen, weight * r / 4

    def _seen(self, theta_d, x, y, n_z):
        n_x, n_y = x / self.setup.radius, y / self.setup.radius
        cos_i = n_x * np.sin(2 * theta_d) + n_z * np.cos(2 * theta_d)
        cos_h = n_x * np.sin(theta_d) + n_z * np.cos(theta_d)
        s2 = ((n_x * np.cos(theta_d) - n_z * np.sin(theta_d)) ** 2 + n_y**2) / cos_h**2
        return self._windowed(theta_d, s2, cos_i, n_z, y)

    def _windowed(self, theta_d, s2, cos_i, cos_o, y):
        """Arguments of the light, and the share of it that the polar rule does not cover."""
        share = 1 - self._near_share(theta_d, s2, y)
        return s2, np.maximum(cos_i, 1e-12), np.maximum(cos_o, 1e-12), share


def _integrals(nodes, shape, light):
    total = 0.0
    for row, columns, shares, (s2, cos_i, cos_o, window), weight in nodes:
        used = window > 0
        values = light(s2[used], cos_i[used], cos_o[used]) * (window * weight)[used]
        index = (row[:, None] * shape[1] + columns)[used].ravel()
        shares = shares[used] if len(shares) > 1 else shares
        total = total + np.array(
            [np.bincount(index, (v[:, None] * shares).ravel(), shape[0] * shape[1]) for v in values]
        )
    return total.reshape(-1, *shape)


def _read(grid, x, y):
    half = int(np.ceil(grid.kernel.reach / grid.step))
    column, row = np.rint((x - grid.x) / grid.step).astype(int), np.rint((y - grid.y) / grid.step).astype(int)
    terms, rows, columns = grid.light.shape
    inside = (column >= half) & (column < columns - half) & (row >= half) & (row < rows - half)
    found = np.flatnonzero(inside)
    out = np.zeros((terms, x.size, 2))
    offsets = np.arange(-half, half + 1)
    size = max(_CHUNK // offsets.size**2, 1)
    for begin in range(0, found.size, size):
        part = found[begin : begin + size]
        dx = (grid.x + column[part] * grid.step - x[part])[:, None] + offsets * grid.step
        dy = (grid.y + row[part] * grid.step - y[part])[:, None] + offsets * grid.step
        over, down = grid.kernel.factors(dx, dy)
        turned = down if grid.kernel.mirrored else grid.kernel.factors(dx, -dy)[1]
        for k in range(terms):
            windows = sliding_window_view(grid.light[k], (offsets.size, offsets.size))
            lines = windows[row[part] - half, column[part] - half] @ over
            out[k, part, 0] = (lines * down).sum((1, 2))
            out[k, part, 1] = out[k, part, 0] if grid.kernel.mirrored else (lines * turned).sum((1, 2))
    return out


def _rise(distance):
    """Smooth step from 0 to 1, of a standard deviation of 1 px: a kernel's quadrature does not see it."""
    return np.where(distance < -6, 0.0, erfc(-distance / np.sqrt(2)) / 2)


def _gaussian(x, sigma):
    return np.exp(-((x / sigma) ** 2) / 2) / (np.sqrt(2 * np.pi) * sigma)


def _gauss(cuts):
    """Nodes and weights of Gauss's rule in panels."""
    size = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + size * (1 + _UNIT)).ravel(), (size * _SHARE).ravel()


def _subdivided(half, count):
    """Panels on [0, 1], graded towards both ends, `count` of them at least."""
    cuts = np.concatenate([half, 1 - half[-2::-1]])
    return np.unique(np.concatenate([cuts, np.arange(1, count) / count]))


def _lagrange(at):
    """First of 6 neighbours on the integers, and the weights of Lagrange's interpolation between them."""
    base = np.floor(at).astype(int) - 2
    u, points = (at - base)[:, None], np.arange(6)
    factors = [np.prod([(u[:, 0] - m) / (n - m) for m in points if m != n], axis=0) for n in points]
    return base, np.stack(factors, -1)
