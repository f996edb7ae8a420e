"""Peaks of real spheres and cylinders, against reference values and integrals by another route."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import erf

from docs_claims import limit
from matcam import (
    EPD,
    GGX,
    Beckmann,
    BoxPixel,
    Camera,
    Cylinder,
    Flat,
    GaussianNDF,
    GaussianOptics,
    HaloOptics,
    Rig,
    Sphere,
    peak_response,
)
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax
from matcam.material import AnisotropicGGX
from tests.golden import rows

FAMILIES = {"gaussian": GaussianNDF, "ggx": GGX, "beckmann": Beckmann, "epd": EPD}


def rig_of(sample, sigma=0.5, half_width=0.5):
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(half_width)), sample)


@pytest.mark.parametrize("family", FAMILIES)
def test_golden_spheres(family):
    chosen = [row for row in rows("sphere_peak") if row["ndf"] == family]
    assert len(chosen) >= 5
    for row in chosen:
        ndf = FAMILIES[family](row["width"], *([row["epd_power"]] if family == "epd" else []))
        rig = rig_of(Sphere(row["radius"]), row["sigma_mtf"], row["half_width"])
        masking = "smith" if family == "ggx" else None
        found = peak_response(rig, ndf, [0.0, row["theta"]], exact=True, masking=masking)
        assert_allclose(found[1], row["peak_2d"], rtol=limit("exact-peaks"))
        assert_allclose(found[1] / found[0], row["relative_2d"], rtol=limit("exact-peaks"))


def test_the_tangent_plane_is_its_limit():
    theta = np.radians([0, 40, 70])
    rig = rig_of(Sphere(256.0))
    assert_allclose(peak_response(rig, GGX(0.001), theta, exact=True), peak_response(rig, GGX(0.001), theta), rtol=1e-5)


def test_close_to_the_limb_a_peak_may_read_too_bright_until_the_kernel_reaches_over_it():
    """docs/model.md 4, w = 100 sigma_mtf: Gaussian D, G = 1: 1.006 / 1.119 / 0.764 at 80 / 85 / 87 degrees; GGX 0.940."""
    wide = 100 * 0.5 / 256
    theta = np.radians([80, 85, 87])
    bright = peak_response(rig_of(Sphere(256.0)), GaussianNDF(wide), theta, exact=True, masking=None)
    assert_allclose(bright, [1.006, 1.119, 0.764], atol=6e-4)
    smith = peak_response(rig_of(Sphere(256.0)), GGX(wide), theta, exact=True)
    assert_allclose(smith[1], 0.940, atol=6e-4)


def test_cylinder_by_one_integral():
    """Along the axis nothing changes: the record is an integral over the normals of one plane."""
    radius, theta, alpha, sigma = 100.0, 1.0, 0.05, 0.6

    def light(u):
        slope2 = np.tan(u - theta) ** 2
        return (1 + slope2) ** 2 / (1 + slope2 / alpha**2) ** 2

    def kernel(d):
        return (erf((d + 0.5) / (np.sqrt(2) * sigma)) - erf((d - 0.5) / (np.sqrt(2) * sigma))) / 2

    centre = radius * np.sin(theta)
    low, high = np.arcsin((centre - 4) / radius), np.arcsin((centre + 4) / radius)
    recorded = quad(
        lambda u: light(u) * kernel(centre - radius * np.sin(u)) * radius, low, high, epsabs=0, epsrel=1e-10, limit=200
    )[0]
    found = peak_response(rig_of(Cylinder(radius), sigma), GGX(alpha), theta, exact=True, masking=None)
    assert_allclose(found, recorded * np.cos(theta), rtol=1e-6)
    # anisotropic: only what runs around the cylinder counts
    twisted = AnisotropicGGX(alpha, 0.3)
    assert_allclose(
        peak_response(rig_of(Cylinder(radius), sigma), twisted, theta, exact=True, masking=None), found, rtol=1e-9
    )


@pytest.mark.slow
def test_a_halo_keeps_what_its_core_keeps():
    """The halo's own share of the peak is small but there; the core's is the core's."""
    ndf, theta = GGX(0.01), np.array([0.5])
    core = peak_response(rig_of(Sphere(100.0)), ndf, theta, exact=True)
    with_halo = Rig(Camera(HaloOptics(GaussianOptics(0.5), 0.1, 20.0), BoxPixel(0.5)), Sphere(100.0))
    found = peak_response(with_halo, ndf, theta, exact=True)
    tangent = peak_response(with_halo, ndf, theta) - 0.9 * peak_response(rig_of(Sphere(100.0)), ndf, theta)
    assert float((found - 0.9 * core)[0]) > 0
    assert_allclose(found - 0.9 * core, tangent, rtol=0.15)


def test_flat_samples_lose_nothing_and_wrong_questions_are_told():
    assert_allclose(peak_response(rig_of(Flat()), EPD(0.01, 0.7), [0.0, 1.0], exact=True), 1)
    with pytest.raises(ArgumentError, match="dims must be 2"):
        peak_response(rig_of(Sphere(100.0)), GGX(0.1), 0.5, dims=1, exact=True)
    with pytest.raises(ArgumentError, match="masking must be one of"):
        peak_response(rig_of(Sphere(100.0)), GGX(0.1), 0.5, exact=True, masking="cook")
    with pytest.raises(ArgumentError, match="exact=True"):
        peak_response(rig_of(Sphere(100.0)), AnisotropicGGX(0.1, 0.2), 0.5)
    for exact in (True, False):
        with pytest.raises(ArgumentError, match="radius must exceed the camera's blur"):
            peak_response(rig_of(Sphere(0.4), 0.2), GGX(0.1), 0.5, exact=exact)


@pytest.mark.parametrize(
    "lens",
    [
        GaussianOptics,
        pytest.param(lambda sigma: HaloOptics(GaussianOptics(sigma), 0.05, 20 * sigma), marks=pytest.mark.slow),
    ],
)
def test_gradients_against_differences(lens):
    def response(numbers):
        width, sigma, half_width = numbers
        rig = Rig(Camera(lens(sigma), BoxPixel(half_width)), Sphere(150.0))
        return peak_response(rig, GGX(width), 1.2, exact=True)

    at = np.array([0.004, 0.5, 0.4])
    gradient = jax.grad(response)(at)
    for i, step in enumerate(np.diag(1e-4 * at)):
        difference = (response(at + step) - response(at - step)) / (2 * step[i])
        assert_allclose(gradient[i], difference, rtol=1e-5)
