"""A sphere's light on a grid, and what lenses show of it, against quadratures that share no code with it: normals in polar
coordinates about the highlight or the optical axis, kernels in the plane. A Gaussian lens is given by its measured curve, which
no longer knows that it is one: so pictures go by frequencies, and the quadratures know the lens."""

import jax
import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    DistantLamp,
    Microfacet,
    NearLamp,
    Rig,
    Sphere,
    ZernikeOptics,
    measure,
    picture,
)
from matcam.core.grid import merl_grid
from matcam.core.jax import jnp
from matcam.forward import picture_values, table_values
from matcam.forward.frequencies.light_grid import LightGrid, per_px_for, serves
from matcam.forward.frequencies.mirrored import MirroredTransfer
from matcam.forward.frequencies.reading import Reading
from matcam.forward.frequencies.taps import Taps
from matcam.forward.integral.scene import Scene
from tests.forward.test_band_limited import gaussian_curve
from tests.oracle import aberrated, lamp_record, sphere_record

SIGMA = 0.6
PARTS = (8.0, 550e-9, 5e-6)


CAMERA = Camera(gaussian_curve(SIGMA), BoxPixel(0.5))


def pixels(image, radius, lamp, count, rng):
    """Rows and columns of the brightest pixel, and of some at the limb, at the terminator and anywhere in the light."""
    values, x, y = image.values[..., 0], *np.meshgrid(image.x.values, image.y.values)
    peak = values.max()
    chosen = [np.unravel_index(values.argmax(), values.shape)]
    limb = np.abs(np.hypot(x, y) - radius) < 3
    terminator = np.abs(x + np.cos(lamp) * np.sqrt(np.maximum(radius**2 - y**2, 0))) < 2
    for where, least in ((limb, 1e-5), (terminator, 1e-6), (np.ones_like(limb), 1e-6)):
        some = np.argwhere(where & (values > least * peak))
        chosen += [tuple(some[k]) for k in rng.integers(0, len(some), count)] if len(some) else []
    return np.array(chosen).T


def against_quadrature(radius, lamp, alpha, diffuse, seed, count=2):
    """Largest difference of pixels from adaptive quadrature, over the picture's peak."""
    image = picture(Microfacet(GGX(alpha), 1.0, diffuse=diffuse), Rig(CAMERA, Sphere(radius)), lamp)
    assert image.attrs["route"] == "frequencies"
    rows, columns = pixels(image, radius, lamp, count, np.random.default_rng(seed))
    truth = [
        sphere_record.record(
            x, y, lamp, sphere_record.Surface(alpha, diffuse), sphere_record.Setup(radius, np.inf, SIGMA)
        )
        for x, y in zip(image.x.values[columns], image.y.values[rows], strict=True)
    ]
    return np.abs(image.values[rows, columns, 0] - truth).max() / float(image.max())


@pytest.mark.parametrize(
    ("radius", "lamp", "alpha", "diffuse"),
    [
        pytest.param(30.0, 0.29, 0.015, 0.3, id="lamp beside the camera", marks=pytest.mark.slow),
        pytest.param(30.0, 1.7, 0.3, 0.3, id="all regions"),
        pytest.param(30.0, 2.87, 0.0015, 0.3, id="crescent"),
        pytest.param(30.0, 3.05, 0.1, 0.3, id="thin crescent", marks=pytest.mark.slow),
        pytest.param(4.0, 0.9, 0.2, 0.3, id="hardly larger than the kernel", marks=pytest.mark.slow),
    ],
)
def test_pixels_of_a_gaussian(radius, lamp, alpha, diffuse):
    assert against_quadrature(radius, lamp, alpha, diffuse, 5) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_pixels_of_drawn_scenes(seed):
    rng = np.random.default_rng(seed)
    lamp = rng.choice([rng.uniform(0.01, 0.3), rng.uniform(0.3, 2.6), rng.uniform(2.6, 3.12)])
    radius, alpha = np.exp(rng.uniform(np.log([2.6, 0.001]), np.log([250, 0.6])))
    assert against_quadrature(radius, lamp, alpha, rng.choice([0, 0.3]), seed) < 2e-6


def under_any_lamp(radius, lamp, azimuth, alpha, distance, disc, seed, count=1):
    kind = DistantLamp(disc) if np.isinf(distance) else NearLamp(distance, np.tan(disc) * distance)
    image = picture(Microfacet(GGX(alpha), 1.0, diffuse=0.3), Rig(CAMERA, Sphere(radius), kind), lamp, azimuth)
    assert image.attrs["route"] == "frequencies"
    rows, columns = pixels(image, radius, lamp, count, np.random.default_rng(seed))
    rig = lamp_record.Rig(radius, np.inf, distance, SIGMA, 0.5, disc)
    points = (6, 24) if disc else (1, 1)
    truth = [
        lamp_record.record(x, y, lamp, azimuth, lamp_record.Surface(alpha, 0.3), rig, points)
        for x, y in zip(image.x.values[columns], image.y.values[rows], strict=True)
    ]
    return np.abs(image.values[rows, columns, 0] - truth).max() / float(image.max())


def test_pixels_under_a_near_lamp_at_an_azimuth():
    assert under_any_lamp(20.0, 1.3, 2.4, 0.2, 5.0, 0.0, 1) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamp", "azimuth", "alpha", "distance", "disc"),
    [(2.4, -2.4, 0.1, np.inf, 0.02), (0.9, 0.8, 0.05, 43.0, 0.02), (2.5, 1.6, 0.02, 30.0, 0.0)],
)
def test_pixels_under_discs_and_far_round(lamp, azimuth, alpha, distance, disc):
    assert under_any_lamp(26.0, lamp, azimuth, alpha, distance, disc, 3) < 1e-6


def cells_against(truth, table, slices, count, peak, seed):
    """Largest difference of cells from `truth(angles)`, the means of both ways, as radiance over the peak's."""
    grid, rng, worst = merl_grid("centre"), np.random.default_rng(seed), []
    for j in slices:
        seen = np.argwhere(np.isfinite(table.values[:, j, :, 0]))
        for i, k in seen[rng.integers(0, len(seen), count)]:
            h, d, p = angles = grid.theta_h[i], grid.theta_d[j], grid.phi_d[k]
            # near the terminator a cell is divided by next to nothing
            cosine = np.cos(h) * np.cos(d) - np.sin(h) * np.sin(d) * abs(np.cos(p))
            worst.append((table.values[i, j, k, 0] - truth(angles)) * cosine / peak)
    return np.abs(worst).max()


@pytest.mark.slow
def test_cells_of_a_gaussian():
    """Over the whole table: small lamp angles, half moons, and crescents up to their tips."""
    surface, setup = sphere_record.Surface(0.3, 0.3), sphere_record.Setup(8.0, np.inf, SIGMA)
    table = measure(Microfacet(GGX(0.3), 1.0, diffuse=0.3), Rig(CAMERA, Sphere(8.0)))
    assert table.attrs["route"] == "frequencies"

    def truth(angles):
        return np.mean(sphere_record.recorded_cell(*angles, surface, setup))

    slices = (3, 44, 45, 70, 80, 86)
    assert cells_against(truth, table, slices, 2, 1 / (4 * np.pi * 0.3**2), 1) < 2e-6


COMA = ZernikeOptics(*PARTS, coma=(0.1, 0.06), defocus=0.05)
PUPIL = aberrated.Pupil(float(COMA.cutoff), 0.05, coma=(0.1, 0.06))


@pytest.mark.slow
@pytest.mark.parametrize("azimuth", [0.0, 2.2])
def test_pixels_through_coma(azimuth):
    """By the pupil's own integral; by the operator for Gaussians strong coma was 2.7e-3 of the peak off."""
    radius, angle = 20.0, 1.4
    image = picture(Microfacet(GGX(0.3), 1.0, diffuse=0.3), Rig(Camera(COMA), Sphere(radius)), angle, azimuth)
    rows, columns = pixels(image, radius, angle, 6, np.random.default_rng(2))
    lamp = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)
    at = image.x.values[columns], image.y.values[rows]
    truth = aberrated.sphere_pixels(*at, lamp, sphere_record.Surface(0.3, 0.3), PUPIL, radius)
    assert np.abs(image.values[rows, columns, 0] - truth).max() < 1e-5 * float(image.max())


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.1, 0.4])
def test_cells_through_coma(alpha):
    radius = 18.0
    table = measure(Microfacet(GGX(alpha), 1.0), Rig(Camera(COMA), Sphere(radius)))

    def truth(angles):
        h, d, p = angles[0], angles[1], angles[2] + np.array([0, np.pi])
        x, y = (np.array(a) for a in sphere_record.position(h, d, p, radius))
        cosine = np.cos(h) * np.cos(d) - np.sin(h) * np.sin(d) * np.cos(p)
        lamp = np.sin(2 * d), 0.0, np.cos(2 * d)
        # in crescents the sum's own nodes would show: 3e-5 of the peak with a fourth of them, 3e-6 between these and half
        seen = aberrated.sphere_pixels(x, y, lamp, sphere_record.Surface(alpha), PUPIL, radius, fine=4)
        return np.mean(seen / cosine)

    assert cells_against(truth, table, (10, 45, 80), 3, 1 / (4 * np.pi * alpha**2), 7) < 1e-5


@pytest.mark.parametrize(
    "lamp", [1.2, pytest.param(0.05, marks=pytest.mark.slow), pytest.param(2.9, marks=pytest.mark.slow)]
)
def test_all_light_of_a_matt_sphere_is_on_the_grid(lamp):
    """2 (sin + (pi - a) cos) / (3 pi) of the sphere's area, in closed form."""
    line = np.arange(-90, 91) / 3
    scene = Scene(Microfacet(GGX(0.1), 0.0, diffuse=1.0), Sphere(24.0), jnp.asarray(lamp))
    laid = LightGrid.of(line, line, 1.136).laid(scene)
    expected = 2 / (3 * np.pi) * (np.sin(lamp) + (np.pi - lamp) * np.cos(lamp)) * 24.0**2
    assert float(laid.sum()) / 9 == pytest.approx(expected, rel=1e-5)
    upper = LightGrid.of(line, line[90:], 1.136, symmetric=True).laid(scene)
    np.testing.assert_allclose(upper, laid[90:], rtol=0, atol=1e-6 * float(laid.max()))


def test_a_laid_point_has_all_low_frequencies_and_none_that_come_back():
    limit = 0.38
    taps, numbers = Taps.below(limit), np.arange(60)
    for position in (30.0, 30.2, 29.51):
        laid = np.asarray(taps.weights(jnp.array([position]), 0, 60))[:, 0]
        waves = np.exp(-2j * np.pi * np.linspace(0, limit, 40)[:, None] * (numbers - position))
        np.testing.assert_allclose(waves @ laid, 1, rtol=0, atol=2e-6)


def test_values_between_points_are_those_of_the_waves():
    limit, size, rng = 0.38, 64, np.random.default_rng(3)
    reading = Reading.below(limit)
    f = np.arange(-24, 25) / size
    wave = (rng.normal(size=(49, 49)) + 1j * rng.normal(size=(49, 49))) * (np.hypot(f, f[:, None]) < limit)
    lost = reading.transfer(np.abs(f))
    on_grid = np.exp(2j * np.pi * np.outer(np.arange(size), f))
    grid = (on_grid @ (wave / np.outer(lost, lost)) @ on_grid.T).real
    row, column = rng.uniform(-10, 80, (2, 30))
    found = reading.values(jnp.asarray(grid)[..., None], jnp.asarray(row), jnp.asarray(column))[:, 0]
    between = np.exp(2j * np.pi * np.multiply.outer((row, column), f))
    truth = np.einsum("pr,rc,pc->p", between[0], wave, between[1]).real
    np.testing.assert_allclose(found, truth, rtol=0, atol=3e-6 * np.abs(truth).max())


def test_what_is_laid_on_grids():
    assert serves(Sphere(60.0), 1.0, 1.136)
    assert serves(Sphere(3.0), 1.0, 1.136)
    assert not serves(Sphere(2.0), 1.0, 1.136)
    assert not serves(Sphere(60.0, distance=20.0), 1.0, 1.136)
    assert not serves(Sphere(60.0), 2.0, 1.136)
    assert not serves(Sphere(60.0), 1.0, 4.0)
    assert not serves(Cylinder(60.0), 1.0, 1.136)
    assert [per_px_for(f, 256.0) for f in (0.57, 1.136, 3.25)] == [2, 3, 8]
    assert per_px_for(1.136, 8.0) == 5


@pytest.mark.slow
def test_derivatives_of_pictures():
    camera = Camera(DiffractionOptics(*PARTS), BoxPixel(0.5))

    def seen(alpha, lamp, radius):
        material = Microfacet(GGX(alpha), 1.0, diffuse=0.2)
        return picture_values(material, Rig(camera, Sphere(radius)), lamp, (5, 47))[2, 41, 0]

    step, way = 1e-4, np.array([1.0, -2.0])
    slope = jax.jvp(lambda *at: seen(*at, 20.0), (0.3, 1.5), tuple(way))[1]
    ends = [seen(*(np.array([0.3, 1.5]) + sign * step * way), 20.0) for sign in (1, -1)]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-4)


@pytest.mark.slow
def test_derivatives_of_tables():
    def mean(alpha, f_number):
        optics = DiffractionOptics(f_number, 550e-9, 5e-6)
        values, _ = table_values(Microfacet(GGX(alpha), 1.0), Rig(Camera(optics), Sphere(18.0)))
        return jnp.mean(values[:6, 40, ::20, 0])

    slopes = jax.grad(mean, argnums=(0, 1))(0.1, 8.0)
    for k, step in ((0, 1e-5), (1, 1e-3)):
        at = np.array([0.1, 8.0])
        ends = [float(mean(*(at + sign * step * (np.arange(2) == k)))) for sign in (1, -1)]
        assert float(slopes[k]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


@pytest.mark.parametrize("rows", [2, 24, 30])
def test_half_a_picture_is_seen_as_the_whole_is(rows):
    rng = np.random.default_rng(rows)
    light, across = rng.normal(size=(rows - rows // 4, 13, 2)), np.fft.rfftfreq(16)
    transfer = np.exp(-3 * np.hypot(across, np.arange(rows + 1)[:, None] / (2 * rows)))
    whole = np.zeros((2 * rows, 16, 2))
    whole[: len(light), :13], whole[-len(light) :, :13] = light, light[::-1]
    passed = np.fft.rfft2(whole, axes=(0, 1)) * np.concatenate([transfer, transfer[-2:0:-1]])[..., None]
    seen = np.fft.irfft2(passed, (2 * rows, 16), axes=(0, 1))[:rows]
    half = MirroredTransfer.of(jnp.asarray(transfer[:-1])).seen(jnp.asarray(light), 16)
    np.testing.assert_allclose(half, seen, atol=1e-14)
