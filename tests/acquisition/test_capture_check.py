"""`check_capture`: every fault that one can mend in the lab is found and named; a good capture has none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from matcam.acquisition.capture_check import check_capture, coverage_remarks
from matcam.acquisition.check.quick_outline import dark_disc
from matcam.acquisition.mirror_ball import MirrorBall, cylinder_line
from matcam.files.capture import read_capture
from matcam.files.capture_frames import LampGuess
from matcam.reconstruction.stated.stated_rig import captured_lens
from tests.acquisition.drawn import VIEW, changed, small, surface
from tests.oracle import cylinder_picture, flat_picture
from tests.oracle.capture import Faults, Sensor, direction, draw, lamp_angle
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


@pytest.mark.parametrize("times", [True, False])
def test_frames_with_exchanged_exposures_are_named(good, tmp_path, times):
    """They are omitted, so that the exposures are measured from the other frames."""
    frames = dict(good.frames)
    one, other = "frames/L01_E1.tif", "frames/L01_E2.tif"
    frames[one], frames[other] = frames[other], frames[one]
    rows = [row if times else row | {"time_s": ""} for row in good.rows]
    found = check_capture(read_capture(changed(good, frames=frames, rows=rows).write(tmp_path)))
    assert {one.code for one in found.findings} == {"frame-mislabelled"}
    assert [text for text in map(str, found.findings) if other in text and "thus that of exposure E1" in text]
    assert found.radiometry.exposures["E2"].value == pytest.approx(5.0, rel=5e-3)


def test_codes_in_steps_of_64_are_named(good, tmp_path):
    """A signal of 10 bits in files of 16 bits; 12 bits still resolve a read noise of half a step."""
    ten = {name: (codes.astype(int) // 16 * 64).astype(np.uint16) for name, codes in good.frames.items()}
    assert "steps of 64 DN" in codes(changed(good, frames=ten), tmp_path / "ten")["codes-coarse"]
    fourteen = {name: (codes.astype(int) * 4).astype(np.uint16) for name, codes in good.frames.items()}
    assert codes(changed(good, frames=fourteen), tmp_path / "fourteen") == {}


def test_a_frame_of_another_size_is_named(good, tmp_path):
    frames = good.frames | {"frames/L01_E1.tif": good.frames["frames/L01_E1.tif"][:-8]}
    assert "L01_E1.tif" in codes(changed(good, frames=frames), tmp_path)["other-size"]


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


@pytest.mark.parametrize("outline", [True, False])
def test_a_steady_lamp_near_a_white_patch_does_not_drift(tmp_path, outline):
    """At 25 radii its light on a patch beside the sphere differs by 6 % from that of a distant lamp.

    Without an outline frame the highlights indicate where the sphere is.
    """
    drawn = small(reference="diffuse")
    rows = [row for row in drawn.rows if outline or not row["file"].startswith("outline")]
    capture = read_capture(changed(drawn, rows=rows).write(tmp_path))
    assert "lamp-drifts" not in {one.code for one in check_capture(capture).findings}


def test_a_white_patch_under_lamps_of_unknown_directions_is_no_finding(tmp_path):
    """Its light depends on the directions, which `reconstruct` finds from the highlights."""
    drawn = small(reference="diffuse")
    rows = [{**row, "angle_deg": "", "azimuth_deg": ""} for row in drawn.rows]
    assert not {"no-reference", "lamp-drifts"} & set(codes(changed(drawn, rows=rows), tmp_path))


def test_frames_that_cannot_be_read_are_one_finding(tmp_path):
    drawn = small()
    frames = {name: (frame >> 8).astype(np.uint8) for name, frame in drawn.frames.items()}
    found = codes(changed(drawn, frames=frames), tmp_path)
    assert "no-radiometry" in found
    assert "no-highlight" not in found


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


def with_angles(drawn, change):
    """The capture with other angles and azimuths, degrees, in its list."""
    lit = [row for row in drawn.rows if row["angle_deg"]]
    table = change(np.array([[float(row["angle_deg"]), float(row["azimuth_deg"])] for row in lit]))
    for row, (angle, azimuth) in zip(lit, table, strict=True):
        row |= {"angle_deg": f"{angle:.5f}", "azimuth_deg": f"{azimuth:.5f}"}
    return drawn


TABLES = {
    "radians": (lambda table: np.radians(table), "radians"),
    "x flipped": (lambda table: [0, 180] + [1, -1] * table, "x axis points left"),
    "reversed": (lambda table: table[::-1], "reverse order"),
}


@pytest.mark.parametrize(("change", "word"), TABLES.values(), ids=TABLES)
@pytest.mark.parametrize("outline", [True, False])
def test_nothing_is_judged_by_a_wrong_lamp_table(tmp_path, change, word, outline):
    """Neither the radius, nor the range of angles, nor the light on a diffuse reference."""
    angles = np.radians([6, 17, 28, 39, 50, 61, 72])
    drawn = draw(surface(), VIEW, angles, exposures=2, step=5.0, azimuth=0.05, seed=4, reference="diffuse")
    drawn = with_angles(changed(drawn), change)
    drawn.rows[:] = [row for row in drawn.rows if outline or not row["file"].startswith("outline")]
    found = check_capture(read_capture(drawn.write(tmp_path)))
    texts = {one.code: one.text for one in found.findings}
    assert not {"angles-missed", "lamp-drifts", "no-reference", "radius-mismatch"} & set(texts)
    assert found.radiometry.lamp_output == {}
    wrong = [text for code, text in texts.items() if code.startswith("table-")]
    assert len(wrong) == 1
    if outline:
        assert word in wrong[0]
        assert found.centre == pytest.approx((VIEW.column, VIEW.row, VIEW.radius), abs=1.5)
    else:
        assert np.isnan(found.centre).all()


def test_clipping_in_the_shortest_exposure_is_found(tmp_path):
    assert "L03" in codes(small(peak_fill=4.0, clip="converter", cfa=None), tmp_path)["peak-clipped"]


def test_gaps_are_named():
    lamps = {f"{t}": LampGuess(np.radians(2 * t), 0.0) for t in (15, 25, 45, 60)}
    texts = [str(remark) for remark in coverage_remarks(lamps)]
    assert any("begin at theta_d = 15" in text for text in texts)
    assert any("theta_d between 25 and 45, between 45 and 60 degrees" in text for text in texts)
    assert any("end at theta_d = 60" in text for text in texts)
    assert len(texts) == 3


def test_mirror_normals_are_alhazens():
    """The sphere's highlight, and in the plane across the axis the line on a cylinder."""
    ball = MirrorBall(0.0, 0.0, 1.0, VIEW.camera)
    for theta in (0.2, 0.8, 1.4):
        angle = lamp_angle(theta, VIEW)
        t = mirror_angle(angle, VIEW)
        q = 1 / VIEW.camera
        away = np.sqrt(1 - q**2) * np.sin(t) / (1 - q * np.cos(t))
        row, column = ball.mirror_position(direction(angle, 0.7), VIEW.lamp)
        assert (column, -row) == pytest.approx(away * np.array([np.cos(0.7), np.sin(0.7)]), abs=1e-9)
        assert cylinder_line(direction(angle, 0.0), VIEW.camera, VIEW.lamp) == pytest.approx(away, abs=1e-9)


def turned(drawn, degrees):
    """The capture with a lamp table turned by a rotation vector."""
    turn = Rotation.from_rotvec(np.radians(degrees))
    rows = []
    for row in drawn.rows:
        row = dict(row)
        if row["angle_deg"]:
            x, y, z = turn.apply(direction(*np.radians([float(row["angle_deg"]), float(row["azimuth_deg"])])))
            row |= {
                "angle_deg": f"{np.degrees(np.arccos(z)):.4f}",
                "azimuth_deg": f"{np.degrees(np.arctan2(y, x)):.4f}",
            }
        rows.append(row)
    return changed(drawn, rows=rows)


@pytest.mark.parametrize("degrees", [(5.0, 0.0, 0.0), (0.0, 0.0, -5.0)])
def test_a_turned_lamp_table_is_found_with_its_size(good, tmp_path, degrees):
    """A turn about an axis in the picture moves all highlights alike: only the outline tells it from a moved sphere."""
    found = check_capture(read_capture(turned(good, degrees).write(tmp_path)))
    assert "5." in next(one.text for one in found.findings if one.code == "table-turned")
    assert np.degrees(found.turn_std).max() < 1
    assert np.all(np.abs(found.turn + np.radians(degrees)) < 3 * found.turn_std)


def test_clipping_is_looked_for_in_every_lamp_position(good, tmp_path):
    """L01 is none of the four whose exposures are all read."""
    frames = dict(good.frames)
    frames["frames/L01_E0.tif"] = np.where(frames["frames/L01_E0.tif"] > 1000, 15256, frames["frames/L01_E0.tif"])
    assert "L01" in codes(changed(good, frames=frames), tmp_path)["peak-clipped"]


def test_clipping_without_a_bracket_is_found_in_every_lamp_position(tmp_path):
    """One exposure: L01, whose frame is read for its highlight only, stands at a code below the largest of the file."""
    drawn = draw(
        surface(alpha=0.08), VIEW, np.radians([6, 17, 28, 39, 50, 61, 72]), exposures=1, seed=4, reference=None,
        sensor=Sensor(cfa=None),
    )  # fmt: skip
    assert "peak-clipped" not in codes(drawn, tmp_path / "good")
    seen = drawn.frames["frames/L01_E0.tif"]
    frames = drawn.frames | {"frames/L01_E0.tif": np.minimum(seen, np.quantile(seen, 0.995).astype(seen.dtype))}
    assert "L01" in codes(changed(drawn, frames=frames), tmp_path / "clipped")["peak-clipped"]


def test_a_stated_circle_is_compared_with_the_highlights(good, tmp_path):
    """It is used without outline frames, and goes before them."""
    circle = {"centre_px": [VIEW.column, VIEW.row], "radius_px": [1.1 * VIEW.radius, 0.3]}
    drawn = changed(good, settings=good.settings | {"outline": circle})
    assert "radius-mismatch" in codes(drawn, tmp_path / "with")
    rows = [row for row in drawn.rows if not row["file"].startswith("outline")]
    assert "radius-mismatch" in codes(changed(drawn, rows=rows), tmp_path / "without")


def of_cylinder(**more):
    stand = cylinder_picture.Stand(
        radius=70.0, camera=40.0, lamp=25.0, column=82.4, row=24.0, shape=(48, 166), strips=((0, 47, 0.0),)
    )
    angles = 2 * np.radians([8, 19, 30, 41, 52, 63, 74])
    return cylinder_picture.draw(
        cylinder_picture.Bent((0.1, 0.1), (3.18,), (3.33,)), stand, angles, np.radians([3, 178, -4, 175, 6, 3, -3]),
        lamp_std=np.radians(0.2), seed=3, **more,
    )  # fmt: skip


def test_a_cylinder_is_judged_as_a_cylinder(tmp_path):
    drawn = of_cylinder()
    assert codes(drawn, tmp_path / "good") == {}
    assert "about y" in codes(turned(drawn, (0, 5, 0)), tmp_path / "turned")["table-turned"]
    assert "radians" in codes(with_angles(changed(drawn), np.radians), tmp_path / "radians")["table-radians-as-degrees"]
    frames = drawn.frames | {"outline/O0.tif": drawn.frames["frames/L00_E0.tif"]}
    assert "O0.tif" in codes(changed(drawn, frames=frames), tmp_path / "stripe")["no-stripe"]
    # the stated outline then takes its place, as in `reconstruct`
    sample = drawn.settings["sample"] | {"outline_radius_px": [70.0, 0.1], "axis_column_px": [82.4, 0.1]}
    stated = turned(changed(drawn, frames=frames, settings=drawn.settings | {"sample": sample}), (0, 5, 0))
    assert {"no-stripe", "table-turned"} <= set(codes(stated, tmp_path / "stated"))


def test_what_a_cylinder_requires_is_checked(tmp_path):
    drawn = of_cylinder()
    rows = [row | {"angle_deg": "", "azimuth_deg": ""} for row in drawn.rows]
    assert "L00" in codes(changed(drawn, rows=rows), tmp_path / "directions")["no-direction"]
    sample = drawn.settings["sample"] | {"strip_rows_px": [[0, 20], [24, 60]], "strip_turn_deg": [0, 90]}
    outside = changed(drawn, settings=drawn.settings | {"sample": sample})
    assert "rows 24 to 60" in codes(outside, tmp_path / "rows")["strip-outside"]


def test_dark_frames_of_another_size_are_not_used(good, tmp_path):
    frames = {name: v[:-8] if name.startswith("dark") else v for name, v in good.frames.items()}
    found = codes(changed(good, frames=frames), tmp_path)
    assert "differs in size" in found["no-radiometry"]
    assert "camera.black_level_dn" in found["no-radiometry"]


def test_a_clipped_field_behind_a_cylinder_is_found(tmp_path):
    drawn = of_cylinder()
    field = drawn.frames["outline/O0.tif"]
    frames = drawn.frames | {"outline/O0.tif": np.minimum(field, np.quantile(field, 0.9).astype(field.dtype))}
    found = codes(changed(drawn, frames=frames), tmp_path)
    assert "O0.tif" in found["outline-clipped"]
    assert "radius-mismatch" not in found


def test_a_flat_sample_is_not_judged_as_a_sphere(tmp_path):
    random = np.random.default_rng(1)
    textures = [flat_picture.random_texture(mean, mean / 5, -2.0, 192, random) for mean in (0.4, 0.06)]

    def drawn(tilts):
        stand = flat_picture.FlatStand(shape=(128, 128))
        return flat_picture.draw(*textures, stand, np.radians(tilts), [(np.radians(20), 0.0)] * 4, seed=2)

    found = check_capture(read_capture(drawn([0, 10, 20, 30]).write(tmp_path / "good")))
    assert found.findings == ()
    assert "not-checked" in {note.code for note in found.notes}
    assert list(codes(drawn([10, 11, 12, 11]), tmp_path / "alike")) == ["half-angles-similar"]


def test_a_dark_disc_is_found_and_its_absence_too():
    frame = 300 + 9000 * backlit(VIEW, 0.05)
    assert dark_disc(frame) == pytest.approx((VIEW.column, VIEW.row, VIEW.radius), abs=0.7)
    assert np.isnan(dark_disc(np.full((60, 60), 500.0))).all()
    assert np.isnan(dark_disc(frame[:, :120])).all()
