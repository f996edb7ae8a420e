"""Veiling glare: weighted sums everywhere, and quadrature rules that see the halo's spike at frequency 0."""

import numpy as np
import pytest
from scipy.special import erf

from matcam import (
    BoxPixel,
    Camera,
    DefocusOptics,
    DiffractionOptics,
    GaussianOptics,
    HaloOptics,
    MeasuredOptics,
    WindowedGaussianPixel,
)
from matcam.camera import kernel as effective
from matcam.camera.optics import optics as fourier
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp

CORES = {
    "gaussian": GaussianOptics(0.5),
    "diffraction": DiffractionOptics(2.8, 550e-9, 4.73e-6),
    "defocus": DefocusOptics(8, 550e-9, 4.73e-6, 2.0),
    "measured": MeasuredOptics(np.linspace(0, 1, 41), (1 - np.linspace(0, 1, 41)) ** 2),
    "halo": HaloOptics(GaussianOptics(0.4), 0.1, 4.0),
}


def box_gaussian(x, sigma, p=0.5):
    return (erf((x + p) / np.sqrt(2) / sigma) - erf((x - p) / np.sqrt(2) / sigma)) / (4 * p)


def test_against_the_closed_form():
    """Two Gaussians through a square pixel (docs/model.md 2), written out."""
    camera = Camera(HaloOptics(GaussianOptics(0.5), 0.03, 40.0), BoxPixel(0.5))
    x, y = np.array([-90, -20, -1.3, -0.4, 0, 0.9, 7, 60]), 0.3
    truth = 0.97 * box_gaussian(x, 0.5) * box_gaussian(y, 0.5) + 0.03 * box_gaussian(x, 40) * box_gaussian(y, 40)
    np.testing.assert_allclose(camera.psf(x, y), truth, rtol=1e-10)
    np.testing.assert_allclose(camera.lsf(x, 0.0), 0.97 * box_gaussian(x, 0.5) + 0.03 * box_gaussian(x, 40), rtol=1e-10)
    f = np.array([0.0, 1e-3, 5e-3, 0.02, 0.2, 0.5, 0.7, 1.2])
    spectrum = 0.97 * np.exp(-2 * (np.pi * 0.5 * f) ** 2) + 0.03 * np.exp(-2 * (np.pi * 40 * f) ** 2)
    np.testing.assert_allclose(camera.mtf(f), spectrum * np.sinc(f), rtol=1e-12)


@pytest.mark.parametrize("core", CORES.values(), ids=CORES)
@pytest.mark.slow
def test_effective_kernels_are_sums(core):
    x = np.linspace(-3, 3, 8)
    pixel = WindowedGaussianPixel(0.2, 0.45) if isinstance(core, GaussianOptics) else BoxPixel(0.45)
    whole, bare, glare = (Camera(o, pixel) for o in (HaloOptics(core, 0.05, 30.0), core, GaussianOptics(30.0)))
    for kernel in (lambda c: c.psf(x, 0.3), lambda c: c.lsf(x, 0.4), lambda c: c.esf(x, 0.4), lambda c: c.mtf(x)):
        np.testing.assert_allclose(kernel(whole), 0.95 * kernel(bare) + 0.05 * kernel(glare), rtol=0, atol=1e-12)
    whole = HaloOptics(core, 0.05, 30.0)
    np.testing.assert_allclose(whole.lsf(x), 0.95 * core.lsf(x) + 0.05 * GaussianOptics(30.0).lsf(x), atol=1e-14)
    np.testing.assert_allclose(
        whole.psf(x, 0.3), 0.95 * core.psf(x, 0.3) + 0.05 * GaussianOptics(30.0).psf(x, 0.3), atol=1e-14
    )


@pytest.mark.parametrize("core", ["gaussian", pytest.param("measured", marks=pytest.mark.slow), "halo"])
@pytest.mark.parametrize("radius", [0.1, 200.0])
def test_the_whole_lens_can_be_integrated_over_frequencies(core, radius):
    """One rule for core and spike: the line spread of the whole by quadrature against the sum of its parts' own."""
    x, angle, core = jnp.asarray([0.0, 0.6, 1, 2, 3, 5, 8, 20.0]), jnp.asarray(0.3), CORES[core]
    whole, pixel = HaloOptics(core, 0.2, radius), BoxPixel(0.5)
    by_parts = Camera(whole, pixel).lsf(x, angle)
    scale = 1e-11 * float(by_parts[0])
    np.testing.assert_allclose(effective.line(whole, pixel, x, angle), by_parts, rtol=0, atol=scale)

    @jax.jit  # where nothing is known beforehand, the rule must do for every radius
    def traced(radius):
        lens = HaloOptics(core, 0.2, radius)
        return fourier.line_kernel(lens.frequency_rule(200), Camera(lens, pixel).mtf, x, angle)

    np.testing.assert_allclose(traced(radius), by_parts, rtol=0, atol=scale)


def test_parts_of_parts():
    lens = HaloOptics(HaloOptics(GaussianOptics(0.5), 0.1, 5.0), 0.2, 50.0)
    weights, parts = zip(*lens.components(), strict=True)
    np.testing.assert_allclose(weights, [0.8 * 0.9, 0.8 * 0.1, 0.2])
    assert [float(p.sigma) for p in parts] == [0.5, 5.0, 50.0]


def test_derivatives():
    def at(fraction, radius, sigma):
        return Camera(HaloOptics(GaussianOptics(sigma), fraction, radius)).psf(3.0, 1.0)

    h, point = 1e-5, (0.1, 6.0, 0.8)
    for i, slope in enumerate(jax.grad(at, argnums=(0, 1, 2))(*point)):
        step = np.eye(3)[i] * h
        assert float(slope) == pytest.approx(float(at(*(point + step)) - at(*(point - step))) / (2 * h), rel=1e-6)
    assert float(jax.grad(at)(0.0, 6.0, 0.8)) > 0  # glare can be found by a fit that starts without it


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: HaloOptics(GaussianOptics(0.5), 1.0, 30), "fraction must lie in [0, 1), got 1"),
        (lambda: HaloOptics(GaussianOptics(0.5), -0.1, 30), "fraction must lie in [0, 1), got -0.1"),
        (lambda: HaloOptics(GaussianOptics(0.5), 0.1, 0), "radius must lie in (0, inf) px, got 0"),
        (lambda: HaloOptics(GaussianOptics(0.5), [0.1, 0.2], 3), "fraction must be a single number"),
        (lambda: HaloOptics(Camera(GaussianOptics(0.5)), 0.1, 3), "core must be Optics, got Camera"),
        (lambda: HaloOptics(BoxPixel(0.5), 0.1, 3), "core must be Optics, got BoxPixel"),
    ],
)
def test_nonsense_is_refused(build, words):
    with pytest.raises(ArgumentError) as caught:
        build()
    assert words in str(caught.value)
