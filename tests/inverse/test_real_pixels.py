"""Tables whose cells were looked up in real pixels: their phase found, their lobe fitted, their peak given back."""

import numpy as np
import pytest

from matcam import Microfacet, Rig, Schlick, Sphere, fit, fresnel, measure, rigs
from matcam.camera import PixelNoise
from matcam.core.errors import FitError
from matcam.core.workspace import Workspace
from matcam.forward import with_pixel_noise
from matcam.forward.pixel_grid import grid_of
from matcam.inverse import Correction
from matcam.inverse.correction.real_pixels import Lattices, pixel_log_ratio
from matcam.inverse.correction.response_lattice import COARSE, FINE, response_lattice
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.fit_readings import FitCoordinates
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.lobe_operator import lobe_operator, perfect_operator
from matcam.inverse.operator.pixel_phase import cell_rule, located_rig
from matcam.inverse.operator.sample_view import SampleView
from matcam.inverse.rig.lens_changes import EIGHTH, SHAPE, SIXTH
from matcam.inverse.rig.rig_axes import change_axis
from matcam.material.ndf.ggx import GGX
from tests.inverse import recorded
from tests.inverse.real_tables import real_shot
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

PHASES = {"nearest": (0.13, -0.31), "bilinear": (-0.4, 0.22), "mean": (0.21, 0.34)}
RULES = tuple(PHASES)


@pytest.mark.parametrize(
    ("rule", "phase"),
    [
        pytest.param(rule, phase, marks=() if rule == "bilinear" else pytest.mark.slow)
        for rule, phase in (*PHASES.items(), ("nearest", (0.13, 0.31)))
    ],
)
def test_the_phase_is_found(rule, phase):
    """To 0.002 px, in noise, by values alone; a sphere of another size is refused by name."""
    table = real_shot(rule, phase, 30).table(oracle.GGX(0.005), seed=1)
    located = located_rig(recorded.rig(cell_value=rule), table)
    np.testing.assert_allclose(located.rig.pixel_phase, phase, atol=0.002)
    assert 0 < located.std < 0.01
    assert "centres of the pixels lie at" in located.remarks[0].text
    by_itself = located_rig(rigs.merl(), table)
    assert (by_itself.rig.cell_value, by_itself.rig.pixel_phase) == (rule, located.rig.pixel_phase)
    seen = cell_rule(table, 256.0)
    assert seen.rule == rule
    assert seen.found.phase == located.rig.pixel_phase
    other = recorded.rig(cell_value="nearest" if rule == "bilinear" else "bilinear")
    with pytest.raises(FitError, match=r"specify pixel_phase|specify the sphere's radius"):
        located_rig(other, table)
    stated = recorded.rig(cell_value=rule, pixel_phase=(0.0, 0.25))
    assert located_rig(stated, table) == (stated, 0.0, (), False)


@pytest.mark.parametrize("rule", RULES[::-1])
def test_the_operator_against_the_oracle(rule):
    """In this order two of the tables are still those of the test before.

    As for cells with pixels of their own (`test_lobe_operator.py`): rms 3e-5 of the value or of 1e-4 of the peak."""
    shot, phase = real_shot(rule, PHASES[rule], 30), PHASES[rule]
    rig = recorded.rig(cell_value=rule, pixel_phase=phase)
    cells, operator = lobe_operator(rig, "centre", 30)
    pixels = shot.truth.pixels(oracle.GGX(0.004))
    for s, values in enumerate(shot.truth.values(pixels)):
        at = {(i, k): n for n, (i, k) in enumerate(zip(shot.i[s], shot.k[s], strict=True))}
        positions = [
            at[i, k] for i, k in zip(cells.i_theta_h[s][cells.valid[s]], cells.i_phi_d[s][cells.valid[s]], strict=True)
        ]
        truth = values[positions]
        record = np.asarray(operator.record(GGX(0.004), "smith", ()))[s][cells.valid[s]]
        there = np.isfinite(truth)
        assert there.sum() > 30
        off = (record - truth)[there] / np.maximum(truth, 1e-4 * np.nanmax(truth))[there]
        assert np.sqrt(np.mean(off**2)) < 3e-5
        assert np.abs(off).max() < 1e-3


@pytest.mark.parametrize(
    ("rule", "azimuth"),
    [
        ("nearest", 0.5),
        *(
            pytest.param(rule, azimuth, marks=pytest.mark.slow)
            for rule, azimuth in [("nearest", np.pi / 4), ("nearest", np.pi / 2), ("bilinear", -1.2), ("mean", 0.5)]
        ),
    ],
)
def test_the_phase_under_a_lamp_at_an_azimuth(rule, azimuth):
    """The grid's phase counts along the sensor, whose rows the plane of light crosses at any angle."""
    table = real_shot(rule, PHASES[rule], 30, azimuth).table(oracle.GGX(0.005), seed=1)
    located = located_rig(recorded.rig(cell_value=rule), table)
    assert located.rig.lamp_azimuth == azimuth
    np.testing.assert_allclose(located.rig.pixel_phase, PHASES[rule], atol=0.002)


def test_other_tables_show_no_real_pixels():
    """Cells with a pixel of their own repeat nothing, and nothing is interpolated."""
    shot = recorded.pictures(30)
    table = shot.table(shot.rule.directions(oracle.GGX(0.005)).mean(-1))
    assert cell_rule(table, 256.0)[:2] == (None, None)
    assert located_rig(rigs.merl(), table).rig.cell_value == "centre"
    constant = table.where(table.isnull(), 1.0)
    assert cell_rule(constant, 256.0)[:2] == (None, None)
    rings = (table * 0 + np.cos(table.theta_h)).assign_attrs(table.attrs)
    assert cell_rule(rings, 256.0)[:2] == (None, None)


def wandering():
    """A phase for each picture: the sphere moves by 0.1 px rms, and the lamps are off by as much."""
    moved = np.random.default_rng(8).normal(0.1, 0.1, (90, 2))
    return tuple((float(x), float(y)) for x, y in np.clip(moved, -0.5, 0.5))


@pytest.mark.slow
def test_each_picture_may_have_its_own_phase():
    phases = wandering()
    shot = real_shot("nearest", phases, 30)
    table = shot.table(oracle.GGX(0.005), seed=1)
    found = located_rig(rigs.merl(), table)
    assert found.rig.cell_value == "nearest"
    ours, truth = np.array(found.rig.pixel_phase)[shot.slices], np.array(phases)[shot.slices]
    # turned by 180 degrees about the highlight, a picture makes the same table
    highlight = np.stack([256 * np.sin(shot.theta_d), 0 * shot.theta_d], axis=-1)
    apart = np.stack([(ours - one + 0.5) % 1 - 0.5 for one in (truth, 2 * highlight - truth)])
    assert np.abs(apart).max(axis=-1).min(axis=0).max() < 0.02
    assert found.std < 0.03
    assert "differ between the images" in found.remarks[0].text
    assert "90 pairs" in repr(found.rig)


@pytest.mark.slow
def test_the_peak_where_pictures_moved():
    shot, lobe = real_shot("nearest", wandering()), oracle.GGX(0.005)
    table, truth = shot.table(lobe, 0), shot.true_peak(lobe)
    done = Correction.of(table, recorded.rig(std=0.015, cell_value="nearest"))
    rows = [s for s in range(shot.slices.size) if np.isfinite(table.values[0, shot.slices[s], 90, 0])]
    value, std, supported = (
        np.array([float(done.table[name].values[0, shot.slices[s], 90, 0]) for s in rows])
        for name in ("brdf", "brdf_std", "supported")
    )
    off = value / truth[rows] - 1
    print(f"moved pictures: worst {np.abs(off).max():.3f}, pulls {np.std((value - truth[rows]) / std):.2f}")
    assert supported.all()
    assert np.abs(off).max() < 0.06


@pytest.mark.slow
def test_cells_found_to_be_means_have_the_noise_of_means():
    """A table that shows its rule by itself gets the standard deviations of one whose rule is specified.

    The phase that it shows errs by 0.0005 px. A few cells have a pixel's centre that close to their border: they hold one pixel
    more or less.
    """
    table = real_shot("mean", PHASES["mean"], 18).table(oracle.GGX(0.005), seed=1)
    specified = recorded.rig(std=0.015, cell_value="mean", pixel_phase=PHASES["mean"])
    by_rig, by_table = (
        Correction.of(table, rig).table["noise_std"].values
        for rig in (specified, recorded.rig(std=0.015, cell_value="unknown"))
    )
    ratio = (by_table / by_rig)[np.isfinite(by_rig)]
    np.testing.assert_allclose(np.quantile(ratio, [0.01, 0.5, 0.99]), 1, rtol=0.02)


def test_repeats_on_no_known_sphere_are_remarked():
    table = real_shot("nearest", PHASES["nearest"], 30).table(oracle.GGX(0.005), seed=1)
    assert cell_rule(table, 200.0)[:2] == ("nearest", None)
    small = Rig(rigs.merl().camera, Sphere(200.0), cell_value="unknown")
    found = located_rig(small, table)
    assert found.rig.cell_value == "centre"
    assert [remark.code for remark in found.remarks] == ["cells-repeat"]
    assert found.unexplained


@pytest.mark.slow
def test_a_table_of_pixels_that_fit_no_grid_is_left_alone():
    table = real_shot("nearest", PHASES["nearest"]).table(oracle.GGX(0.005), seed=1)
    small = Rig(recorded.rig(std=0.015).camera, Sphere(240.0), cell_value="unknown")
    done = Correction.of(table, small)
    assert done.withheld
    np.testing.assert_allclose(done.table["brdf"].values, np.maximum(table.values, 0), rtol=1e-12)
    assert "cells-repeat" in [remark.code for remark in done.remarks]


@pytest.mark.parametrize("rule", RULES)
def test_chosen_cells_share_no_pixel_and_state_their_noise(rule):
    from matcam.forward.pixel_grid import PixelGrid

    cells = chosen_cells(SampleView(256.0), "centre", 15, PixelGrid(rule, PHASES[rule]))
    np.testing.assert_allclose(cells.weight.sum(-1), 1)
    low = {"nearest": 0.5, "bilinear": 0.12, "mean": 0.01}[rule]
    assert cells.noise_share.min() >= low - 1e-9
    assert cells.noise_share.max() <= 1 + 1e-9
    if rule == "nearest":
        np.testing.assert_allclose(cells.noise_share, np.where(cells.one_pixel, 1, 0.5))
        for s in range(cells.slices.size):
            pixels = {
                frozenset(zip(np.round(x, 6), np.round(y, 6), strict=True))
                for x, y in zip(cells.x[s][cells.valid[s]], cells.y[s][cells.valid[s]], strict=True)
            }
            assert len(pixels) == cells.valid[s].sum()
            assert len(frozenset.union(*pixels)) == sum(map(len, pixels))


@pytest.mark.parametrize(("rule", "azimuth"), [*((rule, 0.0) for rule in RULES), *((rule, 0.5) for rule in RULES)])
def test_a_camera_that_sees_points_reads_the_pixels(rule, azimuth):
    """Without blur a cell is the lobe at its pixels' centres: by the oracle's angles of them.

    Lambda is interpolated in a table, to 3e-6 of 1 / (1 + Lambda); everything else is exact.
    """
    from matcam.forward.pixel_grid import PixelGrid
    from tests.oracle.real_pixels import angles_of, behind, light_cosine

    phase, lobe = PHASES[rule], oracle.GGX(0.02)
    cells, operator = perfect_operator("centre", 30, SampleView(256.0), None, PixelGrid(rule, phase, azimuth))
    unmasked, masked = (operator.record(GGX(0.02), masking, ()) for masking in (None, "smith"))
    for s, td in enumerate(cells.theta_d):
        good = cells.valid[s]
        theta_h, phi_d = (recorded.GRID[n][a[s][good]] for n, a in ((0, cells.i_theta_h), (2, cells.i_phi_d)))
        found = behind(rule, phase, theta_h, td, phi_d, azimuth=azimuth)
        s2 = np.tan(angles_of(found.position, td)[0]) ** 2
        cos_i = light_cosine(found.position, td)
        cos_o = np.sqrt(1 - (found.position**2).sum(-1) / 256.0**2)
        light = lobe.p22(s2) * (1 + s2) ** 2 / (4 * cos_i * cos_o)
        seen = light / (1 + lobe.smith(cos_i) + lobe.smith(cos_o))
        many = rule == "mean"  # of more than four pixels on a side the mean and covariance are kept
        faint = 1e-9 * masked[s].max() if many and azimuth else 0.0
        for record, truth, table in ((unmasked, light, 0.0), (masked, seen, 6e-6)):
            few = max(5e-5 if many else 1e-9, table)
            np.testing.assert_allclose(record[s][good], (found.share * truth).sum(1), rtol=few, atol=faint)


@pytest.mark.slow
def test_the_pixels_of_a_lens_of_fitted_shape():
    """Small moments of the lens make faint records negative; bright ones stay the oracle's, to 0.5 %."""
    shot, lobe = real_shot("bilinear", PHASES["bilinear"], 30), oracle.EPD(0.005, 1.0)
    rig, workspace = recorded.rig(cell_value="bilinear", pixel_phase=PHASES["bilinear"]), Workspace()
    axes, fitted = tuple(map(change_axis, (SHAPE, SIXTH, EIGHTH))), np.array([-0.025, -0.125, -0.225])
    lattices = Lattices(
        response_lattice(rig, "centre", FINE, (), workspace),
        response_lattice(rig, "centre", COARSE, axes, workspace),
        fitted,
    )
    found = FitCoordinates(LobeKind("epd", "smith"), np.log([0.005, 1.0]), axes, fitted, np.zeros((5, 5)))
    log, _ = pixel_log_ratio(lattices, found, grid_of(rig), 256.0, 0.0)
    for s, of_pixels in enumerate(shot.truth.values(shot.truth.pixels(lobe))):
        i, k = (index[: 9 * 180 : 7] for index in (shot.i[s], shot.k[s]))
        cells = oracle.Cells(recorded.GRID.theta_h[i][None], shot.theta_d[[s]], recorded.GRID.phi_d[k][None])
        own, of_pixels = cells.directions(lobe).mean(-1)[0], of_pixels[: 9 * 180 : 7]
        bright = of_pixels > 1e-3 * np.nanmax(of_pixels)
        assert bright.sum() > 150
        off = log[i, shot.slices[s], k] - np.log(own / of_pixels)
        assert np.abs(off[bright]).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_the_peak_is_given_back(rule):
    """Issue J, first two rows: the phase unknown, the lens known to 3 %. Over 4 seeds, from 5 to 75 degrees."""
    shot = real_shot(rule, PHASES[rule])
    rig = recorded.rig(std=0.015, cell_value=rule)
    for alpha in (0.005, 0.02):
        lobe, pulls, off = oracle.GGX(alpha), [], []
        for seed in range(4):
            table = shot.table(lobe, seed)
            done = Correction.of(table, rig)
            assert not done.withheld
            truth = shot.true_peak(lobe)
            for s, j in enumerate(shot.slices):
                at = 0, j, 90, 0
                if not np.isfinite(table.values[at]) or shot.theta_d[s] > np.radians(76):
                    continue
                value, std = (float(done.table[name].values[at]) for name in ("brdf", "brdf_std"))
                assert done.table["supported"].values[at]
                off.append(value / truth[s] - 1)
                pulls.append((value - truth[s]) / std)
        print(
            f"{rule} {alpha}: worst {np.abs(off).max():.3f}, pulls {np.std(pulls):.2f}, within {np.mean(np.abs(pulls) < 1):.0%}"
        )
        assert np.abs(off).max() < 0.05
        assert 0.6 < np.std(pulls) < 1.25


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_fresnel_of_real_pixels(rule):
    """F(75): at most 1.5 % rms, pulls as stated; one table, whose slices are 6 degrees apart, and 4 seeds."""
    shot = real_shot(rule, PHASES[rule])
    errors, pulls = [], []
    for seed in range(4):
        found = fresnel(
            shot.table(oracle.GGX(0.005), seed, gain=0.0), recorded.rig(std=0.015, cell_value=rule), slice_step=6
        )
        truth = conductor(found.theta_d.values, *recorded.CHROMIUM)
        truth /= truth[(found.theta_d.values > np.radians(10)) & (found.theta_d.values < np.radians(45))].mean()
        at = int(np.argmin(np.abs(found.theta_d.values - np.radians(75.5))))
        value, std = float(found["corrected"][at, 0]), float(found["corrected_std"][at, 0])
        errors.append(value / truth[at] - 1)
        pulls.append((value - truth[at]) / std)
    print(f"{rule}: F(75.5) rms {np.sqrt(np.mean(np.square(errors))):.4f}, pulls {np.round(pulls, 2)}")
    assert np.sqrt(np.mean(np.square(errors))) < 0.015
    assert np.sqrt(np.mean(np.square(pulls))) < 1.8


@pytest.mark.slow
def test_a_fit_finds_the_pixels_by_itself():
    shot = real_shot("nearest", PHASES["nearest"])
    table = shot.table(oracle.GGX(0.005), 3)
    found = fit(table, recorded.rig(cell_value="nearest"), fresnel="free", slice_step=6)
    assert abs(found.params["alpha"] - 0.005) < 4 * found.std["alpha"]
    blind = fit(table, recorded.rig(cell_value="centre"), fresnel="free", slice_step=6)
    assert "misfit" in {remark.code for remark in blind.remarks} - {remark.code for remark in found.remarks}
    assert blind.std["alpha"] > 5 * found.std["alpha"]
    assert abs(blind.params["alpha"] - 0.005) < 3 * blind.std["alpha"]


@pytest.mark.slow
def test_means_of_pixels_of_any_phase():
    """A table whose cells repeat nothing; taken for cells of one pixel, it is 0.3 % off at 0.02 %."""
    rig = recorded.rig(std=0.015, cell_value="mean")
    table = measure(Microfacet(GGX(0.02), Schlick(0.7)), rig)
    noisy = with_pixel_noise(table, rig, PixelNoise(0.01, 1e-4), seed=1)
    assert located_rig(rig, noisy).rig.pixel_phase is None
    found = fit(noisy, rig, fresnel="free", slice_step=6)
    assert not found.remarks
    assert abs(found.params["alpha"] - 0.02) < 3 * found.std["alpha"]
