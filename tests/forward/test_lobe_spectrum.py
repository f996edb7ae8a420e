"""The peak of lobes that are no sums of Gaussians, against quadrature that shares no code with it and against closed forms."""

from itertools import product

import numpy as np
import pytest
from scipy.special import kv

from matcam import (
    EPD,
    GGX,
    Beckmann,
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    Flat,
    GaussianOptics,
    HaloOptics,
    Rig,
    Sphere,
    peak_response,
    rigs,
)
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.peaks.lobe_spectrum import lobe_spectrum
from matcam.material import AnisotropicGGX
from matcam.material.ndf.student_lobe import StudentLobe
from matcam.material.ndf.two_lobes import TwoLobes
from tests.golden import rows
from tests.oracle import epd_peak

# The box in which the quadrature has to hold 1e-6: beta, power, theta, sigma, half width, radius
LOW = np.array([1e-4, 0.3, 0.0, 0.2, 0.25, 100.0])
HIGH = np.array([0.5, 3.0, np.radians(85), 2.0, 0.5, 1000.0])
STATED = 1e-6


def rig_of(sigma, half_width, radius):
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(half_width)), Sphere(radius))


def errors_of(beta, power, theta, sigma, half_width, radius):
    """Relative error in two dimensions and in one; theta: several."""
    rig, ndf = rig_of(sigma, half_width, radius), EPD(beta, power)
    found = np.stack([np.asarray(peak_response(rig, ndf, theta, dims=dims)) for dims in (2, 1)])
    truth = [
        [epd_peak.peak(beta, power, radius * np.cos(t), across, sigma, half_width) for t in theta]
        for across in (radius, None)
    ]
    return np.abs(found / truth - 1)


def random_points(count, seed):
    """Even in the logarithms of all but the angle."""
    random = np.random.default_rng(seed)
    share = random.uniform(size=(count, 6))
    points = np.exp(np.log(np.maximum(LOW, 1e-9)) + share * np.log(HIGH / np.maximum(LOW, 1e-9)))
    points[:, 2] = share[:, 2] * HIGH[2]
    return points


def test_the_oracle_knows_the_gaussian_lobe():
    for beta, theta, sigma in ((1e-4, 0.3, 0.2), (0.01, 1.4, 0.5), (0.5, 1.0, 2.0)):
        truth = float(peak_response(rig_of(sigma, 0.4, 300), Beckmann(beta), theta))
        assert epd_peak.peak(beta, 1.0, 300 * np.cos(theta), 300, sigma, 0.4) == pytest.approx(truth, rel=1e-12)


def test_response_against_quadrature_at_random_points():
    worst = [errors_of(*p[:2], [p[2], 0.0], *p[3:]).max() for p in random_points(90, seed=7)]
    assert max(worst) < STATED


def test_response_against_quadrature_in_the_corners():
    corners = product(*zip(LOW[:2], HIGH[:2], strict=True), *zip(LOW[3:], HIGH[3:], strict=True))
    worst = [errors_of(*corner[:2], [0.0, HIGH[2]], *corner[2:]).max() for corner in corners]
    assert len(worst) == 32
    assert max(worst) < STATED


def test_response_against_quadrature_close_to_the_limb():
    """Beyond what is asked for, as far as `predict` looks."""
    theta = np.radians([87.0, 89.0, 89.9])
    worst = [errors_of(*p[:2], theta, *p[3:]).max() for p in random_points(20, seed=8)]
    assert max(worst) < STATED


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_response_against_quadrature_at_many_random_points(seed):
    worst = [errors_of(*p[:2], [p[2], 0.0], *p[3:]).max() for p in random_points(3000, seed)]
    assert max(worst) < STATED


@pytest.mark.parametrize("row", [r for r in rows("sphere_peak") if r["ndf"] == "epd"])
def test_tangent_plane_against_golden_exact_spheres(row):
    ndf = EPD(row["width"], row["epd_power"])
    rig = rig_of(row["sigma_mtf"], row["half_width"], row["radius"])
    assert float(peak_response(rig, ndf, row["theta"])) == pytest.approx(row["peak_2d"], rel=1e-3)


@pytest.mark.parametrize("dims", [1, 2])
def test_power_1_is_beckmann_and_so_are_its_derivatives(dims):
    theta = np.radians(np.linspace(0, 85, 18))
    for beta in (3e-4, 0.003, 0.1):
        found, truth = (
            jax.jvp(
                lambda b, n=ndf: peak_response(rigs.merl(), n(b), theta, dims=dims),
                (jnp.asarray(beta),),
                (jnp.asarray(beta),),
            )
            for ndf in (lambda b: EPD(b, 1.0), Beckmann)
        )
        np.testing.assert_allclose(found[0], truth[0], rtol=STATED)
        np.testing.assert_allclose(found[1], truth[1], rtol=0, atol=1e-3 * float(truth[1].max()))


def test_derivatives_against_differences():
    @jax.jit
    def response(values):
        beta, power, sigma, half_width, radius, theta = values
        return peak_response(rig_of(sigma, half_width, radius), EPD(beta, power), theta)

    at = jnp.asarray([0.004, 0.6, 0.45, 0.4, 200.0, 1.1])
    slopes = np.asarray(jax.jit(jax.grad(response))(at))
    for k, step in enumerate(1e-5 * np.asarray(at)):
        moved = np.eye(6)[k] * step
        by_difference = (float(response(at + moved)) - float(response(at - moved))) / (2 * step)
        assert slopes[k] == pytest.approx(by_difference, rel=1e-5)


def test_laws_of_the_tangent_plane():
    """In (0, 1], falling with the angle, growing with the width."""
    theta = np.radians(np.linspace(0, 89.5, 25))
    for power in (0.3, 0.8, 3.0):
        response = np.stack([peak_response(rigs.merl(), EPD(b, power), theta) for b in np.geomspace(1e-4, 0.5, 9)])
        assert np.all((response > 0) & (response <= 1 + STATED))
        assert np.all(np.diff(response, axis=1) < STATED)
        assert np.all(np.diff(response, axis=0) > -STATED)


def test_cylinders_lose_in_one_dimension_and_flat_samples_nothing():
    theta, ndf, merl = np.radians([0.0, 40.0, 80.0]), EPD(0.002, 0.5), rigs.merl()
    on_cylinder = peak_response(Rig(merl.camera, Cylinder(256)), ndf, theta)
    np.testing.assert_allclose(on_cylinder, peak_response(merl, ndf, theta, dims=1), rtol=1e-12)
    np.testing.assert_array_equal(peak_response(Rig(merl.camera, Flat()), ndf, theta), 1)


def test_spectra_are_those_of_tables_of_integrals():
    """Gradshteyn and Ryzhik (1980): 6.631, 6.532 and 3.723 for Beckmann's lobe, that of GGX, and its line."""
    k = np.geomspace(0.1, 400.0, 40)
    plane, line = (lobe_spectrum(Beckmann(0.01), dims).at(np.log(k)) for dims in (2, 1))
    gaussian = np.exp(-((k * 0.01) ** 2) / 4)
    np.testing.assert_allclose(plane, np.pi * 1e-4 * gaussian, rtol=1e-7)
    np.testing.assert_allclose(line, np.sqrt(np.pi) * 0.01 * gaussian, rtol=1e-7)
    plane, line = (lobe_spectrum(GGX(0.01), dims).at(np.log(k)) for dims in (2, 1))
    x = k * 0.01
    np.testing.assert_allclose(plane, np.pi * 1e-4 * x * kv(1, x), rtol=1e-7)
    np.testing.assert_allclose(line, np.pi / 2 * 0.01 * (1 + x) * np.exp(-x), rtol=1e-7)


@pytest.mark.parametrize("dims", [1, 2])
def test_students_t_is_ggx_and_two_lobes_are_their_sum(dims):
    theta = np.radians([0.0, 50.0, 85.0])
    of = lambda ndf: peak_response(rigs.merl(), ndf, theta, dims=dims)  # noqa: E731
    student = StudentLobe(np.asarray(0.004 / np.sqrt(2)), np.asarray(1.0))
    np.testing.assert_allclose(of(student), of(GGX(0.004)), rtol=1e-7)
    two = TwoLobes(*(np.asarray(value) for value in (0.002, 0.02, 0.3, 0.0, 1.0)))
    parts = (0.7, GGX(0.002)), (0.3, Beckmann(0.02))
    peaks = [share * float(lobe.slope_density(0.0)) for share, lobe in parts]
    expected = sum(peak * of(lobe) for peak, (_, lobe) in zip(peaks, parts, strict=True)) / sum(peaks)
    np.testing.assert_allclose(of(two), expected, rtol=1e-7)


@pytest.mark.parametrize("optics", [DiffractionOptics(8, 550e-9, 5e-6), HaloOptics(GaussianOptics(0.5), 0.02, 20.0)])
def test_power_1_is_beckmann_through_every_lens(optics):
    theta = np.radians([0.0, 60.0, 89.0])
    rig = Rig(Camera(optics), Sphere(256))
    for dims in (1, 2):
        found, truth = (peak_response(rig, ndf, theta, dims=dims) for ndf in (EPD(0.004, 1.0), Beckmann(0.004)))
        np.testing.assert_allclose(found, truth, rtol=1e-6)


def test_discs_of_lamp_and_lens_are_those_of_the_closed_form():
    rig = Rig(rigs.merl().camera, Sphere(256), lamp_radius=0.006, aperture=0.02, focus=0.3)
    cylinder = Rig(rigs.merl().camera, Cylinder(256), lamp_radius=0.006)
    for where, dims in ((rig, 2), (rig, 1), (cylinder, 2)):
        found, truth = (
            peak_response(where, ndf, np.radians([0.0, 60.0]), dims=dims) for ndf in (EPD(0.003, 1.0), Beckmann(0.003))
        )
        np.testing.assert_allclose(found, truth, rtol=1e-6)


def test_a_lobe_that_is_not_isotropic_is_refused():
    with pytest.raises(
        ArgumentError, match="the tangent plane needs an isotropic lobe, not AnisotropicGGX: use exact=True"
    ):
        peak_response(rigs.merl(), AnisotropicGGX(0.1, 0.2), 0.1)


def test_size_and_angle_have_no_limits_but_their_own():
    """A lobe far below a pixel's size reads its integral; one far above a camera's band is recorded as it is."""
    merl = rigs.merl()
    tiny = float(peak_response(merl, EPD(1e-7, 1.0), np.radians(89.99)))
    assert tiny == pytest.approx(float(peak_response(merl, Beckmann(1e-7), np.radians(89.99))), rel=1e-4)
    jitted = jax.jit(lambda beta: peak_response(merl, EPD(beta, 1.0), 0.1))
    assert float(jitted(1e-2)) == pytest.approx(float(peak_response(merl, EPD(1e-2, 1.0), 0.1)), rel=1e-9)
