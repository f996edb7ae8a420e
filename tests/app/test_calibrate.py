"""What the calibrate view measures and saves is what the commands print and write."""

import json

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from matcam.app.calibrated import calibrated, edges_in, measured_edge, open_picture, profiles
from matcam.app.transfers import worded
from matcam.cli.app import app
from matcam.core.errors import FileFormatError


def edge_picture(path, size=96):
    """A slanted edge under a Gaussian blur, 16 bits, linear."""
    from scipy.special import ndtr

    y, x = np.mgrid[:size, :size] - size / 2
    light = 0.1 + 0.7 * ndtr((x * np.cos(0.1) + y * np.sin(0.1)) / 0.7)
    noise = np.random.default_rng(1).normal(0, 0.003, light.shape)
    tifffile.imwrite(path, np.clip((light + noise) * 65535, 0, 65535).astype(np.uint16))
    return path


def test_a_picture_says_what_it_is(tmp_path):
    picture = open_picture(edge_picture(tmp_path / "edge.tif"))
    assert picture.about == "edge.tif: 96 x 96 px, grey, codes of 16 bits"
    assert picture.size == (96, 96)
    assert picture.shown.min() == 0
    assert picture.shown.max() == 1
    assert picture.shown[50, 0] < 0.2 < 0.8 < picture.shown[50, 95]


def test_more_pixels_than_can_be_shown_are_refused(tmp_path, monkeypatch):
    from matcam.app import calibrated

    monkeypatch.setattr(calibrated, "_LARGEST", 5000)
    with pytest.raises(FileFormatError, match=r"edge.tif: the image has 0 megapixels"):
        open_picture(edge_picture(tmp_path / "edge.tif"))


def test_messages_name_neither_options_nor_temporary_folders():
    text = "/tmp/matcam-app-x1_y/2/a b.tif: 8 bits: specify the tone curve (--tone)"
    assert worded(text) == "a b.tif: 8 bits: specify the tone curve"


@pytest.mark.slow
def test_an_edges_numbers_are_the_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    edge_picture(tmp_path / "edge.tif")
    result = CliRunner().invoke(app, ["edge", "edge.tif", "--roi", "10", "10", "76", "76", "--json"])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    found = measured_edge(open_picture(tmp_path / "edge.tif"), (10, 10, 76, 76), "auto", 0.5)
    assert (float(found.mtf50), float(found.mtf50_std)) == (said["mtf50_cycles_per_px"], said["mtf50_std"])


@pytest.mark.slow
def test_the_profile_is_the_commands(real_data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = real_data / "edges" / "chart_squares.png"
    result = CliRunner().invoke(app, ["calibrate", str(path), "-o", "camera.json"])
    assert result.exit_code == 0, result.output
    found = calibrated([path], "gaussian", "auto", 0.5)
    saved = profiles(found)
    assert saved["camera.json"] == (tmp_path / "camera.json").read_bytes()
    columns = edges_in(found, open_picture(path))
    assert len(columns["x"]) == found.channels[found.channel].edges.x.size > 8
    np.testing.assert_allclose(np.hypot(columns["x1"] - columns["x0"], columns["y1"] - columns["y0"]), 40)


class _AtOnce:
    """Queue that does each job when it is requested."""

    def __init__(self, document, complain):
        pass

    def ask(self, work, show):
        show(work())

    def close(self):
        pass


def test_results_of_other_settings_are_removed(tmp_path, monkeypatch):
    from bokeh.document import Document
    from bokeh.events import ButtonClick

    from matcam.app import calibrate_view
    from matcam.app.transfers import Downloads

    monkeypatch.setattr(calibrate_view, "Newest", _AtOnce)
    document, complaints = Document(), []
    files = [edge_picture(tmp_path / name) for name in ("a.tif", "b.tif")]
    view = calibrate_view.CalibrateView(document, Downloads(), complaints.append, files)
    document.add_root(view.layout)
    view.start()
    result, saved, curves, measure, picture = (
        document.get_model_by_name(name) for name in ("result", "profiles", "mtf", "measure", "picture")
    )

    def change(attribute, value):
        measure._trigger_event(ButtonClick(measure))
        saved.text = "save the profile: camera.json"
        assert "MTF50" in result.text
        assert len(curves.data["mtf"])
        document.select_one({"title": attribute}).value = value
        assert result.text == ""
        assert [len(column) for column in curves.data.values()] == [0] * 5

    for title, value in (("tone curve", "linear"), ("lens", "halo"), ("pixel half width [px]", 0.3)):
        change(title, value)
        assert saved.text == ""
    change("image", "0")
    assert saved.text  # the calibration of all images is that of the image shown, too
    assert picture.options == [("0", "a.tif"), ("1", "b.tif")]
    assert set(complaints) <= {""}
    view.close()
