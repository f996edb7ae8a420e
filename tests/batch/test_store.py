"""A run's Zarr: labelled, lazy, whole where it says so, grown and mended by later runs."""

import functools
import itertools
import shutil
import time

import numpy as np
import pytest
import xarray as xr

from matcam import rigs
from matcam.batch.run import correct_all
from matcam.batch.store import open_rows, read_row, row_names, whole_rows
from matcam.core.errors import OutputError
from matcam.inverse.correction.corrected_table import TABLE_ATTRIBUTES
from matcam.io import read_netcdf
from tests.batch import simple
from tests.batch.tables import write_database
from tests.files.mutations import mutated, mutated_text, survives


def open_run(folder):
    return xr.open_zarr(folder / "run.zarr", consolidated=False)


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
def test_a_run_as_one_zarr(tmp_path, monkeypatch):
    simple.work_in_this_process(monkeypatch)
    database, out = write_database(tmp_path / "in", ["b"]), tmp_path / "out"
    again = lambda **how: correct_all([database], rigs.merl(), out, corrector=simple.brighter, **how)  # noqa: E731
    again(zarr=True)
    (database / "a-short.binary").write_bytes(b"short")
    again(zarr=True)  # grown
    with open_run(out) as stored:
        assert stored["material"].values.tolist() == ["b", "a-short"]
        assert stored["corrected"].values.tolist() == [True, False]
        assert stored["brdf"].dims == ("material", "theta_h", "theta_d", "phi_d", "channel")
        assert stored["brdf"].chunks[0] == (1, 1)  # Dask: nothing is read before it is asked for
        assert stored.attrs["sampling"] == "centre"
        one, row = read_netcdf(out / "b.nc"), stored.sel(material="b")
        for variable in ("brdf", "brdf_std", "supported", "response"):
            np.testing.assert_array_equal(row[variable].values, one[variable].values)
        for coordinate in ("theta_h", "theta_d", "phi_d", "channel"):
            np.testing.assert_array_equal(row[coordinate].values, one[coordinate].values)
        assert np.isnan(stored["brdf"].sel(material="a-short").values).all()
    shutil.rmtree(out / "run.zarr")
    assert again(zarr=True).corrected == ()  # asked for later, or lost: copied
    with open_run(out) as stored:
        assert stored["material"].values.tolist() == ["a-short", "b"]
        assert stored["corrected"].values.tolist() == [False, True]
        np.testing.assert_array_equal(stored["brdf_std"].sel(material="b").values, one["brdf_std"].values)
    shutil.rmtree(out / "run.zarr")
    (out / "run.zarr").write_text("mine")
    with pytest.raises(OutputError, match=r"run\.zarr"):
        again(zarr=True)
    assert (out / "run.zarr").read_text() == "mine"


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
@pytest.mark.parametrize("count", [60, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_damaged_store(tmp_path, count):
    """Descriptions and chunks in turn; a table, which takes half a second, is read of every hundredth."""
    store = tmp_path / "run.zarr"
    rows = open_rows(store, ["a", "b"], "centre")
    table = xr.Dataset({name: (("x",), np.zeros(1)) for name in TABLE_ATTRIBUTES})
    for name in table:
        table[name] = xr.DataArray(np.zeros((90, 90, 180, 3)), dims=[f"{name}{k}" for k in range(4)])
    rows["a"].write(table)
    assert read_row(store, 0)["brdf"].values.max() == 0
    number = itertools.count()

    def read(path):
        row_names(store)
        whole_rows(store)
        if next(number) % 100 == 0:
            read_row(store, 0)

    targets = [
        "zarr.json", "material/zarr.json", "material/c/0", "corrected/zarr.json", "corrected/c/0", "brdf/zarr.json",
        "brdf/c/0/0/0/0/0",
    ]  # fmt: skip
    for target in targets:
        path = store / target
        whole = path.read_bytes()
        change = mutated_text if target.endswith(".json") else functools.partial(mutated, header=len(whole))
        contents = change(whole, -(-count // len(targets)), seed=5)
        survives(read, path, contents, spare=512 << 20, clock=time.process_time, folder=store)
        path.write_bytes(whole)
    assert row_names(store) == ["a", "b"]


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
def test_a_response_of_each_colour(tmp_path):
    shape = (90, 90, 180, 3)
    values = np.broadcast_to(np.array([0.5, 0.6, 0.7]), shape)
    table = xr.Dataset(
        {name: (("a", "b", "c", "d"), values > 0.65 if name == "supported" else values) for name in TABLE_ATTRIBUTES}
    )
    open_rows(tmp_path / "run.zarr", ["a"], "centre")["a"].write(table)
    found = read_row(tmp_path / "run.zarr", 0)
    assert found["response"].dims == found["brdf"].dims
    np.testing.assert_array_equal(found["response"].values, values)
