"""A reference in pictures of its own: the lamps' light, the unit of values, and how far both are to be trusted."""

import json
import math

import numpy as np
import pytest

from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.light.reference_frames import SeenReference, scatter_between
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.radiometry import measure_radiometry
from matcam.files.capture import Stated, read_capture
from matcam.reconstruction.stated.lamp_light import gains_of
from tests.acquisition.drawn import VIEW, changed, surface
from tests.oracle.capture import Faults, draw

DRIFT, BETWEEN = 0.02, 0.001
ANGLES = np.radians([8, 17, 26, 35, 55, 75])


@pytest.fixture(scope="module")
def monitored():
    faults = Faults(gain=DRIFT, between=BETWEEN)
    return draw(surface(), VIEW, ANGLES, exposures=3, step=5.0, faults=faults, apart=2, seed=3)


@pytest.fixture(scope="module")
def white():
    faults = Faults(gain=0.005, between=BETWEEN)
    return draw(surface(), VIEW, ANGLES, exposures=3, step=5.0, faults=faults, apart=2, seed=4, reference="diffuse")


def light_of(capture):
    """What the capture says of its pictures' light, with the true lamps and sphere: no fit stands between."""
    truth = json.loads((capture.folder / "truth.json").read_text())
    radiometry, remarks = measure_radiometry(capture), []
    ball = MirrorBall(VIEW.row, VIEW.column, VIEW.radius, VIEW.camera)
    lamps = np.array([lamp["direction"] for lamp in truth["lamps"]])
    found = gains_of(capture, radiometry, list(capture.lamps), lamps, ball, 1 / VIEW.lamp, remarks)(
        lamps, 1 / VIEW.lamp
    )
    return found, np.array([lamp["gain"] for lamp in truth["lamps"]]), radiometry, {one.code for one in remarks}


def test_a_drifting_lamp_is_known_by_a_monitor_in_pictures_of_its_own(monitored, tmp_path):
    found, gains, radiometry, _ = light_of(read_capture(monitored.write(tmp_path)))
    off = np.log(found.gain / gains)
    off -= off.mean()
    std = np.sqrt(np.diag(found.covariance))
    assert np.abs(off).max() < 3 * std.max()
    assert std.max() < 0.2 * DRIFT  # three repeats a parameter: the stated scatter is wide
    assert BETWEEN / 2 < radiometry.reference_between < 4 * BETWEEN


def test_a_white_patch_in_the_position_of_the_sphere_gives_the_unit(white, tmp_path):
    found, gains, radiometry, codes = light_of(read_capture(white.write(tmp_path)))
    truth = white.truth
    relative = {one["exposure"]: one["relative"] for one in truth["exposures"]}[radiometry.reference_exposure]
    scale = truth["electrons_per_radiance"] * relative * truth["gain_dn_per_electron"] / radiometry.gain.value
    true = scale * np.array(truth["sensor"]["sensitivity"])
    gain_std = np.sqrt(np.diag(found.covariance))
    assert gain_std[:4].max() < 0.97 * gain_std[4:].min()  # at grazing incidence, the patch says nothing
    std = np.array([unit.std for unit in found.units])
    assert (np.abs(np.array([unit.value for unit in found.units]) / true - 1) < 3 * std).all()
    assert (std < 0.008).all()
    off = np.log(found.gain / gains)[:4]
    assert (np.abs(off - off.mean()) < 4 * np.sqrt(np.diag(found.covariance))[:4]).all()
    assert codes == set()


def test_a_good_reference_is_no_finding(white, tmp_path):
    capture = read_capture(white.write(tmp_path))
    codes = {one.code for one in check_capture(capture).findings}
    assert not {code for code in codes if "reference" in code or code == "lamp-drifts"}


def test_a_drifting_lamp_is_a_finding(monitored, tmp_path):
    settings = monitored.settings | {"lamp": monitored.settings["lamp"] | {"gain_std": 0.002}}
    capture = read_capture(changed(monitored, settings=settings).write(tmp_path))
    assert "lamp-drifts" in {one.code for one in check_capture(capture).findings}


def test_pictures_that_cannot_be_used_are_named(monitored, tmp_path):
    frames, rows = dict(monitored.frames), [dict(row) for row in monitored.rows]
    of = {row["file"]: row for row in rows}
    frames["reference/L00_0.tif"] = np.full_like(frames["reference/L00_0.tif"], 2**14 - 1)
    of["reference/L01_0.tif"]["lamp"] = "L77"
    of["reference/L02_0.tif"]["exposure"] = "E9"
    frames["reference/L03_0.tif"] = frames["reference/L03_0.tif"][:60]
    shifted = frames["reference/L04_0.tif"]
    frames["reference/L04_0.tif"] = np.roll(shifted, 30, axis=1)
    for name in ("reference/L05_0.tif", "reference/L05_1.tif"):
        del frames[name]
    capture = read_capture(changed(monitored, frames=frames, rows=rows).write(tmp_path))
    remarks = [str(one) for one in measure_radiometry(capture).remarks]
    for file, word in (
        ("L00_0", "clipped"), ("L01_0", "lamp"), ("L02_0", "exposure"), ("L03_0", "size"), ("L04_0", "the halves of"),
        ("lamp L05", "no usable image"), ("L05_1", "no such file"),
    ):  # fmt: skip
        assert any(file in line and word in line for line in remarks), (file, remarks)


@pytest.mark.parametrize(
    ("change", "code"),
    [({"apart": False}, "reference-unread"), ({"region_px": None}, "no-reference")],
)
def test_what_is_not_stated_is_said(monitored, tmp_path, change, code):
    reference = {k: v for k, v in (monitored.settings["reference"] | change).items() if v is not None}
    capture = read_capture(changed(monitored, settings=monitored.settings | {"reference": reference}).write(tmp_path))
    radiometry = measure_radiometry(capture, lamps=["L00", "L01"])
    assert code in {one.code for one in radiometry.remarks}


def test_one_picture_at_each_lamp_position_is_trusted_as_far_as_the_light_is_steady(monitored, tmp_path):
    """The lamp's light changes by 2 % from one position to the next: one picture says no more of the next one."""
    rows = [row for row in monitored.rows if not row["file"].endswith("_1.tif") or "reference" not in row["file"]]
    frames = {
        name: codes for name, codes in monitored.frames.items() if not name.endswith("_1.tif") or "ref" not in name
    }
    settings = monitored.settings | {"lamp": monitored.settings["lamp"] | {"gain_std": 0.005}}
    one = changed(monitored, frames=frames, rows=rows, settings=settings)
    found, _, _, codes = light_of(read_capture(one.write(tmp_path / "once")))
    assert "reference-unsteady" in codes
    assert (found.gain == 1).all()
    stated = one.settings | {"reference": one.settings["reference"] | {"between_std": BETWEEN}}
    found, gains, _, codes = light_of(read_capture(changed(one, settings=stated).write(tmp_path / "stated")))
    assert codes == set()
    off = np.log(found.gain / gains)
    assert np.abs(off - off.mean()).max() < 4 * BETWEEN


def seen(light, repeats):
    """Repeats of one exposure at each lamp position, in DN a pixel of one colour."""
    return [
        SeenReference(f"L{i}", np.zeros(repeats, int), one[:, None], np.array([1600])) for i, one in enumerate(light)
    ]


@pytest.mark.parametrize("repeats", [1, 2])
def test_how_the_light_changes_is_estimated(repeats):
    """2,000 trials of 12 lamp positions: a drift of 0.1 % a step and a flicker of 0.2 %."""
    rng, found = np.random.default_rng(1), []
    for _ in range(2000):
        drift = np.cumsum(0.001 * rng.standard_normal(12))
        light = 4000 * np.exp(drift[:, None] + 0.002 * rng.standard_normal((12, repeats)))
        light += np.sqrt(0.5 * light / 1600) * rng.standard_normal(light.shape)
        output = {f"L{i}": Stated(one.mean(), 4000 * 1.9e-4) for i, one in enumerate(light)}
        found.append(scatter_between(seen(light, repeats), np.ones(1), 0.5, 2.0, output))
    true = math.sqrt(2) * 0.002  # of the difference of two moments
    usual = float(np.sqrt(np.mean(np.square(found))))
    # Student's widening of 12 or 11 degrees of freedom; steps hold the drift, too
    widened = math.sqrt(12 / 10) * true if repeats == 2 else math.sqrt((true**2 + 0.001**2) * 11 / 9)
    assert usual == pytest.approx(widened, rel=0.03)


def test_too_few_pictures_tell_nothing():
    output = {f"L{i}": Stated(1.0, 0.001) for i in range(3)}
    assert math.isnan(scatter_between(seen(4000 * np.ones((3, 1)), 1), np.ones(1), 0.5, 2.0, output))
