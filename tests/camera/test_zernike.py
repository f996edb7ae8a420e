"""Lenses with aberrations, for all colours and places or not, against the pupil's integral by other means."""

import jax
import numpy as np
import pytest

import matcam
from matcam import (
    GGX,
    BoxPixel,
    Camera,
    ColourOptics,
    DefocusOptics,
    DiffractionOptics,
    Flat,
    GaussianOptics,
    HaloOptics,
    Microfacet,
    Rig,
    SeidelOptics,
    Sphere,
    ZernikeOptics,
)
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.camera.optics.zernike import _MOST_DIRECTLY
from matcam.core.errors import ArgumentError
from tests.oracle import aberrated

PARTS = (8.0, 550e-9, 5e-6)
ALL = {"defocus": 0.05, "astigmatism": (0.1, -0.03), "coma": (0.1, 0.04), "trefoil": (0.02, 0.01), "spherical": 0.05}
LENS = ZernikeOptics(*PARTS, **ALL)
PUPIL = aberrated.Pupil(float(LENS.cutoff), **ALL)
RNG = np.random.default_rng(5)
FX, FY = RNG.uniform(-0.9, 0.9, (2, 60))


def test_without_aberrations_it_is_the_perfect_lens():
    perfect = DiffractionOptics(*PARTS)
    found = ZernikeOptics(*PARTS).otf(np.append(FX, 0), np.append(FY, 0))
    np.testing.assert_allclose(found, perfect.otf(np.append(FX, 0), np.append(FY, 0)), rtol=0, atol=1e-8)


@pytest.mark.parametrize("circle", [0.5, 3.0])
def test_defocus_alone_is_the_lens_out_of_focus(circle):
    waves = circle * PARTS[2] / (8 * PARTS[0]) / PARTS[1] / (2 * np.sqrt(3))
    found = ZernikeOptics(*PARTS, defocus=waves)
    other = DefocusOptics(*PARTS, circle)
    np.testing.assert_allclose(found.otf(FX, FY), other.otf(FX, FY), rtol=0, atol=1e-6)
    assert float(found.psf(0.3, 0.4)) == pytest.approx(float(other.psf(0.3, 0.4)), rel=1e-6)


def test_transfer_function_against_the_plane_integral():
    truth = [aberrated.otf(PUPIL, *f) for f in zip(FX, FY, strict=True)]
    np.testing.assert_allclose(LENS.otf(FX, FY), truth, rtol=0, atol=1e-9)
    assert complex(LENS.otf(0.0, 0.0)) == pytest.approx(1, abs=1e-12)
    assert complex(LENS.otf(1.2, 0.0)) == 0


@pytest.mark.parametrize("scale", [1.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_many_frequencies_are_read_from_a_table(scale):
    lens = ZernikeOptics(*PARTS, **{name: scale * np.array(value) for name, value in ALL.items()})
    fx, fy = RNG.uniform(-0.85, 0.85, (2, _MOST_DIRECTLY + 1))
    fx[:4], fy[:4] = [0, 1e-9, 0, float(lens.cutoff) * (1 - 1e-9)], [0, 0, -1e-3, 0]
    few = np.r_[0:200]
    np.testing.assert_allclose(np.asarray(lens.otf(fx, fy))[few], lens.otf(fx[few], fy[few]), rtol=0, atol=1e-6)


def test_point_spread_function_and_where_its_light_lies():
    line = np.arange(-9, 9.01, 0.25)
    x, y = np.meshgrid(line, line)
    psf = np.asarray(LENS.psf(x, y))
    np.testing.assert_allclose(psf, aberrated.spread(PUPIL, line, line), rtol=0, atol=1e-9 * psf.max())
    assert psf.min() >= 0
    # it is the transform of the transfer function, whose slope at 0 is the centroid
    for fx, fy in ((0.3, 0.0), (-0.2, 0.4)):
        by_sum = (psf * np.exp(-2j * np.pi * (fx * x + fy * y))).sum() / 16
        assert abs(by_sum - complex(LENS.otf(fx, fy))) < 4e-3  # its tail is cut off
    assert psf.sum() / 16 == pytest.approx(1, abs=0.03)
    step = 1e-4
    centroid = -np.angle(complex(LENS.otf(step, 0.0))) / (2 * np.pi * step)
    assert centroid == pytest.approx(-4 * np.sqrt(2) * ALL["coma"][0] / float(LENS.cutoff), rel=1e-3)


def test_kernels_of_the_camera_by_direction():
    camera = Camera(LENS, BoxPixel(0.5))
    kernel = aberrated.seen_by_pixel(PUPIL, 4.0)
    x, y = np.array([0.0, 0.7, -1.2, 2.0]), np.array([0.0, -0.4, 0.3, 1.5])
    # the point lies at (x, y) from the pixel, the pixel at (-x, -y) from the point
    np.testing.assert_allclose(camera.psf(x, y), kernel(-x, -y), rtol=0, atol=1e-6 * kernel(0, 0))
    at, angle, step = np.array([-0.6, 0.2, 1.1]), 0.6, 1e-3
    slope = (camera.esf(at + step, angle) - camera.esf(at - step, angle)) / (2 * step)
    np.testing.assert_allclose(slope, camera.lsf(-at, angle), rtol=1e-4)
    np.testing.assert_allclose(camera.esf(np.array([-400.0, 400.0]), angle), [0, 1], atol=1e-3)
    both = np.asarray(camera.mtf(0.4, np.array([0.0, np.pi])))
    assert both[0] == pytest.approx(both[1], rel=1e-12)  # of a real kernel
    total = camera.transfer(0.4, 0.1)
    assert abs(complex(total)) == pytest.approx(float(camera.mtf(np.hypot(0.4, 0.1), np.arctan2(0.1, 0.4))), rel=1e-9)
    glare = Camera(HaloOptics(LENS, 0.1, 3.0), BoxPixel(0.5))
    expected = 0.9 * camera.psf(0.5, 0.2) + 0.1 * Camera(GaussianOptics(3.0), BoxPixel(0.5)).psf(0.5, 0.2)
    assert float(glare.psf(0.5, 0.2)) == pytest.approx(float(expected), rel=1e-9)


def test_derivatives_by_a_coefficient():
    def real(coma):
        return ZernikeOptics(*PARTS, coma=(coma, 0.0)).otf(0.3, 0.2).imag

    step = 1e-4
    finite = (real(0.1 + step) - real(0.1 - step)) / (2 * step)
    assert float(jax.grad(real)(0.1)) == pytest.approx(float(finite), rel=1e-5)


def test_aberrations_grow_from_the_axis():
    lens = SeidelOptics(*PARTS, unit=100.0, defocus=0.01, astigmatism=0.2, coma=0.1, curvature=0.04, spherical=0.02)
    at = lens.at(-30.0, 40.0)
    np.testing.assert_allclose(at.coma, [-0.03, 0.04])
    np.testing.assert_allclose(at.astigmatism, 0.2 * np.array([0.09 - 0.16, -2 * 0.12]), atol=1e-15)
    assert float(at.defocus) == pytest.approx(0.02)
    np.testing.assert_allclose(lens.terms_at(np.array([-30.0]), np.array([40.0]))[0], at.terms)


METAL = Microfacet(GGX(0.1), 0.9)


@pytest.mark.parametrize(
    ("do", "words"),
    [
        (lambda: ZernikeOptics(*PARTS, coma=(np.nan, 0)), "coma must lie in [-5, 5] waves rms"),
        (
            lambda: ZernikeOptics(*PARTS, coma=(5e-8, 0)),
            "must be waves rms, not metres, but the largest modulus is 5e-08: 5e-08 m are 0.0909",
        ),
        (lambda: ZernikeOptics(*PARTS, coma=50), "coma must lie in"),
        (lambda: ZernikeOptics(*PARTS, coma=0.1), "coma must be two numbers"),
        (lambda: ZernikeOptics(*PARTS, defocus=(0.1, 0.1)), "defocus must be a single number"),
        (
            lambda: ZernikeOptics(*PARTS, defocus=4.0),
            "the wavefront error is up to 7.0 waves, more than the limit of 2.5",
        ),
        (lambda: ZernikeOptics(8.0, 550, 5e-6), "550 nm is 550e-9"),
        (lambda: SeidelOptics(*PARTS, unit=0.0), "unit must lie in (0, inf) px"),
        (lambda: SeidelOptics(*PARTS, unit=9.0, coma=1e-7), "not metres"),
        (lambda: SeidelOptics(*PARTS, unit=9.0, coma=1.0).at(90.0, 0.0), "the wavefront error is"),
        (lambda: ColourOptics(LENS, LENS, BoxPixel()), "blue must be Optics other than ColourOptics, got BoxPixel"),
        (lambda: ColourOptics(LENS, LENS, LENS, red_shift=1.0), "red_shift must be two numbers"),
        (lambda: Camera(ColourOptics(LENS, LENS, LENS)).psf(0.0, 0.0), "use Camera(optics.red, pixel)"),
        (lambda: Camera(SeidelOptics(*PARTS, unit=9.0)).mtf(0.1), "use Camera(optics.at(x, y), pixel)"),
        (lambda: HaloOptics(LENS, 0.1, 9.0).mtf(0.1), "does not depend on direction, colour or position"),
        (lambda: gaussian_sum(LENS), "`picture` and tables of a sphere support other lenses"),
        (
            lambda: matcam.measure(METAL, Rig(Camera(LENS), matcam.Cylinder(60.0))),
            "does not depend on direction, colour or position",
        ),
        (
            lambda: matcam.measure(METAL, Rig(Camera(SeidelOptics(*PARTS, unit=9.0)), Sphere(60.0, distance=9.0))),
            "SeidelOptics consists of several",
        ),
        (
            lambda: matcam.fit(
                matcam.forward.true_table(METAL).assign_attrs(sample="cylinder"),
                Rig(Camera(LENS), matcam.Cylinder(60.0)),
            ),
            "a fit of a cylinder",
        ),
        (
            lambda: matcam.peak_response(Rig(Camera(LENS), matcam.Cylinder(60.0)), GGX(0.1), 0.3, exact=True),
            "does not depend on direction, colour or position",
        ),
        (
            lambda: matcam.forward.highlight_stamps(Camera(LENS), 8, matcam.forward.Highlights(1.0, 0, 0, 1, 1)),
            "stamps need",
        ),
        (
            lambda: matcam.forward.texture_contrast(Rig(Camera(ColourOptics(LENS, LENS, LENS)), Flat()), 0.1, 0.3),
            "use Camera(optics.red, pixel)",
        ),
        (lambda: matcam.calibrate([], model="zernike"), "model must be one of"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(do, words):
    with pytest.raises(ArgumentError) as caught:
        do()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
