"""Lenses as sums of Gaussians: exact where they are, as close as stated elsewhere, and how close anything could come."""

import numpy as np
import pytest
from scipy.optimize import linprog

from matcam import BoxPixel, Camera, DefocusOptics, DiffractionOptics, GaussianOptics, HaloOptics, MeasuredOptics
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax

WAVELENGTH, PITCH = 550e-9, 4.73e-6


def full_pixel(f):
    angle = np.linspace(0, np.pi / 4, 91)
    return np.max(np.abs(np.sinc(f[:, None] * np.cos(angle)) * np.sinc(f[:, None] * np.sin(angle))), axis=1)


def test_gaussians_and_their_halos_are_exact():
    lens = HaloOptics(HaloOptics(GaussianOptics(0.5), 0.1, 5.0), 0.2, 50.0)
    found = gaussian_sum(lens)
    np.testing.assert_allclose(found.weights, [0.72, 0.08, 0.2], rtol=1e-14)
    np.testing.assert_allclose(found.sigmas, [0.5, 5, 50])
    assert float(found.error) == float(found.total_error) == 0
    f = np.linspace(0, 2, 41)
    np.testing.assert_allclose(found.mtf(f), lens.mtf(f), rtol=1e-14)


# largest error of the total MTF by f-number: a little above what was measured
REACHED = {2.8: 1.4e-3, 8.0: 2.2e-3, 16.0: 5.8e-3}


@pytest.mark.parametrize("f_number", REACHED)
def test_perfect_lenses_in_and_out_of_focus(f_number):
    find = jax.jit(lambda blur: gaussian_sum(DefocusOptics(f_number, WAVELENGTH, PITCH, blur)))
    for blur in (0.0, 1.0, 3.0):
        found, lens = find(blur), DefocusOptics(f_number, WAVELENGTH, PITCH, blur)
        f = np.linspace(0, 6, 1501)
        difference = np.abs(np.asarray(found.mtf(f) - lens.mtf(f)))
        # the error that is stated is the error that is found, on other frequencies
        assert np.max(difference) == pytest.approx(float(found.error), rel=0.02)
        assert np.max(difference * full_pixel(f)) <= 1.02 * float(found.total_error)
        assert float(found.total_error) < REACHED[f_number]
        assert float(np.sum(np.abs(found.weights))) < 50
        assert float(np.sum(found.weights)) == pytest.approx(1, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("f_number", "limit"), [(2.8, 1.2e-4), (8.0, 5e-4), (16.0, 2e-3)])
def test_no_sum_of_gaussians_comes_much_closer(f_number, limit):
    """The smallest possible largest error with sum |w| <= 50, over 70 widths at once, by linear programming."""
    lens = DiffractionOptics(f_number, WAVELENGTH, PITCH)
    cutoff = float(lens.cutoff)
    f = np.concatenate([np.geomspace(1e-4, 0.02, 40), np.linspace(0.02, 1.5 * cutoff + 1, 220)])
    through = full_pixel(f)[:, None]
    sigmas = np.geomspace(0.1 / cutoff, 100, 70)
    rows = np.exp(-2 * (np.pi * f[:, None] * sigmas) ** 2) * through
    wanted = np.asarray(lens.mtf(f)) * through[:, 0]
    one, n = np.ones_like(through), sigmas.size
    solution = linprog(
        np.eye(2 * n + 1)[-1],
        A_ub=np.block([[rows, -rows, -one], [-rows, rows, -one], [np.ones((1, 2 * n)), np.zeros((1, 1))]]),
        b_ub=np.concatenate([wanted, -wanted, [50]]),
        A_eq=np.concatenate([np.ones(n), -np.ones(n), [0]])[None],
        b_eq=[1],
    )
    assert solution.status == 0
    assert solution.fun > limit
    assert solution.fun < float(gaussian_sum(lens).total_error) < 8 * solution.fun


@pytest.mark.slow
def test_kernel_of_the_sum_is_the_kernel_of_the_lens():
    """In space: a sum of closed forms against Fourier quadrature of the lens itself, relative to the kernel's peak."""
    lens, pixel = HaloOptics(DiffractionOptics(8, WAVELENGTH, PITCH), 0.05, 20.0), BoxPixel(0.5)
    found = gaussian_sum(lens, 32)
    x = np.linspace(0, 5, 8)
    across = np.asarray(pixel.of_gaussian(x[:, None], found.sigmas) * pixel.of_gaussian(0.3, found.sigmas))
    truth = np.asarray(Camera(lens, pixel).psf(x, 0.3))
    np.testing.assert_allclose(across @ np.asarray(found.weights), truth, rtol=0, atol=5e-3 * truth[0])


def test_measured_curves():
    f = np.linspace(0, 1, 21)
    lens = MeasuredOptics(f, (1 - f) ** 2 * (1 + 0.5 * f))
    found = gaussian_sum(lens)
    assert float(found.total_error) < 3e-3
    with pytest.raises(ArgumentError, match="append"):
        gaussian_sum(MeasuredOptics(f, np.exp(-f)))
    with pytest.raises(ArgumentError, match=r"terms must lie in \[8, 64\], got 4"):
        gaussian_sum(lens, 4)


def test_derivatives_by_the_numbers_of_the_lens():
    def at(f_number, blur):
        return gaussian_sum(DefocusOptics(f_number, WAVELENGTH, PITCH, blur), 16).mtf(0.31)

    at = jax.jit(at)
    h, point = 1e-5, np.array([5.6, 1.5])
    for i, slope in enumerate(jax.jit(jax.grad(at, argnums=(0, 1)))(*point)):
        step = h * np.eye(2)[i]
        finite = float(at(*(point + step)) - at(*(point - step))) / (2 * h)
        assert float(slope) == pytest.approx(finite, rel=1e-5)
