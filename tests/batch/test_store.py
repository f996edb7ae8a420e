"""A run's Zarr: labelled, lazy, whole where it says so, grown and mended by later runs."""

import shutil

import numpy as np
import pytest
import xarray as xr

from matcam import rigs
from matcam.batch.run import correct_all
from matcam.core.errors import OutputError
from matcam.io import read_netcdf
from tests.batch import simple
from tests.batch.tables import write_database


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
