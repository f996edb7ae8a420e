"""Results as CSV and NetCDF say what they said in memory."""

import csv

import numpy as np
import xarray as xr

from matcam.core.io import write_columns
from matcam.files.datasets import write_netcdf


def result():
    return xr.Dataset(
        {
            "loss": (("roughness", "theta"), np.array([[1.0, 0.5], [np.nan, 1e-300]])),
            "loss_angle": ("roughness", [0.3, 0.4], {"units": "rad"}),
        },
        coords={"roughness": [0.1, 0.2], "theta": ("theta", [0.0, 1.5], {"units": "rad"})},
        attrs={"ndf": "ggx", "normalised_over": [0.1, 0.2]},
    )


def test_columns_carry_units_in_their_names_and_gaps_as_gaps(tmp_path):
    write_columns(tmp_path / "a.csv", result())
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert set(rows[0]) == {"roughness", "theta_rad", "loss", "loss_angle_rad"}
    assert [(float(r["roughness"]), float(r["theta_rad"])) for r in rows] == [
        (0.1, 0),
        (0.1, 1.5),
        (0.2, 0),
        (0.2, 1.5),
    ]
    assert [r["loss"] for r in rows] == ["1", "0.5", "", "1e-300"]


def test_netcdf_is_the_dataset(tmp_path):
    write_netcdf(tmp_path / "a.nc", result())
    with xr.open_dataset(tmp_path / "a.nc") as read:
        xr.testing.assert_identical(read.drop_attrs(), result().drop_attrs())
        assert read.attrs["ndf"] == "ggx"
        np.testing.assert_array_equal(read.attrs["normalised_over"], [0.1, 0.2])
        assert read["theta"].attrs["units"] == "rad"
