"""`check_capture`: every fault that one can mend in the lab is found and named; a good capture has none."""

import numpy as np
import pytest

from matcam.acquisition.capture_check import check_capture, coverage_remarks, dark_disc, mirror_normal
from matcam.files.capture import read_capture
from matcam.files.capture_frames import LampGuess
from matcam.reconstruction.stated.stated_rig import captured_lens
from tests.acquisition.drawn import VIEW, changed, small, surface
from tests.oracle.capture import Faults, direction, draw, lamp_angle
from tests.oracle.sphere_picture import backlit, mirror_angle


@pytest.fixture(scope="module")
def good():
    return draw(
        surface(), VIEW, np.radians([6, 17, 28, 39, 50, 61, 72]), exposures=3, step=5.0, azimuth=0.4, seed=4, outlines=2,
        faults=Faults(lamps=np.radians(0.3), exposure=0.0),
    )  # fmt: skip


def codes(drawn, folder):
    return {finding.code: str(finding) for finding in check_capture(read_capture(drawn.write(folder))).findings}


def test_a_good_capture_has_no_findings(good, tmp_path):
    found = check_capture(read_capture(good.write(tmp_path)))
    assert [str(finding) for finding in found.findings] == []
    assert found.centre[0] == pytest.approx(VIEW.column, abs=1.5)
    assert found.centre[1] == pytest.approx(VIEW.row, abs=1.5)
    assert found.centre[2] == pytest.approx(VIEW.radius, abs=2)


def test_faults_are_found_and_named(good, tmp_path):
    frames = dict(good.frames)
    rows = [dict(row) for row in good.rows]
    for row in rows:
        if row["exposure"] == "E2":
            row["time_s"] = f"{1.067 * float(row['time_s']):.6g}"  # a dial
        if row["lamp"] == "L03":
            row["angle_deg"] = f"{float(row['angle_deg']) - 15:.3f}"
    for k in range(3):
        name = f"frames/L06_E{k}.tif"
        frames[name] = frames[name].copy()
        frames[name][8:48, 8:48] = 256 + ((frames[name][8:48, 8:48].astype(int) - 256) * 0.9).astype(
            int
        )  # the lamp sags
        frames[f"frames/L05_E{k}.tif"] = frames["dark/D0_E0.tif"]  # it was off
    frames["outline/O1.tif"] = np.roll(frames["outline/O1.tif"], 4, axis=1)
    found = codes(changed(good, frames=frames, rows=rows), tmp_path)
    assert "E2" in found["times-wrong"]
    assert "L06" in found["lamp-drifts"]
    assert "L03" in found["table-contradicts"]
    assert "L05" in found["no-highlight"]
    assert "O1.tif" in found["sphere-moved"]


def test_check_and_reconstruct_say_the_same_of_a_lens_without_a_profile(tmp_path):
    """`test_from_photographs_without_a_profile` measures that the lens is determined."""
    drawn = small()
    camera = {name: value for name, value in drawn.settings["camera"].items() if name != "profile"}
    capture = read_capture(changed(drawn, settings={**drawn.settings, "camera": camera}).write(tmp_path))
    found = next(one.text for one in check_capture(capture).findings if one.code == "no-profile")
    said = []
    captured_lens(capture, said)
    assert said[0].code == "lens-guessed"
    assert found.partition(": ")[2] == said[0].text.partition(": ")[2]
    assert "keeps this error" in found
    assert not any("told apart" in one.text for one in coverage_remarks({"L0": LampGuess(0.2, 0.0)}))


def test_a_steady_lamp_near_a_white_patch_does_not_drift(tmp_path):
    """At 25 radii its light on a patch beside the sphere differs by 6 % from that of a distant lamp."""
    capture = read_capture(small(reference="diffuse").write(tmp_path))
    assert "lamp-drifts" not in {one.code for one in check_capture(capture).findings}


def test_azimuths_that_run_the_wrong_way_are_found(good, tmp_path):
    """A flipped y axis: rows run down, azimuths count upwards."""
    drawn = draw(
        surface(), VIEW, np.radians([20, 30, 40, 50, 60, 65]), azimuth=np.radians([0, 60, 120, 200, 260, 310]),
        exposures=2, step=6.0, seed=5,
    )  # fmt: skip
    assert "table-flipped" not in codes(drawn, tmp_path / "right")
    rows = [
        {**row, "azimuth_deg": f"{-float(row['azimuth_deg']):.3f}" if row["azimuth_deg"] else ""} for row in drawn.rows
    ]
    assert "table-flipped" in codes(changed(drawn, rows=rows), tmp_path / "flipped")


def test_clipping_in_the_shortest_exposure_is_found(tmp_path):
    assert "L03" in codes(small(peak_fill=4.0, clip="converter", cfa=None), tmp_path)["peak-clipped"]


def test_gaps_are_named():
    lamps = {f"{t}": LampGuess(np.radians(2 * t), 0.0) for t in (15, 25, 45, 60)}
    texts = [str(remark) for remark in coverage_remarks(lamps)]
    assert any("below 15" in text for text in texts)
    assert any("between theta_d = 25 and 45" in text for text in texts)
    assert any("end at theta_d = 60" in text for text in texts)
    assert len(texts) == 4


def test_mirror_normals_are_alhazens():
    for theta in (0.2, 0.8, 1.4):
        angle = lamp_angle(theta, VIEW)
        t = mirror_angle(angle, VIEW)
        q = 1 / VIEW.camera
        expected = np.sqrt(1 - q**2) * np.sin(t) / (1 - q * np.cos(t)) * np.array([np.cos(0.7), np.sin(0.7)])
        assert mirror_normal(direction(angle, 0.7), VIEW.camera, VIEW.lamp) == pytest.approx(expected, abs=1e-9)


def test_a_dark_disc_is_found_and_its_absence_too():
    frame = 300 + 9000 * backlit(VIEW, 0.05)
    assert dark_disc(frame) == pytest.approx((VIEW.column, VIEW.row, VIEW.radius), abs=0.7)
    assert np.isnan(dark_disc(np.full((60, 60), 500.0))).all()
    assert np.isnan(dark_disc(frame[:, :120])).all()
