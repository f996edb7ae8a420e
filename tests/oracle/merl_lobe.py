"""What a rig records of a Gaussian lobe on the MERL grid, written down a second time (docs/model.md 3, 4, 5), with pixel noise.

Imports nothing of the package: this is the truth that the inverse is judged by.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import quad
from scipy.special import erf

THETA_H = ((np.arange(90) + 0.5) / 90) ** 2 * np.pi / 2
THETA_D = np.radians(np.arange(90) + 0.5)
PHI_D = np.radians(np.arange(180) + 0.5)


class Rig(NamedTuple):
    sigma_mtf: float = 0.5
    sigma_p: float = 0.5
    radius: float = 256.0


PAPER = Rig()


def conductor(theta, n, k):
    """Unpolarised reflectance, from the amplitudes of s and p waves."""
    m = n + 1j * k
    ci = np.cos(theta)
    ct = np.sqrt(1 - (np.sin(theta) / m) ** 2)
    rs = (ci - m * ct) / (ci + m * ct)
    rp = (m * ci - ct) / (m * ci + ct)
    return (abs(rs) ** 2 + abs(rp) ** 2) / 2


def b(u, s, sigma_mtf, sigma_p):
    """Record of a line of unit peak and Gaussian profile of std s, u px away."""
    wide = np.sqrt(2 * (s**2 + sigma_mtf**2))
    return s / (2 * sigma_p) * np.sqrt(np.pi / 2) * (erf((u + sigma_p) / wide) - erf((u - sigma_p) / wide))


def record(width, reflectance, rig=PAPER):
    """Noise-free table (90, 90, 180, channels), 1/sr, NaN below the horizon; G = 1. reflectance: (90, channels)."""
    d0 = 1 / (2 * np.pi * quad(lambda t: np.exp(-(t**2) / 2 / width**2) * np.sin(t) * np.cos(t), 0, min(np.pi / 2, 40 * width),
                               epsabs=0, epsrel=1e-13, limit=200)[0])  # fmt: skip
    th, td, ph = THETA_H[:, None, None], THETA_D[None, :, None], PHI_D[None, None, :]
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    cos_i, cos_o = mean - half, mean + half
    s = width * rig.radius
    lobe = b(-rig.radius * np.cos(td) * th * np.cos(ph), s * np.cos(td), rig.sigma_mtf, rig.sigma_p)
    lobe = lobe * b(rig.radius * th * np.sin(ph), s, rig.sigma_mtf, rig.sigma_p)
    with np.errstate(divide="ignore", invalid="ignore"):
        table = (lobe * d0 / (4 * cos_i * cos_o))[..., None] * reflectance[None, :, None, :]
    table[(cos_i <= 0) | (cos_o <= 0)] = np.nan
    return table


class PixelMap:
    """For every cell, the pixel it was read from one way and the other, in the picture of its theta_d."""

    def __init__(self, radius=256.0):
        th, ph = np.meshgrid(THETA_H, PHI_D, indexing="ij")
        self.pairs = []
        for td in THETA_D:
            directions = []
            for psi in (np.pi - ph, 2 * np.pi - ph):
                x = radius * (np.cos(th) * np.sin(td) + np.sin(th) * np.cos(psi) * np.cos(td))
                y = radius * np.sin(th) * np.sin(psi)
                directions.append(np.floor(x + 0.5) * 4096 + np.floor(y + 0.5))
            _, index = np.unique(np.stack(directions), return_inverse=True)
            self.pairs.append((index.max() + 1, index.reshape(2, *th.shape)))

    def noisy(self, table, rng, relative=0.01, floor=1e-4):
        """Each pixel `relative` of its value plus `floor` of its picture's peak; a cell is the mean of its two pixels."""
        result = table.copy()
        for j, (count, index) in enumerate(self.pairs):
            e = rng.standard_normal((2, count, table.shape[-1]))
            gain, offset = e[0][index].mean(0), e[1][index].mean(0)
            picture = table[:, j]
            result[:, j] = picture * (1 + relative * gain) + floor * np.nanmax(picture) * offset
        return result
