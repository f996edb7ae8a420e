"""Pictures through lenses that end at a frequency: filtered, not summed over Gaussians."""

import galsim
import jax
import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    DiffractionOptics,
    GaussianOptics,
    MeasuredOptics,
    Microfacet,
    Rig,
    Sphere,
    picture,
)
from matcam.forward import picture_values
from matcam.forward.frequencies.band_limited import band_limit

AIRY = DiffractionOptics(8.0, wavelength=550e-9, pixel_pitch=4e-6)
METAL = Microfacet(GGX(0.05), 0.9)


def gaussian_curve(sigma):
    """A measured curve of a Gaussian lens, which no longer knows that it is one."""
    f = np.linspace(0, 1.1 / sigma, 300)
    return MeasuredOptics(f, np.where(f < f[-1], np.exp(-2 * (np.pi * f * sigma) ** 2), 0.0))


@pytest.mark.slow
def test_a_gaussian_by_frequencies_is_a_gaussian():
    """Limb, terminator and highlight, whole and in a part of the picture."""
    exact, filtered = (
        picture(METAL, Rig(Camera(optics, BoxPixel(0.5)), Sphere(20.0)), 1.0, shape=(50, 50))
        for optics in (GaussianOptics(0.5), gaussian_curve(0.5))
    )
    assert (exact.attrs["route"], filtered.attrs["route"]) == ("space", "frequencies")
    assert filtered.attrs["kernel_error"] < 1e-6
    off = np.abs(filtered - exact).values
    assert np.all(off < 1e-4 * exact.values + 1e-5 * float(exact.max()))
    part = picture(METAL, Rig(Camera(gaussian_curve(0.5), BoxPixel(0.5)), Sphere(20.0)), 1.0, shape=(12, 20))
    np.testing.assert_allclose(part, filtered[19:31, 15:35], rtol=1e-4, atol=1e-5 * float(exact.max()))


@pytest.mark.parametrize("f_number", [8.0, pytest.param(4.0, marks=pytest.mark.slow)])
def test_a_point_of_light_is_the_airy_pattern_in_pixels(f_number):
    """A highlight of 0.002 px, by GalSim."""
    lens = DiffractionOptics(f_number, wavelength=550e-9, pixel_pitch=4e-6)
    found = picture(
        Microfacet(GGX(1e-4), 1.0, masking=None), Rig(Camera(lens, BoxPixel(0.5)), Sphere(8.0)), 0.0, shape=(13, 13)
    )
    airy = galsim.Airy(lam=550, diam=1.0, scale_unit=galsim.radians)
    airy = airy.dilate(float(1 / lens.cutoff) / (550e-9))  # lambda / D is one over the cutoff, px
    fine = galsim.GSParams(folding_threshold=1e-3)
    seen = galsim.Convolve(airy, galsim.Pixel(1.0), gsparams=fine)
    truth = seen.drawImage(nx=13, ny=13, scale=1.0, method="no_pixel").array
    ours = found.values[..., 0]
    np.testing.assert_allclose(ours / ours[6, 6], truth / truth[6, 6], rtol=0, atol=1e-4)


@pytest.mark.slow
def test_derivatives_by_the_lens():
    def centre(f_number):
        lens = DiffractionOptics(f_number, wavelength=550e-9, pixel_pitch=4e-6)
        return picture_values(METAL, Rig(Camera(lens, BoxPixel(0.5)), Sphere(12.0)), 0.6, (3, 5))[1, 3, 0]

    step = 1e-3
    finite = float(centre(8.0 + step) - centre(8.0 - step)) / (2 * step)
    assert float(jax.grad(centre)(8.0)) == pytest.approx(finite, rel=1e-4)


def test_a_lens_decides_how_it_is_pictured():
    assert band_limit(Camera(GaussianOptics(0.5))) is None
    slow, fast = (band_limit(Camera(DiffractionOptics(n, 550e-9, 4e-6))) for n in (16.0, 2.8))
    assert slow.per_px == 2
    assert 4 < fast.per_px <= 8
    assert max(slow.error, fast.error) < 1e-6
