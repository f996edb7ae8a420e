"""Solid angles of a rig, by quadrature of the kernel in space and of cones on the sphere."""

import json

import numpy as np
import pytest
from scipy.special import erf

from matcam import BoxPixel, Camera, Cylinder, Flat, GaussianOptics, Rig, Sphere, rigs
from matcam.core.errors import ArgumentError
from matcam.exchange import metadata, solid_angles
from matcam.exchange.receiver import effective_area


@pytest.mark.parametrize(("sigma", "half"), [(0.1, 0.5), (0.5, 0.5), (0.5, 0.35), (2.0, 0.5)])
def test_area_of_the_kernel(sigma, half):
    """1 / integral of k^2, in space; k is the product of two erf differences (docs/model.md 2)."""
    x = np.linspace(-8 * sigma - 1, 8 * sigma + 1, 200_001)
    k = (erf((x + half) / (np.sqrt(2) * sigma)) - erf((x - half) / (np.sqrt(2) * sigma))) / (4 * half)
    expected = np.trapezoid(k**2, x) ** -2
    assert effective_area(Camera(GaussianOptics(sigma), BoxPixel(half))) == pytest.approx(expected, rel=3e-4)


def test_equivalent_receiver_moves_the_half_vector_as_much():
    """Views within a cone of that solid angle, the sample held still, have half vectors that cover as much of the sphere of
    normals as the kernel's area does on the sample's picture: at normal view and at 60 degrees."""
    rig = Rig(rigs.merl().camera, Sphere(100.0), aperture=0.1, lamp_radius=0.01)
    found = solid_angles(rig)
    radius = np.arccos(1 - found["equivalent_receiver_sr"] / (2 * np.pi))
    for theta_d in (0.0, np.pi / 3):
        light = np.array([np.sin(theta_d), 0, np.cos(theta_d)])
        mirror = light * [-1, 1, 1]
        around = np.linspace(0, 2 * np.pi, 2001)
        e, f = np.array([np.cos(theta_d), 0, np.sin(theta_d)]), np.array([0.0, 1.0, 0.0])
        views = np.cos(radius) * mirror + np.sin(radius) * (np.cos(around)[:, None] * e + np.sin(around)[:, None] * f)
        half = views + light
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        # area inside the loop, close to the pole; a kernel's normals cover A / (r^2 cos theta_o) of it
        x, y = half[:, 0], half[:, 1]
        area = abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
        assert area == pytest.approx(found["kernel_area_px2"] / (100.0**2 * np.cos(theta_d)), rel=1e-3)
    assert found["pupil_sr"] == pytest.approx(np.pi * 0.05**2)
    assert found["lamp_sr"] == pytest.approx(np.pi * 0.01**2, rel=1e-4)


@pytest.mark.parametrize("distance", [1.5, 4.0, 1e6])
def test_a_near_camera(distance):
    """A pinhole on the axis, lamp beside it: how fast the half vector leaves the normal as the picture's point moves."""

    def picture_and_half(u):
        point, hole = np.array([np.sin(u), np.cos(u)]), np.array([0.0, distance])
        view = (hole - point) / np.hypot(*(hole - point))
        half = np.arctan2(view[0], view[1]) / 2  # the light comes along the axis
        limb = np.tan(np.arcsin(1 / distance))
        return 100.0 * point[0] / (distance - point[1]) / limb, half - u

    (x0, h0), (x1, h1) = picture_and_half(-1e-4), picture_and_half(1e-4)
    found = solid_angles(Rig(rigs.merl().camera, Sphere(100.0, distance)))
    expected = 4 * found["kernel_area_px2"] * ((h1 - h0) / (x1 - x0)) ** 2
    assert found["equivalent_receiver_sr"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("sample", [Flat(), Cylinder(100.0)])
def test_normals_that_do_not_turn_all_round_make_no_such_receiver(sample):
    found = solid_angles(Rig(rigs.merl().camera, sample))
    assert found["equivalent_receiver_sr"] is None
    json.dumps(metadata(Rig(rigs.merl().camera, sample)), allow_nan=False)


def test_wrong_input():
    with pytest.raises(ArgumentError, match="rig must be a Rig"):
        solid_angles(rigs.merl().camera)


def test_metadata_is_json_and_complete():
    document = json.loads(json.dumps(metadata(rigs.merl(), sample="chrome"), allow_nan=False))
    assert document["receiver"]["solid_angle_sr"] == pytest.approx(4 * 4.23264 / 256**2, rel=1e-4)
    assert document["instrument"]["sample"] == {"kind": "sphere", "radius_px": 256.0, "distance_radii": None}
    assert document["about"] == {"sample": "chrome"}
    with pytest.raises(ArgumentError, match="sample must be a string"):
        metadata(rigs.merl(), sample=3)
