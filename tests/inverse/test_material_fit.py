"""Fits: what they find, what they say of it, and what they refuse."""

import numpy as np
import pytest
import xarray as xr

from matcam import Rig, Sphere, fit
from matcam.camera import PixelNoise
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import texts
from matcam.inverse import FitSetup
from matcam.inverse.correction.explanation import first_setup
from matcam.material import Sampled
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18
F75 = float(conductor(recorded.SEVENTY_FIVE, *recorded.CHROMIUM))


def light(lobe):
    shot = recorded.pictures(EVERY)
    return shot, shot.rule.directions(lobe) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]


def noisy(lobe, seed, **noise):
    shot, directions = light(lobe)
    return shot.table(shot.rule.noisy(directions, np.random.default_rng(seed), **noise))


@pytest.mark.parametrize(
    "lobe",
    [
        oracle.GGX(0.001),
        *(pytest.param(lobe, marks=pytest.mark.slow) for lobe in (oracle.GGX(0.15), oracle.EPD(0.004, 0.6))),
    ],
)
def test_exact_data_give_the_truth(lobe):
    """No noise in the data, little assumed: what is left is the operator's own error."""
    shot, directions = light(lobe)
    found = fit(
        shot.table(directions.mean(-1)),
        recorded.rig(),
        recorded.family(lobe),
        noise=PixelNoise(1e-3, 1e-5),
        slice_step=EVERY,
    )
    np.testing.assert_allclose(list(found.params.values())[: len(lobe)], lobe, rtol=3e-5)
    assert found.params["n[G]"] == pytest.approx(recorded.CHROMIUM[0], rel=2e-3)
    assert found.params["k[G]"] == pytest.approx(recorded.CHROMIUM[1], rel=2e-3)
    assert found.hwhm == pytest.approx(recorded.half_width(lobe), rel=3e-5)
    assert found.fresnel(recorded.SEVENTY_FIVE)[0] == pytest.approx(F75, rel=2e-4)


def test_noisy_data_are_told_within_their_errors():
    lobe = oracle.GGX(0.003)
    found = fit(noisy(lobe, 1), recorded.rig(), noise=recorded.NOISE, slice_step=EVERY)
    assert found.determined
    assert abs(found.params["alpha"] - 0.003) < 4 * found.std["alpha"]
    assert 0.8 < found.misfit < 1.25
    assert texts(found.remarks) == ["the camera is assumed to be exact: the errors do not include its uncertainty"]
    assert set(found.params) == {"alpha", "n[G]", "k[G]"}
    assert found.correlation("n[G]", "n[G]") == pytest.approx(1)
    assert np.nanstd(found.residual["residual"]) == pytest.approx(1, abs=0.15)


def test_noise_is_estimated():
    found = fit(noisy(oracle.GGX(0.01), 2), recorded.rig(), slice_step=EVERY)
    assert found.noise.relative == pytest.approx(0.01, rel=0.15)
    assert found.noise.floor == pytest.approx(1e-4, rel=0.15)
    assert found.noise.picture_gain < 0.02


def test_a_lens_with_a_prior_and_a_free_one():
    """True sigma_mtf 3 % off the rig's: the data say so, with the prior and without."""
    truth = 0.515
    shot = recorded.made(EVERY, oracle.Setup(sigma=truth))
    directions = (
        shot.rule.directions(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    )
    table = shot.table(shot.rule.noisy(directions, np.random.default_rng(3)))
    for rig, use in ((recorded.rig(std=0.015), "prior"), (recorded.rig(), "free")):
        found = fit(table, rig, noise=recorded.NOISE, slice_step=EVERY, camera_parameters=use)
        lens, std = found.params["optics.sigma_px"], found.std["optics.sigma_px"]
        assert abs(lens - truth) < 4 * std < 0.01
        assert abs(found.params["alpha"] - 0.004) < 4 * found.std["alpha"]
        assert float(found.camera.optics.sigma) == pytest.approx(lens)
        assert found.camera.uncertainty.std()["optics.sigma_px"] == pytest.approx(std)
    wrong = fit(table, recorded.rig(0.45), noise=recorded.NOISE, slice_step=EVERY)
    assert wrong.misfit > 2
    assert any("times the given noise" in remark.text for remark in wrong.remarks)


def test_free_reflectance_and_a_blind_fit():
    lobe = oracle.GGX(0.002)
    table = noisy(lobe, 4, gain=0.0)
    found = fit(table, recorded.rig(), fresnel="free", noise=recorded.NOISE._replace(picture_gain=0), slice_step=EVERY)
    truth = conductor(found.curves["theta_d"].values, *recorded.CHROMIUM)
    pull = (found.curves["fresnel"].values[:, 0] - truth) / found.curves["fresnel_std"].values[:, 0]
    assert np.nanmax(np.abs(pull)) < 4.5
    assert isinstance(found.material.fresnel, Sampled)
    blind = fit(table, None, fresnel="free", noise=recorded.NOISE, slice_step=EVERY)
    assert blind.params["alpha"] > 1.3 * lobe.alpha
    assert blind.camera is None
    assert blind.remarks[0].text == "without a rig, the fit assumes a perfect camera"


@pytest.mark.slow
def test_two_materials_tell_one_lens():
    """Fitted together they know it better than each alone."""
    tables = [noisy(lobe, seed) for seed, lobe in enumerate((oracle.GGX(0.002), oracle.GGX(0.006)))]
    both = fit(tables, recorded.rig(), camera_parameters="free", noise=recorded.NOISE, slice_step=EVERY)
    alone = [fit(t, recorded.rig(), camera_parameters="free", noise=recorded.NOISE, slice_step=EVERY) for t in tables]
    name = "optics.sigma_px"
    assert both.std[name] < min(a.std[name] for a in alone)
    assert abs(both.params[name] - 0.5) < 4 * both.std[name]
    assert abs(both.params["alpha[0]"] - 0.002) < 4 * both.std["alpha[0]"]
    assert abs(both.params["alpha[1]"] - 0.006) < 4 * both.std["alpha[1]"]
    assert len(both.materials) == 2


def test_diffuse_and_channels():
    """A Lambertian part, three channels of one roughness or of three."""
    shot, directions = light(oracle.GGX(0.02))
    random = np.random.default_rng(7)
    albedos = (0.1, 0.2, 0.3)
    values = [shot.table(shot.rule.noisy(directions + albedo / np.pi, random)) for albedo in albedos]
    table = xr.concat(values, "channel").transpose("theta_h", "theta_d", "phi_d", "channel")
    table = table.assign_coords(channel=["R", "G", "B"])
    table.attrs["sampling"] = "centre"
    one = fit(table, recorded.rig(), diffuse=True, noise=recorded.NOISE, slice_step=EVERY)
    three = fit(table, recorded.rig(), diffuse=True, per_channel=True, noise=recorded.NOISE, slice_step=EVERY)
    assert abs(one.params["alpha"] - 0.02) < 4 * one.std["alpha"]
    for label, albedo in zip("RGB", albedos, strict=True):
        assert abs(one.params[f"diffuse[{label}]"] - albedo) < 4 * one.std[f"diffuse[{label}]"]
        assert abs(three.params[f"alpha[{label}]"] - 0.02) < 4 * three.std[f"alpha[{label}]"]
    assert three.std["alpha[R]"] > 1.4 * one.std["alpha"]
    # from one lobe for all on to one for each
    setup = FitSetup((table,), recorded.rig(), diffuse=True, per_channel=True, noise=recorded.NOISE, slice_step=EVERY)
    again = setup.solve(start=one)
    assert again.misfit == pytest.approx(three.misfit, rel=1e-3)
    for name, value in three.params.items():
        assert abs(again.params[name] - value) < 0.1 * three.std[name]


def test_a_lobe_too_narrow_for_the_camera_is_said_to_be():
    table = noisy(oracle.GGX(2e-5), 8)
    found = fit(table, recorded.rig(), noise=recorded.NOISE, slice_step=EVERY)
    assert not found.determined
    assert any("has the smallest width that a fit allows" in remark.text for remark in found.remarks)


def test_bad_data_are_refused_before_the_operator_is_computed(monkeypatch):
    def operator(*_, **__):
        raise AssertionError

    monkeypatch.setattr("matcam.inverse.fit.fit_setup.lobe_operator", operator)
    table = noisy(oracle.GGX(0.01), 9)
    empty, dark, torn, few = (table.copy() for _ in range(4))
    empty[:] = np.nan
    dark[:] = 0.0
    torn[:, 20:] = np.nan
    few[:] = np.nan
    few[:3, 1] = 0.3  # in no slice that is used
    for bad, words in (
        (empty, "every value is missing"),
        (dark, "no value is above 0"),
        (torn, "in 1 of 5 slices of theta_d: give a table with at least 20% of them"),
        (few, "contains 0% of the required values, in 0 of 5 slices"),
    ):
        with pytest.raises(FitError, match=words):
            fit(bad, recorded.rig(), slice_step=EVERY)
        with pytest.raises(FitError, match=words):
            first_setup(bad, recorded.rig(), masking="smith", noise=None, workspace=None, slice_step=EVERY)


def test_bad_arguments_are_refused():
    table, rig = noisy(oracle.GGX(0.01), 9), recorded.rig()
    cases = [
        ({"ndf": "phong"}, "ndf must be one of"),
        ({"fresnel": "metal"}, "fresnel must be one of"),
        ({"camera_parameters": "guess"}, "camera_parameters must be one of"),
        ({"camera_parameters": "prior"}, "needs a camera with an uncertainty"),
        ({"camera_parameters": "free", "free": ["optics.f_number"]}, "a free parameter must be one of"),
        ({"slice_step": 0}, "slice_step must be"),
        ({"noise": PixelNoise(-1, 0)}, "noise.relative"),
        ({"masking": "none"}, "masking must be one of"),
    ]
    for options, words in cases:
        with pytest.raises(ArgumentError, match=words):
            fit(table, rig, **{"slice_step": EVERY, **options})
    with pytest.raises(ArgumentError, match="no camera to fit"):
        fit(table, None, camera_parameters="free")
    with pytest.raises(ArgumentError, match="at least one"):
        fit([], rig)
    with pytest.raises(ArgumentError, match="distant camera"):
        fit(table, Rig(rig.camera, Sphere(256, distance=30), cell_value="nearest", pixel_phase=(0.1, 0.2)))
