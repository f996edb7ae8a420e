"""A mosaic that is read as grey is noticed, and nothing else is taken for one."""

import numpy as np
import pytest

from matcam.numerics.alternation import alternation
from tests.oracle import real_edges as oracle
from tests.oracle import slanted_squares

SIZES = ((100, 80), (21, 16), (160, 80))


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("light", [(0.6, 1.0, 0.5), (0.9, 1.0, 0.4), (1.2, 1.0, 0.95), (0.7, 1.0, 0.7)])
def test_a_mosaic_is_noticed(cfa, light):
    rng = np.random.default_rng(1)
    for size in SIZES[:2]:
        planes = [w * oracle.levels(oracle.response(s, 5, size)) for s, w in zip((0.6, 0.5, 0.6), light, strict=True)]
        counts = rng.poisson(slanted_squares.mosaic(planes, cfa) * 60**2).astype(float)
        red, green, blue = light
        largest = max(abs(c - green) / ((c + green) / 2) for c in (red, blue))
        assert alternation(counts) == pytest.approx(largest, abs=0.03)


def test_nothing_else_is_taken_for_a_mosaic():
    rng = np.random.default_rng(2)
    for k in range(150):
        sigma, snr = rng.choice([0.1, 0.3, 0.5, 1.5, 12]), rng.choice([10, 40, 100])
        scene = oracle.levels(oracle.response(sigma, rng.uniform(2, 43), SIZES[k % 3]))
        counts = rng.poisson(scene * snr**2).astype(float)
        assert alternation(np.rint(255 * counts / counts.max()) if k % 4 == 0 else counts) == 0
    assert alternation(np.full((40, 40), np.nan)) == 0
    assert alternation(np.zeros((40, 40))) == 0
