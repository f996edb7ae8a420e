import numpy as np
import pytest

from matcam import Cylinder, Flat, Sphere
from matcam.errors import ArgumentError


def test_px_per_rad_is_the_derivative_of_the_position():
    """x = r sin theta_o towards the limb (paper (5)); across it, the arc r dphi sin(theta) / sin(theta) = r."""
    sphere, step = Sphere(256.0), 1e-6
    for theta in (0.0, 0.5, 1.3):
        along, across = sphere.px_per_rad(np.asarray(theta))
        # a normal tilted towards the limb by t, or sideways by t, about the half vector at theta_o = theta_d = theta
        x0, _ = sphere.position(0.0, theta, 0.0)
        x1, _ = sphere.position(step, theta, 0.0)
        _, y1 = sphere.position(step, theta, np.pi / 2)
        assert (float(x1) - float(x0)) / step == pytest.approx(float(along), abs=1e-3)
        assert float(y1) / step == pytest.approx(float(across), rel=1e-6)


def test_positions_lie_on_the_sphere():
    rng = np.random.default_rng(0)
    theta_h, theta_d, psi = rng.uniform(0, np.pi / 2, (3, 1000))
    x, y = Sphere(100.0).position(theta_h, theta_d, psi)
    # the same normal by rotating (theta_h, psi) about y by theta_d
    n = np.stack([np.sin(theta_h) * np.cos(psi), np.sin(theta_h) * np.sin(psi), np.cos(theta_h)])
    expected_x = 100 * (n[0] * np.cos(theta_d) + n[2] * np.sin(theta_d))
    np.testing.assert_allclose(x, expected_x, atol=1e-11)
    np.testing.assert_allclose(y, 100 * n[1], atol=1e-11)


def test_cylinder_and_flat_do_not_bend_where_they_are_straight():
    theta = np.array([0.0, 1.0])
    along, across = Cylinder(50.0).px_per_rad(theta)
    np.testing.assert_allclose(along, 50 * np.cos(theta))
    assert np.isinf(across).all()
    assert np.isinf(Flat().px_per_rad(theta)).all()


@pytest.mark.parametrize("radius", [0, -1, np.inf, np.nan, "big", [1, 2]])
def test_radius_is_checked(radius):
    for shape in (Sphere, Cylinder):
        with pytest.raises(ArgumentError, match="radius"):
            shape(radius)
