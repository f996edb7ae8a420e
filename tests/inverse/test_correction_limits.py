"""Doing no harm: shrinkage, withheld corrections, energy, and what a rig says of its lens."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import matcam
from matcam import (
    EPD,
    GGX,
    Camera,
    ColourOptics,
    DiffractionOptics,
    GaussianOptics,
    MeasuredOptics,
    Rig,
    Sphere,
    fit,
    read_merl,
    rigs,
)
from matcam.camera import PixelNoise, Uncertainty
from matcam.core.grid import brdf_table
from matcam.core.jax import jnp
from matcam.inverse import Correction
from matcam.inverse.correction.corrected_table import corrected_table, supported_values, zeroed_noise
from matcam.inverse.correction.correction_limits import (
    ROWS,
    LobeRatio,
    above_noise,
    albedo,
    energy_limit,
    shrunk,
    withheld,
)
from matcam.inverse.correction.explanation import Explanation
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.rig.lens_changes import EIGHTH, SHAPE, SIXTH, STRETCH
from matcam.inverse.rig.rig_axes import LENS, free_axis, known_lens, shape_axes
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor

EVERY = 18


def ratio_of(log, std, recorded=1.0):
    """Ratio for a material without a body. All entries are corrected."""
    log, one = np.asarray(log, dtype=float), np.ones(np.shape(log))
    return LobeRatio(log, std * one, one.astype(bool), recorded * one, one, 0 * one)


def test_what_is_known_stays_and_what_is_not_shrinks_to_the_recorded_value():
    log = np.array([2.0, 2.0, 2.0, -1.0, 0.0])
    std = np.array([0.01, 1.0, 3.0, 0.1, 0.5])
    found = shrunk(ratio_of(log, std), 0.0)
    np.testing.assert_allclose(found.log, [2 - 5e-5, 1.5, 0, -0.99, 0], atol=1e-12)
    assert np.all(np.abs(found.log) <= np.abs(log))
    assert np.all(found.std >= std * (1 - 1e-12))
    # the ratio that was given up lies within the standard deviation
    assert found.std[2] >= np.expm1(2.0)


def test_no_camera_takes_its_share():
    sure = ratio_of([1.0], 0.01)
    half = shrunk(sure, 0.5)
    assert 0 <= half.log[0] < 0.5
    assert half.std[0] > 0.5
    assert shrunk(sure, 1.0).log[0] == 0
    none = withheld(sure)
    assert none.log[0] == 0
    assert none.std[0] == pytest.approx(np.e - 1, rel=1e-3)


def lit(albedo_of_body, peak=0.0, width=0.05):
    """A Lambertian body and a lobe that falls off with the half angle, times the cosines that keep its light finite."""
    grid = recorded.GRID
    th, td = grid.theta_h[:, None, None], grid.theta_d[:, None]
    values = albedo_of_body / np.pi + peak * np.exp(-((th / width) ** 2)) * np.cos(td) ** 2
    return brdf_table(np.broadcast_to(values[..., None], (90, 90, 180, 3)).copy(), "centre").values


def sent(body, peak, width, theta_i, count=700):
    """The same light by summing over outgoing directions."""
    theta = (np.arange(count) + 0.5) * np.pi / 2 / count
    phi = ((np.arange(2 * count) + 0.5) * np.pi / count)[:, None]
    out = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi])
    light = np.array([np.sin(theta_i), 0, np.cos(theta_i)])[:, None, None]
    half = out + light
    half /= np.linalg.norm(half, axis=0)
    cos_d = (half * light).sum(0)
    value = body / np.pi + peak * np.exp(-((np.arccos(np.clip(half[2], -1, 1)) / width) ** 2)) * cos_d**2
    return (value * np.cos(theta) * np.sin(theta)).sum() * (np.pi / 2 / count) * (np.pi / count)


@pytest.mark.parametrize("sampling", ["centre", "edge"])
@pytest.mark.parametrize("ndf", [matcam.GaussianNDF(0.001), GGX(0.001), GGX(0.01), matcam.GaussianNDF(0.1)], ids=repr)
def test_the_albedo_of_a_narrow_lobe_is_its_reflectance(ndf, sampling):
    """A mirror reflects what it receives, also if few cells contain its highlight: no false excess of energy."""
    table = matcam.forward.true_table(matcam.Microfacet(ndf, 0.97, masking=None), sampling)
    near = 80 if ndf.roughness < 0.05 else 20
    np.testing.assert_allclose(albedo(table.values, sampling)[:near], 0.97, atol=0.015)
    assert np.abs(albedo(table.values, sampling)[:40] - 0.97).max() < 0.002


@pytest.mark.parametrize(("body", "peak", "width"), [(0.8, 0.0, 1.0), (0.1, 20.0, 0.1), (0.0, 2.0, 0.4)])
def test_albedo_is_the_light_sent(body, peak, width):
    found = albedo(lit(body, peak, width))
    for degrees in (0, 30, 60):
        assert found[degrees, 0] == pytest.approx(sent(body, peak, width, np.radians(degrees + 0.5)), rel=0.01)


def limited(before, wanted, std):
    limit = energy_limit(before, wanted, std, "centre")
    return limit, np.concatenate([limit.of(rows, before[rows], wanted[rows], std[rows]) for rows in ROWS])


def test_no_direction_reflects_more_than_it_gets():
    """A correction that is known to 40 % is lowered to an albedo of 1."""
    before, wanted = lit(0.5, 10.0), lit(0.5, 20.0)
    assert albedo(before).max() < 1 < albedo(wanted).max()
    limit, kept = limited(before, wanted, 0.4 * wanted)
    assert limit.acts
    assert "albedo" not in limit.remarks[-1].text
    assert limit.excess.max() == 0
    assert albedo(kept).max() <= 1 + 1e-9
    assert np.all((kept >= before - 1e-12) & (kept <= wanted + 1e-12))
    assert kept[0, 0, 0, 0] > 1.2 * before[0, 0, 0, 0]
    # light and view exchanged
    np.testing.assert_allclose(kept, kept[:, :, ::-1], rtol=1e-12)
    # a table that breaks it by itself is not made worse, and one within it is not touched
    too_bright = lit(1.2)
    _, same = limited(too_bright, too_bright * 1.1, 0.2 * too_bright)
    np.testing.assert_allclose(same, too_bright, rtol=1e-9)
    assert not limited(before, before * 1.01, 0.01 * before)[0].acts


def test_energy_does_not_lower_what_is_determined():
    """A correction that is known to 0.5 % stays within 1 %, and the remark names the excess."""
    before, wanted = lit(0.5, 10.0), lit(0.5, 20.0)
    limit, kept = limited(before, wanted, 0.005 * wanted)
    np.testing.assert_allclose(kept, wanted, rtol=0.011)
    assert limit.acts
    assert "check the absolute scale" in limit.remarks[-1].text


def test_noise_of_either_sign_does_not_look_like_added_light():
    """Clipping the noise of a dark surround would raise the albedo above 1; the limit sees the noise unclipped."""
    random = np.random.default_rng(1)
    before = lit(0.0, 14.0)
    wanted = lit(0.0, 15.0)
    noise = 0.5 * random.standard_normal(before.shape)
    clipped = np.maximum(wanted + noise, 0)
    assert albedo(clipped).max() > 1.05
    assert albedo(wanted).max() < 0.97
    assert not limited(before + noise, wanted + noise, 0.01 * wanted)[0].acts


def test_a_ratio_below_the_noise_multiplies_nothing():
    """Where the recorded lobe is 1e-20 of the peak the ratio goes to 1; where it stands out of the noise it stays."""
    shape = (90, 90, 180)
    recorded = np.ones(shape)
    recorded[50:] = 1e-20
    ratio = ratio_of(np.full(shape, np.log(4e15)), 0.01, recorded)
    found = above_noise(ratio, np.full(90, 1e-6))
    np.testing.assert_allclose(found.log[:50], np.log(4e15), rtol=1e-11)
    assert np.abs(found.log[50:]).max() < 1e-20
    assert found.std[50:].min() > 1e15


def corrected(brdf, supported, correction_std, response):
    """Dataset of a correction, as far as a file of values alone requires it."""
    arrays = {"supported": supported, "correction_std": correction_std}
    done = xr.Dataset({"brdf": brdf, **{name: (brdf.dims, array) for name, array in arrays.items()}})
    return done.assign(response=(brdf.dims, np.broadcast_to(response, brdf.shape)))


def test_a_file_that_cannot_say_what_is_supported_keeps_the_recorded_value():
    table = brdf_table(np.full((90, 90, 180, 3), 0.1), "centre")
    supported = np.zeros(table.shape, bool)
    supported[5] = True
    for ratio, std in ((1.5, 0.01), (0.5, 0.06)):
        done = corrected(table * ratio, supported, np.full(table.shape, std), 1 / ratio)
        written = supported_values(done, table).values
        np.testing.assert_allclose(written[5], 0.1 * ratio)
        np.testing.assert_array_equal(written[6:], 0.1)


def test_noise_below_zero_is_not_missing_in_a_file():
    recorded = np.full((90, 90, 180, 3), 0.1)
    recorded[40:], recorded[60:] = -1e-4, np.nan
    table = brdf_table(recorded, "centre")
    done = corrected(table, recorded < 0, np.full(table.shape, 0.01), 1.0)
    np.testing.assert_array_equal(supported_values(done, table).values, np.where(recorded < 0, 0.0, recorded))


def test_the_mean_of_noise_about_0_remains():
    """Far from a highlight the record is noise about a faint body: its albedo may not increase by the correction."""
    noise = np.random.default_rng(1).normal(0.01, 0.1, (90, 90, 180, 3))
    table = brdf_table(noise, "centre")
    lobe = ratio_of(np.zeros((90, 90, 180, 1)), 0.01)
    found = SimpleNamespace(
        body=lambda *angles: (np.full((*np.broadcast(*angles).shape, 3), 0.01), 0.0), theta_d=np.zeros(9),
        freedom=9, noise_given=True, base=None, diffuse_part=SimpleNamespace(albedo=(0.03,), coated=0.0),
    )  # fmt: skip
    dark, share = SimpleNamespace(of=lambda rows: 0.0), np.ones((90, 90, 180))
    done, _, _ = corrected_table(table, found, PixelNoise(0.0, 0.1, 0.0), share, lobe, dark, 0.0)
    np.testing.assert_allclose(done["brdf"].values, noise, atol=1e-12)
    raised = albedo(supported_values(done, table).values) - albedo(noise)
    (remark,) = zeroed_noise(table)
    assert f"{raised[:80].max():.2f}" in remark.text
    assert "46% of the recorded entries" in remark.text
    assert zeroed_noise(abs(table)) == ()


def test_a_file_does_not_keep_the_light_of_a_highlight_beside_the_corrected_one():
    """A camera spread 1000 1/sr over five rings; the surface reflects 5000 1/sr in one ring, and 1e-6 ± 10 1/sr beside it."""
    blurred = np.zeros((90, 90, 180, 3))
    blurred[:5] = 1000.0
    true = np.zeros_like(blurred)
    true[0], true[1:5] = 5000.0, 1e-6
    std = np.full(blurred.shape, np.nan)
    std[:5] = 0.01
    response = np.ones(blurred.shape)
    response[:5] = blurred[:5] / true[:5]
    table = brdf_table(blurred, "centre")
    done = corrected(table.copy(data=true), true > 1.0, std, response)
    np.testing.assert_array_equal(supported_values(done, table).values, true)


def test_what_a_rig_says_of_its_lens():
    guess = known_lens(rigs.merl().camera)
    assert guess.uncertainty.std() == {LENS: 0.5}
    assert (guess.assumed, guess.exact) == (False, False)
    assert guess.words == "assumed lens blur 0.50 ± 0.50 px; measure it with matcam calibrate"
    measured = known_lens(Camera(GaussianOptics(0.51), uncertainty=Uncertainty.of({LENS: 0.01})))
    assert measured.words == "lens blur 0.510 ± 0.010 px"
    nothing = known_lens(Camera(GaussianOptics(0.4)))
    assert nothing.assumed
    assert nothing.uncertainty.std()[LENS] == pytest.approx(0.04)
    other = known_lens(Camera(DiffractionOptics(8.0, 550e-9, 5e-6)))
    assert other.uncertainty.std() == {"optics.f_number": pytest.approx(0.8)}
    assert other.words == (
        "f-number 8.00 ± 0.80; no uncertainty is specified, so a standard deviation of 10% is assumed"
    )
    colours = known_lens(Camera(ColourOptics(*(GaussianOptics(sigma) for sigma in (0.5, 0.4, 0.3)))))
    assert colours.words.startswith("lens blur of red 0.500 ± 0.050 px, lens blur of green 0.400 ± 0.040 px, ")
    exact = known_lens(Camera(GaussianOptics(0.4), uncertainty=Uncertainty.of({LENS: 0.0})))
    assert exact.exact
    assert exact.words == "lens blur 0.4 px, specified as exact"


def test_a_guess_that_no_data_confirm_moves_nothing():
    """rigs.merl() guesses its lens; a lens known to 3 % is there whether or not a broad lobe shows it."""
    for rig, undecided in ((rigs.merl(), True), (recorded.rig(std=0.015), False), (recorded.rig(), False)):
        for no_camera, asked in ((0.2, undecided), (1e-3, False)):
            found = SimpleNamespace(located=SimpleNamespace(rig=rig), no_camera=no_camera)
            assert Explanation.undecided.fget(found) == asked


def test_an_estimated_noise_at_its_limit_contradicts_the_rig():
    """An estimate of 20 % means that no lobe explains the data. A specified noise of 20 % does not."""
    for relative, given, contradicts in ((0.2, False, True), (0.1, False, False), (0.2, True, False)):
        fitted = SimpleNamespace(noise=PixelNoise(relative, 1e-4, 0.0), noise_given=given)
        found = SimpleNamespace(located=SimpleNamespace(unexplained=False), no_blur=False, refits=(), fit=fitted)
        assert Explanation.contradicts.fget(found) == contradicts


def test_a_guess_may_be_no_lens_at_all_and_a_lens_without_a_statement_is_asked_of_the_data():
    """True widths 0.44 px and 0.1 px; the rigs say 0.5."""
    for sigma, rig in ((0.44, Rig(Camera(GaussianOptics(0.5)), Sphere(256.0))), (0.1, rigs.merl())):
        shot = recorded.made(EVERY, oracle.Setup(sigma=sigma))
        directions = (
            shot.rule.directions(oracle.GGX(0.004)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
        )
        found = fit(
            shot.table(shot.rule.noisy(directions, np.random.default_rng(3))), rig, fresnel="free", slice_step=EVERY
        )
        square, std = (
            found.squared_width(LENS) if sigma == 0.1 else (found.params[LENS] ** 2, 2 * sigma * found.std[LENS])
        )
        assert abs(square - sigma**2) < 4 * std < 0.02
        assert abs(found.params["alpha"] - 0.004) < 4 * found.std["alpha"]
        said = [remark.code for remark in found.remarks]
        assert ("lens-assumed" in said) == (sigma == 0.44)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lens", "names", "left"),
    [
        (oracle.disc(), (SHAPE,), 0.2),
        (oracle.disc(), (SHAPE, SIXTH), 0.15),
        (oracle.disc(), (SHAPE, SIXTH, EIGHTH), 0.02),
        (oracle.coma(), (STRETCH,), 0.55),
        (oracle.coma(angle=np.pi / 2), (STRETCH,), 0.55),
    ],
)
def test_a_lens_is_changed_towards_another_one(lens, names, left):
    """Coordinates that turn the record of one lobe into that through another lens do so for other lobes, too."""
    shot = recorded.made(EVERY, lens)
    rig = rigs.merl()
    axes = (free_axis(LENS, rig), *(axis for axis in shape_axes(rig)[0] if axis.name in names))
    _, operator = lobe_operator(rig, "centre", EVERY, axes)
    steps = np.diag([0.01, *np.ones(len(names))])

    def differences(lobe, ndf):
        """Difference of the true record from that of the Gaussian lens, and how the latter changes by each axis."""
        truth = shot.rule.directions(lobe).mean(-1)
        peak = np.nan_to_num(truth).max(axis=1, keepdims=True)
        bright = np.isfinite(truth) & shot.cells.valid & (truth > 1e-3 * peak)
        own, *moved = (
            np.asarray(operator.record(ndf, "smith", jnp.asarray(at))) for at in (np.zeros(len(steps)), *steps)
        )
        noise = np.hypot(0.01 * truth, 1e-4 * peak)
        return ((truth - own) / noise)[bright], np.stack([((one - own) / noise)[bright] for one in moved], axis=-1)

    off, slopes = differences(oracle.GGX(0.006), GGX(0.006))
    found = np.linalg.lstsq(slopes, off, rcond=None)[0]
    off, slopes = differences(oracle.EPD(0.004, 1.0), EPD(0.004, 1.0))
    before, after = (np.sqrt(np.mean(one**2)) for one in (off, off - slopes @ found))
    print(f"difference in standard deviations of 1 %: {before:.3f}, with {names} {found[1:]} {after:.3f}")
    assert after < left * before


@pytest.mark.slow
def test_a_measured_lens_is_known_to_ten_percent():
    """Its profile states no uncertainty. The table was recorded through a lens that is 11 % wider than measured."""
    shot = recorded.made(EVERY, oracle.Setup(0.5))
    directions = (
        shot.rule.directions(oracle.GGX(0.006)) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    )
    table = shot.table(shot.rule.noisy(directions, np.random.default_rng(3)))
    f = np.linspace(0, 2.2, 45)
    lens = MeasuredOptics(f, np.append(np.exp(-2 * (np.pi * 0.45 * f[:-1]) ** 2), 0.0))
    rig = Rig(Camera(lens, recorded.rig().camera.pixel), recorded.rig().sample)
    found = fit(table, rig, "ggx", fresnel="free", slice_step=EVERY)
    print(found.params, found.std)
    assert found.params["lens_width"] == pytest.approx(np.log(0.5 / 0.45), abs=0.01)
    assert found.params["alpha"] == pytest.approx(0.006, rel=0.02)
    assert "lens-assumed" in {remark.code for remark in found.remarks}


def changes(recorded_table, done):
    """Relative change of every entry that is written to a file of values alone."""
    before = recorded_table.values
    after = supported_values(done.table, recorded_table).values
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.abs(after / before - 1)
    return np.where(np.isfinite(change), change, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "material",
    ["specular-red-phenolic", "black-obsidian", "chrome", "teflon", "gold-metallic-paint", "pink-fabric", "nickel"],
)
def test_a_stand_in_is_not_harmed(stand_in, material):
    """One lobe for all theta_d: no camera was there, so no peak may be raised, whatever the rig says."""
    table = read_merl(stand_in(material))
    done = Correction.of(table, rigs.merl())
    change, supported = changes(table, done), done.table["supported"].values
    print(f"{material}: {done.determination}, supported {supported.mean():.2f}, largest change {change.max():.4f}")
    assert change[~supported].max(initial=0) == 0
    assert change.max() < 0.01
    before, after = (albedo(one) for one in (table.values, supported_values(done.table, table).values))
    assert np.all(after <= np.maximum(before, 1) + 1e-9)
    raised = np.nan_to_num(done.table["brdf"].values / table.values - 1)
    assert np.all((raised <= 2 * np.nan_to_num(done.table["correction_std"].values) + 1e-9) | ~supported)


@pytest.mark.slow
@pytest.mark.parametrize(
    "material",
    ["paper_white", "satin_rosaline", "cc_ibiza_sunset", "vch_golden_yellow"],
)
def test_a_goniophotometers_table_is_left_alone(goniophotometer, material):
    """No camera has seen it; the virtual rig's sphere is so small that its lens would show."""
    table = read_merl(goniophotometer(material))
    done = Correction.of(table, Rig(rigs.merl().camera, Sphere(24.0)))
    change = changes(table, done).max()
    print(f"{material}: {done.determination}, largest change {change:.4f}")
    assert change < 0.01
