"""Vectors to half/difference angles, against Rusinkiewicz's construction by rotations."""

import numpy as np
from numpy.testing import assert_allclose

from matcam.core.grid import cosines
from matcam.core.shading import shading


def _rotated(vector, axis, angle):
    """Rodrigues' rotation."""
    axis = np.asarray(axis, float)
    return (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )


def _pair(theta_h, theta_d, phi_d):
    """Light and view about the normal z, half vector in the x-z plane."""
    y = np.array([0.0, 1.0, 0.0])
    for azimuth in (phi_d, phi_d + np.pi):
        about_half = np.array([np.sin(theta_d) * np.cos(azimuth), np.sin(theta_d) * np.sin(azimuth), np.cos(theta_d)])
        yield _rotated(about_half, y, theta_h)


def test_angles_come_back_whatever_the_surface_s_orientation():
    random = np.random.default_rng(5)
    for _ in range(40):
        theta_h, theta_d = random.uniform(1e-6, 1.5), random.uniform(0.05, 1.5)
        phi_d, spin = random.uniform(-3.1, 3.1), random.uniform(0, 2 * np.pi)
        light, view = _pair(theta_h, theta_d, phi_d)
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        turn = random.uniform(0, np.pi)
        normal, tangent = np.array([0.0, 0.0, 1.0]), np.array([np.cos(spin), np.sin(spin), 0.0])
        vectors = [tuple(_rotated(v, axis, turn)) for v in (normal, tangent, light, view)]
        seen = shading(*vectors)
        cos_i, cos_o = cosines(theta_h, theta_d, phi_d)
        assert_allclose([seen.cos_i, seen.cos_o], [cos_i, cos_o], atol=1e-14)
        assert_allclose(np.hypot(seen.slope_along, seen.slope_across), np.tan(theta_h), rtol=1e-9)
        assert_allclose(np.arctan2(seen.slope_across, seen.slope_along), np.angle(np.exp(-1j * spin)), atol=1e-8)
        assert_allclose(seen.theta_d, theta_d, rtol=1e-12)
        assert_allclose(np.exp(1j * seen.phi_d), np.exp(1j * phi_d), atol=1e-8)
