"""Cells of a table recorded on a cylinder, each under the lamp that shows it: by turned vectors (docs/model.md 3).

Imports nothing of the package. The cell's directions are built in the surface's own frame from half and difference angles,
then carried to the camera's, in which the view is z and the normal lies in the plane of x and z. Panels over the sensor's x
end at the pixel's borders, at the ends of the light and about the place closest to the half vector.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import erf

_ORDER = np.polynomial.legendre.leggauss(14)


class Lens(NamedTuple):
    """A sum of Gaussians before a box: shares, standard deviations and half width, px; aperture and focus of docs/model.md."""

    share: tuple
    sigma: tuple
    half_width: float

    aperture: float = 0.0
    focus: float = 0.0

    def out_of_focus(self, t, radius, n_z):
        """The kernel where a lens spreads what it shows over a disc: its mean over the columns of the pupil."""
        if not self.aperture:
            return self.kernel(t)
        turn = np.arange(1, 40) * np.pi / 40  # the columns of a disc: Chebyshev's second rule
        disc = radius * self.aperture * (n_z - np.cos(self.focus)) / 2
        return sum(np.sin(at) ** 2 * self.kernel(t + disc * np.cos(at)) for at in turn) / 20

    def kernel(self, t):
        parts = [
            w
            * (erf((t + self.half_width) / (s * 2**0.5)) - erf((t - self.half_width) / (s * 2**0.5)))
            / (4 * self.half_width)
            for w, s in zip(self.share, self.sigma, strict=True)
        ]
        return sum(parts)


def directions(theta_h, theta_d, phi_d):
    """Normal, light and view of a cell in the camera's frame (Rusinkiewicz 1998)."""
    # in the surface's frame the half vector lies at azimuth 0
    d = np.array([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)])
    turn = np.array([[np.cos(theta_h), 0, np.sin(theta_h)], [0, 1, 0], [-np.sin(theta_h), 0, np.cos(theta_h)]])
    half, light, normal = turn @ [0, 0, 1], turn @ d, np.array([0.0, 0, 1])
    view = 2 * (light @ half) * half - light
    x = normal - (normal @ view) * view
    size = np.linalg.norm(x)
    x = x / size if size > 1e-9 else np.array([1.0, 0, 0])
    frame = np.stack([x, np.cross(view, x), view])
    return frame @ normal, frame @ light, frame @ view


def record(lobe, masking, radius, lens, theta_h, theta_d, phi_d, width):
    """The BRDF of F = 1 that a cell reads one way, 1/sr. masking: of cosines of light and view. width: of the lobe."""
    normal, light, _ = directions(theta_h, theta_d, phi_d)
    if min(normal[2], normal @ light) <= 0:
        return np.nan
    x0 = radius * normal[0]
    reach = 7.5 * max(lens.sigma) + lens.half_width + radius * lens.aperture / 2
    half = light + np.array([0, 0, 1.0])
    half /= np.linalg.norm(half)
    peak = np.arctan2(half[0], half[2])
    middle = np.arctan2(light[0], light[2])
    low, high = max(-np.pi / 2, middle - np.pi / 2), min(np.pi / 2, middle + np.pi / 2)
    low = max(low, np.arcsin(np.clip((x0 - reach) / radius, -1, 1)))
    high = min(high, np.arcsin(np.clip((x0 + reach) / radius, -1, 1)))
    cuts = [
        np.arcsin(np.clip((x0 + t) / radius, -1, 1))
        for t in (-lens.half_width, lens.half_width, *np.arange(-30, 31) * reach / 30)
    ]
    cuts += [peak + side * width * 2.0**k for k in range(-4, 14) for side in (-1, 0, 1)]
    cuts += [end + side * width * 2.0**k for k in range(-3, 6) for end, side in ((low, 1), (high, -1))]
    cuts = np.unique(np.clip([low, high, *cuts], low, high))
    a, b = cuts[:-1, None], cuts[1:, None]
    u, w = (a + b) / 2 + (b - a) / 2 * _ORDER[0], (b - a) / 2 * _ORDER[1]
    n = np.stack([np.sin(u), 0 * u, np.cos(u)])
    cos_h = np.tensordot(half, n, 1)
    cross = np.linalg.norm(np.cross(n.reshape(3, -1).T, half), axis=1).reshape(u.shape)
    cos_i, cos_o = np.tensordot(light, n, 1), n[2]
    lit = lobe((cross / cos_h) ** 2) / cos_h**4 * masking(cos_i, cos_o) / 4
    return float(np.sum(w * radius * lens.out_of_focus(x0 - radius * np.sin(u), radius, n[2]) * lit) / (normal @ light))
