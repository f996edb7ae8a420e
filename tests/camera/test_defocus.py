"""A lens out of focus, against the pupil's autocorrelation by brute force, against GalSim, and at its two limits."""

import galsim
import numpy as np
import pytest
from scipy.special import j1

from matcam import BoxPixel, Camera, DefocusOptics, DiffractionOptics
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from tests.oracle.pupil import defocused_otf

WAVELENGTH, PITCH = 550e-9, 4.73e-6


def lens(f_number, blur_diameter):
    return DefocusOptics(f_number, WAVELENGTH, PITCH, blur_diameter)


@pytest.mark.parametrize("f_number", [2.8, 16.0])
@pytest.mark.parametrize("blur", [0.3, 3.0, 12.0])
def test_against_the_pupils_autocorrelation(f_number, blur):
    optics = lens(f_number, blur)
    cutoff = PITCH / (WAVELENGTH * f_number)
    nu = np.array([0.02, 0.31, 0.7, 0.97])
    # W020 = c pitch / (8 N), as a phase
    phase = 2 * np.pi / WAVELENGTH * blur * PITCH / (8 * f_number)
    truth = [defocused_otf(n, phase) for n in nu]
    np.testing.assert_allclose(optics.mtf(nu * cutoff), truth, rtol=0, atol=1e-10)
    assert float(optics.mtf(1.01 * cutoff)) == 0


def test_against_galsim():
    """GalSim transforms a sampled pupil: its error is that of the sampling. Zernike's defocus is sqrt(3) (2 rho^2 - 1)."""
    optics = lens(8.0, 3.0)
    waves = 3.0 * PITCH / (8 * 8.0) / WAVELENGTH  # W020 = c pitch / (8 N)
    theirs = galsim.OpticalPSF(
        lam_over_diam=8.0 * WAVELENGTH / PITCH, defocus=waves / (2 * np.sqrt(3)), oversampling=2, pad_factor=4
    )
    f = np.linspace(0, 1.0, 11)
    truth = [theirs.kValue(2 * np.pi * a, 0).real for a in f]
    np.testing.assert_allclose(optics.mtf(f), truth, rtol=0, atol=2e-3)


def test_in_focus_it_is_diffraction():
    f = np.linspace(0, 1.2, 49)
    np.testing.assert_allclose(lens(8.0, 0.0).mtf(f), DiffractionOptics(8, WAVELENGTH, PITCH).mtf(f), atol=1e-14)
    x = np.linspace(0, 6, 7)
    np.testing.assert_allclose(
        lens(8.0, 0.0).psf(x, 0.0), DiffractionOptics(8, WAVELENGTH, PITCH).psf(x, 0.0), rtol=0, atol=1e-12
    )


def test_far_out_of_focus_it_is_the_circle_of_confusion():
    """The geometric transfer function 2 J1(v) / v, v = pi c f, with an error that falls as the wavelength does."""
    f = np.linspace(0.005, 0.2, 60)
    v = np.pi * 20 * f
    errors = []
    for wavelength in (20e-9, 5e-9):
        optics = DefocusOptics(2.8, wavelength, PITCH, 20.0)
        errors.append(np.max(np.abs(np.asarray(optics.mtf(f)) - 2 * j1(v) / v)))
    assert errors[0] < 5e-3
    assert errors[1] < errors[0] / 3
    # its picture: a disc of uniform light
    inside = np.asarray(DefocusOptics(2.8, 100e-9, PITCH, 20.0).lsf(np.array([0.0, 4.0, 8.0])))
    np.testing.assert_allclose(inside, 8 / np.pi / 20**2 * np.sqrt(10**2 - np.array([0, 4, 8.0]) ** 2), rtol=0.02)


@pytest.mark.parametrize("blur", [0.5, 2.0])
def test_defocus_adds_the_circles_second_moment(blur):
    """The ray aberrations of a uniform disc have variance c^2 / 16 along a line: MTF falls by 2 pi^2 f^2 of that."""
    f = np.array([2e-3, 4e-3, 8e-3])
    drop = np.asarray(lens(8.0, 0.0).mtf(f) - lens(8.0, blur).mtf(f)) / (2 * np.pi**2 * f**2)
    # the overlap shrinks linearly in f: extrapolate to 0
    assert np.polyval(np.polyfit(f, drop, 2), 0) == pytest.approx(blur**2 / 16, rel=1e-4)


def test_smooth_and_differentiable_at_focus_and_at_the_cutoff():
    cutoff = PITCH / (WAVELENGTH * 8.0)

    def at(blur, f):
        return DefocusOptics(8.0, WAVELENGTH, PITCH, blur).mtf(f)

    slope = jax.jit(jax.grad(at))
    for f in (0.0, 0.3, cutoff, 2 * cutoff):
        assert float(slope(0.0, f)) == 0
    h = 1e-5
    assert float(slope(1.5, 0.3)) == pytest.approx(float(at(1.5 + h, 0.3) - at(1.5 - h, 0.3)) / (2 * h), rel=1e-8)
    curvature = jax.jit(jax.grad(slope))(0.0, 0.3)
    assert float(curvature) == pytest.approx(float(at(1e-3, 0.3) - at(0.0, 0.3)) / 1e-6 * 2, rel=1e-5)
    # traced numbers that the quadrature was not made for are not answered wrongly
    assert np.isnan(float(jax.jit(lambda c: DefocusOptics(1.0, WAVELENGTH, PITCH, c).mtf(0.3))(50.0)))


def test_point_line_and_edge_belong_together():
    camera = Camera(lens(5.6, 3.0), BoxPixel(0.5))
    t = np.arange(-20, 20, 0.2)  # steps that the band, 1.5 cycles/px, cannot alias into
    projected = float(np.sum(np.asarray(camera.psf(1.3, t)))) * 0.2
    assert projected == pytest.approx(float(camera.lsf(1.3)), abs=2e-4)  # the Airy tail beyond 20 px
    slope = jax.grad(camera.esf)(0.7)
    assert float(slope) == pytest.approx(float(camera.lsf(0.7)), abs=1e-12)
    inside = float(jnp.sum(camera.lsf(np.arange(-30, 30, 0.1) + 0.05)) * 0.1)
    assert inside + 2 * float(camera.esf(-30.0)) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((8, WAVELENGTH, PITCH, -1.0), "blur_diameter must lie in [0, 1000] px, got -1"),
        ((8, WAVELENGTH, PITCH, np.inf), "blur_diameter"),
        ((8, WAVELENGTH, PITCH, [1.0, 2.0]), "blur_diameter must be a single number"),
        ((8, 550, PITCH, 1.0), "550 nm is 550e-9"),
        ((0, WAVELENGTH, PITCH, 1.0), "f_number"),
    ],
)
def test_nonsense_is_refused(arguments, words):
    with pytest.raises(ArgumentError) as caught:
        DefocusOptics(*arguments)
    assert words in str(caught.value)
