"""The Fresnel term against truth from the oracle: exact data, noisy data, uncertain cameras, wrong cameras, real data."""

import numpy as np
import pytest
import xarray as xr

from matcam import (
    BoxPixel,
    Camera,
    Cylinder,
    DiffractionOptics,
    GaussianNDF,
    GaussianOptics,
    PixelNoise,
    Rig,
    Sphere,
    Uncertainty,
    fresnel,
    read_merl,
    rigs,
    tabulated_fresnel,
)
from matcam.angles import cosines
from matcam.errors import ArgumentError, FitError
from matcam.forward.lobe import lobe_record, tangent_offsets
from matcam.table import brdf_table
from tests.oracle import merl_lobe

WIDTH = 0.002
AT_75 = 74  # slice of theta_d = 74.5 degrees; 75 is the border to the next
CHROMIUM = merl_lobe.conductor(merl_lobe.THETA_D[:, None], np.array([3.3, 2.9, 2.26]), np.array([4.32, 4.23, 3.94]))
PIXELS = merl_lobe.PixelMap()


def one_channel(values):
    """Table of a single channel."""
    coords = {"theta_h": merl_lobe.THETA_H, "theta_d": merl_lobe.THETA_D, "phi_d": merl_lobe.PHI_D, "channel": ["G"]}
    return xr.DataArray(
        values, dims=("theta_h", "theta_d", "phi_d", "channel"), coords=coords, attrs={"sampling": "centre"}
    )


def normalised(reflectance):
    return reflectance / reflectance[10:45].mean(axis=0)


def merl_rig(sigma=0.5, std=None):
    uncertainty = None if std is None else Uncertainty.of({"optics.sigma_px": std})
    return Rig(Camera(GaussianOptics(sigma), BoxPixel(0.5), uncertainty=uncertainty), Sphere(256.0))


def pulls(trials, seed, true_sigma, rig, ndf="gaussian"):
    """(corrected - truth) / stated std, shape (trials, theta_d); the true sigma_mtf of each trial is true_sigma(rng)."""
    rng = np.random.default_rng(seed)
    truth = normalised(CHROMIUM[:, 1])
    result = []
    for _ in range(trials):
        record = merl_lobe.record(WIDTH, CHROMIUM[:, 1:2], merl_lobe.Rig(sigma_mtf=true_sigma(rng)))
        found = fresnel(one_channel(PIXELS.noisy(record, rng)), rig, ndf=ndf, masking=None).isel(channel=0)
        result.append((found["corrected"] - truth) / found["corrected_std"])
    return np.array(result)


@pytest.fixture(scope="module")
def noisy():
    return fresnel(
        brdf_table(PIXELS.noisy(merl_lobe.record(WIDTH, CHROMIUM), np.random.default_rng(11)), "centre"), rigs.merl()
    )


def test_without_noise_the_answer_is_exact():
    found = fresnel(brdf_table(merl_lobe.record(WIDTH, CHROMIUM), "centre"), rigs.merl(), masking=None)
    assert found.attrs["ndf"] == "gaussian"
    assert float(found["width"]) == pytest.approx(WIDTH, rel=1e-7)
    np.testing.assert_allclose(found["corrected"], normalised(CHROMIUM), rtol=1e-7)
    np.testing.assert_allclose(
        found["corrected_peak"], normalised(CHROMIUM), rtol=1e-4
    )  # the first cell is not quite the peak
    np.testing.assert_allclose(found["absolute"], CHROMIUM, rtol=1e-6)
    loss = found["response"] / float(found["response"][0])
    np.testing.assert_allclose(found["raw"], normalised(CHROMIUM) * loss.values[:, None], rtol=2e-4)


def test_beckmanns_lobe_is_the_gaussian_one_when_it_is_sharp():
    """alpha = sqrt(2) width, and the same Fresnel term."""
    found = fresnel(one_channel(merl_lobe.record(WIDTH, CHROMIUM[:, 1:2])), rigs.merl(), ndf="beckmann", masking=None)
    assert found.attrs["ndf"] == "beckmann"
    assert float(found["width"]) == pytest.approx(np.sqrt(2) * WIDTH, rel=1e-3)
    truth = normalised(CHROMIUM[:, 1])
    np.testing.assert_allclose(found["corrected"].values[:76, 0], truth[:76], rtol=2e-3)


def test_corrected_is_within_one_percent_and_raw_is_two_thirds_too_low(noisy):
    truth = normalised(CHROMIUM)
    error = noisy["corrected"].values / truth - 1
    assert np.abs(error[:75]).max() < 0.01
    for slice_ in (AT_75, AT_75 + 1):
        missing = 1 - noisy["raw"].values[slice_] / truth[slice_]
        assert np.all((missing > 0.64) & (missing < 0.69))
    # at 75 degrees itself, between the two slices
    between = 1 - (noisy["raw"].values / truth)[AT_75 : AT_75 + 2].mean(axis=0)
    assert np.all((between > 0.65) & (between < 0.68))


def test_width_noise_and_support_are_found(noisy):
    assert noisy.attrs["ndf"] == "gaussian"
    assert abs(float(noisy["width"]) - WIDTH) < 4 * float(noisy["width_std"])
    assert noisy.attrs["noise_relative"] == pytest.approx(0.01, rel=0.1)
    assert noisy.attrs["noise_floor"] == pytest.approx(1e-4, rel=0.1)
    assert noisy.attrs["noise"] == "estimated from the residuals"
    assert noisy.attrs["camera_uncertainty"] == "none stated: taken as exact"
    assert np.all(np.degrees(noisy["supported_angle"]) > 85)
    np.testing.assert_array_equal(noisy["corrected_std_camera"], 0)
    np.testing.assert_allclose(noisy["raw_std"] / noisy["raw"], noisy.attrs["noise_relative"], rtol=0.01)


def test_absolute_reflectance_is_within_its_error(noisy):
    pull = (noisy["absolute"].values - CHROMIUM) / noisy["absolute_std"].values
    assert np.sqrt(np.mean(pull[:80] ** 2)) < 1.5


def test_right_source_of_chromium_is_the_nearest(noisy):
    tables = tabulated_fresnel(noisy, "Cr").isel(channel=1)
    rms = tables["rms_corrected"].to_series()
    assert rms.idxmin() == "Cr (rakic)"
    assert rms.min() < 0.01
    assert np.all(tables["rms_raw"] > 0.3)
    everything = tabulated_fresnel(noisy)
    assert everything.sizes["table"] > 12
    np.testing.assert_allclose(everything["tabulated"].sel(theta_d=slice(0.18, 0.78)).mean("theta_d"), 1, atol=0.01)


def test_pulls_with_an_exact_camera():
    found = pulls(12, 3, lambda _: 0.5, merl_rig())[:, 5:85]
    # 12 trials of 80 angles, nearly independent: the share within 1 sigma is known to about 2 %
    assert 0.62 <= np.mean(np.abs(found) < 1) <= 0.75
    assert abs(found.mean()) < 0.2


def test_camera_uncertainty_reaches_the_result():
    """An error of sigma_mtf of 3 % moves F(75 degrees) by about 2 % at this width. (MODEL 5 states 1.4 %; how much depends
    on how the lobe is weighted. What must hold is that the stated error is that of refitting with another camera.)"""
    table = one_channel(merl_lobe.record(WIDTH, CHROMIUM[:, 1:2]))
    found = fresnel(table, merl_rig(std=0.015), ndf="gaussian", masking=None, noise=PixelNoise()).isel(channel=0)
    relative = (found["corrected_std_camera"] / found["corrected"]).values
    assert 0.01 < relative[AT_75] < 0.03
    assert found.attrs["camera_uncertainty"] == "stated"
    # the linear propagation against fitting with another camera
    moved = fresnel(table, merl_rig(0.515), ndf="gaussian", masking=None, noise=PixelNoise()).isel(channel=0)
    for angle in (20, 45, AT_75, 85):
        shift = float(moved["corrected"][angle] - found["corrected"][angle])
        assert abs(shift) == pytest.approx(float(found["corrected_std_camera"][angle]), rel=0.1)
    width_shift = float(moved["width"] - found["width"])
    assert abs(width_shift) == pytest.approx(float(found["width_std"]), rel=0.1)


def test_a_wrong_camera_that_nobody_declared_is_seen_in_the_noise():
    """5 % wrong and undeclared: the pulls grow, and the estimated noise is several times that of the pixels."""
    rng = np.random.default_rng(4)
    record = merl_lobe.record(WIDTH, CHROMIUM[:, 1:2], merl_lobe.Rig(sigma_mtf=0.525))
    found = fresnel(one_channel(PIXELS.noisy(record, rng)), merl_rig(), ndf="gaussian", masking=None).isel(channel=0)
    assert found.attrs["noise_relative"] > 0.025
    pull = ((found["corrected"] - normalised(CHROMIUM[:, 1])) / found["corrected_std"]).values
    assert abs(pull[AT_75]) > 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 21])
def test_coverage_with_an_uncertain_camera(seed):
    """Truth drawn from 0.5 px +- 3 %: 62 to 75 % of the pulls at 75 degrees lie within 1 sigma over 400 trials."""
    found = pulls(400, seed, lambda rng: 0.5 * (1 + 0.03 * rng.standard_normal()), merl_rig(std=0.015))
    for angle in (45, 60, AT_75):
        share = np.mean(np.abs(found[:, angle]) < 1)
        print(
            f"theta_d {angle + 0.5}: {share:.3f} within 1 sigma, "
            f"std {found[:, angle].std():.3f}, mean {found[:, angle].mean():+.3f}"
        )
        assert 0.62 <= share <= 0.75


@pytest.mark.slow
def test_pulls_of_a_wrong_camera_grow():
    """sigma_mtf 5 % wrong and undeclared, noise given: mean pull at 75 degrees far from 0."""
    rng = np.random.default_rng(22)
    truth, grown = normalised(CHROMIUM[:, 1]), []
    for _ in range(40):
        record = merl_lobe.record(WIDTH, CHROMIUM[:, 1:2], merl_lobe.Rig(sigma_mtf=0.525))
        table = one_channel(PIXELS.noisy(record, rng))
        for noise in (None, PixelNoise()):
            found = fresnel(table, merl_rig(), ndf="gaussian", masking=None, noise=noise).isel(channel=0)
            grown.append(((found["corrected"] - truth) / found["corrected_std"]).values[AT_75])
    print(
        f"mean pull {np.mean(grown[::2]):.1f} with estimated noise, {np.mean(grown[1::2]):.1f} with the true noise given"
    )
    assert np.mean(grown[::2]) > 3
    assert np.mean(grown[1::2]) > 6


@pytest.mark.slow
def test_ggx_lobes_are_told_from_gaussian_ones():
    """A GGX lobe drawn by the oracle's mixture of Gaussian records."""
    t = np.exp(np.linspace(-12, 3.9, 60))
    weight = t**2 * np.exp(-t)
    ones = np.ones((90, 1))
    table = 0
    for w, scale in zip(weight / weight.sum(), 0.01 / np.sqrt(2 * t), strict=True):
        if scale < 0.4:
            d0 = 1 / (2 * np.pi * scale**2)
            table = (
                table + w * merl_lobe.record(scale, ones) / d0
                if scale < 0.05
                else table + w * merl_lobe.record(scale, ones) * 2 * np.pi * scale**2
            )
    found = fresnel(one_channel(table), merl_rig())
    assert found.attrs["ndf"] == "ggx"
    assert float(found["width"]) == pytest.approx(0.01, rel=0.02)


@pytest.mark.slow
def test_other_lenses_go_through_the_same_fit():
    """A lens without closed form: a lobe recorded through diffraction by our own forward model, and read back."""
    ndf, rings = GaussianNDF(0.004), 20
    rig = Rig(Camera(DiffractionOptics(8, 550e-9, 4.73e-6), BoxPixel(0.5)), Sphere(256.0))
    theta_h, phi_d = (a.ravel() for a in np.meshgrid(merl_lobe.THETA_H[:rings], merl_lobe.PHI_D, indexing="ij"))
    theta_d = merl_lobe.THETA_D[:, None]
    x, y = tangent_offsets(rig, ndf, theta_h, theta_d, phi_d)
    lobe = np.asarray(lobe_record(rig, ndf, merl_lobe.THETA_D, x, np.broadcast_to(y, x.shape)))
    cos_i, cos_o = cosines(theta_h, theta_d, phi_d)
    near = CHROMIUM[:, 1:2] * float(ndf.d(0.0)) * lobe / (4 * np.asarray(cos_i * cos_o))
    table = np.zeros((90, 90, 180, 1))
    table[:rings, ..., 0] = near.reshape(90, rings, 180).transpose(1, 0, 2)
    found = fresnel(one_channel(table), rig, ndf="gaussian", masking=None).isel(channel=0)
    assert float(found["width"]) == pytest.approx(0.004, rel=1e-5)
    np.testing.assert_allclose(found["corrected"][:80], normalised(CHROMIUM[:, 1])[:80], rtol=1e-5)


def test_a_lobe_too_narrow_for_the_camera_is_said_to_be():
    table = one_channel(merl_lobe.record(2e-5, CHROMIUM[:, 1:2]))
    found = fresnel(table, merl_rig(), ndf="gaussian", masking=None).isel(channel=0)
    assert not found.attrs["width_determined"]
    assert np.isinf(found["width_std"])
    assert np.isnan(found["absolute"]).all()
    # what can be known still is: the relative loss is cos(theta)
    np.testing.assert_allclose(found["corrected"][:80], normalised(CHROMIUM[:, 1])[:80], rtol=2e-3)


def test_missing_data_stay_missing():
    record = merl_lobe.record(WIDTH, CHROMIUM)
    record[:, 20] = np.nan
    record[:, 30, :, 2] = np.nan
    record[3, 40, 50:70] = np.nan
    found = fresnel(brdf_table(record, "centre"), rigs.merl(), masking=None, ndf="gaussian")
    gone = np.isnan(found["corrected"].values)
    assert gone[20].all()
    assert gone[30].tolist() == [False, False, True]
    assert gone.sum() == 4
    np.testing.assert_allclose(
        found["corrected"].values[~gone],
        (CHROMIUM / CHROMIUM[[i for i in range(10, 45) if i != 20]].mean(0))[~gone],
        rtol=5e-3,
    )


@pytest.mark.parametrize("masking", ["smith", "smith-separable", "van-ginneken", None])
def test_masking_is_divided_out(masking):
    """A wide lobe whose table carries no masking: what is asked to be divided out is."""
    table = one_channel(merl_lobe.record(0.2, np.ones((90, 1))))
    found = fresnel(table, merl_rig(), ndf="gaussian", masking=masking).isel(channel=0)
    plain = fresnel(table, merl_rig(), ndf="gaussian", masking=None).isel(channel=0)
    ratio = (found["corrected"] * found["masking"] / plain["corrected"]).values
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert (found["masking"].values[80] < 0.9) == (masking is not None)


@pytest.mark.parametrize("material", ["chrome", "steel", "ss440", "tungsten-carbide"])
def test_real_metals_run_through(stand_in, material):
    found = fresnel(read_merl(stand_in(material)), rigs.merl())
    inside = found["corrected"].values[10:75]
    assert np.all(np.isfinite(inside) & (inside > 0))
    assert np.all(found["corrected_std"].values[10:75] > 0)
    assert 1e-3 < float(found["width"]) < 0.02
    assert found.attrs["source"] == f"{material}.binary"


def test_arguments_are_checked():
    table = brdf_table(np.ones((90, 90, 180, 3)), "centre")
    cases = [
        (lambda: fresnel(table.values, rigs.merl()), "must be an xarray.DataArray"),
        (lambda: fresnel(table, rigs.merl().camera), "rig must be a Rig"),
        (
            lambda: fresnel(table, Rig(rigs.merl().camera, Cylinder(3))),
            "recorded from a Sphere, this rig has a Cylinder",
        ),
        (lambda: fresnel(table, rigs.merl(), ndf="beckman"), "ndf must be one of 'auto', 'gaussian', 'ggx'"),
        (lambda: fresnel(table, rigs.merl(), masking="none"), "masking must be one of"),
        (lambda: fresnel(table, rigs.merl(), normalise=(1.0, 0.5)), "normalise must be"),
    ]
    for call, words in cases:
        with pytest.raises(ArgumentError) as caught:
            call()
        assert words in str(caught.value)


def test_tables_without_a_highlight_are_refused():
    flat = brdf_table(np.ones((90, 90, 180, 3)), "centre")
    with pytest.raises(FitError, match="does not fall to half"):
        fresnel(flat, rigs.merl())
    empty = flat.copy(data=np.full(flat.shape, np.nan))
    with pytest.raises(FitError, match="no highlight"):
        fresnel(empty, rigs.merl())
    with pytest.raises(FitError, match="cannot normalise"):
        record = merl_lobe.record(WIDTH, CHROMIUM)
        record[:, 10:45] = np.nan
        fresnel(brdf_table(record, "centre"), rigs.merl(), ndf="gaussian")
