"""Profiles of strips round a cylinder, its straight outline, and the fit of many captures, against an independent renderer."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import Camera, GaussianOptics, reconstruct
from matcam.acquisition.limb.straight_outline import straight_outline
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.errors import FitError
from matcam.files.capture_settings import Stated
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.diffuse_shape import TERMS
from matcam.reconstruction.cylinder.cylinder_pixels import cylinder_pixels
from matcam.reconstruction.cylinder.strips import Strip, strip_profiles
from matcam.reconstruction.joint.joint_problem import JointLayout
from matcam.reconstruction.picture_model import lamp_frame
from matcam.reconstruction.picture_rule import WINDOW
from matcam.reconstruction.sphere_scene import SphereScene, joint_problem
from tests.oracle.capture import METALS, Sensor, _channels
from tests.oracle.cylinder_picture import Bent, Stand, backlit, draw, picture
from tests.oracle.sphere_picture import direction, fresnel

ALPHAS = 0.03, 0.1
STAND = Stand(camera=40.0, lamp=25.0, strips=((0, 39, 0.0), (40, 79, np.pi / 4), (80, 119, np.pi / 2)))
SENSOR = Sensor(cfa=None)
LAMPS = [direction(np.radians(angle), azimuth) for angle, azimuth in ((20, 0.1), (60, 3.0), (140, 0.05))]


def noiseless(stand, lamps, alphas, sensor=SENSOR):
    """Noiseless pictures of a perfect mirror's lobe, and the parameters that made them."""
    pictures, channel = [], _channels(stand.shape, sensor)
    names = ("R", "G", "B") if sensor.cfa else ("grey",)
    for k, lamp in enumerate(lamps):
        values = picture(Bent(alphas, (1e9,), (0.0,)), stand, lamp)[..., 0]
        pictures.append(MergedPicture(f"L{k}", values, np.ones_like(values), values < 0, channel, names))
    scene = SphereScene(
        camera=Camera(GaussianOptics(stand.sigma)),
        lens_std=0.03,
        centres=np.tile([stand.column, stand.row], (len(lamps), 1)),
        radius=stand.radius,
        outline_covariance=np.diag([0.05, 1.0, 0.05]) ** 2,
        shift_std=0.3,
        camera_nearness=Stated(1 / stand.camera, 1e-4),
        lamp_nearness=Stated(1 / stand.lamp, 1e-4),
        lamps=np.array(lamps),
        lamp_std=1e-4,
    )
    kind = LobeKind("ggx", "smith", stretched=True)
    layout = JointLayout(kind.size, len(names), len(lamps))
    p = np.zeros(layout.size)
    p[:2] = np.log(alphas)
    p[layout.scene] = 0.0, stand.radius, 1 / stand.camera, 1 / stand.lamp
    for k in range(len(lamps)):
        p[layout.own(k)] = stand.column, stand.row, 0.0, 0.0
    strips = [Strip(*strip) for strip in stand.strips]
    profiles = {one.name: strip_profiles(one, strips) for one in pictures}
    frames = [lamp_frame(lamp) for lamp in lamps]
    chosen = cylinder_pixels(pictures, scene, frames, layout, kind, p, strips=strips, profiles=profiles)
    return joint_problem(layout, kind, scene, frames, *chosen), p


@pytest.fixture(scope="module")
def problem():
    return noiseless(STAND, LAMPS, ALPHAS)


@pytest.mark.parametrize("k", range(len(LAMPS)))
def test_columns_record_what_an_independent_quadrature_says(problem, k):
    """In the windows to 3e-5 of the peak; beyond them to 1e-3 of the value or 1e-6 of the peak."""
    made, p = problem
    recorded, _ = made.recorded(p, k, slopes=False)
    pixels = made.pixels[k]
    missed, top = np.abs(recorded.lobe - pixels.values), pixels.values.max()
    near = np.arange(pixels.used.size) < len(STAND.strips) * WINDOW
    assert (pixels.used & near).sum() > 50
    assert missed[pixels.used & near].max() < 3e-5 * top
    far = pixels.used & ~near
    assert np.all(missed[far] < np.maximum(1e-3 * pixels.values[far], 1e-6 * top))


@pytest.mark.parametrize("cfa", [None, "GRBG"])
def test_the_highlight_may_change_along_a_strip(cfa):
    """A near lamp beside the plane of the camera turns the half vector along a strip by more than the width of the lobe.

    In a mosaic, each colour is read in other rows, which depend on the column.
    """
    stand = Stand(80.0, 40.0, 25.0, column=110.3, row=40.0, shape=(80, 220), strips=((0, 79, 0.0),), drawn=60)
    lamps = [direction(np.radians(angle), azimuth) for angle, azimuth in ((30, 0.3), (130, -0.15), (150, 0.1))]
    made, p = noiseless(stand, lamps, (0.03, 0.03), Sensor(cfa=cfa))
    for k in range(len(lamps)):
        recorded, _ = made.recorded(p, k, slopes=False)
        pixels = made.pixels[k]
        top = pixels.values.max()
        assert np.abs(recorded.lobe - pixels.values)[pixels.used].max() < 5e-4 * top  # 2e-2 with three rows
        if cfa:  # a model with the same rows for all colours is wrong by much more
            parity = pixels.positions[1] - 39.5
            assert set(np.unique(parity[pixels.used])) == {-0.5, 0.5}


@pytest.mark.slow
def test_a_diffuse_part_may_have_a_shape(problem):
    """Terms of 0 change nothing; what a coat takes is most where light or view graze."""
    made, p = problem
    layout = made.layout._replace(shape=TERMS)
    shaped = np.insert(p, layout.diffuse_shape.start, np.zeros(TERMS))
    before, _ = made.recorded(p, 0, slopes=False)
    again = replace(made, layout=layout)
    after, slopes = again.recorded(shaped, 0, slopes=True)
    assert after.lambert == pytest.approx(before.lambert, rel=1e-12)
    assert slopes.lambert.shape == (*after.lambert.shape, layout.of_picture(0).size)
    shaped[layout.diffuse_shape.start + 4] = -0.5
    coated, _ = again.recorded(shaped, 0, slopes=False)
    lit = before.lambert > 1e-3 * before.lambert.max()
    share = coated.lambert[lit] / before.lambert[lit]
    assert 0.9 < share.max() <= 1
    assert share.min() < 0.7


@pytest.mark.slow
def test_derivatives_are_those_of_the_values(problem):
    made, p = problem
    layout = made.layout
    for k in range(len(LAMPS)):
        _, slopes = made.recorded(p, k, slopes=True)
        used = made.pixels[k].used
        for index, position in enumerate(layout.of_picture(k)):
            step = np.zeros(layout.size)
            step[position] = 1e-5 * max(1.0, abs(p[position]))
            up, down = (made.recorded(p + sign * step, k, slopes=False)[0] for sign in (1, -1))
            for name in ("lobe", "theta_d"):
                ahead, behind, slope = (getattr(one, name) for one in (up, down, slopes))
                difference = (ahead - behind)[used] / (2 * step[position])
                missed = np.abs(slope[used, index] - difference) / (2e-5 * np.abs(difference).max() + 1e-9)
                assert np.quantile(missed, 0.995) < 1


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_straight_edges_tell_axis_and_radius(cfa):
    """To 0.03 px in noise; a lean is remarked, and does not change the radius."""
    rng = np.random.default_rng(0)
    channel = _channels(STAND.shape, Sensor(cfa=cfa))
    sensitivity = np.array([0.6, 1.0, 0.7])[channel]
    for lean in (0.0, 0.01):
        light = backlit(STAND, lean) * sensitivity
        found = straight_outline(rng.poisson(10000 * light).astype(float), channel, origin=(10, 20), reach=(0.0, 0.0))
        middle = STAND.column + lean * ((STAND.shape[0] - 1) / 2 - STAND.row)
        assert found.column == pytest.approx(middle + 20, abs=0.03)
        assert found.radius == pytest.approx(STAND.radius / np.sqrt(1 + lean**2), abs=0.03)
        assert [remark.code for remark in found.remarks] == ["cylinder-leans"] * (lean > 0)


def test_no_outline_is_a_line(problem):
    grey = np.zeros((40, 200), int)
    with pytest.raises(FitError, match="no upright dark stripe"):
        straight_outline(np.full((40, 200), 100.0), grey)
    stripe = np.ones((40, 200))
    stripe[:, 2:120] = 0.01
    with pytest.raises(FitError, match="px of the field on either side"):
        straight_outline(stripe, grey)
    flat = MergedPicture("L", stripe, stripe, stripe < 0, grey, ("grey",))
    with pytest.raises(FitError, match=r"strip 1 \(rows 30 to 60\) must"):
        strip_profiles(flat, [Strip(30, 60, 0.0)])


def true_ratio(n, k, seen):
    at = np.radians([angle for angle in range(10, 50, 5) if seen[0] <= np.radians(angle) <= seen[1]])
    return fresnel(np.cos(np.radians(75)), n, k) / fresnel(np.cos(at), n, k).mean()


@pytest.mark.slow
def test_errors_are_as_stated(tmp_path):
    """12 captures, strips at 0 and 90 degrees, lamp table wrong by 0.2 degrees, gain by 0.5 %, axis by 0.2 px, lens by 3 %.

    Stated errors of the roughness are 1.7 times too small (docs/reconstruct.md says so): the bound here only keeps it from
    getting worse.
    """
    pulls, ratios, alphas, alpha_pulls = [], [], [], []
    for seed in range(12):
        rng = np.random.default_rng(1000 + seed)
        stand = STAND._replace(
            strips=((0, 29, 0.0), (30, 59, np.pi / 2)), shape=(60, 460), row=30.0, column=230 + rng.uniform(-0.5, 0.5)
        )
        truth = tuple(np.exp(rng.uniform(np.log([0.01, 0.05]), np.log([0.1, 0.3]))))[:: 1 if seed % 2 else -1]
        n, k = (values[len(values) // 2] for values in METALS[("Cr", "Au", "glass")[seed % 3]])
        angles, azimuths = np.radians(2 * np.linspace(10, 78, 8)), np.radians(np.tile([8.0, -6.0], 4))
        surface = Bent(truth, (n,), (k,), (0.02,))
        folder = draw(surface, stand, angles, azimuths, lamp_std=np.radians(0.2), seed=seed).write(tmp_path / f"{seed}")
        found = reconstruct(folder)
        for name, value in zip(("alpha_x", "alpha_y"), truth, strict=True):
            alpha_pulls.append((found.parameters[name][0] - value) / found.parameters[name][1])
            alphas.append(found.parameters[name][0] / value - 1)
        ratio = found.ratio(np.radians(75))
        error = ratio.value - true_ratio(n, k, found.measured_range)
        pulls.append(error / ratio.std)
        ratios.append(error / ratio.value)
    assert np.sqrt(np.mean(np.square(alphas))) < 0.001
    assert np.sqrt(np.mean(np.square(alpha_pulls))) < 2.5
    assert np.sqrt(np.mean(np.square(ratios))) < 0.006
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


@pytest.mark.slow
def test_one_strip_of_an_isotropic_material_gives_a_merl_table(tmp_path):
    stand = STAND._replace(strips=((0, 39, 0.0),), shape=(40, 460), row=20.0)
    angles = np.radians(2 * np.linspace(8, 76, 7))
    surface = Bent((0.05, 0.05), (1.5,), (0.0,), (0.1,))
    folder = draw(surface, stand, angles, np.zeros(7), outline=False, seed=4).write(tmp_path / "one")
    found = reconstruct(folder, "ggx")
    value, std = found.parameters["alpha"]
    assert abs(value - 0.05) < 4 * std
    assert found.table["brdf"].shape == (90, 90, 180, 3)
    ratio = found.ratio(np.radians(75))
    assert abs(ratio.value - true_ratio(1.5, 0.0, found.measured_range)) < 4 * ratio.std
