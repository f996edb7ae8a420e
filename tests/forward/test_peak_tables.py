"""The table of EPD's peak, against quadrature that shares no code with it and against closed forms."""

from importlib import resources
from itertools import product

import numpy as np
import pytest

from matcam import (
    EPD,
    Beckmann,
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    Flat,
    GaussianOptics,
    Rig,
    Sphere,
    peak_response,
    rigs,
)
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.peaks import build_peak_tables
from matcam.forward.peaks.peak_tables import FILE
from tests.golden import rows
from tests.oracle import epd_peak

# The box in which the table has to hold 1e-4: beta, power, theta, sigma, half width, radius
LOW = np.array([1e-4, 0.3, 0.0, 0.2, 0.25, 100.0])
HIGH = np.array([0.5, 3.0, np.radians(85), 2.0, 0.5, 1000.0])
STATED = 3e-5  # what the file says of itself


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


def test_table_against_quadrature_at_random_points():
    worst = [errors_of(*p[:2], [p[2], 0.0], *p[3:]).max() for p in random_points(90, seed=7)]
    assert max(worst) < STATED


def test_table_against_quadrature_in_the_corners():
    corners = product(*zip(LOW[:2], HIGH[:2], strict=True), *zip(LOW[3:], HIGH[3:], strict=True))
    worst = [errors_of(*corner[:2], [0.0, HIGH[2]], *corner[2:]).max() for corner in corners]
    assert len(worst) == 32
    assert max(worst) < STATED


def test_table_against_quadrature_close_to_the_limb():
    """Beyond what is asked for, as far as `predict` looks."""
    theta = np.radians([87.0, 89.0, 89.9])
    worst = [errors_of(*p[:2], theta, *p[3:]).max() for p in random_points(20, seed=8)]
    assert max(worst) < STATED


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_table_against_quadrature_at_many_random_points(seed):
    worst = [errors_of(*p[:2], [p[2], 0.0], *p[3:]).max() for p in random_points(3000, seed)]
    assert max(worst) < STATED


@pytest.mark.slow
def test_the_table_is_what_its_builder_makes():
    built = build_peak_tables.build()
    with resources.files("matcam").joinpath(FILE).open("rb") as file, np.load(file) as shipped:
        assert set(shipped.files) == set(built)
        for name in ("plane", "line", "plane_limits", "line_limits"):
            np.testing.assert_allclose(shipped[name], built[name], rtol=0, atol=1e-5)


def test_the_file_is_small_and_states_its_error():
    path = resources.files("matcam").joinpath(FILE)
    assert len(path.read_bytes()) < 200_000
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        assert f"{STATED:g}".replace("e-0", "e-") in str(stored["error"])


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
        assert np.all((response > 0) & (response <= 1))
        assert np.all(np.diff(response, axis=1) < 1e-9)
        assert np.all(np.diff(response, axis=0) > -1e-9)


def test_cylinders_lose_in_one_dimension_and_flat_samples_nothing():
    theta, ndf, merl = np.radians([0.0, 40.0, 80.0]), EPD(0.002, 0.5), rigs.merl()
    on_cylinder = peak_response(Rig(merl.camera, Cylinder(256)), ndf, theta)
    np.testing.assert_allclose(on_cylinder, peak_response(merl, ndf, theta, dims=1), rtol=1e-12)
    np.testing.assert_array_equal(peak_response(Rig(merl.camera, Flat()), ndf, theta), 1)


def test_refusals_name_the_range():
    merl = rigs.merl()
    for ndf, rig, theta, message in (
        (
            EPD(1e-6, 1.0),
            merl,
            0.1,
            r"size of an EPD lobe on the sensor, in widths of the kernel, must lie in \[0.004, 7000\]",
        ),
        (EPD(0.01, 0.29), merl, 0.1, r"power of an EPD lobe whose peak is tabulated must lie in \[0.3, 3\], got 0.29"),
        (EPD(0.01, 1.0), merl, np.radians(89.95), r"foreshortening \(cos theta\) of an EPD lobe must lie in \[0.0017"),
        (
            EPD(0.01, 1.0),
            rig_of(0.1, 0.5, 256),
            0.1,
            r"half_width / sigma with an EPD lobe must lie in \[0, 2.5\], got 5",
        ),
        (EPD(0.01, 1.0), Rig(merl.camera, Sphere(256), lamp_radius=0.01), 0.1, "lamp_radius with an EPD lobe"),
        (
            EPD(0.01, 1.0),
            Rig(Camera(DiffractionOptics(8, 550e-9, 5e-6)), Sphere(256)),
            0.1,
            "GaussianOptics and BoxPixel, this camera has DiffractionOptics and BoxPixel",
        ),
    ):
        with pytest.raises(ArgumentError, match=message):
            peak_response(rig, ndf, theta)


def test_traced_values_outside_the_range_give_nan():
    jitted = jax.jit(lambda beta: peak_response(rigs.merl(), EPD(beta, 1.0), 0.1))
    assert np.isnan(float(jitted(1e-7)))
    assert float(jitted(1e-2)) == pytest.approx(float(peak_response(rigs.merl(), EPD(1e-2, 1.0), 0.1)), rel=1e-12)
