"""Pictures of cylinders under lamps anywhere, against an oracle with a quadrature of its own."""

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, Cylinder, GaussianOptics, Microfacet, NearLamp, Rig, picture
from matcam.forward import picture_values
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from tests.forward.test_lamps import check_picture, made
from tests.oracle import lamp_record


def drawn(rng):
    """A roughness, a lamp's angle and azimuth, and a rig: lamps at 3 to 50 radii and distant ones, any azimuth."""
    camera, lamp = rng.choice([np.inf, rng.uniform(4, 40)]), rng.choice([np.inf, np.exp(rng.uniform(*np.log([3, 50])))])
    most = np.arccos(1 / camera) + np.arccos(1 / lamp) - 0.1
    angle, azimuth = min(rng.uniform(0.05, 2.2), most), rng.uniform(0, 2 * np.pi)
    geometry = {"radius": rng.choice([24.0, 100.0, 256.0]), "sigma": rng.choice([0.15, 0.5, 1.2])}
    return np.exp(rng.uniform(*np.log([0.003, 0.4]))), angle, azimuth, {"camera": camera, "lamp": lamp, **geometry}


def check_positions(rng, count, where=1.5):
    """Pixels of one drawn rig, half of them about the highlight: 1e-4 of the value or 1e-7 of the largest."""
    alpha, angle, azimuth, geometry = drawn(rng)
    rig, theirs = made(kind="cylinder", **geometry)
    radius, half = geometry["radius"], count // 2
    x, y = rng.uniform(-radius - 1, radius + 1, count), rng.uniform(-where * radius, where * radius, count)
    mirror = np.array(lamp_record.cylinder_mirror(angle, azimuth, theirs))
    if abs(mirror[1]) < 20 * radius:
        x[:half], y[:half] = mirror[:, None] + rng.normal(size=(2, half)) * [[3], [5]]
    x, y = np.round(x), np.round(y)
    positions = RecordPositions(x, y, np.full(count, angle), np.full(count, azimuth))
    material, imaging = Microfacet(GGX(alpha), 1.0, 0.2), imaging_of(rig)
    found = np.asarray(record(material, imaging, record_plan(imaging, positions, alpha)))[:, 0]
    surface = lamp_record.Surface(alpha, 0.2)
    truth = np.array([lamp_record.record(*at, angle, azimuth, surface, theirs) for at in zip(x, y, strict=True)])
    return np.abs(found - truth) / np.maximum(np.maximum(1e-4 * truth, 1e-7 * truth.max()), 1e-300)


@pytest.mark.slow
def test_drawn_pixels_are_those_of_an_independent_quadrature():
    """320 of 32 rigs."""
    missed = np.concatenate([check_positions(np.random.default_rng(seed), 10) for seed in range(32)])
    print(f"worst: {missed.max():.2g} of what is allowed, of {missed.size}")
    assert missed.max() < 1


@pytest.mark.parametrize("geometry", [{}, {"camera": 8.0, "lamp": 5.0}])
def test_a_lamp_beside_the_plane_across_the_axis(geometry):
    check_picture(0.05, 0.9, 2.3, 4, (5, 9), kind="cylinder", **geometry)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamp_angle", "azimuth", "disc", "rule", "geometry"),
    [
        (0.9, 0.7, 0.03, (4, 15), {}),
        (1.3, 3.1, 0.06, (6, 19), {"sigma": 0.3}),
        (0.8, 0.7, 0.05, (4, 15), {"camera": 6.0, "lamp": 5.0}),
        (1.1, 1.6, 0.03, (4, 15), {"lamp": 12.0}),
    ],
)
def test_pixels_under_a_disc(lamp_angle, azimuth, disc, rule, geometry):
    check_picture(0.1, lamp_angle, azimuth, 5, (9, 51), rule=rule, disc=disc, kind="cylinder", **geometry)


@pytest.mark.parametrize("azimuth", [0.0, 0.4])
def test_under_distant_lamps_every_row_is_the_same(azimuth):
    """However narrow the highlight: each of its rows is a line of light."""
    rig = Rig(Camera(GaussianOptics(0.5)), Cylinder(256.0))
    seen = picture(Microfacet(GGX(0.001), 1.0), rig, 1.0, azimuth, shape=(41, 301)).values
    np.testing.assert_array_equal(seen, np.broadcast_to(seen[:1], seen.shape))


def test_a_mirror_image_under_the_mirror_image_of_a_lamp():
    rig, material = Rig(Camera(GaussianOptics(0.5)), Cylinder(20.0, 9.0), NearLamp(6.0)), Microfacet(GGX(0.1), 1.0)
    one, up, left = (picture(material, rig, 0.7, azimuth, shape=(5, 9)).values for azimuth in (0.5, -0.5, np.pi - 0.5))
    np.testing.assert_allclose(one, up[::-1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one, left[:, ::-1], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_a_picture_within_an_error():
    rig, material = (
        Rig(Camera(GaussianOptics(0.5)), Cylinder(60.0, 9.0), NearLamp(6.0)),
        Microfacet(GGX(0.02), 1.0, 0.1),
    )
    exact, quick = (picture(material, rig, 0.7, 0.05, shape=(21, 131), error=error).values for error in (None, 1e-3))
    assert 0 < np.abs(quick - exact).max() < 1e-3 * exact.max()


def test_derivatives_are_those_of_differences():
    jax = pytest.importorskip("jax")

    def total(alpha, sigma):
        rig = Rig(Camera(GaussianOptics(sigma), BoxPixel(0.5)), Cylinder(20.0))
        return picture_values(Microfacet(GGX(alpha), 1.0), rig, 0.8, (1, 45), azimuth=0.2)[0, 20:].sum()

    _, slope = jax.jvp(total, (0.05, 0.6), (1.0, 1.0))
    step = 1e-5
    there, back = (total(0.05 + side * step, 0.6 + side * step) for side in (1, -1))
    np.testing.assert_allclose(slope, (there - back) / (2 * step), rtol=1e-5)
