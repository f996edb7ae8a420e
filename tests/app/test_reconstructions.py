"""What `matcam reconstruct` writes opens with its pictures; photographs are read only from a capture that the user opened."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr

from matcam.app.exploring.explored import slice_of
from matcam.app.exploring.fitted_pictures import fitted_pictures, is_capture, opened_captures, shots_of
from matcam.app.exploring.opened import entries_of
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import brdf_table, merl_grid
from matcam.files.datasets import write_netcdf
from tests.app.browsing import BOXES, faults
from tests.app.conftest import running
from tests.app.test_browser import SIZES, message, opened

GRID = merl_grid("centre")
NAMES, SIDE = ("L00", "L01"), 33
PLACES = {
    "window_left": (30.0, 44.0), "window_top": (20.0, 21.0), "outline_column": (50.2, 50.3), "outline_row": (48.1, 48.0),
    "outline_radius": (40.5, 40.5), "highlight_column": (46.0, 60.0), "highlight_row": (36.0, 37.0),
    "picture_theta_d": (0.2, 0.5),
}  # fmt: skip


def windows():
    """The part of a reconstruction's file that holds its pictures, written out here."""
    recorded = np.arange(2 * SIDE * SIDE, dtype=np.float32).reshape(2, SIDE, SIDE)
    dims = ("picture", "window_row", "window_column")
    data = {"window_recorded": (dims, recorded), "window_fitted": (dims, recorded + 1)}
    data["window_residual"] = (dims, np.full_like(recorded, -0.5))
    data |= {name: ("picture", np.array(values)) for name, values in PLACES.items()}
    return xr.Dataset({**data, "picture_name": ("picture", np.array(NAMES, dtype=object))})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A capture of two lamp positions, and beside it what `reconstruct` would have written."""
    folder = tmp_path_factory.mktemp("rig")
    shots = folder / "shots"
    (shots / "frames").mkdir(parents=True)
    (shots / "capture.toml").write_text('format = "matcam capture"\nversion = 1\n')
    lines = ["file,lamp,angle_deg,azimuth_deg,exposure,time_s"]
    for k, lamp in enumerate(NAMES):
        for name, time in (("E0", 0.01), ("E1", 0.1)):
            light = np.full((100, 104), 50 + k, np.uint16)
            light[40:44, 60:64] = int(20000 * time)
            tifffile.imwrite(shots / "frames" / f"{lamp}_{name}.tif", light)
            lines.append(f"frames/{lamp}_{name}.tif,{lamp},10,0,{name},{time}")
    (shots / "frames.csv").write_text("\n".join(lines) + "\n")
    values = np.full((90, 90, 180, 3), 2.0)
    data = brdf_table(values, "centre").to_dataset(name="brdf")
    pinhole = np.full(values.shape, np.nan)
    pinhole[3, 30, [10, 20], 1] = 1.0, 2.0  # few cells hold a pixel
    data["brdf_std"], data["supported"] = data["brdf"] * 0 + 0.1, data["brdf"] > 1
    data["pinhole"] = brdf_table(pinhole, "centre")
    write_netcdf(folder / "chrome.nc", data.merge(windows()))
    (folder / "chrome.json").write_text(
        json.dumps({"format": "matcam reconstruction", "parameters": {"alpha": [0.02, 1e-4]}})
    )
    return folder


def test_a_result_opens_with_its_pictures(folder):
    (by_record,), (by_data,) = entries_of(folder / "chrome.json"), entries_of(folder / "chrome.nc")
    assert (by_record.label, by_data.label) == ("chrome · alpha 0.02", "chrome.nc")
    table = by_data.read()
    assert [one.name for one in table.pictures] == list(NAMES)
    second = table.pictures[1]
    assert second.outline == (50.3, 48.0, 40.5)
    assert (second.highlight, second.corner, second.theta_d) == ((60.0, 37.0), (44.0, 21.0), 0.5)
    assert second.windows["window_recorded"][2, 3] == SIDE * SIDE + 2 * SIDE + 3
    assert (second.windows["window_residual"] == -0.5).all()
    shown = slice_of(table, float(GRID.theta_d[30]), 1)
    assert shown["recorded"][3] == 1.5  # the mean over phi_d of the cells that hold a pixel
    assert np.isfinite(shown["recorded"]).sum() == 1


def test_photographs_are_those_of_the_opened_capture(folder):
    shots = folder / "shots"
    assert is_capture(shots)
    assert entries_of(shots) == []
    captures, failures = opened_captures([folder / "chrome.nc", shots])
    assert failures == []
    first = fitted_pictures("chrome.nc", windows())[0]
    found = shots_of(first, captures)
    assert [shot.label for shot in found] == ["frames/L00_E1.tif", "frames/L00_E0.tif"]
    values, (left, top, width, height) = found[0].about(first.outline)
    y, x = np.unravel_index(values.argmax(), values.shape)
    assert (x + left + 0.5, y + top + 0.5) == (60, 40)  # where the highlight was drawn
    assert left < 50.2 - 40.5
    assert left + width > 50.2 + 40.5
    assert top < 48.1 - 40.5
    assert top + height > 48.1 + 40.5


def test_no_photograph_is_read_that_was_not_opened(folder, monkeypatch):
    """A result beside a capture gives no right to the capture."""
    captures, _ = opened_captures([folder / "chrome.nc"])
    assert captures == []
    monkeypatch.setattr("matcam.files.capture.open_photograph", lambda *_: pytest.fail("read without being opened"))
    with pytest.raises(ArgumentError, match="give the folder of the capture"):
        shots_of(fitted_pictures("chrome.nc", windows())[0], captures)


def test_photographs_that_have_gone_are_one_line(folder, tmp_path):
    import shutil

    moved = tmp_path / "moved"
    shutil.copytree(folder / "shots", moved)
    (capture,), _ = opened_captures([moved])
    picture = fitted_pictures("chrome.nc", windows())[0]
    (shot, _) = shots_of(picture, [capture])
    (moved / "frames" / "L00_E1.tif").unlink()
    with pytest.raises(FileFormatError, match=r"L00_E1\.tif") as error:
        shot.about(picture.outline)
    assert "\n" not in str(error.value)
    other = fitted_pictures("chrome.nc", windows().assign(picture_name=("picture", ["X", "Y"])))[0]
    with pytest.raises(FileFormatError, match="no photograph of lamp position X"):
        shots_of(other, [capture])
    with pytest.raises(FileFormatError, match="does not contain the fitted outline"):
        shots_of(picture, [capture])[1].about((500.0, 500.0, 40.0))


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.drop_vars("outline_row"),
        lambda data: data.assign(
            window_fitted=data["window_fitted"].isel(window_row=slice(5)).rename(window_row="short")
        ),
        lambda data: data.assign(outline_radius=("picture", [np.nan, 1.0])),
        lambda data: data.isel(picture=slice(0)),
    ],
)
def test_damaged_pictures_are_one_line(change):
    with pytest.raises(FileFormatError, match=r"^a\.nc: the images in the file are damaged: ") as error:
        fitted_pictures("a.nc", change(windows()))
    assert "\n" not in str(error.value)


def test_links_beside_a_result_are_refused(folder, tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "a.json").write_text("{}")
    (tmp_path / "inner" / "a.nc").symlink_to(folder / "chrome.nc")
    with pytest.raises(FileFormatError, match="link"):
        entries_of(tmp_path / "inner" / "a.json")


SHOT = "Bokeh.documents[0].get_model_by_name('shot-image').data"


@pytest.mark.slow
def test_overlays_stand_in_the_page(chromium, folder):
    for files in ((folder / "chrome.nc",), (folder / "shots", folder / "chrome.nc")):
        with running(*files) as app, opened(chromium, app) as page:
            page.wait_for_function("Bokeh.documents[0].get_model_by_name('looked-at').visible", timeout=60_000)
            page.get_by_role("button", name="photographs").click()
            page.wait_for_function(
                "Bokeh.documents[0].get_model_by_name('fitted-outline').data.x.length", timeout=60_000
            )
            outline = page.evaluate("Bokeh.documents[0].get_model_by_name('fitted-outline').data")
            assert [outline[key][0] for key in ("x", "y", "radius")] == [50.2, 48.1, 40.5]
            if len(files) == 1:
                page.wait_for_timeout(500)
                assert "the photographs are not open" in message(page)
                assert page.evaluate(f"{SHOT}.image.length") == 0
                continue
            page.wait_for_function(f"{SHOT}.image.length", timeout=60_000)
            assert message(page) == ""
            for size in SIZES:
                page.set_viewport_size({"width": size[0], "height": size[1]})
                page.wait_for_timeout(400)
                assert faults(page.evaluate(BOXES), size[0]) == []
            # the other lamp position by the keyboard alone
            page.get_by_label("lamp position").focus()
            page.keyboard.press("ArrowDown")
            page.wait_for_function("Bokeh.documents[0].get_model_by_name('fitted-outline').data.x[0] === 50.3")
            (folder / "shots" / "frames" / "L01_E0.tif").unlink()
            page.evaluate("Bokeh.documents[0].get_model_by_name('shot').value = '1'")
            page.wait_for_function("Bokeh.documents[0].get_model_by_name('message').text.includes('L01_E0.tif')")
