"""What one pixel records of a sphere under a distant point lamp, by adaptive quadrature over normals in polar coordinates
about the highlight's normal (docs/model.md 3): GGX (Walter et al. 2007, (33), (34)) and Lambert, a Gaussian lens, a box pixel.

Imports nothing of the package. Visible and lit are explicit limits of the azimuth; the kernel is followed to 10 standard
deviations, and the part of the sphere under it is all that is integrated over.
The azimuth by two fixed rules, whose difference is checked.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import cubature
from scipy.optimize import brentq
from scipy.special import erfc


def _towards_both_ends(order):
    """Gauss-Legendre (nodes, weights) on [0, 1] in panels that shrink towards both ends: masking ends in a layer that is
    as thin as the roughness is small."""
    half = np.array([0, 1e-4, 1e-3, 1e-2, 0.05, 0.15, 0.3, 0.5])
    cuts = np.concatenate([half, 1 - half[-2::-1]])
    unit, weight = np.polynomial.legendre.leggauss(order)
    size = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + size * (1 + unit)).ravel(), (size * weight).ravel()


_RULES = _towards_both_ends(14), _towards_both_ends(19)


class Surface(NamedTuple):
    """F = 1. separable: G1(i) G1(o) instead of height-correlated Smith."""

    alpha: float
    diffuse: float = 0.0
    separable: bool = False


class Setup(NamedTuple):
    """radius of the limb, px; distance of the camera from the sphere's centre, radii; lens and pixel, px."""

    radius: float = 256.0
    distance: float = np.inf
    sigma: float = 0.5
    half_width: float = 0.5


def position(theta_h, theta_d, phi_d, radius):
    """(x, y) px at which the picture with lamp and camera 2 theta_d apart shows the cell from the lamp's side
    (orthographic, docs/model.md 3); the other way is phi_d + pi."""
    psi = np.pi - phi_d
    x = np.cos(theta_h) * np.sin(theta_d) + np.sin(theta_h) * np.cos(psi) * np.cos(theta_d)
    return radius * x, radius * np.sin(theta_h) * np.sin(psi)


def recorded_cell(theta_h, theta_d, phi_d, surface, setup, rtol=1e-8):
    """(one way, other way) of a cell, 1/sr: the pixel at its centre over the light's cosine there; NaN below the horizon."""
    directions = []
    for phi in (phi_d, phi_d + np.pi):
        mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi)
        if min(mean - half, mean + half) <= 0:
            directions.append(np.nan)
            continue
        x, y = position(theta_h, theta_d, phi, setup.radius)
        directions.append(record(x, y, 2 * theta_d, surface, setup, rtol) / (mean - half))
    return tuple(directions)


def record(x, y, lamp_angle, surface, setup, rtol=1e-8):
    """Radiance per unit irradiance, 1/sr, that the pixel centred on (x, y) px records."""
    q = 1 / setup.distance
    stretch = setup.radius * np.sqrt(1 - q**2)
    u = _highlight(lamp_angle, q)
    reach = setup.half_width + 10 * setup.sigma
    normals = _under(x, y, reach, setup.radius, stretch, q)
    if not normals.size:
        return 0.0
    pole = np.array([np.sin(u), 0.0, np.cos(u)])
    theta = np.arctan2(np.linalg.norm(np.cross(normals, pole), axis=1), normals @ pole)
    pole_x, pole_y = stretch / (1 - q * pole[2]) * pole[:2]
    slack = 0.02 * np.ptp(theta) + 1e-9
    first = 0.0 if max(abs(x - pole_x), abs(y - pole_y)) < reach else max(theta.min() - slack, 0.0)
    last = theta.max() + slack
    scale = stretch / (1 - q * normals[:, 2])
    scales = scale.min() * 0.99, scale.max() * 1.01

    def integrand(at):
        theta = at[:, :1]
        sin, cos = np.sin(theta), np.cos(theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            # lit: n . l > 0, visible: n_z > q, as limits of cos psi
            lit = -cos / sin * np.cos(lamp_angle - u) / np.sin(lamp_angle - u) if lamp_angle > u else -np.inf * cos
            seen = (cos * pole[2] - q) / (sin * pole[0]) if u > 0 else np.inf * (cos - q)
        # under the kernel: n_x = cos sin(u) + sin cos(psi) cos(u)
        low = np.maximum(lit, (_lowest(x - reach, scales) - cos * pole[0]) / (sin * pole[2]))
        high = np.minimum(seen, (_highest(x + reach, scales) - cos * pole[0]) / (sin * pole[2]))
        low, high = np.clip(low, -1, 1), np.clip(high, -1, 1)
        total = np.zeros((theta.size, 2))
        for side in (1, -1):
            rows = _lowest(side * y - reach, scales), _highest(side * y + reach, scales)
            rise = [np.arcsin(np.clip(row / sin, 0, 1)) for row in rows]
            for begin, end in ((rise[0], rise[1]), (np.pi - rise[1], np.pi - rise[0])):
                begin, end = np.maximum(begin, np.arccos(high)), np.minimum(end, np.arccos(low))
                width = np.maximum(end - begin, 0.0)
                used = width[:, 0] > 0
                for k, (share, weight) in enumerate(_RULES):
                    psi = side * (begin[used] + share * width[used])
                    total[used, k] += (light(theta[used], psi) @ weight) * width[used, 0]
        return total * sin

    def light(theta, psi):
        sin, cos = np.sin(theta), np.cos(theta)
        across = sin * np.cos(psi)
        n_x, n_y = cos * pole[0] + across * pole[2], sin * np.sin(psi)
        n_z = cos * pole[2] - across * pole[0]
        depth = 1 - q * n_z
        offset = (stretch * n_x / depth - x, stretch * n_y / depth - y)
        view = np.array([-q * n_x, -q * n_y, depth])
        length = np.sqrt((view**2).sum(0))
        cos_o = (n_z - q) / length
        lamp = np.array([np.sin(lamp_angle), 0.0, np.cos(lamp_angle)])
        cos_i = n_x * lamp[0] + n_z * lamp[2]
        sent = _reflected(surface, np.array([n_x, n_y, n_z]), lamp, view / length, cos_i, cos_o)
        kernel = _kernel(offset[0], setup) * _kernel(offset[1], setup)
        # dx dy = stretch^2 (n_z - q) / depth^3 d omega, n_z - q = cos_o length: the cosine is in `sent`
        return np.where((cos_i > 0) & (cos_o > 0), kernel * sent * stretch**2 * length / depth**3, 0.0)

    borders = np.arccos(q) - u, np.pi / 2 - (lamp_angle - u)
    cuts = [first, last, np.median(theta), *borders, *surface.alpha * 4.0 ** np.arange(-1, 8)]
    cuts = np.unique(np.clip(cuts, first, last))
    parts = [(a, b) for a, b in zip(cuts[:-1], cuts[1:], strict=True) if b - a > 1e-14]
    # a rough total says what a part may err by
    rough = sum(cubature(integrand, [a], [b], rtol=1e-2, max_subdivisions=5).estimate for a, b in parts)
    allowed = rtol * abs(rough[1]) / len(parts)
    found = [cubature(integrand, [a], [b], rtol=rtol, atol=allowed, max_subdivisions=500) for a, b in parts]
    coarse, fine = sum(part.estimate for part in found)
    where = x, y, lamp_angle, surface, setup
    assert all(part.status == "converged" for part in found), where
    assert abs(coarse - fine) <= 10 * rtol * fine, where
    return float(fine)


def _lowest(edge, scales):
    """Smallest component of a normal that lies at `edge` px or beyond, at any of the scales, px."""
    return min(edge / s for s in scales)


def _highest(edge, scales):
    return max(edge / s for s in scales)


def _highlight(lamp_angle, q):
    """Angle from the axis of the normal that is the half vector."""

    def miss(u):
        return 2 * u + np.arctan2(q * np.sin(u), 1 - q * np.cos(u)) - lamp_angle

    return 0.0 if lamp_angle == 0 else brentq(miss, 0, lamp_angle, xtol=1e-15, rtol=1e-15)


def _under(x, y, reach, radius, stretch, q):
    """Normals along the border of what the kernel's square shows: its sides inside the limb, the limb inside of it."""
    t = np.linspace(-1, 1, 401)
    square = np.concatenate([np.stack([t, s + 0 * t], -1) for s in (-1, 1)])
    square = np.concatenate([square, square[:, ::-1], np.stack([t, 0 * t], -1)]) * reach + [x, y]
    turn = np.linspace(0, 2 * np.pi, 40001)
    limb = radius * (1 - 1e-15) * np.stack([np.cos(turn), np.sin(turn)], -1)
    limb = limb[(np.abs(limb - [x, y]) <= reach).all(-1)]
    points = np.concatenate([square[np.hypot(*square.T) < radius], limb])
    slope2 = (points**2).sum(-1) / stretch**2
    n_z = (slope2 * q + np.sqrt(np.maximum(1 - slope2 * (1 - q**2), 0))) / (1 + slope2 * q**2)
    return np.concatenate([points / stretch * (1 - q * n_z)[:, None], n_z[:, None]], axis=-1)


def _kernel(x, setup):
    unit, x = np.sqrt(2) * setup.sigma, np.abs(x)
    return (erfc((x - setup.half_width) / unit) - erfc((x + setup.half_width) / unit)) / (4 * setup.half_width)


def _reflected(surface, normal, lamp, view, cos_i, cos_o):
    """D G / 4 + diffuse cos_i cos_o / pi."""
    half = view + lamp[:, None, None]
    cross = np.cross(half, normal, axis=0)
    tan2 = (cross**2).sum(0) / (half * normal).sum(0) ** 2
    d = (surface.alpha * (1 + tan2) / (surface.alpha**2 + tan2)) ** 2 / np.pi
    cosines = np.maximum(cos_i, 1e-150), np.maximum(cos_o, 1e-150)
    lambda_i, lambda_o = (np.sqrt(1 + surface.alpha**2 * (1 / c**2 - 1)) / 2 - 0.5 for c in cosines)
    g = 1 / ((1 + lambda_i) * (1 + lambda_o)) if surface.separable else 1 / (1 + lambda_i + lambda_o)
    return d * g / 4 + surface.diffuse * cos_i * cos_o / np.pi
