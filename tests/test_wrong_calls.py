"""Random calls with wrong arguments: an error of the family in one line, TypeError, or the right result."""

import os

import numpy as np
import pytest
import xarray as xr

import matcam
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import brdf_table
from tests import wrong_calls


@pytest.mark.parametrize(("count", "seed"), [(250, 1), pytest.param(1000, 2, marks=pytest.mark.slow)])
def test_random_calls(monkeypatch, count, seed):
    """`python -m tests.wrong_calls 10000` makes more. A call that computes is ended after a second."""
    monkeypatch.setattr(wrong_calls, "SECONDS", 1)
    tally, faults = wrong_calls.campaign(count, seed)
    assert faults == []
    assert tally.total() == count
    assert tally["error of the family"] > count / 3


SWITCH = xr.DataArray(np.ones(3), dims="x")
RIG, LOBE = matcam.rigs.merl(), matcam.GGX(0.1)
TABLE = xr.DataArray(np.zeros(3), dims="x")
MERL = brdf_table(np.full((90, 90, 180, 3), 0.5), "centre")
SOURCE = matcam.UncertaintySource("a", 1.0, 0.1, 1.0, "B")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: matcam.calibrate([], samples={1}), "entry 1 of samples must be a MTFSamples, got 1"),
        (lambda: matcam.calibrate([], samples=1), "samples must be a sequence of MTFSamples, got 1"),
        (lambda: matcam.calibrate([], accept_sharpened="no"), "accept_sharpened must be True or False, got 'no'"),
        (
            lambda: matcam.peak_response(RIG, LOBE, 0.1, exact=SWITCH),
            "exact must be True or False, got <xarray.DataArray",
        ),
        (lambda: matcam.reconstruct("none", diffuse="no"), "diffuse must be True or False, got 'no'"),
        (
            lambda: matcam.edge_mtf(np.ones((20, 20)), accept_sharpened=1),
            "accept_sharpened must be True or False, got 1",
        ),
        (
            lambda: matcam.io.write_netcdf("a.nc", xr.Dataset(), compress="no"),
            "compress must be True or False, got 'no'",
        ),
        (
            lambda: matcam.correct_all([], RIG, "out", zarr="no"),
            "zarr must be True or False, got 'no'",
        ),
        (
            lambda: matcam.correct_all([], RIG, "out", workers=SWITCH),
            "workers must be a whole number in [1, 1024] or None, got <xarray.DataArray",
        ),
        (
            lambda: matcam.targets.design_chart(page=[[1], [1, 2]]),
            "page must be an array with rows of equal length, got",
        ),
        (
            lambda: matcam.fresnel_conductor([], np.ones(3), np.ones(2)),
            "theta, n and k must have shapes that broadcast, got (0,), (3,), (2,)",
        ),
        (
            lambda: matcam.forward.texture_contrast(matcam.Rig(RIG.camera, matcam.Flat()), [0.1, 0.2], [0.1, 0.2, 0.3]),
            "frequency and theta_o must have shapes that broadcast, got (2,), (3,)",
        ),
        (
            lambda: matcam.inverse.tabulated_fresnel(xr.Dataset(), wavelengths=[]),
            "result must be a Dataset from fresnel, but these entries are missing or have other dimensions: theta_d, raw, corr",
        ),
        (
            lambda: matcam.camera.LensField((1, 2), 3, k2=[[1], [1, 2]]),
            "k2 must be an array with rows of equal length, got",
        ),
        (lambda: matcam.camera.LensField(b"x", 3), "centre_px must be a number or an array of numbers, got b'x'"),
        (lambda: matcam.metal("Cr", 10**400), "wavelength must be a number or an array of numbers, got 1000"),
        (
            lambda: RIG.camera.esf([0.1, 0.2], [0.1, 0.2, 0.3]),
            "x and angle must have shapes that broadcast, got (2,), (3,)",
        ),
        (
            lambda: matcam.Microfacet(LOBE, 0.9).brdf([0.1, 0.2], [0.1, 0.2, 0.3], 0),
            "theta_h, theta_d, phi_d and phi_h must have shapes that broadcast, got (2,), (3,), (), ()",
        ),
        (lambda: matcam.targets.star_mtf(np.ones((20, 20)), cfa=TABLE), "cfa must be one of 'RGGB', 'BGGR'"),
        (lambda: matcam.targets.star_mtf(np.ones((20, 20)), channel=TABLE), "channel must be one of 'R', 'G', 'B'"),
        (lambda: matcam.targets.measure_targets(np.ones((20, 20)), LOBE), "chart must be a Chart, got GGX"),
        (
            lambda: matcam.targets.measure_targets(np.ones((20, 20)), matcam.targets.design_chart(), source=np.ones(3)),
            "source must be a str, got array([1., 1., 1.])",
        ),
        (lambda: matcam.edge_mtf_stack([[1], [1, 2]]), "images must be an array with rows of equal length, got a list"),
        (lambda: matcam.calibration.level_frequency(TABLE, 0.5), "edge must be an EdgeMTF, got <xarray.DataArray"),
        (lambda: matcam.UncertaintyBudget("x", 1, [1]), "entry 1 of sources must be an UncertaintySource, got 1"),
        (
            lambda: matcam.UncertaintyBudget("x", "a\nb", []),
            "value must be a number or an array of numbers, got 'a\\nb'",
        ),
        (lambda: matcam.UncertaintyBudget("x", 10**400, []), "value must be a number or an array of numbers, got 1000"),
        (lambda: matcam.UncertaintyBudget(b"x", 1, []), "name must be a str, got b'x'"),
        (lambda: matcam.UncertaintyBudget("x", np.ones(3), []), "value must be a single number, got an array of shape"),
        (lambda: matcam.UncertaintyBudget("a\nb", 1, []), "the budget of 'a\\nb' needs at least one source"),
        (
            lambda: matcam.UncertaintyBudget("x", 1, [SOURCE], "x"),
            "correlation must be a number or an array of numbers, got 'x'",
        ),
        (
            lambda: matcam.UncertaintyBudget("x", 1, [SOURCE._replace(sensitivity="x")]),
            "sensitivity of source 'a' must be a number or an array of numbers, got 'x'",
        ),
        (
            lambda: matcam.UncertaintyBudget.of("x", len, [3]),
            "entry 1 of sources must be an UncertaintySource, got 3",
        ),
        (
            lambda: matcam.forward.with_pixel_noise(MERL, RIG, matcam.camera.PixelNoise(0.01, 0.0), seed=-1),
            "seed must be a whole number >= 0, got -1",
        ),
        (
            lambda: matcam.picture(matcam.Microfacet(LOBE, 0.9), RIG, 0.5, shape=(3, 5), shift=MERL),
            "shift must be two numbers (right, down), px, got an array of shape (90, 90, 180, 3)",
        ),
        (lambda: matcam.camera.Uncertainty.of(0.1), "std must map names to standard deviations, got 0.1"),
        (lambda: RIG.camera.with_parameters([1]), "values must be a dict, got [1]"),
        (
            lambda: matcam.camera.expose_bracket(matcam.Sensor(5e-6, 1e4, 2.0), np.ones((2, 2)), [1.0], seed=1 << 63),
            "seed must be a whole number in [0, 2^63) or a key of jax.random, got 9223372036854775808",
        ),
        (lambda: matcam.camera.merge_bracket(2, np.ones((1, 2, 2)), [1.0]), "sensor must be a Sensor, got 2"),
        (
            lambda: matcam.inspect(xr.DataArray(np.ones((2, 3)), dims=("sample", "channel"))),
            "samples must have a numeric coordinate theta_h along the dimension sample",
        ),
        (
            lambda: matcam.edge_mtf_stack([np.ones((20, 20))], gain=np.ones((2, 3)), read_noise=0.5),
            "gain must be a single number, got an array of shape (2, 3)",
        ),
        (lambda: matcam.io.write_budgets("a.csv", [3]), "entry 1 of budgets must be an UncertaintyBudget, got 3"),
    ],
)
def test_the_message_names_what_is_wrong(call, message):
    with pytest.raises(ArgumentError) as caught:
        call()
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_picture_with_labels_is_measured_as_one_without():
    y, x = np.mgrid[:110, :110] - 54.5
    picture = 1000 * (1 + 0.5 * np.cos(20 * np.arctan2(y, x)) * (np.hypot(x, y) < 52))
    plain = matcam.targets.star_mtf(picture, contrast=0.5)
    labelled = matcam.targets.star_mtf(xr.DataArray(picture, dims=("y", "x")), contrast=0.5)
    np.testing.assert_array_equal(labelled.samples.mtf, plain.samples.mtf)


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "none"])
def test_a_folder_that_cannot_be(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    words = {"none": "none: no such folder", "a\0b": "a\\x00b: the path is not valid: remove the special characters"}
    with pytest.raises(FileFormatError) as caught:
        matcam.reconstruct(name)
    assert str(caught.value) == words.get(name, f"{name}: cannot be read: {os.strerror(36)}")
