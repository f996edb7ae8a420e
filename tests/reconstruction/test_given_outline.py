"""The outline that a capture gives: frames before a bright field of any kind, a mask, a stated circle."""

import numpy as np
import pytest

from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.outline import Sighting
from matcam.core.errors import FileFormatError
from matcam.files.capture import read_capture
from matcam.reconstruction.stated.captured_scene import INCOMPLETE
from matcam.reconstruction.stated.outline_frames import found_outline
from tests.acquisition.drawn import VIEW, changed, surface
from tests.oracle.capture import Sensor, draw, write_tiff
from tests.oracle.sphere_picture import backlit

SIGHTING = Sighting(VIEW.camera)
FRAME = VIEW.shape[::-1]


@pytest.fixture(scope="module")
def drawn():
    sensor = Sensor(cfa=None)
    return draw(surface(), VIEW, np.radians([10, 35]), exposures=1, seed=4, outlines=1, reference=None, sensor=sensor)


def given(drawn, folder, codes=None, outline=None, mask=None):
    """Outline, part of the frames and remarks of a capture with another outline frame, other statements or a mask."""
    frames = dict(drawn.frames)
    if codes is not None:
        frames["outline/O0.tif"] = np.round(codes).clip(0, 65535).astype(np.uint16)
    capture = changed(drawn, frames=frames, settings={**drawn.settings, "outline": outline or {}})
    capture.write(folder)
    if mask is not None:
        write_tiff(folder / "mask.tif", mask)
    remarks = []
    return *found_outline(read_capture(folder), SIGHTING, VIEW.sigma, FRAME, remarks), remarks


def misses(outline):
    """Errors over standard deviations of column, row and radius."""
    row, column, radius = (outline.row - VIEW.row, outline.column - VIEW.column, outline.radius - VIEW.radius)
    return np.abs([row, column, radius]) / outline.std


def test_a_field_of_one_code_is_an_outline_frame(drawn, tmp_path):
    """Without noise every pixel of the field reads the same; NumPy warned of empty slices, and the frame was refused."""
    outline, region, remarks = given(drawn, tmp_path, 256 + 9000 * backlit(VIEW, np.radians(3), surface()))
    assert remarks == []
    assert abs(outline.radius - VIEW.radius) < 0.01
    assert (misses(outline) < 4).all()
    assert region[2] < VIEW.shape[1]


@pytest.mark.parametrize("brightness", [1.3, 2.0, 10.0])
def test_a_clipped_field_is_used_with_the_error_that_this_makes(drawn, tmp_path, brightness):
    rng = np.random.default_rng(1)
    electrons = rng.poisson(brightness * 30000 * backlit(VIEW, np.radians(3), surface()))
    codes = np.minimum(256 + 0.5 * electrons + 1.5 * rng.standard_normal(VIEW.shape), 15256)
    outline, _, remarks = given(drawn, tmp_path, codes)
    assert [one.code for one in remarks] == ["outline-clipped"]
    assert 0.2 < outline.std[2] < 0.8
    assert misses(outline)[2] < 2


@pytest.mark.parametrize("values", [(0, 255), (255, 0), (0, 1)])
def test_a_mask_is_an_outline(drawn, tmp_path, values):
    """Of 8 bits, bright or dark inside."""
    row, column = np.indices(VIEW.shape)
    inside = np.hypot(row - VIEW.row, column - VIEW.column) < VIEW.radius
    mask = np.where(inside, values[1], values[0]).astype(np.uint8)
    outline, region, remarks = given(drawn, tmp_path, outline={"mask": "mask.tif", "mask_std_px": 0.3}, mask=mask)
    assert remarks == []
    assert abs(outline.radius - VIEW.radius) < 0.05
    assert np.hypot(outline.row - VIEW.row, outline.column - VIEW.column) < 0.05
    np.testing.assert_allclose(outline.std, [0.15, 0.15, 0.3])
    assert region[2] < VIEW.shape[1]


def test_a_stated_circle_is_an_outline(drawn, tmp_path):
    stated = {"centre_px": [VIEW.column + 0.4, VIEW.row - 0.3], "radius_px": [VIEW.radius + 0.5, 0.6]}
    outline, _, remarks = given(drawn, tmp_path, outline=stated)
    assert (outline.column, outline.row, outline.radius) == (*stated["centre_px"], VIEW.radius + 0.5)
    np.testing.assert_allclose(outline.std, 0.6)
    assert remarks == []


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (None, "no such file"),
        (np.zeros((50, 60), np.uint8), "has 60 x 50 px, but the frames have 220 x 220"),
        (np.zeros(VIEW.shape, np.uint8), "shows no disc"),
        (np.kron([[0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]], np.ones((55, 73))).astype(np.uint8), "has 219"),
        (np.pad(np.ones((100, 100), np.uint8), 60), "the shape in the mask is not a disc"),
    ],
)
def test_what_is_no_mask_is_left_out_and_named(drawn, tmp_path, mask, words):
    """The outline frame is used in its place, and the capture is not complete."""
    outline, _, remarks = given(drawn, tmp_path, outline={"mask": "mask.tif"}, mask=mask)
    assert abs(outline.radius - VIEW.radius) < 0.1
    assert [one.code for one in remarks] == ["outline-left-out"]
    assert words in remarks[0].text
    assert remarks[0].code in INCOMPLETE


def test_an_outline_frame_without_a_sphere_is_left_out_with_its_true_reason(drawn, tmp_path):
    outline, region, remarks = given(drawn, tmp_path, np.full(VIEW.shape, 9000.0))
    assert outline is None
    assert region is None
    assert "no sphere dark in front of a bright field is visible" in remarks[0].text


@pytest.mark.parametrize(
    ("outline", "mask", "codes"),
    [
        ({}, False, {"no-outline"}),
        ({"mask": "mask.tif"}, True, set()),
        ({"mask": "mask.tif"}, False, {"no-outline", "outline-left-out"}),
        ({"centre_px": [VIEW.column, VIEW.row], "radius_px": 70.0}, False, set()),
    ],
)
def test_check_takes_what_reconstruct_takes(drawn, tmp_path, outline, mask, codes):
    rows = [row for row in drawn.rows if not row["file"].startswith("outline")]
    folder = changed(drawn, rows=rows, settings={**drawn.settings, "outline": outline}).write(tmp_path)
    if mask:
        row, column = np.indices(VIEW.shape)
        write_tiff(folder / "mask.tif", 255 * (np.hypot(row - 110, column - 110) < 70).astype(np.uint8))
    found = {one.code for one in check_capture(read_capture(folder)).findings}
    assert found & {"no-outline", "outline-left-out"} == codes


def test_check_finds_a_clipped_field(drawn, tmp_path):
    bright = drawn.frames["outline/O0.tif"].astype(int) * 2
    folder = changed(drawn, frames={**drawn.frames, "outline/O0.tif": np.minimum(bright, 15256).astype(np.uint16)})
    found = {one.code for one in check_capture(read_capture(folder.write(tmp_path))).findings}
    assert "outline-clipped" in found
    assert "outline-clipped" not in {one.code for one in check_capture(read_capture(drawn.write(tmp_path))).findings}


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        ({"centre_px": [1.0, 2.0]}, "give both or neither"),
        ({"mask": "../mask.png"}, "leads out of the capture's folder"),
        ({"centre_px": [1.0, 2.0], "radius_px": [0.0, 1.0]}, "radius_px"),
    ],
)
def test_wrong_statements_are_refused(drawn, tmp_path, outline, words):
    folder = changed(drawn, settings={**drawn.settings, "outline": outline}).write(tmp_path)
    with pytest.raises(FileFormatError, match=words):
        read_capture(folder)
