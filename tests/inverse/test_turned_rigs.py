"""The fit's operator where the lamp's azimuth turns the plane of incidence against the pixels, and fits through it."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import GGX, Microfacet, correct, fit, fresnel, limits, measure, rigs, rivals
from matcam.camera import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, brdf_table
from matcam.core.workspace import Workspace
from matcam.forward import true_table, with_pixel_noise
from matcam.inverse import FitSetup
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.rig.rig_axes import rig_with
from tests.inverse.test_near_rigs import CHROMIUM, NEVER, knowing, made, missed
from tests.oracle import lamp_record
from tests.oracle.real_pixels import about_axis, behind, light_cosine

GEOMETRIES = [
    (np.inf, np.inf, 256.0, np.pi / 4),
    (np.inf, np.inf, 100.0, -1.1),
    (6.0, 4.0, 256.0, 0.5),
    (20.0, 50.0, 400.0, 2.0),
    (np.inf, 3.0, 100.0, 3.9),
]


def test_cells_of_a_turned_rig():
    assert np.max(missed(np.inf, np.inf, 100.0, [0.02], 2, slice_step=45, azimuth=0.6)) < 1


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "lamp", "radius", "azimuth"), GEOMETRIES)
def test_many_cells_of_turned_rigs(camera, lamp, radius, azimuth):
    """210 in all; lobes of a quarter of a pixel and broad ones."""
    assert np.max(missed(camera, lamp, radius, [0.001, 0.02, 0.2], 14, azimuth=azimuth)) < 1


@pytest.mark.slow
@pytest.mark.parametrize(("azimuth", "worst"), [(0.0, 2e-4), (-1.1, 2e-4)])
def test_broad_lobes_at_the_limb(azimuth, worst):
    """Without masking, so that the whole surface sends light up to the limb: all chosen cells of all slices."""
    rig, _ = made(np.inf, np.inf, 100.0, lamp_azimuth=azimuth)
    cells, operator = lobe_operator(rig, "centre", 1, (), NEVER)
    found = np.asarray(operator.record(GGX(0.2), None, ()))
    table = measure(Microfacet(GGX(0.2), 1.0, masking=None), rig).values[..., 0]
    truth = table[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d]
    assert np.max(np.abs(found / truth - 1)[cells.valid]) < worst


def test_a_quarter_turn_is_no_turn():
    """A square's other side: the very operator is the same."""
    workspace = Workspace()
    straight = lobe_operator(rigs.merl(), "centre", 30, (), workspace)
    for turns in (-3, 1, 2):
        rig = replace(rigs.merl(), lamp_azimuth=turns * np.pi / 2)
        quarter = lobe_operator(rig, "centre", 30, (), workspace)
        assert quarter[1] is straight[1]


@pytest.mark.slow
@pytest.mark.parametrize(("disc", "worst", "median"), [(0.002, 1e-5, 1e-8), (0.006, 1e-4, 3e-6)])
def test_the_turned_way_joins_the_straight_one(disc, worst, median):
    """At an azimuth of 1e-8 cells read what they do at 0: small discs as Gaussians, large ones by chords."""
    straight, _ = made(6.0, 4.0, 100.0)
    straight = rig_with(straight, {"lamp_radius": disc})
    turned = replace(straight, lamp_azimuth=1e-8)
    (cells, one), (_, other) = (lobe_operator(rig, "centre", 45, (), NEVER) for rig in (straight, turned))
    one, other = (np.asarray(o.record(GGX(0.02), "smith", ())) for o in (one, other))
    peak = one.max(axis=1, keepdims=True, where=cells.valid, initial=0)
    off = (np.abs(one - other) / np.maximum(one, 1e-3 * peak))[cells.valid]
    assert off.max() < worst
    assert np.median(off) < median


@pytest.mark.slow
def test_a_lamp_disc_under_a_turned_camera():
    """Against the oracle's mean over the disc's points: as close as before an aligned camera, where it is a Gaussian, too."""
    worst = {}
    for azimuth in (0.0, 0.7):
        rig, theirs = made(np.inf, np.inf, 100.0, lamp_azimuth=azimuth)
        rig, theirs = rig_with(rig, {"lamp_radius": 0.004}), theirs._replace(lamp_radius=0.004)
        cells, operator = lobe_operator(rig, "centre", 30, (), NEVER)
        found = np.asarray(operator.record(GGX(0.02), "smith", ()))
        off = []
        for s, n in np.random.default_rng(2).permutation(np.argwhere(cells.valid))[:12]:
            angles = cells.theta_h[s, n], cells.theta_d[s], cells.phi_d[s, n]
            truth = lamp_record.recorded_cell(angles, azimuth, lamp_record.Surface(0.02), theirs, (2, 8))
            off.append(abs(found[s, n] - truth) / np.max(found[s], where=cells.valid[s], initial=0))
        worst[azimuth] = max(off)
    print("of the peak:", worst)
    assert max(worst.values()) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["nearest", "bilinear"])
def test_cells_of_turned_real_pixels(rule):
    """Each the mean of its pixels' records over the light's cosine at their centres: 6 cells of pixels at 0.5 rad."""
    phase, azimuth, surface = (0.13, -0.31), 0.5, lamp_record.Surface(0.02)
    rig, theirs = made(np.inf, np.inf, 100.0, lamp_azimuth=azimuth, cell_value=rule, pixel_phase=phase)
    cells, operator = lobe_operator(rig, "centre", 30, (), NEVER)
    found = np.asarray(operator.record(GGX(0.02), "smith", ()))
    for s, n in np.random.default_rng(3).permutation(np.argwhere(cells.valid))[:6]:
        td = cells.theta_d[s]
        pixels = behind(rule, phase, cells.theta_h[s, n : n + 1], td, cells.phi_d[s, n : n + 1], 100.0, azimuth)
        on_sensor, cosines = about_axis(pixels.position[0], azimuth), light_cosine(pixels.position[0], td, 100.0)
        records = [lamp_record.record(x, y, 2 * td, azimuth, surface, theirs) for x, y in on_sensor]
        truth = np.sum(pixels.share[0] * np.array(records) / cosines)
        assert found[s, n] == pytest.approx(truth, rel=1e-4)


def test_where_the_lamp_stood_is_said_once():
    """By the rig, or by the table; what contradicts itself is refused in one line."""
    table, plain = brdf_table(np.ones((*GRID_SHAPE, 3)), "centre"), replace(rigs.merl(), cell_value="centre")
    for stated, own, fitted in ((None, None, None), (0.5, None, 0.5), (None, 0.5, 0.5), (0.5, 0.5 - 2 * np.pi, None)):
        table.attrs["lamp_azimuth"] = stated
        if stated is None:
            del table.attrs["lamp_azimuth"]
        rig = replace(plain, lamp_azimuth=own)
        assert FitSetup((table,), rig).rig.lamp_azimuth == (own if fitted is None else fitted)
    table.attrs["lamp_azimuth"] = 0.5
    assert FitSetup((table,), None).rig is None
    other = table.assign_attrs(lamp_azimuth=0.6)
    bad = table.assign_attrs(lamp_azimuth=30.0)
    for tables, azimuth, words in (
        (
            (table,),
            0.4,
            r"lamp_azimuth must be that of the table, attrs\['lamp_azimuth'\] = 0.5 rad, or None, got 0.4 rad",
        ),
        ((table, other), None, r"attrs\['lamp_azimuth'\] = 0.6 rad, or None, got 0.5 rad"),
        ((bad,), None, r"attrs\['lamp_azimuth'\] of a BRDF table must lie in \[-2 pi, 2 pi\] rad, got 30.0"),
    ):
        with pytest.raises(ArgumentError, match=words) as caught:
            FitSetup(tables, replace(plain, lamp_azimuth=azimuth))
        assert "\n" not in str(caught.value)
    with pytest.raises(ArgumentError, match=r"lamp_azimuth must lie in \[.*\] rad \(2 pi is a turn"):
        replace(rigs.merl(), lamp_azimuth=45.0)


@pytest.fixture(scope="module")
def turned_table():
    """A distant rig with its lamp at 29 degrees, and the table that it records of chromium, by `measure`."""
    rig, _ = made(np.inf, np.inf, 100.0)
    return rig, measure(Microfacet(GGX(0.02), CHROMIUM), rig, azimuth=0.5).isel(channel=[1])


@pytest.mark.slow
def test_a_turned_rigs_table_gives_its_material_back(turned_table):
    """Noise-free; the same table taken for an aligned rig's gives n 0.2 % too small."""
    rig, table = turned_table
    found = fit(table, knowing(rig, 0.0), "ggx", slice_step=9, workspace=NEVER).params
    print(found)
    assert found["alpha"] == pytest.approx(0.02, rel=1e-6)
    assert found["n[G]"] == pytest.approx(2.9, rel=1e-5)
    assert found["k[G]"] == pytest.approx(4.23, rel=1e-5)
    taken = table.assign_attrs(lamp_azimuth=0.0)
    assert fit(taken, knowing(rig, 0.0), "ggx", slice_step=9, workspace=NEVER).params["n[G]"] < 2.895


@pytest.mark.slow
def test_a_turned_rigs_table_is_corrected(turned_table):
    """1 % noise, lens known to 3 %: F, peaks, the verdict on the camera and the bounds."""
    rig, table = turned_table
    rig, workspace = knowing(rig, 0.015), Workspace()
    noisy = with_pixel_noise(table, rig, PixelNoise(0.01, 1e-4), 1)
    found = fresnel(noisy, rig, ndf="ggx", slice_step=6, workspace=workspace)
    angles = found["theta_d"].values
    true = np.asarray(CHROMIUM.at(angles)).ravel()
    true = true / true[(angles >= np.radians(10)) & (angles <= np.radians(45))].mean()
    seen = (angles > np.radians(10)) & (angles < np.radians(76))
    off, by_peak = (found[name].values[seen, 0] / true[seen] - 1 for name in ("corrected", "corrected_peak"))
    print("F off by", np.round(off, 4), "by the peak alone", np.round(by_peak, 4))
    assert np.abs(off).max() < 0.01
    assert np.abs(by_peak).max() < 0.04
    corrected = correct(noisy, rig, ndf="ggx", workspace=workspace)
    truth = true_table(Microfacet(GGX(0.02), CHROMIUM)).values[..., 1]
    value, std = (corrected[name].values[..., 0] / truth for name in ("brdf", "brdf_std"))
    recorded, supported = noisy.values[..., 0] / truth, corrected["supported"].values
    supported = (supported[..., 0] if supported.ndim == 4 else supported) & np.isfinite(value)
    rows = 0, np.arange(5, 76), 90
    print("peaks: recorded", recorded[rows][::10], "corrected", value[rows][::10], "supported", supported[rows].mean())
    false = np.mean(np.abs(value - 1)[supported] > 3 * std[supported])
    print("false support", false, "of", supported.mean())
    assert supported[rows].mean() > 0.9
    assert np.abs(value[rows] - 1)[supported[rows]].max() < 0.05
    assert false < 0.01
    assert "the camera explains the data better" in rivals(noisy, rig, workspace=workspace).verdict
    bounds = [
        limits(replace(rig, lamp_azimuth=a), roughness=[0.02], workspace=workspace)["width_std"] for a in (0.0, 0.5)
    ]
    np.testing.assert_allclose(*(b.values for b in bounds), rtol=0.1)
