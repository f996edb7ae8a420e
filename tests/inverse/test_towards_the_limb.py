"""Corrections at grazing angles, where a blurred highlight reaches to the last pixels of the sphere."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import GGX, Sphere, metal, rigs
from matcam.core.jax import jnp
from matcam.core.workspace import Workspace, default_workspace
from matcam.forward.measurement import CHROMIUM_WIDTH, simulated_chromium
from matcam.inverse import Correction
from matcam.inverse.correction.corrected_table import supported_values
from matcam.inverse.correction.correction_limits import albedo
from matcam.inverse.correction.response_lattice import FINE, on_table, response_lattice, seen_cells
from matcam.inverse.operator.chosen_cells import ChosenCells, positions_in
from matcam.inverse.operator.lobe_operator import operator_in, point_operator
from matcam.inverse.operator.sample_view import sample_view
from tests.oracle import sphere_cells, sphere_record
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H, conductor


def cosines(theta_h, theta_d, phi_d):
    mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    return mean - half, mean + half


def test_the_response_of_a_highlight_agrees_with_the_oracle_to_the_limb():
    """GGX 0.006, entries within 0.65 px of the limb in at least one of both images."""
    alpha = 0.006
    lattice = response_lattice(rigs.merl(), "centre", FINE, (), default_workspace())
    recorded, true = (op.record(GGX(alpha), "smith", jnp.zeros(0)) for op in (lattice.recorded, lattice.true))
    ok = lattice.cells.valid
    found = np.exp(on_table(np.log(np.where(ok, recorded, 1.0)) - np.log(np.where(ok, true, 1.0)), lattice))
    lobe = sphere_cells.GGX(alpha)
    for i, j, k in ((0, 86, 90), (0, 87, 90), (6, 85, 0), (10, 85, 5), (14, 84, 2)):
        at = THETA_H[i], THETA_D[j], PHI_D[k]
        cos = cosines(*at)
        shown = sphere_record.recorded_cell(*at, sphere_record.Surface(alpha), sphere_record.Setup(), 1e-7)
        tan2 = np.tan(at[0]) ** 2
        hidden = 1 + sum(lobe.smith(c) for c in cos)
        truth = lobe.p22(tan2) * (1 + tan2) ** 2 / hidden / (4 * cos[0] * cos[1])
        assert min(cos) < 0.071
        assert seen_cells(lattice)[i, j, k]
        assert found[i, j, k] == pytest.approx(np.mean(shown) / truth, rel=2e-3), (i, j, k)


@pytest.mark.parametrize("alpha", [0.003, 0.1])
def test_the_limb_does_not_change_entries_pixels_away(alpha):
    """Entries far from the highlight, within 8 px of the limb: between the slices of the lattice they changed by up to 60 %."""
    random = np.random.default_rng(0)
    lattice = response_lattice(rigs.merl(), "centre", FINE, (), default_workspace())
    lowest = np.min(cosines(THETA_H[:, None, None], THETA_D[:, None], PHI_D), axis=0)
    slices = np.arange(2, 80, 4)
    far = seen_cells(lattice) & (lowest < 0.25) & (np.arange(90) >= 20)[:, None, None]
    i, k = np.moveaxis(np.array([random.permutation(np.argwhere(far[:, j]))[:12] for j in slices]), -1, 0)
    theta_d, there = THETA_D[slices], np.ones(i.shape, bool)
    at = positions_in(sample_view(rigs.merl()), THETA_H[i], theta_d[:, None], PHI_D[k])
    cells = ChosenCells(slices, theta_d, i, k, THETA_H[i], PHI_D[k], there, *at, ~there)

    def log_response(recorded, true, cells):
        shown, own = (np.where(cells.valid, one.record(GGX(alpha), "smith", ()), 1.0) for one in (recorded, true))
        return np.log(shown / own)

    direct = operator_in(rigs.merl(), cells, (), "far entries", Workspace(entries=0))
    expected = log_response(direct, point_operator(cells), cells)
    found = on_table(log_response(lattice.recorded, lattice.true, lattice.cells), lattice)
    error = found[i, slices[:, None], k] - expected
    print(f"alpha {alpha}: rms {np.sqrt(np.mean(error**2)):.4f}, largest {np.abs(error).max():.4f}")
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert np.abs(error).max() < 0.04


@pytest.mark.parametrize(("radius", "i", "j", "k"), [(1500.0, 5, 88, 24), (256.0, 12, 87, 30)])
def test_a_highlight_just_beside_the_window_of_a_pixel(radius, i, j, k):
    """GGX 0.02, foreshortened 40 times: the highlight is nearer to the window than any of the points that sample its border."""
    column = [np.array([[a]]) for a in (i, k, THETA_H[i], PHI_D[k])]
    theta_d, rig = THETA_D[[j]], replace(rigs.merl(), sample=Sphere(radius))
    there = np.ones((1, 1), bool)
    positions = positions_in(sample_view(rig), column[2], theta_d[:, None], column[3])
    cells = ChosenCells(np.array([j]), theta_d, *column, there, *positions, ~there)
    operator = operator_in(rig, cells, (), "beside a window", Workspace(entries=0))
    found = np.asarray(operator.directions(GGX(0.02), "smith", jnp.zeros(0)))[0, 0]
    setup = sphere_record.Setup(radius)
    shown = sphere_record.recorded_cell(THETA_H[i], THETA_D[j], PHI_D[k], sphere_record.Surface(0.02), setup, 1e-6)
    np.testing.assert_allclose(found, shown, rtol=5e-3)


@pytest.mark.slow
def test_the_light_of_a_highlight_is_not_counted_twice():
    """The table of `matcam demo`: a peak and the light beside it are corrected together. The albedo is that of the metal."""
    table = simulated_chromium().clip(min=0)
    n, k, _ = metal("Cr", [610e-9, 550e-9, 465e-9], "rakic")
    cos_i, cos_o = cosines(THETA_H[:, None, None], THETA_D[:, None], PHI_D)
    lobe = np.exp(-(THETA_H[:, None, None] ** 2) / 2 / CHROMIUM_WIDTH**2) / (2 * np.pi * CHROMIUM_WIDTH**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        true = lobe / (4 * cos_i * cos_o)
    reflectance = np.stack([conductor(THETA_D, *one) for one in zip(n, k, strict=True)], axis=-1)
    true = np.where((cos_i > 0) & (cos_o > 0), true, np.nan)[..., None] * reflectance[:, None]
    done = Correction.of(table, rigs.merl())
    right, raw = albedo(true), albedo(table.values)
    for corrected in (done.table["brdf"], supported_values(done.table, table)):
        error = np.abs(albedo(corrected.values) - right) / right
        print(f"error of the albedo at 60.5 to 88.5 degrees: {error[60:89].max(axis=1)}")
        assert np.all(error <= np.maximum(np.abs(raw - right) / right, 0.02))
        assert error[84].max() < 0.02
