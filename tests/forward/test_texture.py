"""Pictures of textures: sines against golden contrasts, squares against sums of integrals, laws that any picture obeys."""

import numpy as np
import pytest
from scipy.special import erf

from matcam import BoxPixel, Camera, DiffractionOptics, Flat, GaussianOptics, HaloOptics, Rig, ZernikeOptics, rigs
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax
from matcam.forward import textured_picture
from tests.golden import rows


def rig(optics=None, half_width=0.5):
    return Rig(Camera(optics or GaussianOptics(0.5), BoxPixel(half_width)), Flat())


@pytest.mark.parametrize("row", rows("flat"))
def test_golden_contrast_of_a_sine(row):
    """Three waves on sixteen texels; the picture's amplitude, fitted, is the golden contrast."""
    pitch = 3 / (16 * row["frequency"])
    u = np.arange(16) - 7.5
    sine = np.broadcast_to(1 + 0.6 * np.cos(2 * np.pi * 3 * u / 16), (2, 16))
    picture = textured_picture(
        sine, rig(GaussianOptics(row["sigma_mtf"]), row["half_width"]), row["theta"], (2, 101), pitch
    )
    x = np.arange(101) - 50
    phase = 2 * np.pi * row["frequency"] / np.cos(row["theta"]) * x
    columns = np.stack([np.ones(101), 0.6 * np.cos(phase), 0.6 * np.sin(phase)], axis=1)
    found, residual, *_ = np.linalg.lstsq(columns, np.asarray(picture[1]), rcond=None)
    np.testing.assert_allclose(found, [1, row["contrast"], 0], rtol=1e-9, atol=1e-10)
    assert residual[0] < 1e-20  # and it is that sine, everywhere


@pytest.mark.parametrize("optics", [DiffractionOptics(8, 550e-9, 4.73e-6), HaloOptics(GaussianOptics(0.4), 0.1, 6.0)])
def test_a_sine_keeps_the_mtf_along_and_across_the_tilt(optics):
    theta, pitch = 0.9, 1.3
    u = np.arange(20) - 9.5
    wave = np.cos(2 * np.pi * 4 * u / 20)
    camera = rig(optics).camera
    for texture, f in ((1 + wave[None, :], 4 / 20 / pitch / np.cos(theta)), (1 + wave[:, None], 4 / 20 / pitch)):
        picture = np.asarray(textured_picture(np.broadcast_to(texture, (20, 20)), rig(optics), theta, (1, 1), pitch))
        # the central pixel lies on the crest
        assert float(picture[0, 0]) == pytest.approx(1 + float(camera.mtf(f)), rel=1e-9)


def test_aberrations_shift_and_weaken_waves_as_the_kernel_of_the_lens_does():
    """Waves to the right and upwards, against integrals over the kernel of a line."""
    lens = ZernikeOptics(8, 550e-9, 5e-6, coma=(0.25, -0.2), astigmatism=(0.05, 0.04))
    u, step = np.linspace(-150, 150, 12001, retstep=True)
    wave, turns = 0.5 * np.cos(2 * np.pi * 3 * (np.arange(16) - 7.5) / 16), 2 * np.pi * 3 / 16
    for angle, texture in (
        (0.0, np.broadcast_to(1 + wave, (16, 16))),
        (np.pi / 2, np.broadcast_to(1 + wave[:, None], (16, 16))),
    ):
        seen = np.asarray(textured_picture(texture, rig(lens), 0.0, (5, 5)))
        along = seen[2] if angle == 0 else seen[::-1, 2]
        kernel = np.asarray(rig(lens).camera.lsf(u, angle))
        for position, value in zip(np.arange(5) - 2, along, strict=True):
            truth = 1 + 0.5 * step * np.sum(kernel * np.cos(turns * (u + position)))
            assert value == pytest.approx(truth, abs=1e-4)
    assert abs(seen[3, 2] - seen[1, 2]) > 3e-3  # coma moves the wave


@pytest.mark.parametrize("texels", ["band-limited", "squares"])
@pytest.mark.parametrize("theta", [0.0, 1.5])
def test_a_uniform_texture_reads_its_own_albedo(texels, theta):
    colour = np.broadcast_to([0.18, 0.5, 0.9], (5, 4, 3))
    picture = textured_picture(colour, rig(), theta, (6, 7), 0.7, texels)
    np.testing.assert_allclose(picture, np.broadcast_to([0.18, 0.5, 0.9], (6, 7, 3)), rtol=1e-9)


def texel_weights(pixels, texels, scale, sigma, p):
    """What each texel's square gives to each pixel along one axis, by quadrature over the square, texture repeated."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    at = (np.arange(pixels) - (pixels - 1) / 2)[:, None, None]
    total = np.zeros((pixels, texels))
    for turn in range(-6, 7):
        centre = (np.arange(texels) - (texels - 1) / 2 + turn * texels)[:, None]
        d = at - scale * (centre + nodes / 2)
        kernel = (erf((d + p) / np.sqrt(2) / sigma) - erf((d - p) / np.sqrt(2) / sigma)) / (4 * p)
        total += kernel @ weights * scale / 2
    return total


@pytest.mark.parametrize(("theta", "pitch"), [(0.0, 1.0), (1.1, 2.3)])
def test_squares_against_their_integrals(theta, pitch):
    texture = np.random.default_rng(4).random((6, 5))
    texture[2] = 0
    sigma, p = 0.45, 0.4
    across = texel_weights(9, 6, pitch, sigma, p)
    along = texel_weights(8, 5, pitch * np.cos(theta), sigma, p)
    picture = textured_picture(texture, rig(GaussianOptics(sigma), p), theta, (9, 8), pitch, "squares")
    np.testing.assert_allclose(picture, across @ texture @ along.T, rtol=0, atol=1e-9)
    assert float(picture.min()) >= 0


def test_head_on_with_point_pixels_a_texture_is_its_own_picture():
    sharp = rig(GaussianOptics(1e-4), 1e-4)
    texture = np.random.default_rng(5).random((6, 7, 2))
    picture = textured_picture(texture, sharp, 0.0)
    np.testing.assert_allclose(picture, texture, atol=1e-6)
    # the texture repeats itself; its centre is the picture's
    wider = np.asarray(textured_picture(texture, sharp, 0.0, (12, 21)))
    np.testing.assert_allclose(wider[3:9, 7:14], texture, atol=1e-6)
    np.testing.assert_allclose(wider[:, :7], wider[:, 7:14], atol=1e-9)


def test_light_is_conserved():
    """Over whole periods the picture's mean is the texture's: blur moves light, it does not make any."""
    texture = np.random.default_rng(6).random((8, 8))
    for texels in ("band-limited", "squares"):
        picture = textured_picture(texture, rig(HaloOptics(GaussianOptics(0.5), 0.05, 9.0)), 0.0, (16, 16), 2.0, texels)
        assert float(picture.mean()) == pytest.approx(texture.mean(), rel=1e-9)


@pytest.mark.parametrize("texels", ["band-limited", "squares"])
def test_derivatives(texels):
    texture = np.random.default_rng(7).random((4, 5))

    def at(sigma, theta, bright):
        optics = GaussianOptics(sigma)
        lens = Rig(Camera(optics, BoxPixel(0.5)), Flat())
        return textured_picture(texture * bright, lens, theta, (3, 4), 1.5, texels)[1, 2]

    at = jax.jit(at)
    point, h = np.array([0.6, 0.7, 1.2]), 1e-5
    for i, slope in enumerate(jax.jit(jax.grad(at, argnums=(0, 1, 2)))(*point)):
        step = h * np.eye(3)[i]
        finite = float(at(*(point + step)) - at(*(point - step))) / (2 * h)
        assert float(slope) == pytest.approx(finite, rel=1e-5)


def holed(value):
    texture = np.ones((4, 4))
    texture[1, 2] = value
    return texture


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((holed(np.nan), rig(), 0.1), "texture must lie in [0, inf), got nan"),
        ((holed(-0.1), rig(), 0.1), "texture must lie in [0, inf), got -0.1"),
        ((holed(np.inf), rig(), 0.1), "texture must lie in [0, inf), got inf"),
        ((np.ones(5), rig(), 0.1), "texture must have shape (H, W) or (H, W, channels), got (5,)"),
        ((np.ones((0, 5)), rig(), 0.1), "texture must have at least one row"),
        ((np.ones((2, 2, 2, 2)), rig(), 0.1), "texture must have shape"),
        (([["a"]], rig(), 0.1), "texture must be a number"),
        ((np.ones((4, 4)), rig(), np.pi / 2), "theta_o must lie in [0, 1.5708) rad"),
        ((np.ones((4, 4)), rig(), [0.1, 0.2]), "theta_o must be a single number"),
        ((np.ones((4, 4)), rig(), 0.1, (0, 4)), "shape must be a tuple of two whole numbers"),
        ((np.ones((4, 4)), rig(), 0.1, (4, 4), 0.0), "texture_pitch must lie in (0, inf) px, got 0"),
        ((np.ones((4, 4)), rig(), 0.1, (4, 4), 1.0, "nearest"), "texels must be one of 'band-limited', 'squares'"),
        ((np.ones((4, 4)), rig(), 0.1, (4, 4), 1e4, "squares"), "give a smaller texture"),
        ((np.ones((4, 4)), rigs.merl(), 0.1), "needs a rig with a Flat sample, got Sphere"),
    ],
)
def test_nonsense_is_refused(arguments, words):
    with pytest.raises(ArgumentError) as caught:
        textured_picture(*arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
