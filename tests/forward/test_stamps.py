"""Stamps of highlights against GalSim, which nobody here wrote, and their laws."""

import galsim
import numpy as np
import pytest

from matcam import BoxPixel, Camera, DiffractionOptics, GaussianOptics, HaloOptics, WindowedGaussianPixel
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward import Highlights, highlight_stamps

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
        ((CAMERA, 8, [1, 2], [1, 2, 3], 0, 1, 1), "do not broadcast"),
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
