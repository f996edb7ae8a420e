"""What one pixel of a table records of a GGX lobe through a lens that is limited by diffraction, by sums over normals in polar
coordinates about the highlight's normal (docs/model.md 3) and over points of the pixel: Airy's pattern in closed form (Goodman,
Introduction to Fourier Optics, 4.4.2), a distant camera and lamp, a box pixel of 100 % fill.

Imports nothing of the package. Nodes are fine about the highlight and everywhere within `AROUND` px of it: cells must lie
there, and further than that from limb and terminator.
"""

import numpy as np
from scipy.special import j1

AROUND = 24.0
"""px."""
_PIXEL = np.polynomial.legendre.leggauss(10)
_AZIMUTHS = 480


def recorded_way(theta_h, theta_d, phi_d, alpha, cutoff, radius=256.0, kernel=None):
    """Radiance over the light's cosine at the cell's centre, 1/sr at F = 1.

    cutoff: of the lens, cycles/px. kernel: of another lens, a function of the pixel's offsets from the point, px, that has the
    pixel in it already (tests/oracle/aberrated.py).
    """
    edges = np.concatenate([[0], np.geomspace(1e-3, 2, 60), np.arange(2.2, AROUND / np.cos(theta_d), 0.2)]) / radius
    unit, weight = np.polynomial.legendre.leggauss(2)
    size = np.diff(edges)[:, None] / 2
    theta, ring = (edges[:-1, None] + size * (1 + unit)).ravel(), (size * weight).ravel()
    psi = 2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    theta, psi = (a.ravel() for a in np.meshgrid(theta, psi, indexing="ij"))
    ring = np.repeat(ring, _AZIMUTHS) * 2 * np.pi / _AZIMUTHS
    n_x, n_y, cos_i, cos_o = _seen(theta, psi, theta_d)
    lit = (cos_i > 0) & (cos_o > 0)
    d = (alpha / (np.cos(theta) ** 2 * (alpha**2 - 1) + 1)) ** 2 / np.pi
    tails = sum((np.sqrt(1 + alpha**2 * (1 / np.maximum(c, 1e-9) ** 2 - 1)) - 1) / 2 for c in (cos_i, cos_o))
    light = np.where(lit, d / (1 + tails) / 4 * np.sin(theta) * ring * radius**2, 0.0)
    x, y, cos_here, _ = _seen(theta_h, np.pi - phi_d, theta_d)
    if kernel is not None:
        near = np.hypot(n_x - x, n_y - y) * radius < AROUND
        seen = kernel(radius * (x - n_x[near]), radius * (y - n_y[near]))
        return float(light[near] @ seen) / cos_here
    total = 0.0
    for at_x, w_x in zip(*_PIXEL, strict=True):
        for at_y, w_y in zip(*_PIXEL, strict=True):
            r = np.hypot(radius * (n_x - x) - at_x / 2, radius * (n_y - y) - at_y / 2)
            total += w_x * w_y / 4 * float(light @ _airy(r, cutoff))
    return total / cos_here


def _seen(theta, psi, theta_d):
    """Normal's x and y, cosines of light and view."""
    n_x = np.cos(theta) * np.sin(theta_d) + np.sin(theta) * np.cos(psi) * np.cos(theta_d)
    mean, half = np.cos(theta) * np.cos(theta_d), np.sin(theta) * np.sin(theta_d) * np.cos(psi)
    return n_x, np.sin(theta) * np.sin(psi), mean + half, mean - half


def _airy(r, cutoff):
    v = np.maximum(np.pi * cutoff * r, 1e-9)
    return np.pi / 4 * cutoff**2 * (2 * j1(v) / v) ** 2
