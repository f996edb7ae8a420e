"""What the explore view shows is what the files hold."""

import json
import os
import resource
import time

import numpy as np
import pytest

from matcam.app.exploring.explored import as_csv, as_exr, as_pbrt, fresnel_of, on_screen, range_of, slice_of, sphere_of
from matcam.app.exploring.opened import OpenedTable, entries_of, read_opened
from matcam.app.transfers import safe_name
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import brdf_table, merl_grid
from matcam.files.datasets import write_netcdf
from matcam.files.merl import write_merl

GRID = merl_grid("centre")


@pytest.fixture(scope="module")
def table():
    """A lobe that is a known function of the angles."""
    theta_h, theta_d = GRID.theta_h[:, None, None, None], GRID.theta_d[None, :, None, None]
    values = 5 * np.exp(-((theta_h / 0.1) ** 2)) / np.cos(theta_d) ** 2 + 0.01 + np.zeros((90, 90, 180, 3))
    return brdf_table(values * [1.0, 0.5, 0.25], "centre")


@pytest.fixture(scope="module")
def corrected(table):
    """A corrected table, as `correct` writes it, of which the recorded one is known."""
    response = np.clip(np.cos(GRID.theta_d), 0.1, 1)[:, None, None] * np.ones(table.shape)
    after = table.values / response
    camera, noise = 0.03 * table.values, 0.01 * after
    data = table.to_dataset(name="brdf")
    data["brdf"] = table.copy(data=after)
    data["brdf_std"] = table.copy(data=np.hypot(camera, noise))
    data["correction_std"] = table.copy(data=camera / table.values)
    data["noise_std"] = table.copy(data=noise)
    data["supported"] = table.copy(data=camera < 0.05 * after)
    data["response"] = table.copy(data=response)
    return data


def test_recorded_is_found_in_a_correction(table, corrected):
    from matcam.inverse.correction.corrected_table import recorded_table

    np.testing.assert_allclose(recorded_table(corrected), table, rtol=1e-9)


def test_files_open_and_slices_are_theirs(tmp_path, table, corrected):
    write_merl(tmp_path / "a.binary", table)
    write_netcdf(tmp_path / "b.nc", corrected)
    (first,), (second,) = entries_of(tmp_path / "a.binary"), entries_of(tmp_path / "b.nc")
    plain, both = first.read(), second.read()
    assert plain.corrected is None
    j = 30
    shown = slice_of(both, float(GRID.theta_d[j]), 1)
    np.testing.assert_allclose(shown["theta_h"], np.degrees(GRID.theta_h))
    np.testing.assert_allclose(shown["recorded"], table.values[:, j, 90, 1], rtol=1e-6)
    np.testing.assert_allclose(shown["corrected"], corrected["brdf"].values[:, j, 90, 1], rtol=1e-6)
    np.testing.assert_allclose(shown["high"] - shown["corrected"], corrected["brdf_std"].values[:, j, 90, 1], rtol=1e-5)
    known = corrected["supported"].values[:, j, 90, 1]
    assert (np.isfinite(shown["supported"]) == known).all()
    assert (np.isfinite(shown["unsupported"]) == ~known).all()
    np.testing.assert_allclose(slice_of(plain, float(GRID.theta_d[j]), 1)["recorded"], shown["recorded"], rtol=1e-6)
    low, high = range_of(shown)
    assert low < np.nanmin(shown["recorded"]) < np.nanmax(shown["corrected"]) < high


def test_the_peaks_make_the_fresnel_term(table):
    """The lobe was made as exp / cos^2, so that its term is 1 at every angle."""
    term = fresnel_of(OpenedTable("a", recorded=table), 0)
    below = term["theta_d"] < 80
    np.testing.assert_allclose(term["recorded"][below], 1, atol=0.02)
    assert np.isnan(term["corrected"]).all()


def test_a_legend_has_no_entry_without_data():
    """The browser draws no symbol for such an entry."""
    from matcam.app.plots import curve_figure, empty_source, follow_data

    plot, sources = curve_figure("a", "x [px]", "y [px]", height=200), [empty_source(name, "x", "y") for name in "ab"]
    for source in sources:
        plot.line("x", "y", source=source, legend_label=source.name)
    follow_data(plot)
    for full in ([], ["b"], ["a", "b"]):
        for source in sources:
            source.data = {"x": [0.0], "y": [0.0 if source.name in full else np.nan]}
        assert [item.label.value for item in plot.legend.items if item.visible] == full


def test_the_lamp_moves_the_highlight(table):
    size = 101
    for lamp, azimuth in ((0.0, 0.0), (1.0, 0.0), (1.0, np.pi / 2), (1.6, np.pi)):
        light = sphere_of(table, lamp, azimuth, size)[..., 0]
        y, x = np.unravel_index(light.argmax(), light.shape)
        at = np.array([x - size // 2, size // 2 - y]) / (size / 2)
        expected = np.sin(lamp / 2) * np.array([np.cos(azimuth), np.sin(azimuth)])
        np.testing.assert_allclose(at, expected, atol=0.06)
    assert on_screen(sphere_of(table, 1.0, 0.0, size), 0.0).shape == (size, size)


def test_exports_hold_what_is_shown(tmp_path, table):
    from matcam.files.float_pictures import read_exr

    shown = slice_of(OpenedTable("a", recorded=table), 0.5, 0)
    lines = as_csv(shown, "theta_h").decode().splitlines()
    first = [line for line in lines if not line.startswith("#")]
    assert len(first) == 91
    light = sphere_of(table, 1.0, 0.0, 32)
    (tmp_path / "a.exr").write_bytes(as_exr(light))
    np.testing.assert_allclose(read_exr(tmp_path / "a.exr"), light, rtol=1e-6)
    with pytest.raises(ArgumentError, match="no such fit"):
        as_pbrt(OpenedTable("a", recorded=table))
    names = {
        "alpha": 0.05,
        **{f"{name}[{c}]": at for c in "RGB" for name, at in (("n", 1.5), ("k", 3.0))},
    }  # as `fit` names them
    text = as_pbrt(OpenedTable("a", recorded=table, record={"fit": {"ndf": "ggx", "params": names}})).decode()
    assert "conductor" in text
    assert text.count("1.5") >= 3


def test_a_run_of_1000_opens_soon_and_lazily(tmp_path):
    """No table is read before it is looked at: these are not even tables."""
    record = {"fit": {"ndf": "ggx", "params": {"alpha": 0.01}}, "supported_share": 0.8, "filling": list(range(3000))}
    (tmp_path / "m0000.nc").write_bytes(b"nothing yet")
    (tmp_path / "m0000.json").write_text(json.dumps(record))
    for i in range(1, 1000):
        for suffix in (".nc", ".json"):
            os.link(tmp_path / f"m0000{suffix}", tmp_path / f"m{i:04d}{suffix}")
    (tmp_path / "settings.json").write_text("{}")
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    entries = entries_of(tmp_path)
    assert time.process_time() - start < 3  # of the processor: what else runs is not judged
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000  # kB
    assert len(entries) == 1000
    assert entries[7].label == "m0007 · alpha 0.01 · 80% of its values supported"
    with pytest.raises(FileFormatError, match="not a NetCDF"):
        entries[7].read()


def test_links_in_a_run_are_refused(tmp_path, table):
    (tmp_path / "run").mkdir()
    (tmp_path / "outside.nc").write_bytes(b"secret")
    (tmp_path / "run" / "a.json").write_text("{}")
    (tmp_path / "run" / "a.nc").symlink_to(tmp_path / "outside.nc")
    with pytest.raises(FileFormatError, match="outside"):
        entries_of(tmp_path / "run")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match="no record of a run"):
        entries_of(tmp_path / "empty")


def test_a_runs_zarr_is_read_by_row(tmp_path, corrected):
    pytest.importorskip("zarr")
    from matcam.batch.store import open_rows

    rows = open_rows(tmp_path / "run.zarr", ["a", "b"], "centre")
    rows["b"].write(corrected)
    first, second = entries_of(tmp_path / "run.zarr")
    assert (first.label, second.label) == ("a", "b")
    np.testing.assert_array_equal(second.read().corrected, corrected["brdf"])
    with pytest.raises(FileFormatError, match="is incomplete"):
        first.read()


def test_other_things_are_refused_in_one_line(tmp_path):
    (tmp_path / "camera.txt").write_text("no table")
    with pytest.raises((ArgumentError, FileFormatError)) as error:
        read_opened(tmp_path / "camera.txt")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("../../etc/passwd", "passwd"),
        ("a\\b.nc", "b.nc"),
        ("..", "file"),
        ("x<b>.exr", "x_b_.exr"),
        ("ä b.nc", "ä b.nc"),
    ],
)
def test_a_dropped_files_name_is_only_a_name(name, safe):
    assert safe_name(name) == safe
