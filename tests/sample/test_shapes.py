"""Sensor <-> normal <-> angles, against a camera that projects points in space."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from matcam import Cylinder, Flat, Sphere
from matcam.core.errors import ArgumentError
from matcam.core.shading import shading

DISTANCES = (np.inf, 30.0, 3.0, 1.2)


def _projected(point, distance, radius):
    """Pinhole at (0, 0, distance) radii, picture scaled so that the limb of a unit sphere or cylinder is at `radius`."""
    if np.isinf(distance):
        return radius * point[:2], np.array([0.0, 0.0, 1.0])[:, None] + 0 * point
    ray = np.array([0.0, 0.0, distance])[:, None] - point
    limb = np.tan(np.arcsin(1 / distance))
    return radius * point[:2] / (distance - point[2]) / limb, ray / np.linalg.norm(ray, axis=0)


def _sphere_point(u, v):
    normal = np.array([np.cos(v) * np.sin(u), np.sin(v), np.cos(v) * np.cos(u)])
    return normal, normal


def _cylinder_point(u, v):
    return np.array([np.sin(u), v, np.cos(u)]), np.array([np.sin(u), 0 * u, np.cos(u)])


SHAPES = [(Sphere, _sphere_point), (Cylinder, _cylinder_point)]


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize(("shape", "point"), SHAPES)
def test_pieces_of_surface_lie_where_a_pinhole_sees_them(shape, point, distance):
    sample, random = shape(200.0, distance), np.random.default_rng(1)
    v = random.uniform(-0.3, 0.3, 30)
    u = random.uniform(-0.95, 0.95, 30) * np.asarray(sample.visible(v))
    element = sample.surface(u, v)
    position, normal = point(u, v)
    pixel, view = _projected(position, distance, 200.0)
    assert_allclose([element.x, element.y], pixel, atol=1e-10)
    assert_allclose(np.stack(np.broadcast_arrays(*element.normal)), normal, atol=1e-14)
    assert_allclose(np.stack(np.broadcast_arrays(*element.view, u)[:3]), view, atol=1e-13)
    # area: the Jacobian of the projection, by differences, over the cosine of the view
    h = 1e-5
    left, right, low, high = (
        _projected(point(u + a, v + b)[0], distance, 200.0)[0] for a, b in ((-h, 0), (h, 0), (0, -h), (0, h))
    )
    du, dv = (right - left) / (2 * h), (high - low) / (2 * h)
    cos_o = np.sum(normal * view, axis=0)
    assert_allclose(element.area * cos_o, du[0] * dv[1] - du[1] * dv[0], rtol=1e-6)
    # and back
    seen, hits = sample.at(*pixel)
    assert hits.all()
    assert_allclose(np.stack(np.broadcast_arrays(*seen.normal)), normal, atol=1e-11)
    assert_allclose(np.stack(np.broadcast_arrays(*seen.view, u)[:3]), view, atol=1e-11)
    assert_allclose(seen.area * cos_o, 1, rtol=1e-11)
    assert_allclose(sample.coordinates(seen), (u, v), atol=1e-10)
    assert_allclose(sample.across(pixel[0], v), u, atol=1e-10)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("shape", [Sphere, Cylinder])
def test_the_limb_is_at_the_radius(shape, distance):
    sample = shape(200.0, distance)
    end = sample.visible(np.asarray(0.0))
    assert_allclose(sample.surface(end, 0.0).x, 200, rtol=1e-12)
    _, hits = sample.at(np.array([199.999, 200.001, 1e4]), np.zeros(3))
    assert hits.tolist() == [True, False, False]


@pytest.mark.parametrize("distance", DISTANCES)
def test_angles_have_their_position_and_the_position_has_these_angles(distance):
    sphere, random = Sphere(200.0, distance), np.random.default_rng(3)
    theta_h, theta_d = random.uniform(1e-3, 1.3, (2, 60))
    phi_d = random.uniform(-3.1, 3.1, 60)
    place = sphere.position(theta_h, theta_d, phi_d)
    element, hits = sphere.at(place.x, place.y)
    light = (np.sin(place.lamp_angle), 0.0, np.cos(place.lamp_angle))
    seen = shading(element.normal, element.tangent, light, element.view)
    cos_i = np.cos(theta_h) * np.cos(theta_d) - np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    cos_o = 2 * np.cos(theta_h) * np.cos(theta_d) - cos_i
    above = (cos_i > 0.02) & (cos_o > 0.02)
    assert above.sum() > 15
    assert np.asarray(hits)[above].all()
    for name, got, wanted in (
        ("cos_i", seen.cos_i, cos_i),
        ("cos_o", seen.cos_o, cos_o),
        ("theta_h", np.arctan(np.hypot(seen.slope_along, seen.slope_across)), theta_h),
        ("theta_d", seen.theta_d, theta_d),
        ("phi_d", np.exp(1j * seen.phi_d), np.exp(1j * phi_d)),
    ):
        assert_allclose(np.asarray(got)[above], wanted[above], atol=1e-7, err_msg=name)


def test_a_distant_sphere_s_positions_are_the_paper_s():
    """x = r (cos th sin td + sin th cos psi cos td), y = r sin th sin psi, psi = pi - phi_d (docs/model.md 3), lamp at 2 td."""
    theta_h, theta_d, phi_d = np.random.default_rng(4).uniform(0, np.pi / 2, (3, 200))
    phi_d *= 4
    place = Sphere(256.0).position(theta_h, theta_d, phi_d)
    psi = np.pi - phi_d
    x = np.cos(theta_h) * np.sin(theta_d) + np.sin(theta_h) * np.cos(psi) * np.cos(theta_d)
    assert_allclose(place.x, 256 * x, atol=1e-10)
    assert_allclose(place.y, 256 * np.sin(theta_h) * np.sin(psi), atol=1e-10)
    assert_allclose(place.lamp_angle, 2 * theta_d, atol=1e-12)
    # lamp and camera coincide: the frame's own direction
    aligned = Sphere(256.0).position(0.3, 0.0, 0.4)
    assert_allclose([aligned.x, aligned.y], [-256 * np.sin(0.3) * np.cos(0.4), 256 * np.sin(0.3) * np.sin(0.4)])


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("shape", [Sphere, Cylinder])
def test_the_highlight_sees_lamp_and_camera_under_one_angle_and_moves_as_said(shape, distance):
    sample = shape(200.0, distance)
    theta = np.array([0.05, 0.6, 1.2])
    lamp = sample.lamp_angle(theta)
    peak = sample.highlight(lamp)

    def seen_from(u, v):
        element = sample.surface(u, v)
        return element, shading(element.normal, element.tangent, (np.sin(lamp), 0.0, np.cos(lamp)), element.view)

    _, seen = seen_from(peak, np.zeros(3))
    assert_allclose(seen.slope_along, 0, atol=1e-12)
    assert_allclose(seen.theta_d, theta, rtol=1e-10)
    # px per radian between normal and half vector, by differences
    h = 1e-5
    along, across = sample.px_per_rad(theta)
    (a, seen_a), (b, seen_b) = seen_from(peak - h, np.zeros(3)), seen_from(peak + h, np.zeros(3))
    assert_allclose((b.x - a.x) / (seen_a.slope_along - seen_b.slope_along), along, rtol=1e-5)
    (a, seen_a), (b, seen_b) = seen_from(peak, np.full(3, -h)), seen_from(peak, np.full(3, h))
    with np.errstate(divide="ignore"):
        assert_allclose((b.y - a.y) / np.abs(np.asarray(seen_b.slope_across - seen_a.slope_across)), across, rtol=1e-5)


def test_what_is_lit_is_what_both_see():
    sphere, random = Sphere(100.0, 4.0), np.random.default_rng(5)
    v, lamp, u = random.uniform(-1.2, 1.2, 400), random.uniform(0, 3.0, 400), random.uniform(-1.5, 1.5, 400)
    element = sphere.surface(u, v)
    cos_o = sum(n * o for n, o in zip(element.normal, element.view, strict=True))
    cos_i = element.normal[0] * np.sin(lamp) + element.normal[2] * np.cos(lamp)
    low, high = sphere.lit(v, lamp)
    both = np.asarray((cos_o > 0) & (cos_i > 0))
    assert 50 < both.sum() < 350
    np.testing.assert_array_equal(np.asarray((low < u) & (u < high)), both)


def test_a_distant_cylinder_and_a_flat_sample_do_not_bend_where_they_are_straight():
    theta = np.array([0.0, 1.0])
    along, across = Cylinder(50.0).px_per_rad(theta)
    assert_allclose(along, 50 * np.cos(theta))
    assert np.isinf(across).all()
    assert np.isinf(Flat().px_per_rad(theta)).all()


def test_a_cylinder_positions_the_normals_of_its_one_plane():
    cylinder = Cylinder(50.0, 5.0)
    place = cylinder.position(0.2, 0.5, np.array([0.0, np.pi, 1.0]))
    assert np.isnan(place.x[2])
    for x, lamp, phi_d in zip(place.x[:2], place.lamp_angle[:2], (0.0, np.pi), strict=True):
        element, _ = cylinder.at(x, np.zeros(()))
        seen = shading(element.normal, element.tangent, (np.sin(lamp), 0.0, np.cos(lamp)), element.view)
        assert_allclose([abs(seen.slope_along), seen.theta_d], [np.tan(0.2), 0.5], rtol=1e-10)
        assert_allclose(np.cos(seen.phi_d), np.cos(phi_d), atol=1e-12)


@pytest.mark.parametrize("radius", [0, -1, np.inf, np.nan, "big", [1, 2]])
def test_radius_is_checked(radius):
    for shape in (Sphere, Cylinder):
        with pytest.raises(ArgumentError, match="radius"):
            shape(radius)


@pytest.mark.parametrize("distance", [1, 0.5, -3, np.nan, "far", [5, 6]])
def test_distance_is_checked(distance):
    for shape in (Sphere, Cylinder):
        with pytest.raises(ArgumentError, match="distance"):
            shape(10.0, distance)


def test_shapes_read_as_they_are_made():
    for shape in (Sphere(256.0), Sphere(256.0, 30.0), Cylinder(10.0), Cylinder(10.0, 2.5), Flat()):
        assert repr(eval(repr(shape))) == repr(shape)


def test_the_polynomial_of_the_sphere_is_a_sine_that_never_exceeds_1():
    angle = np.concatenate([np.linspace(-np.pi / 2, np.pi / 2, 100_001), np.pi / 2 - np.geomspace(1e-16, 1e-3, 10_000)])
    sphere = Sphere(1.0)
    normal = sphere.surface(angle, np.zeros(1)).normal
    assert_allclose(normal[0], np.sin(angle), rtol=7e-16, atol=1e-300)
    assert np.abs(normal[0]).max() <= 1
    assert_allclose(normal[2], np.cos(angle), atol=4e-8)  # the root of two roundings
