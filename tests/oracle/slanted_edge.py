"""Pictures of slanted edges as exact integrals over square pixels, and what can be known from them at best (docs/model.md 7).

Coordinates: px from the picture's centre, x along the rows, y down; the bright side lies at larger x. Imports nothing of
the package: this is the truth that the edge's estimator is judged by.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

HEIGHT, WIDTH = 160, 80
DARK, BRIGHT = 0.25, 1.0


def grid(height=HEIGHT, width=WIDTH):
    """x and y of every pixel's centre, (height, width)."""
    y, x = np.mgrid[:height, :width].astype(float)
    return x - (width - 1) / 2, y - (height - 1) / 2


def normal_pdf(t):
    return np.exp(-t * t / 2) / np.sqrt(2 * np.pi)


def edge(distance, angle, sigma, half_width=0.5):
    """A Gaussian-blurred 0-1 edge, integrated over a square at an angle: the second difference of the normal
    distribution's second antiderivative."""

    def twice(x):
        t = x / sigma
        return sigma**2 / 2 * ((t * t + 1) * ndtr(t) + t * normal_pdf(t))

    a, b = half_width * abs(np.cos(angle)), half_width * abs(np.sin(angle))
    corners = twice(distance + a + b) - twice(distance + a - b) - twice(distance - a + b) + twice(distance - a - b)
    return corners / (4 * a * b)


def gaussian(sigma, degrees=5.0, half_width=0.5, **size):
    """Edge response of every pixel, for a straight edge through the centre whose normal is at an angle to the rows."""
    x, y = grid(**size)
    angle = np.radians(degrees)
    return edge(x * np.cos(angle) + y * np.sin(angle), angle, sigma, half_width)


def curved_gaussian(sigma, bow, degrees=5.0, half_width=0.5):
    """The same for a parabolic edge x0(y) that leaves its chord by `bow` px along the rows.

    A Gaussian and a square are separable: along x the response is the integral of the normal distribution over the box,
    along y an average over where the edge is, weighted by box * Gaussian. No distance, no angle, no approximation.
    """
    x, y = grid()
    nodes, weights = np.polynomial.legendre.leggauss(64)
    reach = half_width + 7 * sigma
    u = reach * nodes
    along = (ndtr((u + half_width) / sigma) - ndtr((u - half_width) / sigma)) / (2 * half_width) * reach * weights

    def across(t):
        once = lambda v: v * ndtr(v / sigma) + sigma * normal_pdf(v / sigma)  # noqa: E731
        return (once(t + half_width) - once(t - half_width)) / (2 * half_width)

    total = np.zeros_like(x)
    for shift, weight in zip(u, along, strict=True):
        v = y - shift
        total += weight * across(x + np.tan(np.radians(degrees)) * v - bow * ((2 * v / HEIGHT) ** 2 - 0.5))
    return total / along.sum()


def box_mtf(f, degrees, half_width=0.5):
    angle = np.radians(degrees)
    return np.sinc(2 * half_width * f * np.cos(angle)) * np.sinc(2 * half_width * f * np.sin(angle))


def gaussian_mtf(f, sigma, degrees=5.0, half_width=0.5):
    return np.exp(-2 * (np.pi * sigma * f) ** 2) * box_mtf(f, degrees, half_width)


def airy_mtf(f, cutoff, degrees=5.0):
    nu = np.clip(np.abs(f) / cutoff, 0, 1)
    return 2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2)) * box_mtf(f, degrees)


def defocused_mtf(f, cutoff, blur, degrees=5.0):
    """Hopkins: the pupil's autocorrelation with a quadratic phase, integrated over the overlap; `blur` px in diameter."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    values = []
    for nu in np.clip(np.abs(np.atleast_1d(f)) / cutoff, 0, 1):
        half = 1 - nu  # of the overlap along the shift, in pupil radii
        u = nu + half * (nodes + 1) / 2
        wave = np.cos(np.pi * blur * nu * cutoff * (u - nu)) * np.sqrt(1 - u**2)
        values.append(4 / np.pi * half / 2 * (wave @ weights))
    return np.array(values) * box_mtf(f, degrees)


def edge_of(mtf, cutoff, degrees=5.0, panels=260):
    """Edge response of every pixel, of any even MTF that ends at `cutoff` cycles/px, by Gauss-Legendre over frequency."""
    x, y = grid()
    distance = (x * np.cos(np.radians(degrees)) + y * np.sin(np.radians(degrees))).ravel()
    nodes, weights = np.polynomial.legendre.leggauss(16)
    borders = np.linspace(0, 1, panels + 1)
    t = (borders[:-1, None] + np.diff(borders)[:, None] * (nodes + 1) / 2).ravel()
    dt = (np.diff(borders)[:, None] * weights / 2).ravel()
    f, df = cutoff * t * (2 - t), cutoff * 2 * (1 - t) * dt  # smooth where the MTF ends as a power of 3/2
    amplitude = mtf(f) * df / (np.pi * f)
    parts = [np.sin(2 * np.pi * np.outer(some, f)) @ amplitude for some in np.array_split(distance, 40)]
    return 0.5 + np.concatenate(parts).reshape(x.shape)


def picture(response, light=(0.0, 0.0)):
    """Expected values in units of the bright level; light: relative change over the whole width and height."""
    x, y = grid(*response.shape)
    even = DARK + (BRIGHT - DARK) * response
    return even * (1 + light[0] * x / response.shape[1] + light[1] * y / response.shape[0])


def photographs(response, snr, count, seed, light=(0.0, 0.0)):
    """(count, height, width) pictures in electrons, bright level snr^2, Poisson noise."""
    expected = picture(response, light) * snr**2
    return np.random.default_rng(seed).poisson(expected, size=(count, *expected.shape)).astype(float)


def half_frequency(mtf):
    """MTF50, cycles/px."""
    return brentq(lambda f: float(np.squeeze(mtf(f))) - 0.5, 1e-3, 1.2, xtol=1e-13)


def gaussian_half(sigma, degrees=5.0, half_width=0.5):
    return half_frequency(lambda f: gaussian_mtf(f, sigma, degrees, half_width))


def bound_of_half(sigma, snr, degrees=5.0):
    """Cramer-Rao bound of MTF50, relative, with levels, light (x, y), the edge's place, slope and bow, and sigma free."""
    x, y = grid()

    def expected(p):
        dark, bright, gx, gy, position, slope, bow, s = p
        t = -np.tan(np.radians(degrees)) + slope
        c = 1 / np.hypot(1, t + 2 * bow * y)
        response = edge((x - position - t * y - bow * y**2) * c, np.arctan(t), s)
        return (dark + (bright - dark) * response) * (1 + gx * x + gy * y) * snr**2

    at = np.array([DARK, BRIGHT, 0, 0, 0, 0, 0, sigma])
    steps = np.array([1e-4, 1e-4, 1e-6, 1e-6, 1e-4, 1e-6, 1e-8, 1e-4])
    design = np.array(
        [(expected(at + d) - expected(at - d)).ravel() / (2 * s) for d, s in zip(np.diag(steps), steps, strict=True)]
    )
    scaled = design * steps[:, None]
    covariance = np.linalg.inv((scaled / expected(at).ravel()) @ scaled.T)
    slope = (gaussian_half(sigma + 1e-5) - gaussian_half(sigma - 1e-5)) / 2e-5
    return abs(slope) * np.sqrt(covariance[-1, -1]) * steps[-1] / gaussian_half(sigma, degrees)
