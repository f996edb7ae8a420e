"""Values that are 0 because negative noise was clipped: censored observations (Tobin 1958).

A clipped cell states that its value with noise is at most 0, with the probability Phi(-z), where z = m / s, m is the modelled
value and s the standard deviation of the noise. With lambda = phi(z) / Phi(-z), the first two derivatives of its log-likelihood
are those of a normal observation of the value m - s / (lambda - z), whose variance is s^2 / (lambda (lambda - z)).
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

_CLIPPED_SHARE = 0.7
"""Share of zeros among the cells of a channel that are at least as far from the peaks as its zeros. If negative noise was
clipped, the share is at most about 1/2. If the values themselves are 0, for example in the tails of a simulated lobe, it is
about 1.
"""
_FAR = 50.0
"""Value of z from which lambda - z is computed by its asymptotic series, 1 / (z + 2 / z)."""


def clipped_values(values: np.ndarray, used: np.ndarray, theta_h: np.ndarray) -> np.ndarray:
    """Find the cells that are 0 because negative noise was clipped, (u, s, n).

    Args:
        values: values of the cells, 1/sr, (u, s, n).
        used: True for cells that have a value, (u, s, n).
        theta_h: half angles of the cells, rad, (s, n).
    """
    zero = used & (values == 0)
    innermost = np.where(zero, theta_h, np.inf).min(-1, keepdims=True)
    outside = (used & (theta_h >= innermost)).sum((-2, -1))
    few = zero.sum((-2, -1)) < _CLIPPED_SHARE * outside
    negative = (used & (values < 0)).any((-2, -1))
    return zero & (few & ~negative)[:, None, None]


def inside_clipped(clipped: np.ndarray, theta_h: np.ndarray) -> np.ndarray:
    """Select the cells that are closer to the peak than every clipped cell of their slice, (u, s, n)."""
    return theta_h < np.where(clipped, theta_h, np.inf).min(-1, keepdims=True)


def log_probability(z: np.ndarray) -> np.ndarray:
    """Compute ln Phi(-z), the log-likelihood of clipped cells, where z is the modelled value over its standard deviation."""
    return log_ndtr(-z)


def inverse_mills_ratio(z: np.ndarray) -> np.ndarray:
    """Compute lambda = phi(z) / Phi(-z)."""
    return np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(-z))


def as_normal(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residual, in standard deviations, and the information of the normal observations at z.

    The information is the inverse variance, in units of 1 / s^2.
    """
    near = np.minimum(z, _FAR)
    ratio = inverse_mills_ratio(near)
    far = np.maximum(z, _FAR)
    above = np.where(z > _FAR, 1 / (far + 2 / far), ratio - near)
    return -1 / above, (np.maximum(z, near) + above) * above
