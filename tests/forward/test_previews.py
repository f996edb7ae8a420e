"""Previews against the exact routes, within the errors that their docstrings state."""

import numpy as np
import pytest

import matcam
from matcam.core.errors import ArgumentError
from matcam.forward import highlight_preview, response_preview, sphere_preview
from matcam.forward.prediction import predicted

RADIUS = 60.0
HALO = matcam.HaloOptics(matcam.GaussianOptics(0.6), 0.02, 8.0)


def rig_of(optics=None, **more):
    optics = matcam.GaussianOptics(0.5) if optics is None else optics
    return matcam.Rig(matcam.Camera(optics, matcam.BoxPixel(0.45)), matcam.Sphere(RADIUS), **more)


def metal(alpha):
    return matcam.Microfacet(matcam.GGX(alpha), matcam.Conductor([3.1], [3.3]), 0.05)


@pytest.mark.parametrize(
    ("optics", "error"),
    [
        (None, 1e-6),
        (HALO, 1e-6),
        pytest.param(matcam.DiffractionOptics(8.0, 550e-9, 3e-6), 5e-3, marks=pytest.mark.slow),
    ],
)
def test_response_is_that_of_peak_response(optics, error):
    theta = np.radians([0, 30, 60, 75, 85])
    for rig in (rig_of(optics), rig_of(optics, jitter=0.4)):
        exact = matcam.peak_response(rig, matcam.GGX(0.01), theta)
        np.testing.assert_allclose(response_preview(rig, matcam.GGX(0.01), theta), exact, rtol=error)


def test_fast_prediction_finds_the_angle():
    rig = matcam.rigs.merl()
    fast, slow = (predicted(rig, [matcam.GGX(0.02)], fast=fast) for fast in (True, False))
    assert fast.theta.size < slow.theta.size / 3
    np.testing.assert_allclose(np.degrees(fast.loss_angle), np.degrees(slow.loss_angle), atol=0.05)


def errors(alpha, degrees, optics=None):
    """Distance of the sphere's preview from the exact picture over its peak, where neither limb nor terminator shows."""
    rig, theta = rig_of(optics), np.radians(degrees)
    found = sphere_preview(metal(alpha), rig, theta, side=128)
    assert found.attrs["pixels_per_value"] == 1
    exact = matcam.picture(
        metal(alpha), rig, float(rig.sample.lamp_angle(theta)), shape=found["recorded"].shape, error=1e-4
    )
    exact = exact.values[::-1, :, 0]
    x, y = np.meshgrid(found["x"], found["y"])
    n_z = np.sqrt(np.maximum(RADIUS**2 - x**2 - y**2, 0)) / RADIUS
    lit = (x / RADIUS * np.sin(2 * theta) + n_z * np.cos(2 * theta)) * RADIUS > 4
    shown = lit & (np.hypot(x, y) < RADIUS - 3)
    assert shown.sum() > 1000
    closeup = highlight_preview(metal(alpha), rig, theta, half_side=4.0, points=81)
    return np.abs(found["recorded"].values - exact)[shown].max() / exact.max(), found, closeup, exact


@pytest.mark.slow
def test_sphere_and_closeup_lie_near_the_exact_picture():
    error, sphere, closeup, exact = errors(0.05, 45)
    assert error < 0.01
    # the brightest pixel, where it lies in the close-up
    at = np.unravel_index(exact.argmax(), exact.shape)
    x = float(sphere["x"][at[1]]) - RADIUS * np.sin(np.pi / 4)
    assert float(closeup["recorded"].interp(x=x, y=float(sphere["y"][at[0]]))) == pytest.approx(exact.max(), rel=0.01)
    np.testing.assert_allclose(closeup["difference"], closeup["recorded"] - closeup["true"])


@pytest.mark.slow
@pytest.mark.parametrize(("optics", "error"), [(None, 0.01), (HALO, 0.015)])
@pytest.mark.parametrize("degrees", [10, 60])
@pytest.mark.parametrize("alpha", [0.003, 0.05, 0.1])
def test_sphere_within_its_error(alpha, degrees, optics, error):
    """A halo's light comes from where the sphere ends, which a preview does not know: 1.14 % at 0.1 rad and 60 degrees."""
    assert errors(alpha, degrees, optics)[0] < error


@pytest.mark.slow
def test_blocks_are_means_of_pixels():
    rig = rig_of()
    fine = sphere_preview(metal(0.1), rig, 0.6, side=1000)["recorded"].values
    coarse = sphere_preview(metal(0.1), rig, 0.6, side=42)
    middle = len(coarse["x"]) // 2
    block = (
        fine[60:63, 60:63]
        if fine.shape[0] == 123
        else fine[fine.shape[0] // 2 - 1 :][:3, fine.shape[1] // 2 - 1 :][:, :3]
    )
    assert coarse.attrs["pixels_per_value"] == 3
    assert coarse["recorded"].values[middle, middle] == pytest.approx(block.mean(), rel=0.01)


def test_one_program_serves_all_numbers(caplog):
    """A slider that moves must not wait for a compiler, whatever it moves: camera, lamp, lobe, metal or the sphere's size."""
    from matcam.core.jax import jax

    def show(rig, alpha, n):
        material = matcam.Microfacet(matcam.GGX(alpha), matcam.Conductor([n], [3.3]))
        response_preview(rig, matcam.GGX(alpha), np.array([0.1, 0.2]))
        highlight_preview(material, rig, 0.5, points=21)
        return sphere_preview(material, rig, 0.5, side=32)

    show(matcam.rigs.merl(), 0.01, 3.0)
    camera = rig_of(HALO).camera
    rigs = [rig_of(HALO), rig_of(lamp=matcam.NearLamp(20.0, 0.1)), rig_of(lamp_radius=0.01)]
    rigs += [matcam.Rig(camera, matcam.Sphere(radius, 20.0)) for radius in (20.0, 47.0, 2000.0)]
    with jax.log_compiles(), caplog.at_level("WARNING"):
        shapes = {show(rig, 0.02 + 0.01 * i, 1.0 + i)["true"].shape for i, rig in enumerate(rigs)}
    assert len(shapes) > 1
    compiled = [record.getMessage() for record in caplog.records if "ompil" in record.getMessage()]
    assert not [line for line in compiled if any(name in line for name in ("_responses", "_closeup", "_sphere"))]


def test_bad_arguments():
    rig = rig_of()
    with pytest.raises(ArgumentError, match="sum of Gaussians"):
        response_preview(rig, matcam.EPD(0.01, 1.0), [0.0])
    with pytest.raises(ArgumentError, match="needs a Sphere"):
        response_preview(matcam.Rig(rig.camera, matcam.Cylinder(60.0)), matcam.GGX(0.01), [0.0])
    with pytest.raises(ArgumentError, match=r"needs a lamp towards \+x, got the azimuth 0.5 rad"):
        sphere_preview(metal(0.1), matcam.Rig(rig.camera, rig.sample, lamp_azimuth=0.5), 0.6)
    with pytest.raises(ArgumentError, match="without defocus over the depth of the sample, got aperture"):
        response_preview(matcam.Rig(rig.camera, rig.sample, aperture=0.1), matcam.GGX(0.01), [0.0])
    with pytest.raises(ArgumentError, match="theta_d"):
        sphere_preview(metal(0.1), rig, 2.0)
    with pytest.raises(ArgumentError, match="side must be"):
        sphere_preview(metal(0.1), rig, 0.5, side=3)
    with pytest.raises(ArgumentError, match="material must be"):
        highlight_preview(matcam.GGX(0.1), rig, 0.5)
