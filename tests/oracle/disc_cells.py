"""Cells of a distant sphere under a distant lamp's disc: truth for fits (docs/model.md 3), by brute force.

Imports nothing of the package. The record is the mean over points of the disc (evenly over its solid angle: Gauss-Legendre in
the height of the cap, equal steps round it). Under each point the lobe is integrated over a polar grid of normals about that
point's own half vector, graded towards it, each with its own cosines. Cells whose pixel lies further than `NEAR` px from
all that the disc's highlight covers are those of `sphere_cells`: there a disc and a Gaussian of its variance are one to 3e-4.
"""

import numpy as np
from scipy.special import erfc

from tests.oracle import sphere_cells

NEAR = sphere_cells.NEAR
_AZIMUTHS = 240
_ORDER = np.polynomial.legendre.leggauss(8)


class DiscCells:
    """theta_h, phi_d: (slices, cells); theta_d: (slices,); setup: its lamp is the disc's radius, rad; finest: a slope below
    which the lobe has no structure; fineness: points of the disc for each sigma of its image."""

    def __init__(self, theta_h, theta_d, phi_d, setup, finest, fineness=1.0):
        self.setup, self.finest, self.fineness = setup, finest, fineness
        self.far = sphere_cells.Cells(theta_h, theta_d, phi_d, setup, finest=finest / 30)
        self.theta_d, self.good = theta_d, self.far.good

    def directions(self, lobe, reflectance=np.ones_like):
        """What is recorded one way and the other, 1/sr: (slices, cells, 2), NaN where left out. reflectance: F of theta_d,
        which is each point's own."""
        out = self.far.directions(lobe) * reflectance(self.theta_d)[:, None, None]
        for j, td in enumerate(self.theta_d):
            image = self.setup.lamp / 2 * self.setup.radius / np.cos(td)
            near = self.good[j] & (
                np.hypot(self.far.x[j] - self.setup.radius * np.sin(td), self.far.y[j]) < NEAR + image
            )
            pixels = self.far.x[j][near], self.far.y[j][near]
            record = _record(lobe, reflectance, *pixels, td, self.setup, self.finest, self.fineness)
            out[j][near] = record / self.far.cos_i[j][near]
        return out


def _record(lobe, reflectance, x, y, theta_d, setup, finest, fineness):
    """Integral of F D G / 4 over the sphere through pixels at x, y."""
    theta, phi, area = _nodes(finest, setup, theta_d)
    light = lobe.p22(np.tan(theta) ** 2) / np.cos(theta) ** 4 * area * setup.radius**2 / 4
    local = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    total, reach = np.zeros(x.shape), setup.half_width + 7 * setup.sigma
    for towards, share in _points(theta_d, setup, fineness):
        half = towards + np.array([0, 0, 1.0])
        half /= np.linalg.norm(half)
        share = share * reflectance(np.arccos(half[2:]))[0]
        first = np.cross([0, 1.0, 0], half)
        first /= np.linalg.norm(first)
        frame = first, np.cross(half, first), half
        normal = [sum(part * axis[i] for part, axis in zip(local, frame, strict=True)) for i in range(3)]
        cos_i, cos_o = sum(n * t for n, t in zip(normal, towards, strict=True)), normal[2]
        seen = (cos_i > 1e-9) & (cos_o > 1e-9)
        order = np.flatnonzero(seen)[np.argsort(normal[1][seen])]
        at_x, at_y = (setup.radius * normal[i][order] for i in (0, 1))
        sent = light[order] / (1 + lobe.smith(cos_i[order]) + lobe.smith(cos_o[order]))
        for n in range(x.size):
            begin, end = np.searchsorted(at_y, [y[n] - reach, y[n] + reach])
            inside = begin + np.flatnonzero(np.abs(at_x[begin:end] - x[n]) < reach)
            kernel = _kernel(at_x[inside] - x[n], setup) * _kernel(at_y[inside] - y[n], setup)
            total[n] += share * (kernel @ sent[inside])
    return total


def _nodes(finest, setup, theta_d):
    """Angles from the half vector, azimuths about it and solid angles."""
    last = min((2 * NEAR + setup.lamp * setup.radius / np.cos(theta_d)) / setup.radius / np.cos(theta_d), 1.4)
    cuts = np.concatenate([[0], finest * 1.6 ** np.arange(-8, 14), np.arange(0.8, 200, 0.8) / setup.radius])
    cuts = np.unique(cuts[cuts < last])
    widths = np.diff(cuts)
    theta = (cuts[:-1, None] + widths[:, None] * (_ORDER[0] + 1) / 2).ravel()
    weight = (widths[:, None] / 2 * _ORDER[1]).ravel() * np.sin(theta) * 2 * np.pi / _AZIMUTHS
    phi = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    return np.repeat(theta, _AZIMUTHS), np.tile(phi, theta.size), np.repeat(weight, _AZIMUTHS)


def _points(theta_d, setup, fineness):
    """(direction, share) of points of the disc."""
    ratio = setup.lamp / 2 * setup.radius / np.cos(theta_d) / setup.sigma * fineness
    rings, spokes = int(np.ceil(1.3 + 0.8 * ratio)), int(np.ceil(6.5 + 3.2 * ratio))
    x, w = np.polynomial.legendre.leggauss(rings)
    turns = 2 * np.pi * (np.arange(spokes) + 0.3) / spokes
    for height, weight in zip((1 + x) / 2, w / 2, strict=True):
        up = 1 - height * (1 - np.cos(setup.lamp))
        aside = np.sqrt(1 - up**2)
        for turn in turns:
            along, across = aside * np.cos(turn), aside * np.sin(turn)
            sin, cos = np.sin(2 * theta_d), np.cos(2 * theta_d)
            yield np.array([up * sin + along * cos, across, up * cos - along * sin]), weight / spokes


def _kernel(x, setup):
    unit, x = np.sqrt(2) * setup.sigma, np.abs(x)
    ends = erfc((x - setup.half_width) / unit) - erfc((x + setup.half_width) / unit)
    return ends / (4 * setup.half_width)
