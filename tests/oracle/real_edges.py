"""Pictures of edges as they come: under bad light, bent, dirty, processed. Truth for the edge's estimator.

A pixel is the edge's light integrated over its square by quadrature: along x in closed form, along y by Gauss-Legendre over
box and Gaussian. Then come the light's fields, ghosts, noise, dirt and what a camera's software does. Coordinates: px from the
picture's centre, x along the rows, y down; the bright side lies at larger x. Imports nothing of the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

DARK, BRIGHT = 0.25, 1.0


def grid(height, width):
    """x and y of every pixel's centre, (height, width)."""
    y, x = np.mgrid[:height, :width].astype(float)
    return x - (width - 1) / 2, y - (height - 1) / 2


def response(sigma, degrees=5.0, size=(100, 80), course=None, offset=0.0):
    """Edge response of every pixel, 0 to 1. `course(v)`: px along x that the edge leaves its straight line by."""
    x, y = grid(*size)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    reach = 0.5 + 6.5 * sigma
    u = reach * nodes
    kernel = (ndtr((u + 0.5) / sigma) - ndtr((u - 0.5) / sigma)) * weights

    def box_of_step(t):
        once = lambda v: v * ndtr(v / sigma) + sigma * np.exp(-((v / sigma) ** 2) / 2) / np.sqrt(2 * np.pi)  # noqa: E731
        found = np.where(t > 0, 1.0, 0.0)
        near = np.abs(t) < 0.5 + 9 * sigma  # beyond, the step has ended to 1e-19
        found[near] = once(t[near] + 0.5) - once(t[near] - 0.5)
        return found

    total = np.zeros_like(x)
    for shift, weight in zip(u, kernel, strict=True):
        v = y - shift
        position = offset - np.tan(np.radians(degrees)) * v + (0.0 if course is None else course(v))
        total += weight * box_of_step(x - position)
    return total / kernel.sum()


def half(sigma, degrees):
    """MTF50 of Gaussian lens and square pixel along the normal."""
    a = np.radians(degrees)

    def mtf(f):
        box = np.sinc(f * np.cos(a)) * np.sinc(f * np.sin(a))
        return np.exp(-2 * (np.pi * sigma * f) ** 2) * box - 0.5

    return brentq(mtf, 1e-3, 1.5, xtol=1e-13)


def exposed(scene, snr, rng):
    """Photo-electrons of a scene whose bright level is 1."""
    return rng.poisson(np.maximum(scene, 0) * snr**2).astype(float)


def printed(of, sigma, size=(100, 80), fine=4):
    """What a camera sees of any print `of(x, y)`, 0 to 1: sampled finely, blurred, summed over pixels."""
    from scipy.ndimage import gaussian_filter

    height, width = size
    y, x = (np.mgrid[: fine * height, : fine * width] + 0.5) / fine - 0.5
    seen = gaussian_filter(of(x - (width - 1) / 2, y - (height - 1) / 2).astype(float), fine * sigma, mode="nearest")
    return seen.reshape(height, fine, width, fine).mean((1, 3))


def levels(of):
    return DARK + (BRIGHT - DARK) * of


def soft_step(t, width):
    return ndtr(t / width)


# ---------------------------------------------------------------- light: a factor and an addend of every pixel


def along(strength):
    return lambda x, y: (1 - strength * (y / np.ptp(y) + 0.5), 0.0)


def shadow(strength, degrees=90.0, width=8.0):
    """A soft shadow; 90 degrees: across the rows."""
    a = np.radians(degrees)
    return lambda x, y: (1 - strength * soft_step(x * np.cos(a) + y * np.sin(a), width), 0.0)


def dip(strength):
    return lambda x, y: (1 - strength * ((2 * x / np.ptp(x)) ** 2 + (2 * y / np.ptp(y)) ** 2), 0.0)


def dip_across(strength):
    return lambda x, y: (1 - strength * (2 * x / np.ptp(x)) ** 2, 0.0)


def flare(strength):
    return lambda x, y: (1.0, strength * (x / np.ptp(x) + 0.5))


def lit(of, light):
    x, y = grid(*of.shape)
    factor, addend = light(x, y)
    return factor * levels(of) + addend


def cubic(bend, length):
    """An S: `bend` px at most off its chord, odd in y."""
    return lambda v: bend * ((t := 2 * v / length) ** 3 - t) / (2 / 3**1.5)


def rough(rms, rng, correlation=3.0):
    """A printed edge."""
    from scipy.ndimage import gaussian_filter1d

    fine = 4
    bumps = gaussian_filter1d(rng.normal(size=4000), correlation * fine / np.sqrt(2))
    bumps *= rms / bumps.std()
    positions = (np.arange(4000) - 2000) / fine
    return lambda v: np.interp(v, positions, bumps)


# ---------------------------------------------------------------- dirt and software: what comes after the light


def with_pixels(counts, positions, factor):
    """Hot (factor > 1) or dead (0) pixels."""
    counts = counts.copy()
    for y, x in positions:
        counts[y, x] *= factor
    return counts


def near_edge(count, rng, size, degrees):
    height, width = size
    rows = rng.integers(0, height, count)
    columns = (width - 1) / 2 - np.tan(np.radians(degrees)) * (rows - (height - 1) / 2) + rng.uniform(-5, 5, count)
    return list(zip(rows, np.rint(columns).astype(int), strict=True))


def dusty(scene, position, radius, depth):
    x, y = grid(*scene.shape)
    return scene * (1 - depth * ((x - position[0]) ** 2 + (y - position[1]) ** 2 < radius**2))


def crushed(counts, black):
    return np.maximum(counts - black, 0)


# ---------------------------------------------------------------- pictures at random

SIZE = (100, 80)
EVEN = ("even light",)
LIGHT = ("along", "shadow across rows", "slanted shadow", "dip", "flare")
COURSE = ("S", "rough")
DIRT = ("hot", "dead", "dust")
LENS = ("ghost",)
FLAWS = (*EVEN, *LIGHT, *COURSE, *DIRT, *LENS)


@dataclass(frozen=True)
class Drawn:
    """A picture drawn at random: what is wrong with it, how much, electrons, and the lens's MTF50."""

    flaw: str
    strength: float
    picture: np.ndarray
    mtf50: float
    sigma: float
    snr: float


def drawn(rng, flaw, size=SIZE):
    """A picture with one of `FLAWS`, at a random strength, angle, blur and noise."""
    sigma, snr = float(rng.choice([0.3, 0.5, 0.7, 1.5])), float(rng.choice([40, 100]))
    degrees = float(rng.uniform(3.5, 14))
    u = float(rng.uniform(0.1, 1))
    strength, course, light, ghost = u, None, None, None
    if flaw == "along":
        light = along(strength := 0.6 * u)
    elif flaw == "shadow across rows":
        light = shadow(strength := 0.3 * u, 90, rng.uniform(5, 20))
    elif flaw == "slanted shadow":
        light = shadow(strength := 0.3 * u, rng.uniform(30, 60), rng.uniform(8, 25))
    elif flaw == "dip":
        light = dip(strength := 0.1 * u)
    elif flaw == "flare":
        light = flare(strength := 0.05 * u)
    elif flaw == "S":
        course = cubic(strength := u, size[0])
    elif flaw == "rough":
        course = rough(strength := 0.4 * u, rng)
    scene = response(sigma, degrees, size, course)
    if flaw == "ghost":
        strength, ghost = 0.2 * u, rng.uniform(2, 6)
        scene = (1 - strength) * scene + strength * response(sigma, degrees, size, offset=ghost)
    scene = levels(scene) if light is None else lit(scene, light)
    if flaw == "dust":
        scene = dusty(scene, (rng.uniform(-6, 6), rng.uniform(-40, 40)), strength := 1 + 2 * u, 0.6)
    counts = exposed(scene, snr, rng)
    if flaw in ("hot", "dead"):
        positions = near_edge(int(strength := rng.integers(1, 4)), rng, size, degrees)
        counts = with_pixels(counts, positions, 2.0 if flaw == "hot" else 0.0)
    truth = half(sigma, degrees) if ghost is None else ghosted_half(sigma, degrees, strength, ghost)
    return Drawn(flaw, strength, counts, truth, sigma, snr)


def ghosted_half(sigma, degrees, share, offset):
    """MTF50 of a lens with a ghost, which is a second, weaker edge `offset` px to the right."""
    return doubled_half(sigma, degrees, share, offset, sigma)


def doubled_half(sigma, degrees, share, offset, blur):
    """MTF50 of a lens with a second one, of another blur, `offset` px to the right along the rows."""
    a = np.radians(degrees)
    f = np.linspace(0, 1.5, 150001)
    first, second = (np.exp(-2 * (np.pi * s * f) ** 2) for s in (sigma, blur))
    both = (1 - share) * first + share * second * np.exp(-2j * np.pi * f * offset * np.cos(a))
    mtf = np.abs(both * np.sinc(f * np.cos(a)) * np.sinc(f * np.sin(a)))
    return float(f[np.argmax(mtf < 0.5)])
