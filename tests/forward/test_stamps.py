"""Stamps of highlights against GalSim, which nobody here wrote, and their laws."""

import galsim
import numpy as np
import pytest
from scipy.special import erf

from matcam import (
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    GaussianOptics,
    HaloOptics,
    NearLamp,
    Rig,
    Sphere,
    WindowedGaussianPixel,
)
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward import Highlights, highlight_stamps, rig_highlights

TIGHT = galsim.GSParams(
    folding_threshold=1e-9, maxk_threshold=1e-10, kvalue_accuracy=1e-12, xvalue_accuracy=1e-12, maximum_fft_size=32768
)


def galsim_stamp(size, sigma, side, flux, x, y, along, across, angle):
    """The same highlight by multiplied transforms; row 0 on top."""
    highlight = galsim.Gaussian(sigma=np.sqrt(along * across), flux=flux, gsparams=TIGHT)
    highlight = highlight.shear(q=across / along, beta=angle * galsim.radians)
    lens, pixel = galsim.Gaussian(sigma=sigma, gsparams=TIGHT), galsim.Pixel(side)
    drawn = galsim.Convolve([highlight, lens, pixel], gsparams=TIGHT).drawImage(
        nx=size, ny=size, scale=1, method="no_pixel", offset=(x, y), dtype=float
    )
    return drawn.array[::-1]


def worst(ours, theirs):
    return np.abs(ours - theirs).max() / theirs.max()


@pytest.mark.parametrize(
    ("sigma", "along", "across"), [(0.5, 0.6, 0.6), (0.5, 1.5, 0.3), (0.15, 0.2, 0.14), (0.15, 3, 0.14)]
)
def test_against_galsim(sigma, along, across):
    """64 x 64 px, off centre: aligned both ways, and at ten orientations; the narrowest is 0.2 px with its lens."""
    camera = Camera(GaussianOptics(sigma))
    where = 1.3, 0.2, -0.3
    lying = highlight_stamps(camera, 64, Highlights(*where, along, across))
    assert worst(lying, galsim_stamp(64, sigma, 1, *where, along, across, 0.0)) < 1e-9
    standing = highlight_stamps(camera, 64, Highlights(*where, across, along))
    assert worst(standing, galsim_stamp(64, sigma, 1, *where, along, across, np.pi / 2)) < 1e-9
    angles = np.random.default_rng(3).uniform(-np.pi, np.pi, 10)
    angles[:2] = np.pi / 4, -np.pi / 4
    for angle, ours in zip(
        angles, highlight_stamps(camera, 64, Highlights(*where, along, across, angles)), strict=True
    ):
        assert worst(ours, galsim_stamp(64, sigma, 1, *where, along, across, angle)) < 1e-7  # allowed: 5e-7


def test_a_small_pixel():
    """Edges that neighbours do not share."""
    camera = Camera(GaussianOptics(0.3), BoxPixel(0.35))
    numbers = 0.7, -0.4, 1.1, 0.9, 0.2
    theirs = galsim_stamp(33, 0.3, 0.7, *numbers, 0.5)
    assert worst(highlight_stamps(camera, 33, Highlights(*numbers, 0.5)), theirs) < 1e-7
    theirs = galsim_stamp(33, 0.3, 0.7, *numbers, 0.0)
    assert worst(highlight_stamps(camera, 33, Highlights(*numbers)), theirs) < 1e-9


def drawn(count, seed):
    random = np.random.default_rng(seed)
    centres = random.uniform(-2, 2, (2, count))
    return random.uniform(0.5, 2, count), *centres, random.uniform(0.3, 2, count), random.uniform(0, 0.5, count)


def test_laws():
    """Light is conserved; no angle is angle 0; a batch is its stamps; a half turn changes nothing; a quarter turn swaps."""
    camera, highlights = Camera(GaussianOptics(0.4)), drawn(6, 1)
    flux, x, y, along, across = highlights
    stamps = highlight_stamps(camera, 48, Highlights(*highlights, 0.7))
    np.testing.assert_allclose(stamps.sum((1, 2)), flux, rtol=1e-7)
    aligned = highlight_stamps(camera, 48, Highlights(*highlights))
    np.testing.assert_allclose(aligned.sum((1, 2)), flux, rtol=1e-12)
    np.testing.assert_allclose(highlight_stamps(camera, 48, Highlights(*highlights, 0.0)), aligned, atol=1e-8)
    turned = highlight_stamps(camera, 48, Highlights(*highlights, 0.7 + np.pi))
    np.testing.assert_allclose(turned, stamps, atol=1e-12)
    swapped = highlight_stamps(camera, 48, Highlights(flux, x, y, across, along, 0.7 - np.pi / 2))
    np.testing.assert_allclose(swapped, stamps, atol=1e-12)
    # transposing the picture mirrors position and direction about the diagonal; the rule runs along y alone
    mirrored = highlight_stamps(camera, 48, Highlights(flux, -y, -x, along, across, -np.pi / 2 - 0.7))
    np.testing.assert_allclose(np.swapaxes(mirrored, 1, 2), stamps, atol=5e-8)
    for k in (0, 5):
        single = highlight_stamps(camera, 48, Highlights(*(number[k] for number in highlights), 0.7))
        np.testing.assert_allclose(single, stamps[k], atol=1e-8)
    jitted = jax.jit(lambda angle: highlight_stamps(camera, 48, Highlights(*highlights, angle)))(0.7)
    np.testing.assert_allclose(jitted, stamps, atol=1e-8)


def test_a_point_is_the_camera_itself():
    camera = Camera(GaussianOptics(0.45), BoxPixel(0.5))
    offset = np.arange(-3, 4)
    expected = camera.psf(offset[None, :] - 0.2, -offset[:, None] + 0.3)
    for angle in (None, 1.0):
        np.testing.assert_allclose(
            highlight_stamps(camera, 7, Highlights(1.0, 0.2, -0.3, 0.0, 0.0, angle)), expected, atol=1e-8
        )


def test_a_halo_is_a_part():
    core, wide = GaussianOptics(0.5), GaussianOptics(4.0)
    numbers = 1.0, 0.1, 0.2, 0.8, 0.3, 0.6
    parts = [highlight_stamps(Camera(lens), 16, Highlights(*numbers)) for lens in (core, wide)]
    whole = highlight_stamps(Camera(HaloOptics(core, 0.1, 4.0)), 16, Highlights(*numbers))
    np.testing.assert_allclose(whole, 0.9 * parts[0] + 0.1 * parts[1], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("angle", [(), (0.4,)])
def test_gradients(angle):
    """Of a weighted sum of pixels, with respect to every number of highlight, lens and pixel."""
    weights = np.random.default_rng(2).normal(size=(9, 9))
    numbers = np.array([1.3, 0.2, -0.4, 0.8, 0.3, 0.5, 0.45, *angle])

    def total(numbers):
        flux, x, y, along, across, sigma, half_width, *angle = numbers
        camera = Camera(GaussianOptics(sigma), BoxPixel(half_width))
        return jnp.sum(weights * highlight_stamps(camera, 9, Highlights(flux, x, y, along, across, *angle)))

    gradient = jax.grad(total)(jnp.asarray(numbers))
    for k, step in enumerate(np.eye(len(numbers)) * 1e-5):
        np.testing.assert_allclose(
            gradient[k], (total(numbers + step) - total(numbers - step)) / 2e-5, rtol=1e-5, atol=1e-8
        )


CAMERA = Camera(GaussianOptics(0.5))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((GaussianOptics(0.5), 8, 1, 0, 0, 1, 1), "camera must be a Camera"),
        ((Camera(DiffractionOptics(8, 550e-9, 5e-6)), 8, 1, 0, 0, 1, 1), "need GaussianOptics"),
        (
            (Camera(GaussianOptics(0.5), WindowedGaussianPixel(0.3)), 8, 1, 0, 0, 1, 1),
            "BoxPixel, got WindowedGaussianPixel",
        ),
        ((CAMERA, 0, 1, 0, 0, 1, 1), "size must be a whole number of pixels in [1, 4096], got 0"),
        ((CAMERA, 8.5, 1, 0, 0, 1, 1), "size must be a whole number of pixels in [1, 4096], got 8.5"),
        ((CAMERA, 8, 1, 0, 0, -1, 1), "std_along must lie in [0, inf) px, got -1"),
        ((CAMERA, 8, 1, 0, 0, 1, np.nan), "std_across must lie in [0, inf) px, got nan"),
        ((CAMERA, 8, np.inf, 0, 0, 1, 1), "flux must be finite, got inf"),
        ((CAMERA, 8, 1, 0, 0, 1, 1, "up"), "angle must be a number"),
        ((CAMERA, 8, [1, 2], [1, 2, 3], 0, 1, 1), "must have shapes that broadcast"),
    ],
)
def test_nonsense_is_refused(arguments, words):
    with pytest.raises(ArgumentError) as caught:
        camera, size, *values = arguments
        highlight_stamps(camera, size, Highlights(*values))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_highlights_are_named():
    with pytest.raises(
        ArgumentError, match=r"highlights must be Highlights\(flux, x, y, std_along, std_across\), got tuple"
    ):
        highlight_stamps(CAMERA, 8, (1, 0, 0, 1, 1))


def summed(width, lamp_angle, azimuth, where, q, w, radius=256.0, sigma=0.5):
    """Pixels at `where`, px, of a Gaussian lobe before a camera at 1 / q radii and under a lamp at 1 / w: a sum over normals
    about the brightest one, which a bisection finds."""
    low, high = 0.0, lamp_angle
    for _ in range(60):
        u = (low + high) / 2
        view, light = np.array([-q * np.sin(u), 1 - q * np.cos(u)]), np.array([np.sin(lamp_angle), np.cos(lamp_angle)])
        light = light - w * np.array([np.sin(u), np.cos(u)])
        half = view / np.linalg.norm(view) + light / np.linalg.norm(light)
        low, high = (u, high) if half[0] * np.cos(u) > half[1] * np.sin(u) else (low, u)
    t, chi = np.meshgrid(
        (np.arange(500) + 0.5) / 500 * 7 * width, (np.arange(96) + 0.5) / 96 * 2 * np.pi, indexing="ij"
    )
    along, across, up = np.sin(t) * np.cos(chi), np.sin(t) * np.sin(chi), np.cos(t)
    n = np.stack([along * np.cos(u) + up * np.sin(u), across, up * np.cos(u) - along * np.sin(u)])
    towards = np.array([np.sin(lamp_angle), 0, np.cos(lamp_angle)])[:, None, None]
    view, light = np.array([0, 0, 1.0])[:, None, None] - q * n, towards - w * n
    length, far = np.linalg.norm(view, axis=0), np.linalg.norm(light, axis=0)
    half = view / length + light / far
    angle = np.arcsin(np.linalg.norm(np.cross(half, n, axis=0), axis=0) / np.linalg.norm(half, axis=0))
    depth, stretch = 1 - q * n[2], radius * np.sqrt(1 - q**2)
    density = np.exp(-((angle / width) ** 2) / 2) / (2 * np.pi * width**2)
    area = stretch**2 * length / depth**3 * np.sin(t) * (7 * width / 500) * (2 * np.pi / 96)
    light_sent = density / 4 / far**2 * area
    x, y = stretch * n[0] / depth, stretch * n[1] / depth
    x, y = x * np.cos(azimuth) - y * np.sin(azimuth), x * np.sin(azimuth) + y * np.cos(azimuth)

    def kernel(d):
        return (erf((d + 0.5) / (np.sqrt(2) * sigma)) - erf((d - 0.5) / (np.sqrt(2) * sigma))) / 2

    return np.array([np.sum(light_sent * kernel(x - a) * kernel(y - b)) for a, b in where])


@pytest.mark.parametrize(
    ("camera", "lamp", "degrees", "azimuth", "by_rig"),
    [
        (np.inf, np.inf, 60.0, 0.0, False),
        (20.0, 28.0, 100.0, 0.0, False),
        (6.0, 4.0, 70.0, 0.6, False),
        (np.inf, 3.0, 20.0, 2.0, False),
        (6.0, 4.0, 70.0, 0.6, True),
    ],
)
def test_highlights_of_a_rig(camera, lamp, degrees, azimuth, by_rig):
    """Nine pixels about the highlight, against a sum over normals that knows no tangent plane.

    The rig states the azimuth, or another, which the one that is given goes before.
    """
    light = None if np.isinf(lamp) else NearLamp(lamp)
    stated = azimuth if by_rig else azimuth + 1
    rig = Rig(Camera(GaussianOptics(0.5)), Sphere(256.0, camera), light, lamp_azimuth=stated)
    given = None if by_rig else azimuth
    found = rig_highlights(rig, 0.002, np.radians(degrees), given, reflectance=0.5)
    middle = np.round([float(found.x), float(found.y)])
    stamp = highlight_stamps(rig.camera, 3, found._replace(x=found.x - middle[0], y=found.y - middle[1]))
    where = [(middle[0] + column, middle[1] - row) for row in (-1, 0, 1) for column in (-1, 0, 1)]
    truth = 0.5 * summed(0.002, np.radians(degrees), azimuth, where, 1 / camera, 1 / lamp)
    off = np.abs(np.asarray(stamp).ravel() - truth).max() / truth.max()
    print(f"worst {off:.1e} of the peak")
    assert off < 6e-4
    assert (found.angle is None) == (azimuth == 0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rig_highlights(NEAR, 0.6, 0.5), r"width must lie in \(0, 0.5\] rad, got 0.6"),
        (lambda: rig_highlights(NEAR, 0.01, [0.5, 2.9]), "the lamp is behind the sample"),
        (
            lambda: rig_highlights(NEAR, 0.01, 0.5, 45),
            "azimuth must lie in .*, got 45; if 45 is in degrees, give np.radians",
        ),
        (lambda: rig_highlights(NEAR, 0.01, [0.1, 0.2], [0.1, 0.2, 0.3]), "shapes that broadcast"),
        (lambda: rig_highlights(NEAR, 0.01, 0.5, reflectance=-1), "reflectance must lie in"),
        (lambda: rig_highlights(Rig(NEAR.camera, Cylinder(20)), 0.01, 0.5), "need a Sphere, got a rig with a Cylinder"),
        (lambda: rig_highlights(NEAR.camera, 0.01, 0.5), "rig must be a Rig"),
        (
            lambda: rig_highlights(Rig(NEAR.camera, Sphere(20, 5), NearLamp(5)), 0.01, [0.5, 0.0]),
            "is inside the camera",
        ),
    ],
)
def test_highlights_that_no_rig_shows_are_refused(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()


NEAR = Rig(Camera(GaussianOptics(0.5)), Sphere(20.0), NearLamp(3.0))
