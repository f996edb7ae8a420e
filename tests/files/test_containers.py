"""NetCDF and Zarr: any result, back to the bit."""

import zipfile

import netCDF4
import numpy as np
import pytest
import xarray as xr

from matcam.core.errors import FileFormatError
from matcam.io import read_netcdf, read_zarr, write_netcdf, write_zarr
from tests.files.mutations import mutated, survives


@pytest.fixture(scope="module")
def result():
    random = np.random.default_rng(1)
    values = random.random((90, 3))
    values[3, 1] = np.nan
    return xr.Dataset(
        {"raw": (("theta_d", "channel"), values, {"units": "1/sr"}), "count": ("theta_d", np.arange(90))},
        coords={"theta_d": ("theta_d", random.random(90), {"units": "rad"}), "channel": ["R", "G", "B"]},
        attrs={"rig": "x" * 300, "width": 0.002},
    )


FORMATS = {"nc": (write_netcdf, read_netcdf), "zarr.zip": (write_zarr, read_zarr)}


@pytest.mark.parametrize("suffix", FORMATS)
def test_everything_comes_back(result, tmp_path, suffix):
    write, read = FORMATS[suffix]
    write(tmp_path / f"a.{suffix}", result)
    back = read(tmp_path / f"a.{suffix}")
    xr.testing.assert_identical(back, result)
    assert back["raw"].dtype == np.float64


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_it_is_not(tmp_path, suffix):
    read = FORMATS[suffix][1]
    (tmp_path / "text").write_text("hello")
    for path in (tmp_path / "text", tmp_path / "none", tmp_path):
        with pytest.raises(FileFormatError) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))


def test_a_compressed_table_is_smaller_and_the_same(result, tmp_path):
    rng = np.random.default_rng(0)
    values = rng.random((90, 9, 20, 3))
    values[10:] = np.nan  # mostly missing
    table = result.assign(
        brdf=(("theta_h", "slice", "phi_d", "colour"), values), known=(("theta_h",), values[:, 0, 0, 0] > 0)
    )
    for compress in (False, True):
        write_netcdf(tmp_path / f"{compress}.nc", table, compress=compress)
    xr.testing.assert_identical(read_netcdf(tmp_path / "True.nc"), read_netcdf(tmp_path / "False.nc"))
    np.testing.assert_array_equal(read_netcdf(tmp_path / "True.nc")["brdf"].values, values)
    assert (tmp_path / "True.nc").stat().st_size < 0.4 * (tmp_path / "False.nc").stat().st_size


def test_standard_deviations_are_stored_as_float32_and_flags_as_bytes(tmp_path):
    """The default: brdf to the bit, and any program that knows HDF5's own filters reads the rest, flags as bool."""
    rng = np.random.default_rng(0)
    dims = ("theta_h", "theta_d", "phi_d", "channel")
    values = rng.random((30, 9, 20, 3))
    values[25:] = np.nan
    std = values / 3
    std[0, 0, 0, 0] = 1e60
    table = xr.Dataset({
        "brdf": (dims, values), "brdf_std": (dims, std), "supported": (dims, values > 0.9),
        "small_std": (dims[:2], values[..., 0, 0]),
    })  # fmt: skip
    write_netcdf(tmp_path / "a.nc", table)
    with xr.open_dataset(tmp_path / "a.nc", engine="netcdf4") as other:
        assert {name: other[name].encoding["dtype"] for name in ("brdf", "brdf_std", "supported", "small_std")} == {
            "brdf": np.float64, "brdf_std": np.float32, "supported": "bool", "small_std": np.float64,
        }  # fmt: skip
        for name in ("brdf", "brdf_std", "supported"):
            assert other[name].encoding["zlib"]
            assert other[name].encoding["shuffle"]
        np.testing.assert_array_equal(other["brdf"].values, values)
    with netCDF4.Dataset(tmp_path / "a.nc") as raw:
        assert raw["supported"].dtype == np.int8
    for back in (read_netcdf(tmp_path / "a.nc"), xr.load_dataset(tmp_path / "a.nc", engine="h5netcdf")):
        np.testing.assert_array_equal(back["brdf"].values, values)
        np.testing.assert_allclose(back["brdf_std"].values, np.minimum(std, 3.4028235e38), rtol=1e-7)
        np.testing.assert_array_equal(back["supported"].values, values > 0.9)
        assert back["supported"].dtype == bool


def test_what_compresses_too_well_to_be_trusted_is_written_plainly(tmp_path):
    """A reader refuses arrays that are 16 times larger than their file: what is written can be read."""
    empty = xr.Dataset({name: (("a", "b", "c"), np.full((30, 90, 90), np.nan)) for name in ("brdf", "brdf_std")})
    write_netcdf(tmp_path / "a.nc", empty)
    xr.testing.assert_equal(read_netcdf(tmp_path / "a.nc"), empty)


def test_arrays_that_cannot_be_in_there_are_not_asked_for(result, tmp_path):
    """A store that says it holds 8 TB; every chunk that is not there would be filled."""
    write_zarr(tmp_path / "a.zarr.zip", result)
    with zipfile.ZipFile(tmp_path / "a.zarr.zip") as old, zipfile.ZipFile(tmp_path / "b.zarr.zip", "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, data.replace(b"90", b"1000000000000") if name.endswith("count/zarr.json") else data)
    with pytest.raises(FileFormatError, match="does not fit into"):
        read_zarr(tmp_path / "b.zarr.zip")
    result.astype("f4").to_netcdf(
        tmp_path / "c.nc", encoding={"raw": {"zlib": True, "chunksizes": (1, 1)}}, unlimited_dims=["theta_d"]
    )
    assert read_netcdf(tmp_path / "c.nc")["raw"].shape == (90, 3)
    big = xr.Dataset({"zeros": ("x", np.zeros(4_000_000))})
    big.to_netcdf(tmp_path / "d.nc", encoding={"zeros": {"zlib": True}})
    with pytest.raises(FileFormatError, match="does not fit into"):
        read_netcdf(tmp_path / "d.nc")


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("count", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged(result, tmp_path, suffix, count):
    write, read = FORMATS[suffix]
    write(tmp_path / f"a.{suffix}", result)
    content = (tmp_path / f"a.{suffix}").read_bytes()
    # HDF5 may search a damaged file for as long as it is allowed to
    limit = 12.0 if suffix == "nc" else 2.0
    refused, _ = survives(read, tmp_path / f"b.{suffix}", mutated(content, count, 3, 400), seconds=limit)
    assert refused > count / 20
