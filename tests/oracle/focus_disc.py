"""The kernel of a lens out of focus by brute force: a square pixel and a Gaussian, at every point of the pupil."""

import numpy as np
from scipy.special import erf

_RADII, _TURNS = 8, 24


def kernel(x, y, sigma, half_width, disc):
    """Return the reading, 1/px^2, of points x, y px from the pixel's centre, whose light fills discs of these radii, px."""
    node, weight = np.polynomial.legendre.leggauss(_RADII)
    radius, share = (node + 1) / 2, weight / 2 * (node + 1)
    total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(disc)))
    unit = np.sqrt(2) * sigma
    for r, s in zip(radius, share, strict=True):
        for turn in 2 * np.pi * (np.arange(_TURNS) + 0.5) / _TURNS:
            line = [
                (erf((at + disc * r * part + half_width) / unit) - erf((at + disc * r * part - half_width) / unit))
                / (4 * half_width)
                for at, part in ((x, np.cos(turn)), (y, np.sin(turn)))
            ]
            total += s / _TURNS * line[0] * line[1]
    return total
