"""Tables through a lens with its own blur in each colour, recorded by the oracle: fits, `correct` and `fresnel`."""

import numpy as np
import pytest
import xarray as xr

from matcam import Camera, ColourOptics, GaussianOptics, Rig, Sphere, fit, fresnel, limits
from matcam.camera import PixelNoise, Uncertainty
from matcam.core.errors import ArgumentError
from matcam.inverse import Correction, FitSetup
from matcam.inverse.correction.evidence import channel_misfit
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H, conductor
from tests.oracle.whole_tables import Case, Facets, simulate

SIGMAS = (0.7, 0.5, 0.4)
METALS = ((0.21, 3.67), (0.96, 2.58), (1.18, 2.45))
EVERY, LOBE, NOISE = 18, oracle.GGX(0.004), PixelNoise(1e-3, 1e-5)


def rig(sigmas=SIGMAS, relative=0.0, **more):
    """Each width known to `relative`."""
    names = [f"optics.{colour}.sigma_px" for colour in ("red", "green", "blue")]
    known = Uncertainty.of({name: relative * sigma for name, sigma in zip(names, sigmas, strict=True)})
    lens = ColourOptics(*map(GaussianOptics, sigmas), **more)
    return Rig(Camera(lens, uncertainty=known), Sphere(256.0))


@pytest.fixture(scope="module")
def table():
    """Without noise."""
    channels = []
    for sigma, metal in zip(SIGMAS, METALS, strict=True):
        shot = recorded.made(EVERY, oracle.Setup(sigma))
        values = shot.rule.directions(LOBE).mean(-1) * conductor(shot.cells.theta_d, *metal)[:, None]
        channels.append(shot.table(values))
    return xr.concat(channels, "channel").transpose(..., "channel").assign_coords(channel=list("RGB"))


def test_each_channel_is_fitted_through_its_lens(table):
    found = fit(table, rig(), noise=NOISE, slice_step=EVERY)
    assert found.params["alpha"] == pytest.approx(LOBE.alpha, rel=3e-5)
    for channel, (n, k) in zip("RGB", METALS, strict=True):
        assert found.params[f"n[{channel}]"] == pytest.approx(n, rel=2e-3)
        assert found.params[f"k[{channel}]"] == pytest.approx(k, rel=2e-3)
    green = fit(table, rig().colours[1], slice_step=EVERY)
    assert not green.explained  # one lens is wrong for two of the channels
    assert channel_misfit(found, NOISE) < NOISE.relative < 0.03 < channel_misfit(green, NOISE)


def test_the_widths_have_a_common_factor(table):
    """All lenses are stated as 5 % too narrow."""
    found = fit(table, rig([sigma / 1.05 for sigma in SIGMAS], relative=0.05), noise=NOISE, slice_step=EVERY)
    assert found.params["lens_width"] == pytest.approx(np.log(1.05), abs=4 * found.std["lens_width"])
    assert found.params["alpha"] == pytest.approx(LOBE.alpha, abs=4 * found.std["alpha"])
    assert found.std["lens_width"] < 0.01


def test_priors_are_those_of_the_camera(table):
    """The largest of the widths' relative errors, and other parameters' own."""
    stds = {"optics.red.sigma_px": 0.007, "optics.green.sigma_px": 0.02, "pixel.half_width_px": 0.01}
    known = Rig(Camera(rig().camera.optics, uncertainty=Uncertainty.of(stds)), Sphere(256.0))
    prior = FitSetup((table,), known).prior
    assert [axis.name for axis in prior.axes] == ["lens_width", "pixel.half_width_px"]
    np.testing.assert_allclose(prior.root, np.diag([1 / 0.04, 1 / 0.02]))


def test_what_is_refused(table):
    for what, match in (
        (lambda: fit(table.isel(channel=[0]), rig()), "must have 3 channels"),
        (lambda: fit(table, rig(red_shift=(0.1, 0.0))), "without lateral colour"),
        (lambda: fit(table, rig(), camera_parameters="free"), "cannot be free if each colour"),
        (lambda: limits(rig()), "Gaussian lens, got ColourOptics"),
    ):
        with pytest.raises(ArgumentError, match=match):
            what()


@pytest.mark.slow
def test_a_whole_table_is_corrected():
    """Copper behind three lenses that are known to 3 %."""
    case = Case("colours", (Facets(LOBE, *zip(*METALS, strict=True)),))
    shots = [simulate(case._replace(setup=oracle.Setup(sigma)), seed=n) for n, sigma in enumerate(SIGMAS)]
    values, clean, true = (
        np.stack([getattr(shot, part)[..., n] for n, shot in enumerate(shots)], axis=-1)
        for part in ("recorded", "clean", "true")
    )
    coords = {"theta_h": THETA_H, "theta_d": THETA_D, "phi_d": PHI_D, "channel": list("RGB")}
    behind = xr.DataArray(values, dims=tuple(coords), coords=coords, attrs={"sampling": "centre"})
    done = Correction.of(behind, rig(relative=0.03))
    assert done.table["response"].dims == behind.dims
    peaks = np.s_[0, 5:81, 90]
    value, std, supported = (done.table[name].values for name in ("brdf", "brdf_std", "supported"))
    assert supported[peaks].mean() > 0.95
    assert np.abs(value[peaks] / true[peaks] - 1).mean() < 0.02
    response = done.table["response"].values[peaks]
    np.testing.assert_allclose(response, (clean / true)[peaks], rtol=0.02)
    judged = np.isfinite(std) & (true > 1e-9) & supported
    pull = np.abs(value - true)[judged] / std[judged]
    assert np.mean(pull > 3) < 0.01
    budget = done.uncertainty_budget(np.radians(45.0), 0)
    assert budget.combined == pytest.approx(std[0, 45, 90, 0], rel=1e-6)

    green = Correction.of(behind, rig(relative=0.03).colours[1])
    assert "channels-differ" in [remark.code for remark in green.remarks]
    assert "channels-differ" not in [remark.code for remark in done.remarks]
    value, std, supported = (green.table[name].values for name in ("brdf", "brdf_std", "supported"))
    judged = np.isfinite(std) & (true > 1e-9) & supported
    pull = np.abs(value - true)[judged] / std[judged]
    assert np.mean(pull > 3) < 0.03

    wrong = fresnel(behind, rig(relative=0.03).colours[1])
    expected = case.terms[0].factor(wrong["theta_d"].values)
    normal = (np.degrees(wrong["theta_d"].values) > 10) & (np.degrees(wrong["theta_d"].values) < 45)
    pull = (wrong["corrected"].values - expected / expected[normal].mean(axis=0)) / wrong["corrected_std"].values
    assert np.sqrt(np.nanmean(pull[50:80] ** 2)) < 1
    total = np.sqrt((wrong["budget_std"].values ** 2).sum(axis=0))
    np.testing.assert_allclose(total, wrong["corrected_std"].values, rtol=1e-6)

    curve = fresnel(behind, rig(relative=0.03))
    assert curve["response"].dims == ("theta_d", "channel")
    np.testing.assert_allclose(curve["response"].values[5:81], (clean / true)[peaks], rtol=0.02)
    expected = case.terms[0].factor(curve["theta_d"].values)
    normal = (np.degrees(curve["theta_d"].values) > 10) & (np.degrees(curve["theta_d"].values) < 45)
    expected = expected / expected[normal].mean(axis=0)
    ratio = curve["corrected"].values / expected
    assert np.sqrt(np.nanmean((ratio[:80] - 1) ** 2)) < 0.015  # the gains of the images alone are 1 %
