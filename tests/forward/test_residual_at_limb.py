"""What Gaussians leave of a lens at the limb, against sums over a fine grid of the sensor."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, DiffractionOptics, Microfacet, Rig, Sphere
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.integral.residual_at_limb import limb_rule
from matcam.forward.integral.scene import Scene
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record

LIMB, LENS = 120.0, DiffractionOptics(8.0, 550e-9, 5e-6)
PLACES = ((0.3, 0.2), (-1.0, 1.0), (2.6, -0.4), (4.0, 2.0), (5.5, -2.6), (7.6, 1.4))
"""Depth within the limb, px, and azimuth, rad."""


@pytest.fixture(scope="module")
def imaging():
    return imaging_of(Rig(Camera(LENS, BoxPixel()), Sphere(LIMB)))


def fine_kernel(rest):
    """Offsets along an axis, px, and what the rest of the lens shows at each pair of them, 1/px^2."""
    line = np.arange(-800, 801) * 0.01
    return line, np.asarray(rest.at(*(jnp.asarray(at) for at in np.meshgrid(line, line, indexing="ij")), None))


def brute(line, kernel, roughness, lamp, x, y):
    """The radiance of a GGX sphere in the picture times the rest, summed over 0.01 px; 1/sr."""
    dx, dy = np.meshgrid(line, line, indexing="ij")
    n_x, n_y = (x - dx) / LIMB, (y - dy) / LIMB
    inside = n_x**2 + n_y**2 < 1
    n_z = np.sqrt(np.where(inside, 1 - n_x**2 - n_y**2, 1.0))
    cos_i = n_x * np.sin(lamp) + n_z * np.cos(lamp)
    cos_h = n_x * np.sin(lamp / 2) + n_z * np.cos(lamp / 2)
    d = roughness**2 / np.pi / (1 + (roughness**2 - 1) * cos_h**2) ** 2
    hidden = sum((np.sqrt(1 + roughness**2 * (1 / np.clip(c, 1e-9, 1) ** 2 - 1)) - 1) / 2 for c in (cos_i, n_z))
    light = np.where(inside & (cos_i > 0), d / (1 + hidden) / (4 * n_z), 0.0)
    return (kernel * light).sum() * 0.01**2


@pytest.mark.parametrize(
    ("roughness", "lamp"),
    [(0.5, 100.0), *(pytest.param(*drawn, marks=pytest.mark.slow) for drawn in ((0.2, 130.0), (0.5, 20.0)))],
)
def test_few_nodes_hold_the_rings(imaging, roughness, lamp):
    lamp, rest = np.radians(lamp), imaging.blur.residual
    x, y = (np.array([(LIMB - depth) * part(azimuth) for depth, azimuth in PLACES]) for part in (np.cos, np.sin))
    scene = Scene(Microfacet(GGX(roughness), 1.0), imaging.sample, jnp.asarray(lamp))
    rule = limb_rule(rest, LIMB)
    got = np.asarray(rule.record(scene, jnp.asarray(x), jnp.asarray(y)))[:, 0]
    fine = fine_kernel(rest)
    expected = np.array([brute(*fine, roughness, lamp, *at) for at in zip(x, y, strict=True)])
    highest = 1 / (4 * np.pi * roughness**2)
    assert np.abs(expected).max() > 1e-4 * highest
    np.testing.assert_allclose(
        got, expected, rtol=0, atol=1.2e-5 * highest
    )  # a hundredth of what the rest shows at most


def test_positions_at_the_limb_take_it(imaging):
    x = np.array([LIMB - 3.0, LIMB - 3.0, 60.0])
    positions = RecordPositions(x, np.zeros(3), np.full(3, 1.7))
    part = record_plan(imaging, positions, 0.1).parts[-1]
    assert set(part.limb) == {0, 1}
    assert set(part.smooth) == {2}
    thin = positions._replace(lamp_angle=np.full(3, np.radians(176.0)))
    part = record_plan(imaging, thin, 0.1).parts[-1]
    assert not part.limb.size  # a crescent is no smooth light: a window follows it
    assert set(part.arcs.position) == {0, 1}


@pytest.mark.slow
def test_each_lamp_has_its_azimuth(imaging):
    """A quarter turn of lamp and position changes nothing: the pixels are square, and the lens is isotropic."""
    x, y, lamp = np.array([LIMB - 3.0, 60.0, LIMB - 2.0]), np.array([4.0, 5.0, 0.0]), np.array([1.7, 1.2, 0.9])
    quarters = np.array([1, 2, 3]) * np.pi / 2
    turned = x * np.cos(quarters) - y * np.sin(quarters), x * np.sin(quarters) + y * np.cos(quarters)
    material = Microfacet(GGX(0.3), 1.0)
    found, expected = (
        np.asarray(record(material, imaging, record_plan(imaging, positions, 0.3)))[:, 0]
        for positions in (RecordPositions(*turned, lamp, quarters), RecordPositions(x, y, lamp, np.zeros(3)))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_rule_follows_the_parameters(imaging):
    x = np.array([LIMB - 3.0])
    positions = RecordPositions(x, np.array([5.0]), np.array([1.7]))
    plan = record_plan(imaging, positions, 0.1)

    def seen(roughness):
        return record(Microfacet(GGX(roughness), 1.0), imaging, replace(plan, parts=plan.parts[-1:]))[0, 0]

    slope, step = float(jax.grad(seen)(0.3)), 1e-4
    assert slope == pytest.approx(float(seen(0.3 + step) - seen(0.3 - step)) / (2 * step), rel=1e-4)


def test_a_small_sphere_has_none(imaging):
    assert limb_rule(imaging.blur.residual, 20.0) is None
    small = imaging_of(Rig(Camera(LENS, BoxPixel()), Sphere(20.0)))
    positions = RecordPositions(np.array([17.0]), np.zeros(1), np.array([1.0]))
    assert record_plan(small, positions, 0.1).parts[-1].limb_rule is None
