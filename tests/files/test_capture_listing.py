"""A capture's list from a folder of photographs: lamp positions, exposures, times, and light position files."""

import numpy as np
import pytest
import tifffile

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.files.capture import read_capture
from matcam.files.capture_listing import list_photographs
from matcam.files.capture_writing import write_template
from matcam.files.light_positions import are_unit_vectors, read_light_positions
from matcam.files.picture_header import read_exif

CODES = np.arange(96, dtype=np.uint16).reshape(8, 12)


def shot(folder, name, time=None):
    """A TIFF whose Exif directory states the time; a TIFF's first directory may hold the tag, too."""
    folder.mkdir(parents=True, exist_ok=True)
    tags = [] if time is None else [(0x829A, 5, 1, (round(1e6 * time), 1_000_000), True)]
    tifffile.imwrite(folder / name, CODES, photometric="minisblack", extratags=tags)


def rows(listing, kind="frames"):
    return [
        (row["file"], row["lamp"], row["exposure"], row["time_s"])
        for row in listing.rows
        if row["file"].startswith(kind)
    ]


def test_exposure_time_is_read(tmp_path):
    shot(tmp_path, "a.tif", 0.004)
    shot(tmp_path, "b.tif")
    assert read_exif(tmp_path / "a.tif").time == pytest.approx(0.004)
    assert read_exif(tmp_path / "b.tif").time is None
    assert read_exif(tmp_path / "none.tif").time is None


def test_brackets_are_told_by_times_that_repeat(tmp_path):
    for number in range(1, 7):
        shot(tmp_path, f"IMG_{number}.tif", (0.001, 0.004, 0.016)[(number - 1) % 3])
    shot(tmp_path / "dark", "d.tif", 0.0041)
    (tmp_path / "notes.txt").write_text("none")
    listing = list_photographs(tmp_path)
    assert rows(listing)[2:5] == [
        ("frames/IMG_3.tif", "L01", "E3", "0.016"),
        ("frames/IMG_4.tif", "L02", "E1", "0.001"),
        ("frames/IMG_5.tif", "L02", "E2", "0.004"),
    ]
    assert rows(listing, "dark") == [("dark/d.tif", "", "E2", "0.004")]
    assert any("notes.txt" in note for note in listing.notes)
    listing.copy_to(tmp_path / "new")
    write_template(tmp_path / "new", listing.rows)
    capture = read_capture(tmp_path / "new")
    assert capture.problems == ()
    assert (len(capture.lamps), capture.exposures) == (2, ["E1", "E2", "E3"])


def test_brackets_are_told_by_names(tmp_path):
    for lamp in ("left", "right"):
        for exposure in ("E1", "E2"):
            shot(tmp_path, f"{lamp}_{exposure}.tif")
    shot(tmp_path / "dark", "covered_E2.tif")
    assert rows(list_photographs(tmp_path), "dark")[0][2] == "E2"
    assert [row[1:3] for row in rows(list_photographs(tmp_path))] == [
        ("left", "E1"), ("left", "E2"), ("right", "E1"), ("right", "E2"),
    ]  # fmt: skip


def test_one_photograph_a_lamp_is_the_rest(tmp_path):
    for number in (1, 2, 10):
        shot(tmp_path, f"chrome.{number}.tif")
    assert [row[:3] for row in rows(list_photographs(tmp_path))] == [
        (f"frames/chrome.{number}.tif", f"L{k:02d}", "E1") for k, number in enumerate((1, 2, 10), 1)
    ]
    with pytest.raises(ArgumentError, match="contains no photograph"):
        list_photographs(tmp_path / "..")
    with pytest.raises(FileFormatError, match="no such folder"):
        list_photographs(tmp_path / "none")


def test_light_positions_are_the_lamp_table(tmp_path):
    """Names with blanks and folders, another suffix than the photographs', positions in their own unit."""
    for number in (1, 2):
        shot(tmp_path, f"my ball {number}.tif")
    (tmp_path / "lamps.lp").write_text(
        "2\nC:\\rti\\my ball 1.jpg 2.0 0.0 2.0\nmy ball 2.JPG 0.0 -3.0 0.0\n\n", encoding="utf-8"
    )
    listing = list_photographs(tmp_path)
    assert [(row["lamp"], row["angle_deg"], row["azimuth_deg"]) for row in listing.rows] == [
        ("L01", "45.0000", "0.0000"), ("L02", "90.0000", "-90.0000"),
    ]  # fmt: skip
    assert any("distances.lamp_mm" in note for note in listing.notes)
    positions = read_light_positions(tmp_path / "lamps.lp")
    assert positions[0].angles == pytest.approx((np.pi / 4, 0.0))
    assert not are_unit_vectors(positions)


def test_a_table_that_names_one_photograph_of_a_bracket_is_enough(tmp_path):
    for name in ("a_1.tif", "a_2.tif", "b_1.tif", "b_2.tif"):
        shot(tmp_path, name)
    (tmp_path / "lamps.lp").write_text("2\na_1.tif 0 0 1\nb_1.tif 1 0 0\n")
    found = [(row["lamp"], row["exposure"], row["angle_deg"]) for row in list_photographs(tmp_path).rows]
    assert found == [("a", "1", "0.0000"), ("a", "2", "0.0000"), ("b", "1", "90.0000"), ("b", "2", "90.0000")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got 'nothing'"),
        ("a 0 0 1\n", "must be the number of photographs"),
        ("2\na 0 0 1\n", "specifies 2 photographs, but 1 lines follow"),
        ("1\na 0 0 up\n", "line 2 must be a file name"),
        ("1\na 0 0\n", "line 2 must be a file name"),
        ("1\na 0 0 0\n", "line 2 must be a file name"),
        ("1\na 0 0 nan\n", "line 2 must be a file name"),
    ],
)
def test_wrong_light_positions_are_refused_by_line(tmp_path, text, message):
    (tmp_path / "a.lp").write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_light_positions(tmp_path / "a.lp")
