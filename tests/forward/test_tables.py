"""What a rig's settings do to a whole table: the meaning of a cell, the sensor's crop, the pixels behind it, gradients."""

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Microfacet, Rig, Schlick, Sphere, measure
from matcam.core.grid import cosines, merl_grid, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.measurement import table_values
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from tests.oracle.sphere_record import Setup, Surface, position, recorded_cell

pytestmark = pytest.mark.slow

RADIUS = 100.0
SURFACE = Surface(0.03)
CELLS = [(0, 30, 90), (3, 20, 60), (12, 45, 130), (30, 10, 20), (50, 60, 95), (5, 75, 170)]


def rig(**more):
    return Rig(Camera(GaussianOptics(0.5)), Sphere(RADIUS), **more)


@pytest.fixture(scope="module")
def plain():
    return measure(Microfacet(GGX(SURFACE.alpha), 1.0), rig())


def one_way(theta_h, theta_d, phi_d):
    """Recorded radiance over the cosine of the light, at angles that broadcast, by the package's operator."""
    theta_h, theta_d, phi_d = (a.ravel() for a in np.broadcast_arrays(theta_h, theta_d, phi_d))
    x, y = position(theta_h, theta_d, phi_d, RADIUS)
    imaging = imaging_of(rig())
    plan = record_plan(imaging, RecordPositions(x, y, 2 * theta_d), SURFACE.alpha)
    values = record(Microfacet(GGX(SURFACE.alpha), 1.0), imaging, plan)[:, 0]
    return np.asarray(values) / np.asarray(cosines(theta_h, theta_d, phi_d)[0])


def test_cells_that_stand_for_their_edges():
    table = measure(Microfacet(GGX(SURFACE.alpha), 1.0), rig(cell_value="edge"))
    grid = merl_grid("edge")
    for i, j, k in CELLS:
        truth = np.mean(
            recorded_cell(grid.theta_h[i], grid.theta_d[j], grid.phi_d[k], SURFACE, Setup(RADIUS), rtol=1e-7)
        )
        assert float(table[i, j, k, 0]) == pytest.approx(truth, rel=1e-4)


def test_cells_that_stand_for_their_pixels():
    """The mean over a cell of both ways, each place as heavy as the pixels that it holds: by 12 x 12 places."""
    table = measure(Microfacet(GGX(SURFACE.alpha), 1.0), rig(cell_value="mean"))
    theta_d = merl_grid("centre").theta_d
    nodes, weights = np.polynomial.legendre.leggauss(12)
    edges = theta_h_edges()
    for i, j, k in CELLS:
        theta_h = edges[i] + (edges[i + 1] - edges[i]) * (1 + nodes[:, None]) / 2
        phi_d = (k + (1 + nodes) / 2) * np.pi / 180
        total = heavy = 0.0
        for turn in (0, np.pi):
            angles = theta_h, theta_d[j], phi_d + turn
            weight = weights[:, None] * weights * np.sin(theta_h) * np.asarray(cosines(*angles)[1])
            total += np.sum(weight * one_way(*angles).reshape(12, 12))
            heavy += np.sum(weight)
        # two places along either side stand for the cell: exact for what is a cubic across it
        assert float(table[i, j, k, 0]) == pytest.approx(total / heavy, rel=2e-3)


def test_a_crop_leaves_out_what_the_sensor_does_not_see(plain):
    cropped = measure(Microfacet(GGX(SURFACE.alpha), 1.0), rig(crop=(120, 160)))
    lost = cropped.isnull() & plain.notnull()
    assert 0.1 < float(lost.mean()) < 0.6
    both = cropped.notnull()
    np.testing.assert_array_equal(cropped.pixels.values == 0, cropped.isnull().values[..., 0])
    whole = (cropped.pixels == plain.pixels) & both[..., 0]
    np.testing.assert_allclose(cropped.values[whole], plain.values[whole], rtol=1e-9)
    assert float(whole.sum()) > 1e5


def test_pixels_behind_the_cells_are_those_of_the_picture(plain):
    """At each theta_d, the area of the sphere that is visible and lit: r^2 pi (1 + cos 2 theta_d) / 2."""
    theta_d = merl_grid("centre").theta_d
    area = np.pi * RADIUS**2 * (1 + np.cos(2 * theta_d)) / 2
    counted = plain.pixels.sum(("theta_h", "phi_d")).values
    np.testing.assert_allclose(counted[:80], area[:80], rtol=0.01)


@pytest.mark.parametrize("k", range(4))
def test_gradients(k):
    """Of cells of the table, to roughness, Fresnel, lens and pixel, against central differences under one plan: 1e-5."""
    numbers = np.array([0.03, 0.6, 0.5, 0.45])

    def made(numbers):
        alpha, f0, sigma, half_width = numbers
        return Microfacet(GGX(alpha), Schlick(f0), 0.1), Rig(
            Camera(GaussianOptics(sigma), BoxPixel(half_width)), Sphere(RADIUS)
        )

    grid = merl_grid("centre")
    random = np.random.default_rng(3)
    seen = np.argwhere(np.isfinite(np.asarray(table_values(*made(numbers))[0][..., 0])))
    i, j, l = seen[random.choice(len(seen), 300)].T  # noqa: E741 - the third index of a table
    weights = random.normal(size=i.size)

    def total(numbers):
        return jnp.sum(weights * table_values(*made(numbers))[0][i, j, l, 0])

    angles = grid.theta_h[i], grid.theta_d[j], grid.phi_d[l]
    x, y, light = [], [], []
    for turn in (0, np.pi):
        for out, value in zip((x, y), position(*angles[:2], angles[2] + turn, RADIUS), strict=True):
            out.append(value)
        light.append(np.asarray(cosines(*angles[:2], angles[2] + turn)[0]))
    positions = RecordPositions(np.concatenate(x), np.concatenate(y), 2 * np.tile(angles[1], 2))
    plan = record_plan(imaging_of(made(numbers)[1]), positions, numbers[0])

    def under_plan(numbers):
        material, rig = made(numbers)
        values = np.asarray(record(material, imaging_of(rig), plan)[:, 0]).reshape(2, -1)
        return float(np.sum(weights * np.mean(values / np.array(light), axis=0)))

    value, slope = jax.jvp(total, (jnp.asarray(numbers),), (jnp.eye(4)[k],))
    # in the table, cells around a highlight are interpolated along a ring
    assert float(value) == pytest.approx(under_plan(numbers), rel=1e-7)
    step = 4e-3 * numbers[k]
    there, back, far, farther = (under_plan(numbers + s * step * np.eye(4)[k]) for s in (1, -1, 2, -2))
    assert float(slope) == pytest.approx((8 * (there - back) - (far - farther)) / (12 * step), rel=1e-5)
