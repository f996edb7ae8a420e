"""The fit's operator before near cameras and under near lamps, against an oracle with a quadrature of its own."""

import numpy as np
import pytest

from matcam import (
    GGX,
    BoxPixel,
    Camera,
    Conductor,
    DistantLamp,
    GaussianOptics,
    Microfacet,
    NearLamp,
    Rig,
    Sphere,
    correct,
    fit,
    fresnel,
    limits,
    measure,
    rigs,
)
from matcam.camera import PixelNoise, Uncertainty
from matcam.core.workspace import Workspace
from matcam.forward import true_table, with_pixel_noise
from matcam.inverse.operator.chosen_cells import ChosenCells, positions_in
from matcam.inverse.operator.lobe_operator import lobe_operator, operator_in
from matcam.inverse.operator.sample_view import SampleView, sample_view
from matcam.inverse.rig.rig_axes import free_axis, rig_with
from tests.golden import rows
from tests.oracle import lamp_record

CHROMIUM = Conductor([2.9], [4.23])
NEVER = Workspace(entries=0)
GEOMETRIES = [(6.0, 4.0, 256.0), (np.inf, 3.0, 100.0), (20.0, 50.0, 400.0), (8.0, np.inf, 100.0)]


def made(camera, lamp, radius, sigma=0.5, **more):
    """(the package's rig, the oracle's): distances in radii."""
    light = None if np.isinf(lamp) else NearLamp(lamp)
    rig = Rig(Camera(GaussianOptics(sigma), BoxPixel(0.5)), Sphere(radius, camera), light, **more)
    return rig, lamp_record.Rig(radius, camera, lamp, sigma, 0.5)


def missed(camera, lamp, radius, alphas, count, slice_step=18, azimuth=0.0):
    """Errors of `count` random chosen cells for each alpha, over 1e-4 of the value or 1e-7 of the picture's peak."""
    rig, theirs = made(camera, lamp, radius, lamp_azimuth=azimuth)
    cells, operator = lobe_operator(rig, "centre", slice_step, (), NEVER)
    random, errors = np.random.default_rng(5), []
    for alpha in alphas:
        found = np.asarray(operator.record(GGX(alpha), "smith", ()))
        peak = np.max(found, axis=1, where=cells.valid, initial=0)
        for s, n in random.permutation(np.argwhere(cells.valid))[:count]:
            angles = cells.theta_h[s, n], cells.theta_d[s], cells.phi_d[s, n]
            truth = lamp_record.recorded_cell(angles, azimuth, lamp_record.Surface(alpha), theirs)
            errors.append(abs(found[s, n] - truth) / max(1e-4 * truth, 1e-7 * peak[s]))
    print(f"camera {camera}, lamp {lamp}, radius {radius}: worst {max(errors):.2g} of what is allowed")
    return np.array(errors)


def test_cells_of_a_near_rig():
    assert np.max(missed(6.0, 4.0, 100.0, [0.02], 5, slice_step=30)) < 1


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "lamp", "radius"), GEOMETRIES)
def test_many_cells_of_near_rigs(camera, lamp, radius):
    """240 in all; lobes of a quarter of a pixel and broad ones."""
    assert np.max(missed(camera, lamp, radius, [0.001, 0.02, 0.2], 20)) < 1


def test_golden_cells_by_the_near_code():
    """Camera and lamp at 1e8 radii: both ways of the golden cells that a fit uses, closer than by the distant code."""
    golden = rows("measure_cells")
    theta_h, theta_d, phi_d, rings = (
        np.array([row[key] for row in golden]) for key in ("theta_h", "theta_d", "phi_d", "i_theta_h")
    )
    rig = Rig(rigs.merl().camera, Sphere(256.0, 1e8), NearLamp(1e8))
    column = [a[:, None] for a in (rings, rings, theta_h, phi_d)]
    positions = positions_in(sample_view(rig), column[2], theta_d[:, None], column[3])
    valid = np.ones(column[0].shape, bool)
    cells = ChosenCells(np.arange(len(golden)), theta_d, *column, valid, *positions, ~valid)
    operator = operator_in(rig, cells, (), "golden, near", NEVER)
    compared = 0
    for position, row in enumerate(golden):
        grazing = min(cells.cos_i[position].min(), cells.cos_o[position].min())
        if grazing < (0.06 if row["i_theta_h"] < 12 else 0.17):
            continue
        record = np.asarray(operator.directions(GGX(row["alpha"]), "smith", ()))[position, 0]
        truth = np.array([row["recorded_one_way"], row["recorded_other_way"]])
        np.testing.assert_allclose(record, truth, rtol=1e-6, err_msg=f"{row}")
        compared += 1
    assert compared > 15


def test_a_lamps_disc_is_changed_at_its_distance():
    rig = rig_with(Rig(rigs.merl().camera, Sphere(64.0), NearLamp(10.0, 0.1)), {"lamp_radius": 0.02})
    assert isinstance(rig.lamp, NearLamp)
    assert float(rig.lamp.distance) == 10
    assert float(rig.lamp_radius) == pytest.approx(0.02, rel=1e-12)


def test_the_position_of_a_highlight_and_its_light():
    """The flux of a highlight by its area in the picture, against the ratio of the picture's shift by finite differences."""
    view = SampleView(100.0, 1 / 6, 1 / 4)
    theta_d, step = np.radians([5.0, 40.0, 70.0]), 1e-4
    none = np.zeros(3)
    peak = view.position(none, theta_d, none)
    np.testing.assert_allclose(view.at_highlight(peak.lamp_angle), peak.x, rtol=1e-12)
    # normals a small angle from the half vector, each in the picture of the same lamp
    from scipy.optimize import brentq

    for n, angle in enumerate(theta_d):
        corners = []
        for phi in (0.0, np.pi / 2):

            def lamp_miss(at, phi=phi, n=n):
                there = view.position(np.array([step]), np.array([at]), np.array([phi]))
                return float(there.lamp_angle[0] - peak.lamp_angle[n])

            at = brentq(lamp_miss, angle - 0.01, angle + 0.01, xtol=1e-15)
            there = view.position(np.array([step]), np.array([at]), np.array([phi]))
            corners.append((float(there.x[0] - peak.x[n]), float(there.y[0])))
        area = abs(corners[0][0] * corners[1][1] - corners[0][1] * corners[1][0]) / step**2
        lamp = 1 / (np.sqrt(1 - view.lamp**2 * np.sin(angle) ** 2) - view.lamp * np.cos(angle))
        assert view.highlight_area(angle) == pytest.approx(area * lamp**2 / np.cos(angle), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "azimuth", "slice_step"), [((6.0, 4.0, 256.0), None, 18), ((np.inf, np.inf, 100.0), 0.5, 45)]
)
def test_the_lens_and_a_lamp_are_followed(where, azimuth, slice_step):
    """Along its axis the operator of a near or turned rig is that of a rig with the other lens or lamp."""
    rig, _ = made(*where, lamp_azimuth=azimuth)
    for name, value in (("optics.sigma_px", 0.4), ("lamp_radius", 0.003)):
        axis = free_axis(name, rig)
        coordinate = 0.5 * np.log((value**2 + axis.softening**2) / (axis.base**2 + axis.softening**2))
        _, along = lobe_operator(rig, "centre", slice_step, (axis,), NEVER)
        cells, there = lobe_operator(rig_with(rig, {name: value}), "centre", slice_step, (), NEVER)
        ours = np.asarray(along.record(GGX(0.01), "smith", np.array([coordinate])))
        truth = np.asarray(there.record(GGX(0.01), "smith", ()))
        inner = cells.valid & (cells.cos_i.min(-1) > 0.2) & (cells.cos_o.min(-1) > 0.2)
        peak = np.max(truth, axis=1, keepdims=True, where=inner, initial=0)
        off = np.abs(ours - truth)[inner] / np.hypot(truth, 0.01 * peak)[inner]
        print(f"{name}: worst {off.max():.1e}")
        assert off.max() < 1e-3


@pytest.mark.slow
def test_bounds_of_a_very_distant_rig_are_a_distant_rigs():
    camera = rigs.merl().camera
    near, far = (
        limits(rig, roughness=[0.002, 0.02], slice_step=15, workspace=NEVER)
        for rig in (Rig(camera, Sphere(256.0, 1e6), NearLamp(1e6)), Rig(camera, Sphere(256.0)))
    )
    for name in ("width_std", "width_std_free", "lens_std_free", "fresnel_std", "width_std_changed"):
        np.testing.assert_allclose(near[name].values, far[name].values, rtol=5e-3)


@pytest.fixture(scope="module")
def near_table():
    """A rig with the camera at 20 radii and the lamp at 10, and the table that it records of chromium, by `measure`."""
    rig, _ = made(20.0, 10.0, 100.0)
    return rig, measure(Microfacet(GGX(0.02), CHROMIUM), rig).isel(channel=[1])


def knowing(rig, std, **changes):
    """The rig, its lens known to `std` px."""
    camera = Camera(rig.camera.optics, rig.camera.pixel, uncertainty=Uncertainty.of({"optics.sigma_px": std}))
    return Rig(camera, changes.get("sample", rig.sample), changes.get("lamp", rig.lamp))


@pytest.mark.slow
def test_a_near_rigs_table_gives_its_material_back(near_table):
    """Noise-free; the same table taken for a distant rig's gives n 14 % too small."""
    rig, table = near_table
    found = fit(table, knowing(rig, 0.0), "ggx", slice_step=9, workspace=NEVER).params
    print(found)
    assert found["alpha"] == pytest.approx(0.02, rel=1e-5)
    assert found["n[G]"] == pytest.approx(2.9, rel=5e-5)
    assert found["k[G]"] == pytest.approx(4.23, rel=5e-5)
    far = knowing(rig, 0.0, sample=Sphere(100.0), lamp=DistantLamp())
    assert fit(table, far, "ggx", slice_step=9, workspace=NEVER).params["n[G]"] < 2.6


@pytest.mark.slow
def test_a_near_rigs_table_is_corrected(near_table):
    """1 % noise, lens known to 3 %: F at every angle to 75.5 degrees, and the peaks of the corrected table."""
    rig, table = near_table
    rig = knowing(rig, 0.015)
    noisy = with_pixel_noise(table, rig, PixelNoise(0.01, 1e-4), 1)
    workspace = Workspace()
    found = fresnel(noisy, rig, ndf="ggx", slice_step=6, workspace=workspace)
    angles = found["theta_d"].values
    true = np.asarray(CHROMIUM.at(angles)).ravel()
    true = true / true[(angles >= np.radians(10)) & (angles <= np.radians(45))].mean()
    seen = (angles > np.radians(10)) & (angles < np.radians(76))
    off = found["corrected"].values[seen, 0] / true[seen] - 1
    print("F off by", np.round(off, 4))
    assert np.abs(off).max() < 0.01
    assert abs(found["raw"].values[seen, 0][-1] / true[seen][-1] - 1) > 0.4
    corrected = correct(noisy, rig, ndf="ggx", workspace=workspace)
    truth = true_table(Microfacet(GGX(0.02), CHROMIUM)).values[..., 1]
    value, std = (corrected[name].values[..., 0] / truth for name in ("brdf", "brdf_std"))
    recorded, supported = noisy.values[..., 0] / truth, corrected["supported"].values
    supported = (supported[..., 0] if supported.ndim == 4 else supported) & np.isfinite(value)
    rows = 0, np.arange(5, 76), 90
    print("peaks: recorded", recorded[rows][::10], "corrected", value[rows][::10], "supported", supported[rows].mean())
    print("false support", np.mean(np.abs(value - 1)[supported] > 3 * std[supported]), "of", supported.mean())
    assert supported[rows].mean() > 0.9
    assert np.abs(value[rows] - 1)[supported[rows]].max() < 0.05
    assert recorded[0, 75, 90] < 0.6
    assert np.mean(np.abs(value - 1)[supported] > 3 * std[supported]) < 0.01
