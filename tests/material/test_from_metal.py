"""`Conductor.from_metal` against Fresnel's equations and the printed rows of a table."""

import cmath
import math

import numpy as np
import pytest

from matcam import Conductor
from matcam.core.errors import ArgumentError


def reflectance(theta, index):
    """Unpolarised reflectance of a metal in air (Born & Wolf 14.2), in complex numbers of Python."""
    c = cmath.cos(theta)
    inside = cmath.sqrt(index**2 - math.sin(theta) ** 2)
    s, p = (c - inside) / (c + inside), (index**2 * c - inside) / (index**2 * c + inside)
    return (abs(s) ** 2 + abs(p) ** 2) / 2


def test_a_row_of_johnson_and_christy():
    """Chromium at 582 nm (2.13 eV): n = 3.22, k = 3.30 in table II of Johnson & Christy (1974)."""
    term = Conductor.from_metal("Cr", 582e-9, "johnson")
    assert (float(term.n), float(term.k)) == pytest.approx((3.22, 3.30), abs=5e-3)
    assert float(term.at(1.2)) == pytest.approx(reflectance(1.2, complex(float(term.n), float(term.k))), rel=1e-12)


def test_channels():
    term = Conductor.from_metal("Cu", [650e-9, 550e-9, 450e-9])
    assert term.n.shape == (3,)
    expected = [reflectance(0.7, complex(n, k)) for n, k in zip(term.n.tolist(), term.k.tolist(), strict=True)]
    np.testing.assert_allclose(term.at(np.array([0.7])), [expected], rtol=1e-12)
    assert Conductor.from_metal("Cu").n.shape == (3,)


def test_wrong_names_and_units_are_refused():
    with pytest.raises(ArgumentError, match=r"unknown metal 'Chrome'"):
        Conductor.from_metal("Chrome")
    with pytest.raises(ArgumentError, match="give wavelengths of this range, in m, such as 550e-9 for 550 nm"):
        Conductor.from_metal("Cr", 550)
