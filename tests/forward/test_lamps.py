"""Lamps anywhere: near, at any azimuth, with a disc; against an oracle with a quadrature of its own."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    Cylinder,
    DistantLamp,
    GaussianOptics,
    Microfacet,
    NearLamp,
    Rig,
    Sphere,
    measure,
    picture,
    rigs,
)
from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines, merl_grid
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.lamp.lamps import lamp_points
from tests.golden import rows
from tests.oracle import lamp_record

GRID = merl_grid("centre")
SHAPE = 61, 61


def made(camera=np.inf, lamp=np.inf, radius=24.0, sigma=0.5, half_width=0.5, disc=0.0, kind="sphere"):
    """(the package's rig, the oracle's): distances in radii, the disc's angular radius in rad."""
    sample = {"sphere": Sphere, "cylinder": Cylinder}[kind](radius, camera)
    light = DistantLamp(disc) if np.isinf(lamp) else NearLamp(lamp, np.tan(disc) * lamp)
    rig = Rig(Camera(GaussianOptics(sigma), BoxPixel(half_width)), sample, light)
    return rig, lamp_record.Rig(radius, camera, lamp, sigma, half_width, disc, kind)


def check_picture(alpha, lamp_angle, azimuth, pixels, shape=SHAPE, rule=(1, 1), by_rig=False, **geometry):
    """`pixels` random ones and the brightest: 1e-4 of the value or 1e-7 of the peak. by_rig: the rig states the azimuth."""
    rig, theirs = made(**geometry)
    rig = replace(rig, lamp_azimuth=azimuth if by_rig else azimuth / 3)  # one that is given goes before the rig's
    given = None if by_rig else azimuth
    surface = lamp_record.Surface(alpha, 0.2)
    seen = picture(Microfacet(GGX(alpha), 1.0, 0.2), rig, lamp_angle, given, shape=shape)
    assert seen.attrs["lamp_azimuth"] == azimuth
    ours = seen.values[..., 0]
    random = np.random.default_rng(11)
    chosen = [np.unravel_index(ours.argmax(), shape), *zip(*random.integers(0, shape, (pixels, 2)).T, strict=True)]
    half = (np.array(shape) - 1) / 2
    missed = []
    for row, column in chosen:
        truth = lamp_record.record(column - half[1], half[0] - row, lamp_angle, azimuth, surface, theirs, rule)
        missed.append(abs(ours[row, column] - truth) / max(1e-4 * truth, 1e-7 * ours.max()))
    worst = int(np.argmax(missed))
    print(f"worst: {missed[worst]:.2g} of what is allowed at {chosen[worst]}")
    assert max(missed) < 1


@pytest.mark.parametrize(("by_rig", "pixels"), [pytest.param(False, 8, marks=pytest.mark.slow), (True, 3)])
def test_a_near_lamp_before_a_near_camera_at_an_azimuth(by_rig, pixels):
    """Around the highlight; the ends of the light are in the slow tests."""
    check_picture(0.1, 0.5, 2.3, pixels, (7, 7), camera=6.0, lamp=4.0, radius=12.0, by_rig=by_rig)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alpha", "lamp_angle", "azimuth", "geometry"),
    [
        (0.05, 0.9, 0.6, {}),
        (0.05, 0.9, 0.6, {"sigma": 0.15}),
        (0.05, 0.9, 0.0, {"lamp": 3.0}),
        (0.02, 0.0, 1.0, {"lamp": 5.0}),
        (0.01, 1.9, 4.0, {"camera": 8.0, "lamp": 14.0}),
        (0.2, 2.4, 5.5, {"camera": 20.0, "lamp": 50.0}),
        (0.05, 0.9, np.pi, {"camera": 8.0, "lamp": 5.0, "kind": "cylinder"}),
        (0.05, 1.4, 0.0, {"lamp": 20.0, "kind": "cylinder"}),
    ],
)
def test_pixels_under_lamps_anywhere(alpha, lamp_angle, azimuth, geometry):
    """208 in all."""
    check_picture(alpha, lamp_angle, azimuth, 25, **geometry)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamp_angle", "azimuth", "disc", "rule", "geometry"),
    [(0.9, 0.0, 0.03, (4, 15), {}), (1.1, 2.5, 0.06, (5, 17), {"camera": 5.0, "lamp": 6.0})],
)
def test_pixels_under_a_disc(lamp_angle, azimuth, disc, rule, geometry):
    check_picture(0.1, lamp_angle, azimuth, 6, rule=rule, disc=disc, **geometry)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("azimuth", "geometry"), [(0.6, {}), (0.0, {"lamp": 4.0}), (2.0, {"camera": 6.0, "lamp": 9.0})]
)
def test_cells_under_lamps_anywhere(azimuth, geometry):
    """70 cells of a table each, half of them close to the highlight."""
    rig, theirs = made(**geometry)
    table = measure(Microfacet(GGX(0.05), 1.0, 0.2), rig, azimuth=azimuth).values[..., 0]
    random, missed = np.random.default_rng(12), []
    while len(missed) < 70:
        cell = (int(random.integers(0, (20, 90)[len(missed) % 2])), *map(int, random.integers(0, (90, 180))))
        angles = GRID.theta_h[cell[0]], GRID.theta_d[cell[1]], GRID.phi_d[cell[2]]
        truth = lamp_record.recorded_cell(angles, azimuth, lamp_record.Surface(0.05, 0.2), theirs)
        if np.isnan(truth):
            assert np.isnan(table[cell])
            continue
        missed.append(abs(table[cell] - truth) / max(1e-4 * truth, 1e-7 * np.nanmax(table)))
    print(f"worst: {max(missed):.2g} of what is allowed")
    assert max(missed) < 1


@pytest.mark.slow
def test_a_lamp_very_far_away_is_a_distant_one():
    """Golden cells under a lamp at 1e8 radii, towards +x and at an azimuth of a whole turn, by the other code."""
    golden = rows("measure_cells")
    rig = Rig(rigs.merl().camera, Sphere(256.0), NearLamp(1e8))
    imaging, near = imaging_of(rig), rig.lamp.nearness
    i, j, k = (np.tile([row[name] for row in golden], 2) for name in ("i_theta_h", "i_theta_d", "i_phi_d"))
    turn = np.repeat([0, np.pi], len(golden))
    angles = GRID.theta_h[i], GRID.theta_d[j], GRID.phi_d[k] + turn
    positions = RecordPositions(*(np.asarray(a) for a in rig.sample.position(*angles, near)))
    truth, alphas = (np.array([row[name] for row in golden]) for name in ("recorded", "alpha"))
    for azimuth in (None, np.full(j.size, 2 * np.pi)):
        for alpha in np.unique(alphas):
            plan = record_plan(imaging, positions._replace(azimuth=azimuth), alpha)
            values = np.asarray(record(Microfacet(GGX(alpha), 1.0), imaging, plan))[:, 0]
            found = np.mean((values / np.asarray(cosines(*angles)[0])).reshape(2, -1), axis=0)
            own = alphas == alpha
            np.testing.assert_allclose(found[own], truth[own], rtol=1e-4, atol=1e-7 * truth[own].max())


def test_a_discs_points():
    """Their mean is the centre's direction, their spread the disc's; irradiance at the centre is 1 for a small disc."""
    for lamp, spread in ((DistantLamp(0.02), 0.02), (NearLamp(10.0, 0.2), 0.02)):
        points = lamp_points(lamp, np.array([0.7]), 0.4, 2.0)
        vectors = np.array(
            [
                [
                    np.sin(p.angle[0]) * np.cos(p.azimuth[0]),
                    np.sin(p.angle[0]) * np.sin(p.azimuth[0]),
                    np.cos(p.angle[0]),
                ]
                for p in points
            ]
        )
        weights = np.array([p.weight for p in points])
        centre = np.array([np.sin(0.7) * np.cos(0.4), np.sin(0.7) * np.sin(0.4), np.cos(0.7)])
        assert weights.sum() == pytest.approx(1, abs=3e-4)
        assert weights @ vectors / weights.sum() @ centre == pytest.approx(1, abs=3e-4)
        across = np.cross([0, 0, 1], centre) / np.sin(0.7)
        assert np.sqrt(weights @ (vectors @ across) ** 2) == pytest.approx(spread / 2, rel=1e-3)


def test_a_discs_points_are_enough():
    """The mean of a Gaussian over the disc, by the rule for its width and by one six times finer."""
    for fineness in (0.3, 1.0, 2.0, 4.0, 8.0):
        at = np.linspace(0, fineness + 4, 40)
        x, y = at * np.cos(0.3), at * np.sin(0.3)

        def mean(lamp, steps, size=fineness, x=x, y=y):
            total = 0.0
            for p in lamp_points(lamp, np.array(0.0), 0.0, steps):
                r = np.tan(p.angle) / 1e-3 * size
                offset = (x - r * np.cos(p.azimuth)) ** 2 + (y - r * np.sin(p.azimuth)) ** 2
                total = total + p.weight * np.exp(-offset / 2)
            return total

        found, truth = mean(DistantLamp(1e-3), fineness), mean(DistantLamp(1e-3), 6 * fineness + 6)
        counted = truth > 1e-3 * truth.max()
        np.testing.assert_allclose(found[counted], truth[counted], rtol=5e-5)


MATERIAL = Microfacet(GGX(0.1), 1.0)
SMALL = Sphere(20.0)
CAMERA = Camera(GaussianOptics(0.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: NearLamp(0.5),
            r"lamp_distance must lie in \(1, inf\) radii of the sample \(the lamp is outside it\), got 0.5",
        ),
        (lambda: NearLamp(-3), "lamp_distance must lie in"),
        (lambda: NearLamp(np.inf), "lamp_distance must lie in"),
        (lambda: NearLamp(5, 3), "lamp_radius must lie in"),
        (lambda: NearLamp(5, -0.1), "lamp_radius must lie in"),
        (lambda: DistantLamp(0.5), "lamp_radius must lie in"),
        (lambda: Rig(CAMERA, SMALL, 0.1), "lamp must be a DistantLamp or NearLamp, got float"),
        (lambda: Rig(CAMERA, SMALL, NearLamp(5), lamp_radius=0.1), "give lamp_radius or lamp, not both"),
        (lambda: picture(MATERIAL, Rig(CAMERA, SMALL, NearLamp(3)), 2.9), "the lamp is behind the sample"),
        (lambda: picture(MATERIAL, Rig(CAMERA, Sphere(20, 5), NearLamp(3)), 2.61), "the lamp is behind the sample"),
        (lambda: picture(MATERIAL, Rig(CAMERA, SMALL), 3.2), "beyond pi the lamp is behind the sample"),
        (lambda: picture(MATERIAL, Rig(CAMERA, Sphere(20, 5), NearLamp(5)), 0.0), "the lamp is inside the camera"),
        (
            lambda: picture(MATERIAL, Rig(CAMERA, SMALL), 0.5, 45),
            "azimuth must lie in .*, got 45; if 45 is in degrees, give np.radians",
        ),
        (lambda: measure(MATERIAL, Rig(CAMERA, SMALL), azimuth=90), "azimuth must lie in"),
    ],
)
def test_bad_lamps_are_refused_in_one_line(call, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
