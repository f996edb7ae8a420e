"""Kernel of a lens whose MTF is tabulated far beyond the frequencies that it passes. The truth is a sum over points."""

import numpy as np
import pytest
from scipy.special import j0

import matcam
from matcam.forward.integral.blur import Spread, blur_of
from matcam.rigs import Rig

SIGMA, RINGS = 0.4, ((0.8, 0.0), (0.15, 1.0), (0.05, 2.0))
"""Standard deviation, px, of the image of each point; share and radius, px, of the rings of points."""


def mtf(f):
    return np.exp(-2 * (np.pi * SIGMA * f) ** 2) * sum(share * j0(2 * np.pi * radius * f) for share, radius in RINGS)


def by_points(x, pixel):
    """Kernel at offsets x along a row."""
    turn = 2 * np.pi * np.arange(64) / 64
    total = np.zeros(x.shape)
    for share, radius in RINGS:
        along, across = (np.asarray(pixel.of_gaussian(a, SIGMA)) for a in (
            x[:, None] - radius * np.cos(turn), -radius * np.sin(turn)
        ))  # fmt: skip
        total += share * (along * across).mean(1)
    return total


@pytest.mark.parametrize("last", [1.65, 4.2])
def test_the_end_of_the_table_does_not_matter(last):
    f = np.linspace(0, last, int(30 * last) + 1)
    values = mtf(f)
    values[-1] = 0.0
    pixel = matcam.BoxPixel(0.5)
    camera = matcam.Camera(matcam.MeasuredOptics(f, values), pixel)
    blur = blur_of(Rig(camera, matcam.Sphere(256.0)), whole=True)
    x = np.linspace(0, 5, 101)
    none = Spread(*np.zeros(3))
    found = sum(np.asarray(blur.share(j) * blur.at(j, none, x, 0 * x)) for j in blur.terms)
    truth = by_points(x, pixel)
    error = np.abs(found - truth).max() / truth[0]
    print(f"table up to {last} cycles/px: {error:.1e} of the peak")
    assert error < 5e-5
