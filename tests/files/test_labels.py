"""Labels and units: honoured, or refused in one line; what stands in no label stands in its place."""

import numpy as np
import pytest
import xarray as xr

import matcam
from matcam import write
from matcam.core.errors import ArgumentError
from matcam.core.grid import brdf_table, checked_table
from matcam.files.samples import samples_of, table_of
from matcam.io import read_samples, write_exr, write_rgl, write_samples

COLOURS = np.array([0.1, 0.2, 0.3])


@pytest.fixture(scope="module")
def table():
    return brdf_table(np.broadcast_to(COLOURS, (90, 90, 180, 3)).copy(), "centre")


@pytest.fixture
def samples(table):
    return samples_of(table)[:5]


ORDERS = [[2, 1, 0], [1, 2, 0], [0, 1, 2]]


@pytest.mark.parametrize("order", ORDERS)
def test_channels_in_any_order(table, tmp_path, order):
    """Each writer stores red as red; each user of a table takes it for red."""
    turned = table.isel(channel=order)
    matcam.write_merl(tmp_path / "a.binary", turned)
    xr.testing.assert_allclose(matcam.read_merl(tmp_path / "a.binary").drop_attrs(), table.drop_attrs())
    write(tmp_path / "a.nc", turned)
    write_samples(tmp_path / "a.csv", samples_of(turned)[:5])
    assert read_samples(tmp_path / "a.csv").sel(channel="R").values[0] == 0.1
    np.testing.assert_allclose(matcam.material.Tabulated(turned).brdf(0.1, 0.5, 1.0), COLOURS)
    np.testing.assert_array_equal(checked_table(turned)["channel"], ["R", "G", "B"])


@pytest.mark.parametrize("order", ORDERS)
def test_columns_of_a_csv_in_any_order(table, tmp_path, order):
    few = table.where(table["theta_h"] == table["theta_h"][3])
    write_samples(tmp_path / "a.csv", samples_of(few).isel(channel=order))
    back = table_of(read_samples(tmp_path / "a.csv"))
    np.testing.assert_array_equal(back["channel"], ["R", "G", "B"])
    np.testing.assert_allclose(back.values[3, 4, 5], COLOURS)


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        (["B", "G", "X"], "must label them R, G, B"),
        (["R", "R", "B"], "each label must occur once"),
        ([0, 1, 2], "R, G, B"),
    ],
)
def test_labels_that_are_no_colours(table, tmp_path, labels, words):
    wrong = table.assign_coords(channel=labels)
    for use in (
        lambda: matcam.write_merl(tmp_path / "a.binary", wrong),
        lambda: matcam.material.Tabulated(wrong),
        lambda: samples_of(wrong),
        lambda: write(tmp_path / "a.nc", wrong),
        lambda: matcam.fresnel(wrong, matcam.rigs.merl()),
    ):
        with pytest.raises(ArgumentError, match=words):
            use()


def test_without_labels_channels_are_what_they_stand_for(table):
    np.testing.assert_array_equal(checked_table(table.drop_vars("channel")).values, table.values)
    assert checked_table(table.isel(channel=[2, 0])).sizes["channel"] == 2


def test_samples_of_one_colour_are_no_table(samples):
    with pytest.raises(ArgumentError, match="one channel for all colours"):
        table_of(samples.isel(channel=[0]))


@pytest.mark.parametrize("units", ["W/m^2", "1/deg", 3])
def test_units_of_values(table, samples, tmp_path, units):
    with pytest.raises(ArgumentError, match="must be in 1/sr"):
        matcam.write_merl(tmp_path / "a.binary", table.assign_attrs(units=units))
    with pytest.raises(ArgumentError, match="must be in 1/sr"):
        write_samples(tmp_path / "a.csv", samples.assign_attrs(units=units))


def test_units_of_angles(table, samples, tmp_path):
    table, samples = table.copy(), samples.copy()
    table["theta_d"].attrs["units"] = samples["theta_d"].attrs["units"] = "deg"
    with pytest.raises(ArgumentError, match="theta_d must be in rad"):
        matcam.write_merl(tmp_path / "a.binary", table)
    with pytest.raises(ArgumentError, match="theta_d must be in rad"):
        write_samples(tmp_path / "a.csv", samples)
    fields = matcam.exchange.adaptive_grid(matcam.Microfacet(matcam.GGX(0.3), 0.9), square=16)
    fields["theta_i"].attrs["units"] = "deg"
    with pytest.raises(ArgumentError, match="theta_i must be in rad"):
        write_rgl(tmp_path / "a.bsdf", fields)


def test_channels_of_a_picture(tmp_path):
    picture = xr.DataArray(np.ones((2, 3, 3)), dims=("row", "column", "channel"), coords={"channel": ["B", "G", "R"]})
    with pytest.raises(ArgumentError, match="must have R, G, B"):
        write_exr(tmp_path / "a.exr", picture)
    write_exr(tmp_path / "a.exr", picture.isel(channel=[2, 1, 0]))
