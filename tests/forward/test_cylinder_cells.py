"""Tables of a cylinder, against an independent quadrature of its one line."""

import numpy as np
import pytest

import matcam
from matcam import (
    GGX,
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    GaussianOptics,
    HaloOptics,
    Microfacet,
    Rig,
    peak_response,
)
from matcam.camera.optics.gaussian import gaussian_sum
from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines, merl_grid
from matcam.forward import true_table
from matcam.forward.cylinder_cells import line_positions, record_cells
from matcam.forward.sampler.cylinder_ridge import towards
from matcam.forward.sampler.plan import RecordPositions
from matcam.lamp.lamps import closeness
from tests.forward.test_lamps import made
from tests.oracle import cylinder_cells as oracle
from tests.oracle import lamp_record, sphere_cells

RIGS = [(0.5, 0.5, 256.0), (0.15, 0.5, 400.0), (1.5, 0.4, 60.0), (0.8, 0.5, 12.0)]  # sigma, half width, radius: px
ALPHAS = (0.001, 0.005, 0.05, 0.3)


def rig_of(sigma, half_width, radius, **more):
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(half_width)), Cylinder(radius), **more)


def smith(lobe):
    return lambda i, o: 1 / (1 + lobe.smith(np.clip(i, 1e-9, 1)) + lobe.smith(np.clip(o, 1e-9, 1)))


def drawn_cells(rng, count):
    """Angles of cells of the grid, half of them near the highlight, both ways; only such as are seen."""
    grid = merl_grid("centre")
    ring = np.where(np.arange(count) % 2, rng.integers(0, 12, count), rng.integers(0, 90, count))
    angles = grid.theta_h[ring], grid.theta_d[rng.integers(0, 90, count)], grid.phi_d[rng.integers(0, 180, count)]
    angles = (*angles[:2], angles[2] + np.pi * rng.integers(0, 2, count))
    seen = np.minimum(*(np.asarray(c) for c in cosines(*angles))) > 0
    return tuple(a[seen] for a in angles)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("view", RIGS)
def test_drawn_cells_are_those_of_an_independent_quadrature(view, alpha):
    sigma, half_width, radius = view
    angles = drawn_cells(np.random.default_rng(int(1e4 * alpha + radius)), 60)
    lobe, lens = sphere_cells.GGX(alpha), oracle.Lens((1.0,), (sigma,), half_width)
    truth = np.array(
        [oracle.record(lobe.p22, smith(lobe), radius, lens, *cell, alpha) for cell in zip(*angles, strict=True)]
    )
    positions = line_positions(rig_of(*view).sample, *angles)
    found = np.asarray(record_cells(Microfacet(GGX(alpha), 1.0), rig_of(*view), positions))[:, 0] / np.asarray(
        cosines(*angles)[0]
    )
    assert np.all(np.abs(found - truth) < np.maximum(1e-4 * truth, 1e-7 * truth.max()))


@pytest.mark.parametrize("alpha", [0.01, 0.2])
def test_a_lens_out_of_focus_makes_discs(alpha):
    angles = drawn_cells(np.random.default_rng(5), 40)
    lobe, lens = sphere_cells.GGX(alpha), oracle.Lens((1.0,), (0.5,), 0.5, 0.03, 0.4)
    truth = np.array(
        [oracle.record(lobe.p22, smith(lobe), 150.0, lens, *cell, alpha) for cell in zip(*angles, strict=True)]
    )
    rig = rig_of(0.5, 0.5, 150.0, aperture=0.03, focus=0.4)
    found = np.asarray(
        record_cells(Microfacet(GGX(alpha), 1.0), rig, line_positions(rig.sample, *angles, rig.lamp.nearness))
    )[:, 0]
    found = found / np.asarray(cosines(*angles)[0])
    assert np.all(np.abs(found - truth) < np.maximum(1e-4 * truth, 1e-7 * truth.max()))


def check_cells(count, rule=(1, 1), alpha=0.05, most=np.pi / 2, **geometry):
    """Cells of a cylinder of 60 px before near cameras and under near lamps or discs, one way each; most: of theta_d."""
    rig, theirs = made(radius=60.0, kind="cylinder", **geometry)
    angles = drawn_cells(np.random.default_rng(7), 4 * count)
    angles = tuple(a[angles[1] < most][:count] for a in angles)
    positions, cos_i = line_positions(rig.sample, *angles, rig.lamp.nearness), np.asarray(cosines(*angles)[0])
    found = np.asarray(record_cells(Microfacet(GGX(alpha), 1.0, 0.2), rig, positions))[:, 0]
    found = found / (cos_i * np.asarray(closeness(rig.lamp.nearness, cos_i)) ** 2)
    surface = lamp_record.Surface(alpha, 0.2)
    truth = [lamp_record.recorded_line_cell(cell, surface, theirs, rule) for cell in zip(*angles, strict=True)]
    missed = np.abs(found - truth) / np.maximum(1e-4 * np.array(truth), 1e-7 * max(truth))
    print(f"worst: {missed.max():.2g} of what is allowed, of {missed.size}")
    assert missed.max() < 1


def test_cells_before_a_near_camera_and_under_a_near_lamp():
    check_cells(6, camera=6.0, lamp=5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "geometry",
    [{"camera": 9.0}, {"lamp": 6.0}, {"camera": 6.0, "lamp": 5.0}, {"camera": 20.0, "lamp": 50.0, "alpha": 0.006}],
)
def test_cells_before_near_cameras_and_under_near_lamps(geometry):
    check_cells(60, **geometry)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "geometry"), [(10, {"disc": 0.02}), (5, {"disc": 0.02, "lamp": 6.0}), (5, {"disc": 0.02, "camera": 8.0})]
)
def test_cells_under_a_disc(count, geometry):
    """Up to 69 degrees: further on the oracle would need thousands of points."""
    check_cells(count, (5, 17), most=1.2, **geometry)


def test_a_lamp_is_turned_until_the_normal_lies_across_the_axis():
    angles = drawn_cells(np.random.default_rng(2), 40)
    positions = line_positions(rig_of(0.5, 0.5, 100.0).sample, *angles)
    for n, cell in enumerate(zip(*angles, strict=True)):
        normal, light, _ = oracle.directions(*cell)
        np.testing.assert_allclose(positions.x[n], 100 * normal[0], atol=1e-10)
        lamp = towards(positions.lamp_angle[n], positions.azimuth[n])
        np.testing.assert_allclose(lamp, light, atol=1e-10)


def test_a_table_holds_the_cells_of_both_ways_and_a_sharp_camera_reads_the_material():
    material = Microfacet(GGX(0.2), 0.9)
    rig = rig_of(0.01, 0.01, 5000.0)
    table, truth = matcam.measure(material, rig), true_table(material)
    assert table.attrs["sample"] == "cylinder"
    np.testing.assert_array_equal(np.isfinite(table.values), np.isfinite(truth.values))
    inside = np.asarray(np.minimum(*cosines(*np.meshgrid(*merl_grid("centre"), indexing="ij")))) > 0.05
    np.testing.assert_allclose(table.values[inside], truth.values[inside], rtol=1e-4)
    assert set(np.unique(table.pixels.values)) <= {0.0, 1.0, 2.0}


def test_the_peak_is_that_of_the_exact_peak_response():
    rig, theta_d = rig_of(0.6, 0.5, 200.0), np.radians(np.arange(1.0, 86.0, 7.0))
    positions = line_positions(rig.sample, 0 * theta_d, theta_d, 0 * theta_d, rig.lamp.nearness)
    recorded = np.asarray(record_cells(Microfacet(GGX(0.004), 1.0, masking=None), rig, positions))[:, 0]
    true = 1 / (np.pi * 0.004**2) / (4 * np.cos(theta_d))
    np.testing.assert_allclose(
        recorded / true, peak_response(rig, GGX(0.004), theta_d, exact=True, masking=None), rtol=1e-4
    )


@pytest.mark.parametrize(
    "optics",
    [
        pytest.param(DiffractionOptics(8.0, 550e-9, 4e-6), marks=pytest.mark.slow),
        HaloOptics(GaussianOptics(0.5), 0.01, 30.0),
    ],
)
@pytest.mark.parametrize("alpha", [0.01, 0.2])
def test_a_lens_of_several_gaussians_is_the_sum_of_its_terms(optics, alpha):
    lens = gaussian_sum(optics)
    angles = drawn_cells(np.random.default_rng(3), 60)
    lobe = sphere_cells.GGX(alpha)
    through = [
        (float(share), oracle.Lens((1.0,), (float(sigma),), 0.5))
        for share, sigma in zip(lens.weights, lens.sigmas, strict=True)
    ]
    truth = np.array(
        [
            sum(share * oracle.record(lobe.p22, smith(lobe), 150.0, term, *cell, alpha) for share, term in through)
            for cell in zip(*angles, strict=True)
        ]
    )
    rig = Rig(Camera(optics, BoxPixel(0.5)), Cylinder(150.0))
    found = np.asarray(
        record_cells(Microfacet(GGX(alpha), 1.0), rig, line_positions(rig.sample, *angles, rig.lamp.nearness))
    )[:, 0]
    found = found / np.asarray(cosines(*angles)[0])
    assert np.all(np.abs(found - truth) < np.maximum(1e-4 * truth, 1e-7 * truth.max()))


@pytest.mark.parametrize("aperture", [0.0, 0.01])
def test_under_a_lamp_across_the_axis_a_row_of_the_picture_says_the_same(aperture):
    rig = rig_of(0.6, 0.5, 40.0, aperture=aperture, focus=0.2)
    material = Microfacet(GGX(0.05), 1.0)
    row = matcam.picture(material, rig, 1.0, shape=(1, 81))
    x = row.x.values
    shown = (x > 0) & (x < 40)
    positions = RecordPositions(x[shown], np.zeros(shown.sum()), np.full(shown.sum(), 1.0))
    found = np.asarray(record_cells(material, rig, positions))[:, 0]
    np.testing.assert_allclose(found, row.values[0, shown, 0], rtol=2e-4, atol=1e-7 * found.max())


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    jax = pytest.importorskip("jax")
    positions = line_positions(rig_of(0.6, 0.5, 80.0).sample, *drawn_cells(np.random.default_rng(4), 30))

    def total(alpha, sigma):
        return record_cells(Microfacet(GGX(alpha), 1.0), rig_of(sigma, 0.5, 80.0), positions).sum()

    slopes = jax.grad(total, argnums=(0, 1))(0.02, 0.6)
    step = 1e-5
    np.testing.assert_allclose(slopes[0], (total(0.02 + step, 0.6) - total(0.02 - step, 0.6)) / (2 * step), rtol=1e-4)
    np.testing.assert_allclose(slopes[1], (total(0.02, 0.6 + step) - total(0.02, 0.6 - step)) / (2 * step), rtol=1e-4)


def test_what_a_cylinder_cannot_show_is_refused():
    camera, material = matcam.rigs.merl().camera, Microfacet(GGX(0.1), 0.9)
    for rig, words in (
        (Rig(camera, Cylinder(100.0), lamp_azimuth=0.3), "omit the azimuth of the lamp"),
        (Rig(camera, Cylinder(100.0), cell_value="mean"), "specify 'centre' or 'edge'"),
    ):
        with pytest.raises(ArgumentError, match=words):
            matcam.measure(material, rig)
    with pytest.raises(ArgumentError, match="omit the azimuth of the lamp"):
        matcam.measure(material, Rig(camera, Cylinder(100.0)), azimuth=0.5)
