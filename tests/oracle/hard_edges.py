"""Edges in bad light and behind software that no polynomial describes: glints, banding, penumbrae, a near lamp, steps, dust.

The edges are those of `real_edges`, whose pixels are quadratures. Truth is the MTF50 of lens and pixel; a ghost belongs to the
lens, everything else does not. Imports nothing of the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter

from tests.oracle import processed_pictures as software
from tests.oracle import real_edges as edges

SIZE = (100, 80)
_SHOULDER = 0.9  # of the range: the bright level before the shoulder


def glint(rng):
    """A Gaussian spot of light of 10 to 40 px that adds to the scene; its middle lies in the region or near it."""
    size, strength = rng.uniform(10, 40), rng.uniform(0.03, 0.3)
    x0, y0 = rng.uniform(-45, 45), rng.uniform(-55, 55)
    return lambda x, y: (1.0, strength * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * size**2)))


def banding(rng):
    """Tilted waves of light, which multiply the scene."""
    period, turn = rng.uniform(25, 90), rng.uniform(0.1, np.pi - 0.1)
    strength, phase = rng.uniform(0.01, 0.06), rng.uniform(0, 2 * np.pi)
    return lambda x, y: (
        1 + strength * np.sin(2 * np.pi * (x * np.cos(turn) + y * np.sin(turn)) / period + phase),
        0.0,
    )


def penumbra(rng):
    """The border of a shadow that falls linearly over 4 to 30 px, in any direction but along the edge."""
    width, turn, depth = rng.uniform(4, 30), np.radians(rng.uniform(25, 90)), rng.uniform(0.05, 0.3)
    turn *= rng.choice([-1.0, 1.0])
    at = rng.uniform(-25, 25)

    def light(x, y):
        across = x * np.cos(turn) + y * np.sin(turn) - at
        return 1 - depth * np.clip(across / width + 0.5, 0, 1), 0.0

    return light


def near_lamp(rng):
    """A lamp at a height of 1 to 4 widths of the region: inverse square and cosine."""
    height, x0, y0 = rng.uniform(80, 320), rng.uniform(-80, 80), rng.uniform(-80, 80)

    def light(x, y):
        field = (1 + ((x - x0) ** 2 + (y - y0) ** 2) / height**2) ** -1.5
        return field / field.mean(), 0.0

    return light


def light_step(rng):
    """A step of 3 to 20 % in the light or the print, sharp as a shadow of something close, at any angle but the edge's."""
    turn, depth, at = (
        np.radians(rng.uniform(25, 90)) * rng.choice([-1, 1]),
        rng.uniform(0.03, 0.2),
        rng.uniform(-25, 25),
    )
    return lambda x, y: (1 - depth * edges.soft_step(x * np.cos(turn) + y * np.sin(turn) - at, 0.6), 0.0)


def dust(scene, rng):
    """One to three specks of 1 to 3 px."""
    for _ in range(rng.integers(1, 4)):
        position = rng.uniform(-12, 12), rng.uniform(-40, 40)
        scene = edges.dusty(scene, position, rng.uniform(1, 3), rng.uniform(0.2, 0.8))
    return scene


def shoulder(counts, level, rng):
    """A highlight shoulder, tanh: the bright level is compressed."""
    bend = rng.uniform(0.3, 1.2)
    return level * np.tanh(bend * counts / level) / np.tanh(bend)


def smoothed(counts, width):
    return gaussian_filter(counts, width, mode="nearest")


def deconvolved(counts, rng):
    """Two to five steps of van Cittert's deconvolution with a Gaussian of 0.4 to 0.8 px."""
    width, found = rng.uniform(0.4, 0.8), counts
    for _ in range(rng.integers(2, 6)):
        found = found + counts - gaussian_filter(found, width, mode="nearest")
    return found


def rotated(counts, rng):
    """Turned by up to 2 degrees with cubic splines."""
    turn = np.radians(rng.uniform(0.2, 2)) * rng.choice([-1, 1])
    by = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = (np.array(counts.shape) - 1) / 2
    return affine_transform(counts, by, middle - by @ middle, order=3, mode="nearest")


LIGHT = {"glint": glint, "banding": banding, "penumbra": penumbra, "near lamp": near_lamp, "step": light_step}
SOFTWARE = {
    "shoulder": shoulder,
    "smoothed by 0.4 px": lambda c, level, rng: smoothed(c, 0.4),
    "smoothed": lambda c, level, rng: smoothed(c, rng.uniform(0.3, 0.8)),
    "unsharp": lambda c, level, rng: software.unsharp(c, rng.uniform(0.1, 0.3), rng.uniform(0.7, 1.5)),
    "deconvolved": lambda c, level, rng: deconvolved(c, rng),
    "rotated": lambda c, level, rng: rotated(c, rng),
}
KINDS = ("even", *LIGHT, "dust", "far ghost", *SOFTWARE, "no noise")


@dataclass(frozen=True)
class HardEdge:
    """A picture drawn at random: counts, and the MTF50 and blur of the lens, cycles/px and px."""

    kind: str
    picture: np.ndarray
    mtf50: float
    sigma: float
    snr: float


def drawn(rng, kind, size=SIZE):
    """A picture of one of `KINDS` at a random strength, angle, blur (0.3 to 1.5 px) and SNR (40 or 100)."""
    sigma, snr = float(rng.choice([0.3, 0.5, 0.7, 1.0, 1.5])), float(rng.choice([40, 100]))
    degrees = float(rng.uniform(3.5, 14))
    offset = rng.uniform(-0.5, 0.5)
    scene = edges.response(sigma, degrees, size, offset=offset)
    truth = edges.half(sigma, degrees)
    if kind == "far ghost":
        share, position = rng.uniform(0.02, 0.15), rng.uniform(9, 25) * rng.choice([-1, 1])
        scene = (1 - share) * scene + share * edges.response(sigma, degrees, size, offset=position)
        truth = edges.ghosted_half(sigma, degrees, share, position - offset)
    scene = edges.lit(scene, LIGHT[kind](rng)) if kind in LIGHT else edges.levels(scene)
    if kind == "dust":
        scene = dust(scene, rng)
    if kind == "no noise":
        return HardEdge(kind, np.rint(scene * rng.choice([60.0, 200, 3000])), truth, sigma, np.inf)
    counts = edges.exposed(scene, snr, rng)
    if kind in SOFTWARE:
        counts = SOFTWARE[kind](counts, snr**2, rng)
    return HardEdge(kind, counts, truth, sigma, snr)
