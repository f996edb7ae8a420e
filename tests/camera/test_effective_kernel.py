"""The effective kernel against golden values, against GalSim, and against laws that any kernel obeys."""

import galsim
import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from docs_claims import limit
from matcam import (
    BoxPixel,
    Camera,
    DiffractionOptics,
    GaussianOptics,
    HaloOptics,
    MeasuredOptics,
    WindowedGaussianPixel,
)
from matcam.camera import kernel as effective
from matcam.camera.optics import optics as fourier
from matcam.camera.pixel import gaussian_over_interval
from matcam.core.jax import jax, jnp
from tests.golden import rows

CAMERAS = {
    "sharp": Camera(GaussianOptics(0.2), BoxPixel(0.5)),
    "paper": Camera(GaussianOptics(0.5), BoxPixel(0.5)),
    "soft": Camera(GaussianOptics(2.0), BoxPixel(0.3)),
    "windowed": Camera(GaussianOptics(0.4), WindowedGaussianPixel(0.25, 0.45)),
    "diffraction": Camera(DiffractionOptics(8, 550e-9, 4.73e-6), BoxPixel(0.4)),
    "halo": Camera(HaloOptics(GaussianOptics(0.4), 0.02, 3.5), BoxPixel(0.5)),
}


@pytest.fixture(params=CAMERAS, name="camera")
def _camera(request):
    return CAMERAS[request.param]


@pytest.mark.parametrize("row", rows("kernel"))
def test_golden_lines_and_transfer_functions(row):
    box = Camera(GaussianOptics(row["sigma_mtf"]), BoxPixel(row["half_width"]))
    windowed = Camera(GaussianOptics(row["sigma_mtf"]), WindowedGaussianPixel(row["pixel_sigma"], row["half_width"]))
    for camera, name in ((box, "box"), (windowed, "windowed")):
        assert float(camera.lsf(row["x"])) == pytest.approx(row[f"{name}_lsf"], rel=limit("kernel"))
        assert float(camera.mtf(row["f"])) == pytest.approx(row[f"{name}_mtf"], rel=limit("kernel"))
        assert float(camera.pixel.of_gaussian(row["x"], row["sigma_mtf"])) == pytest.approx(
            row[f"{name}_lsf"], rel=limit("kernel")
        )


@pytest.mark.parametrize("row", rows("diffraction"))
def test_golden_diffraction(row):
    optics = DiffractionOptics(row["f_number"], row["wavelength"], row["pixel_pitch"])
    camera = Camera(optics, BoxPixel(row["half_width"]))
    assert float(optics.mtf(row["f"])) == pytest.approx(row["optics_mtf"], rel=1e-8, abs=1e-15)
    assert float(camera.mtf(row["f"])) == pytest.approx(row["total_mtf"], rel=1e-8, abs=1e-15)


@pytest.mark.parametrize(
    "angle",
    [
        0.0,
        1e-4,
        pytest.param(0.3, marks=pytest.mark.slow),
        pytest.param(np.pi / 4, marks=pytest.mark.slow),
        1.2,
        np.pi / 2,
    ],
)
def test_closed_forms_agree_with_fourier_quadrature(angle):
    x = jnp.linspace(-5, 5, 201)
    for sigma in (0.05, 0.3, 1.7):
        camera = Camera(GaussianOptics(sigma), BoxPixel(0.45))
        rule, a = effective.rule_for(camera.optics, x), jnp.asarray(angle)
        np.testing.assert_allclose(
            camera.lsf(x, angle), fourier.line_kernel(rule, camera.mtf, x, a), rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(
            camera.esf(x, angle), fourier.step_response(rule, camera.mtf, x, a), rtol=0, atol=1e-13
        )


def test_kernel_has_unit_energy(camera):
    # the diffraction kernel's line spread falls as 1/x^2: its mass beyond 40 px is taken from the edge response
    reach = 40.0
    x = np.arange(-reach, reach, 0.05) + 0.025
    for angle in (0.0, 0.4):
        inside = float(np.sum(np.asarray(camera.lsf(x, angle))) * 0.05)
        outside = 1 - float(camera.esf(reach, angle) - camera.esf(-reach, angle))
        assert inside + outside == pytest.approx(1, abs=1e-9)
    assert float(camera.mtf(0.0)) == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize(
    "angle", [0.35, pytest.param(0.0, marks=pytest.mark.slow), pytest.param(np.pi / 4, marks=pytest.mark.slow)]
)
def test_line_is_the_projection_of_the_point(camera, angle):
    """Integrating the PSF along a line must give the LSF: two code paths for one kernel."""
    t = np.arange(-30, 30, 0.08)
    for x in (0.0, 0.4, 1.1):
        px, py = x * np.cos(angle) - t * np.sin(angle), x * np.sin(angle) + t * np.cos(angle)
        projected = float(np.sum(np.asarray(camera.psf(px, py))) * 0.08)
        # an Airy pattern leaves 1/r^2 of its line integral beyond 30 px
        assert projected == pytest.approx(
            float(camera.lsf(x, angle)), abs=1e-4 if isinstance(camera.optics, DiffractionOptics) else 1e-10
        )


@pytest.mark.parametrize("sigma", [0.1, 0.5, 3.0, 100.0])
@pytest.mark.parametrize("half_width", [0.01, 0.25, 0.5])
def test_second_moment_is_that_of_optics_plus_pixel(sigma, half_width):
    camera = Camera(GaussianOptics(sigma), BoxPixel(half_width))
    reach, n = 10 * sigma + 2 * half_width, 20001
    x = np.linspace(-reach, reach, n)
    for angle in (0.0, 0.5):
        moment = np.sum(x**2 * np.asarray(camera.lsf(x, angle))) * (x[1] - x[0])
        assert moment == pytest.approx(sigma**2 + half_width**2 / 3, rel=1e-9)


def test_point_optics_and_point_pixel_are_the_identity():
    camera = Camera(GaussianOptics(1e-5), BoxPixel(1e-5))
    f = np.linspace(0, 3, 31)
    np.testing.assert_allclose(camera.mtf(f, 0.3), 1, atol=1e-7)
    np.testing.assert_allclose(camera.esf(np.array([-0.01, 0.01])), [0, 1], atol=1e-12)


@pytest.mark.parametrize(("sigma", "percent"), [(0.2, 12), (0.3, 3.4), (0.5, 0.54), (0.8, 0.09)])
def test_square_pixel_is_not_isotropic(sigma, percent):
    """docs/model.md 2: a narrow highlight at 45 degrees to the grid, treated as isotropic, errs by this much of the peak."""
    camera = Camera(GaussianOptics(sigma), BoxPixel(0.5))
    r = np.linspace(0, 3, 601)
    straight = camera.psf(r, 0 * r)
    diagonal = camera.psf(r / np.sqrt(2), r / np.sqrt(2))
    error = 100 * float(jnp.max(jnp.abs(straight - diagonal)) / straight[0])
    assert error == pytest.approx(percent, rel=0.06)


@pytest.mark.parametrize("sigma", [0.3, 0.8])
def test_against_galsim(sigma):
    """GalSim convolves Gaussian and pixel by its own Fourier transforms."""
    accuracy = galsim.GSParams(
        folding_threshold=1e-7, maxk_threshold=1e-9, kvalue_accuracy=1e-10, maximum_fft_size=20000
    )
    kernel = galsim.Convolve(galsim.Gaussian(sigma=sigma), galsim.Pixel(1.0), gsparams=accuracy)
    image = kernel.drawImage(nx=9, ny=9, scale=0.37, method="sb", dtype=float).array
    x = (np.arange(9) - 4) * 0.37
    ours = Camera(GaussianOptics(sigma), BoxPixel(0.5)).psf(x, x[:, None])
    np.testing.assert_allclose(ours, image, rtol=0, atol=1e-6 * image.max())


def test_airy_pattern_against_galsim():
    optics = DiffractionOptics(f_number=5.6, wavelength=550e-9, pixel_pitch=4.73e-6)
    airy = galsim.Airy(lam_over_diam=float(1 / optics.cutoff))
    x, y = np.linspace(0, 30, 40), 7.0
    truth = [airy.xValue(float(a), y) for a in x]
    np.testing.assert_allclose(optics.psf(x, y), truth, rtol=0, atol=1e-12 * airy.xValue(0, 0))


@pytest.mark.slow
def test_measured_optics_sampled_from_a_gaussian_behave_like_it():
    f = np.linspace(0, 2.8, 281)
    curve = np.exp(-2 * (np.pi * 0.5 * f) ** 2)
    curve[-1] = 0
    measured, gaussian = (Camera(o, BoxPixel(0.5)) for o in (MeasuredOptics(f, curve), GaussianOptics(0.5)))
    x = np.linspace(-4, 4, 33)
    np.testing.assert_allclose(measured.lsf(x, 0.2), gaussian.lsf(x, 0.2), atol=2e-8)
    np.testing.assert_allclose(measured.psf(x, 0.3), gaussian.psf(x, 0.3), atol=2e-8)
    np.testing.assert_allclose(measured.optics.psf(x, 0.3), gaussian.optics.psf(x, 0.3), atol=2e-8)
    np.testing.assert_allclose(measured.esf(x), gaussian.esf(x), atol=2e-8)


@jax.jit
def _line_and_slope_of_edge(sigma, half_width, x, angle):
    camera = Camera(GaussianOptics(sigma), BoxPixel(half_width))
    return camera.lsf(x, angle), jax.grad(camera.esf)(x, angle)


@given(st.floats(0.05, 5), st.floats(0.05, 0.5), st.floats(-6, 6), st.floats(0, 2 * np.pi))
@example(0.5, 0.5, 0.5, 0.0)
@example(0.5, 0.5, 0.0, 0.7)
@example(2.0, 0.25, 0.25, np.pi / 4)
def test_edge_is_the_integral_of_the_line(sigma, half_width, x, angle):
    line, slope = _line_and_slope_of_edge(sigma, half_width, x, angle)
    assert float(slope) == pytest.approx(float(line), rel=1e-8, abs=1e-12)
    assert float(line) >= -1e-15


@jax.jit
def _in_windowed_pixel(sigma, half_width, x, std):
    return WindowedGaussianPixel(sigma, half_width).of_gaussian(x, std)


@given(st.floats(0.05, 3), st.floats(0.05, 0.5), st.floats(0.01, 3), st.floats(-4, 4))
def test_gaussian_in_a_windowed_pixel_is_the_integral_that_it_claims(std, half_width, sigma, x):
    weigh = lambda t: np.exp(-(t**2) / 2 / sigma**2)  # noqa: E731
    profile = lambda t: np.exp(-((x - t) ** 2) / 2 / std**2) / np.sqrt(2 * np.pi) / std  # noqa: E731
    kinks = [p for p in (x, 0.0) if -half_width < p < half_width]
    inside = quad(lambda t: weigh(t) * profile(t), -half_width, half_width, points=kinks, epsrel=1e-12, limit=200)[0]
    area = quad(weigh, -half_width, half_width, points=[0], epsrel=1e-12, limit=200)[0]
    assert float(_in_windowed_pixel(sigma, half_width, x, std)) == pytest.approx(inside / area, rel=1e-8, abs=1e-13)


@pytest.mark.parametrize("ratio", [1e-7, 1e-3, 0.0199, 0.0201, 0.3, 10.0])
def test_box_mean_keeps_its_digits_at_any_ratio(ratio):
    std = 0.7
    for z in (0.0, 0.7, 3.0, 8.0):
        x, p = z * std, ratio * std
        with mpmath.workdps(50):
            unit = std * mpmath.sqrt(2)
            truth = (mpmath.erfc((mpmath.mpf(x) - p) / unit) - mpmath.erfc((mpmath.mpf(x) + p) / unit)) / (
                4 * mpmath.mpf(p)
            )
        assert float(gaussian_over_interval(jnp.asarray(x), p, jnp.asarray(std))) == pytest.approx(
            float(truth), rel=1e-11
        )


def test_jit_and_batches_do_not_change_the_kernel(camera):
    x = np.linspace(-2, 2, 4)
    y = x[:, None]
    batched = camera.psf(x, y)
    one_by_one = np.array([[float(camera.psf(a, b)) for a in x] for b in x])
    np.testing.assert_allclose(batched, one_by_one, rtol=0, atol=1e-11)
    np.testing.assert_allclose(jax.jit(lambda a: camera.lsf(a, 0.2))(x), camera.lsf(x, 0.2), rtol=0, atol=1e-11)


def test_derivatives_by_the_cameras_parameters():
    def kernel(sigma, half_width):
        return Camera(GaussianOptics(sigma), BoxPixel(half_width)).psf(0.6, 0.2)

    gradient = jax.grad(kernel, argnums=(0, 1))(0.5, 0.4)
    h = 1e-6
    finite = (
        (kernel(0.5 + h, 0.4) - kernel(0.5 - h, 0.4)) / (2 * h),
        (kernel(0.5, 0.4 + h) - kernel(0.5, 0.4 - h)) / (2 * h),
    )
    np.testing.assert_allclose(gradient, finite, rtol=1e-7)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.6137])
def test_mtf50_is_where_the_mtf_is_one_half(sigma):
    camera = Camera(GaussianOptics(sigma), BoxPixel(0.5))
    exact = brentq(lambda f: np.exp(-2 * (np.pi * sigma * f) ** 2) * np.sinc(f) - 0.5, 0.01, 1.0)
    assert effective.mtf50(camera.optics, camera.pixel)[""] == pytest.approx(exact, abs=1e-6)
