"""capture.toml and frames.csv: what is read, and what is refused by name."""

import csv
import json

import numpy as np
import pytest

from matcam.core.errors import FileFormatError
from matcam.files.capture import COLUMNS, json_schema, read_capture, read_settings
from tests.conftest import REPOSITORY
from tests.oracle.capture import as_toml, write_tiff

SETTINGS = {
    "format": "matcam capture",
    "version": 1,
    "camera": {"profile": "camera.json", "cfa": "RGGB"},
    "sample": {"kind": "sphere", "radius_mm": [25.0, 0.005]},
    "distances": {"camera_mm": [1000, 5], "lamp_mm": 625},
    "lamp": {"radius_mm": [3.5, 0.05], "motion": "arc", "intensity": "reference", "gain_std": 0.005},
    "reference": {"kind": "monitor", "region_px": [0, 0, 4, 4]},
}


def row(file, lamp="", angle="", azimuth="", exposure="", time=""):
    return dict(zip(COLUMNS, (file, lamp, angle, azimuth, exposure, time), strict=True))


ROWS = [
    row("frames/a.tif", "L1", "20", "90", "E1", "0.01"),
    row("frames/b.tif", "L1", "20", "90", "E2", "0.04"),
    row("frames/c.tif", "L2", "60", "90", "E1", "0.01"),
    row("dark/d.tif", exposure="E1", time="0.01"),
]


def write(folder, settings=SETTINGS, rows=ROWS, frames=True):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.toml").write_text(as_toml(settings) if isinstance(settings, dict) else settings)
    with (folder / "frames.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    for one in rows if frames else ():
        path = folder / one["file"]
        if path.resolve().is_relative_to(folder.resolve()):
            path.parent.mkdir(exist_ok=True)
            write_tiff(path, np.full((6, 8), 300, np.uint16))
    return folder


def test_what_is_stated_is_read(tmp_path):
    capture = read_capture(write(tmp_path))
    assert [frame.file for frame in capture.of("frames")] == ["frames/a.tif", "frames/b.tif", "frames/c.tif"]
    assert [frame.file for frame in capture.of("dark", exposure="E1")] == ["dark/d.tif"]
    assert capture.exposures == ["E1", "E2"]
    assert capture.time("E2") == 0.04
    assert capture.radius_mm == (25.0, 0.005)
    assert capture.camera_radii.value == pytest.approx(40)
    assert capture.camera_radii.std == pytest.approx(np.hypot(5 / 25, 40 * 0.005 / 25))
    assert capture.lamp_radii.value == pytest.approx(25)
    assert capture.profile == tmp_path / "camera.json"
    assert capture.reference_region == (0, 0, 4, 4)
    assert capture.region is None
    assert capture.problems == ()
    assert capture.direction_std == pytest.approx(np.radians(1.0))


def test_lamps_point_up_where_their_azimuth_is_90_degrees(tmp_path):
    """x right, y up, z to the camera."""
    guess = read_capture(write(tmp_path)).lamps["L2"]
    assert guess.direction == pytest.approx([0, np.sin(np.radians(60)), 0.5])


def test_frames_are_read_in_part(tmp_path):
    capture = read_capture(write(tmp_path))
    picture = np.arange(48, dtype=np.uint16).reshape(6, 8)
    write_tiff(tmp_path / "frames/a.tif", picture)
    assert (capture.read(capture.frames[0]).values == picture).all()
    assert (capture.read(capture.frames[0], (2, 4, 5, 2)).values == picture[4:6, 2:7]).all()
    with pytest.raises(FileFormatError, match="have the same size"):
        capture.read(capture.frames[0], (4, 0, 6, 6))


BAD_SETTINGS = {
    "unknown key": ({**SETTINGS, "lamp": {"radius": 3}}, "field lamp.radius: unknown field"),
    "unknown table": ({**SETTINGS, "lamps": {"a": 1}}, "field lamps: unknown field"),
    "no number": ({**SETTINGS, "distances": {"camera_mm": "far"}}, "field distances.camera_mm: .*value or"),
    "three numbers": ({**SETTINGS, "sample": {"radius_mm": [1, 2, 3]}}, "field sample.radius_mm: .*value or"),
    "negative": ({**SETTINGS, "sample": {"radius_mm": -1}}, "field sample.radius_mm: .*must lie in"),
    "negative std": ({**SETTINGS, "sample": {"radius_mm": [1, -1]}}, "field sample.radius_mm: .*standard deviation"),
    "truth value": ({**SETTINGS, "sample": {"radius_mm": True}}, "field sample.radius_mm"),
    "other version": ({**SETTINGS, "version": 2}, "version 2 is unknown"),
    "other format": ({**SETTINGS, "format": "capture"}, 'field "format" must be "matcam capture"'),
    "mosaic": ({**SETTINGS, "camera": {"cfa": "RGBW"}}, "field camera.cfa: must be one of"),
    "reflectance": ({**SETTINGS, "reference": {"kind": "diffuse", "reflectance": 98}}, "field reference.reflectance"),
    "profile outside": ({**SETTINGS, "camera": {"profile": "../camera.json"}}, "leads out of"),
    "strips of a sphere": (
        {**SETTINGS, "sample": {"strip_rows_px": [[0, 9]]}},
        "field sample: .*strip_rows_px applies only if kind is cylinder, but kind is sphere",
    ),
    "turns without strips": (
        {**SETTINGS, "sample": {"kind": "cylinder", "strip_rows_px": [[0, 9]], "strip_turn_deg": [0.0, 90.0]}},
        "field sample: .*strip_turn_deg has 2 angles, but strip_rows_px has 1 strips",
    ),
    "rows backwards": (
        {**SETTINGS, "sample": {"kind": "cylinder", "strip_rows_px": [[9, 0]]}},
        "field sample: .*first row, last row",
    ),
    "strips overlap": (
        {**SETTINGS, "sample": {"kind": "cylinder", "strip_rows_px": [[0, 40], [60, 99], [40, 59]]}},
        r"the strips \[0, 40\] and \[40, 59\] of strip_rows_px overlap",
    ),
    "narrow strip": (
        {**SETTINGS, "sample": {"kind": "cylinder", "strip_rows_px": [[0, 9]]}},
        r"must have at least 12 rows, got \[0, 9\]",
    ),
    "not TOML": ("format = matcam capture", "not TOML"),
    "lamp inside": ({**SETTINGS, "distances": {"lamp_mm": 24}}, "field distances.lamp_mm: must exceed the radius"),
    "too many digits": ("format = 'matcam capture'\nversion = " + "9" * 900, "version 9999"),
    "a number that no float holds": ({**SETTINGS, "sample": {"radius_mm": 10**400}}, "must be finite"),
    "a key without end": ("a." * 30_000 + "a = 1", "line 1 has 60005 bytes"),
    "a name that is none": ({**SETTINGS, "camera": {"profile": "a\0.json"}}, "a name that is not plain text"),
    "infinite": ("format = 'matcam capture'\nversion = 1\n[sample]\nradius_mm = inf", "must be finite"),
}


@pytest.mark.parametrize(("settings", "message"), BAD_SETTINGS.values(), ids=BAD_SETTINGS)
def test_bad_settings_are_refused_by_name(tmp_path, settings, message):
    with pytest.raises(FileFormatError, match=message) as error:
        read_capture(write(tmp_path, settings))
    assert "\n" not in str(error.value)


BAD_ROWS = {
    "missing": (row("frames/none.tif", "L1", "20", "90", "E1", "0.01"), "none.tif: no such file", False),
    "outside": (row("frames/../../x.tif", "L1", "20", "90", "E1", "0.01"), "leads out of", False),
    "absolute": (row("/etc/x.tif", "L1", "20", "90", "E1", "0.01"), "leads out of", False),
    "the folder": (row(".", "L1", "20", "90", "E1", "0.01"), "file '.' has a name that is not", False),
    "elsewhere": (row("other/x.tif", "L1", "20", "90", "E1", "0.01"), "must lie in one of the folders", True),
    "twice": (ROWS[0], "a.tif: the file is listed twice", True),
    "angle": (row("frames/x.tif", "L3", "far", "0", "E1", "0.01"), "x.tif: angle_deg must be a number", True),
    "range": (row("frames/x.tif", "L3", "200", "0", "E1", "0.01"), "x.tif: angle_deg, from the axis", True),
    "no angle": (row("frames/x.tif", "L1", "nan", "90", "E3", "1"), "x.tif: angle_deg must be finite, got nan", True),
    "no azimuth": (
        row("frames/x.tif", "L3", "20", "NaN", "E1", "1"),
        "x.tif: azimuth_deg must be finite, got NaN",
        True,
    ),
    "no time": (
        row("frames/x.tif", "L3", "20", "0", "E1", "nan"),
        "x.tif: time_s must be finite and above 0, got nan",
        True,
    ),
    "time": (row("frames/x.tif", "L3", "20", "0", "E1", "-1"), "x.tif: time_s must be", True),
    "no lamp": (row("frames/x.tif", "", "20", "0", "E1", "1"), "x.tif: a frame must have a lamp", True),
    "lamp moved": (
        row("frames/x.tif", "L1", "25", "90", "E3", "1"),
        "x.tif: lamp L1 has a different position from that in an earlier line",
        True,
    ),
    "name": (row("frames/x.tif", "L 1;", "25", "90", "E3", "1"), "x.tif: lamp must consist of letters", True),
    "suffix": (row("frames/x.txt", "L1", "20", "90", "E3", "1"), "the suffix is not that of a supported image", True),
    "other time": (row("frames/x.tif", "L3", "25", "90", "E2", "1"), "x.tif: exposure E2 has 1 s here and 0.04", True),
}


@pytest.mark.parametrize(("bad", "message", "there"), BAD_ROWS.values(), ids=BAD_ROWS)
def test_bad_lines_are_listed_and_the_rest_is_used(tmp_path, bad, message, there):
    folder = write(tmp_path / "capture")
    if there:
        (folder / bad["file"]).parent.mkdir(exist_ok=True)
        write_tiff(folder / bad["file"], np.zeros((6, 8), np.uint16))
    write(folder, rows=[*ROWS, bad], frames=False)
    capture = read_capture(folder)
    assert {frame.file for frame in capture.frames} >= {one["file"] for one in ROWS}
    assert [message in str(problem) for problem in capture.problems].count(True) == 1
    assert all("\n" not in str(problem) for problem in capture.problems)


def test_an_empty_angle_is_that_of_another_line_of_the_lamp(tmp_path):
    angles = ("20", "", "20")
    rows = [row(f"frames/{n}.tif", "L1", angle, "90", f"E{n}", f"{n + 1}") for n, angle in enumerate(angles)]
    capture = read_capture(write(tmp_path, rows=rows))
    assert not capture.problems
    assert np.degrees(capture.lamps["L1"].angle) == pytest.approx(20)


def test_extra_pictures_are_named(tmp_path):
    folder = write(tmp_path)
    write_tiff(folder / "frames/extra.tif", np.zeros((6, 8), np.uint16))
    (problem,) = read_capture(folder).problems
    assert "extra.tif: the file is not listed" in str(problem)


def test_many_files_of_one_fault_are_one_remark(tmp_path):
    folder = write(tmp_path)
    for number in range(9):
        write_tiff(folder / f"frames/extra{number}.tif", np.zeros((6, 8), np.uint16))
    absent = [row(f"frames/none{number}.tif", "L1", "20", "90", "E1", "0.01") for number in range(17)]
    write(folder, rows=[*ROWS, *absent], frames=False)
    missing, extra = (str(problem) for problem in read_capture(folder).problems)
    assert "frames/none0.tif, frames/none1.tif" in missing
    assert "and 11 more: no such files" in missing
    assert "9 files are not listed" in extra
    assert "frames/extra0.tif" in extra


@pytest.mark.parametrize(
    ("azimuths", "exchanged"),
    [((20, 60), True), ((20, 200), False), ((90, 90), False), (("", 60), False)],
)
def test_angles_out_of_range_are_one_remark_which_names_exchanged_columns(tmp_path, azimuths, exchanged):
    frames = [row(f"frames/{k}{n}.tif", f"L{k}", "-0.2", azimuths[k], f"E{n}", "") for k in (0, 1) for n in range(4)]
    (problem,) = read_capture(
        write(tmp_path, rows=[row("frames/a.tif", "L3", "0.1", azimuths[1], "E1"), *frames])
    ).problems
    assert "must lie in [0, 180] degrees, got -0.2 (line 3 of frames.csv, the first of 8 such lines)" in str(problem)
    assert ("valid if angle_deg and azimuth_deg are exchanged" in str(problem)) == exchanged
    assert problem.code == ("table-exchanged" if exchanged else "bad-frame")


@pytest.mark.parametrize("what", ["frame", "folder", "list"])
def test_links_out_of_the_folder_are_not_followed(tmp_path, what):
    outside = write(tmp_path / "outside")
    folder = write(tmp_path / "capture")
    if what == "frame":
        (folder / "frames/a.tif").unlink()
        (folder / "frames/a.tif").symlink_to(outside / "frames/a.tif")
        assert "is a link to a file outside" in str(read_capture(folder).problems[0])
        return
    name = "frames" if what == "folder" else "frames.csv"
    (folder / name).rename(folder / "away")
    (folder / name).symlink_to(outside / name)
    with pytest.raises(FileFormatError, match=r"is a link to .*outside"):
        read_capture(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "first line must be file,lamp"),
        ("file,lamp\n", "first line must be"),
        (",".join(COLUMNS) + "\n", "no frame of the sample"),
        (",".join(COLUMNS) + "\nframes/a.tif,L1\n", "line 2 has 2 cells"),
        (",".join(COLUMNS) + '\n"frames/a.tif', "no frame|csv|line"),
        ('file,lamp,"angle\n_deg",azimuth_deg\n', "got file,lamp,angle _deg,azimuth_deg$"),
    ],
)
def test_a_list_without_any_frame_is_refused(tmp_path, text, message):
    folder = write(tmp_path)
    (folder / "frames.csv").write_text(text)
    with pytest.raises(FileFormatError, match=message) as error:
        read_capture(folder)
    assert "\n" not in str(error.value)


def test_no_folder_and_no_files(tmp_path):
    with pytest.raises(FileFormatError, match="no such folder"):
        read_capture(tmp_path / "none")
    with pytest.raises(FileFormatError, match=r"capture\.toml"):
        read_capture(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileFormatError, match="is not a folder"):
        read_capture(tmp_path / "file")


def test_the_published_schema_is_that_of_the_reader():
    published = json.loads((REPOSITORY / "docs/capture-v1.schema.json").read_text())
    assert published == json_schema(), "write docs/capture-v1.schema.json anew: matcam.files.capture.json_schema()"


def with_light(rows, *intensities):
    return [{**one, "intensity": light} for one, light in zip(rows, intensities, strict=True)]


def listed(folder, rows, **sections):
    """A capture whose list has a column more."""
    settings = {k: v for k, v in {**SETTINGS, **sections}.items() if v is not None}
    write(folder, settings)
    with (folder / "frames.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [*COLUMNS, "intensity"], restval="")
        writer.writeheader()
        writer.writerows(rows)
    return folder


TABLE = {"lamp": {"intensity": "table"}, "reference": None}


def test_the_lamps_light_may_be_a_table(tmp_path):
    capture = read_capture(listed(tmp_path, with_light(ROWS, "1.5 2 2.5", "1.5 2 2.5", "3", ""), **TABLE))
    assert capture.lamps["L1"].intensity == (1.5, 2.0, 2.5)
    assert capture.lamps["L2"].intensity == (3.0,)
    assert not capture.problems


@pytest.mark.parametrize(
    ("light", "sections", "words"),
    [
        (("1", "1", "", ""), TABLE, "gives no intensity of lamp L2"),
        (("1", "1", "2", ""), {"lamp": {"intensity": "constant"}}, "set lamp.intensity to 'table'"),
        (("1", "1", "2", ""), {"lamp": {"intensity": "table"}}, "delete this section"),
        (("", "", "", ""), {"reference": None}, "there is no .reference."),
    ],
)
def test_a_table_of_light_and_the_settings_agree(tmp_path, light, sections, words):
    with pytest.raises(FileFormatError, match=words):
        read_capture(listed(tmp_path, with_light(ROWS, *light), **sections))


@pytest.mark.parametrize("light", ["-1", "nan", "bright", "1 2", "0"])
def test_an_intensity_that_is_none(tmp_path, light):
    capture = read_capture(listed(tmp_path, with_light(ROWS, "2", "2", light, ""), **TABLE))
    (problem,) = capture.problems
    assert "intensity must be one or three positive numbers" in problem.text


def test_a_lamp_has_one_intensity(tmp_path):
    capture = read_capture(listed(tmp_path, with_light(ROWS, "2", "3", "1", ""), **TABLE))
    assert any("a different intensity" in problem.text for problem in capture.problems)


@pytest.mark.parametrize("box", ["[0, 0, 0, 0]", "[0, 0, 10, 0]"])
@pytest.mark.parametrize("table", ["sample", "reference"])
def test_a_region_without_pixels(tmp_path, table, box):
    text = 'format = "matcam capture"\nversion = 1\n'
    text += "[sample]\n" if table == "sample" else '[reference]\nkind = "monitor"\n'
    (tmp_path / "capture.toml").write_text(f"{text}region_px = {box}\n")
    with pytest.raises(FileFormatError, match=rf"field {table}\.region_px.*at least 1 px"):
        read_settings(tmp_path / "capture.toml")
