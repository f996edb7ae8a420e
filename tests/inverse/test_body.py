"""The body below a lobe: diffuse, in part under a coat, and a rough base under a coat. Truth is the oracle's."""

import numpy as np
import pytest
import xarray as xr

from matcam.camera import PixelNoise
from matcam.inverse import FitSetup
from matcam.inverse.correction.corrected_table import corrected_table, recorded_table
from matcam.inverse.correction.correction_limits import LobeRatio
from matcam.inverse.correction.farthest_glare import FarthestGlare
from matcam.inverse.fit.body import Base, DiffusePart
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle import whole_tables
from tests.oracle.merl_lobe import conductor

INDEX, ALPHA, REFLECTANCE = 1.5, 0.15, 0.3


def base_of(theta_h, theta_d, phi_d, alpha=ALPHA):
    """BRDF of the oracle's base, 1/sr, and the smaller cosine."""
    mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    cos_i, cos_o = mean - half, mean + half
    light = whole_tables.Base(oracle.GGX(alpha), (1.0,), INDEX).light(np.tan(theta_h) ** 2, cos_i, cos_o)
    return light / (4 * cos_i * cos_o), np.minimum(cos_i, cos_o)


def test_a_base_has_the_light_of_the_oracle():
    random = np.random.default_rng(3)
    theta_h, theta_d, phi_d = random.uniform(0, [[0.6], [1.3], [np.pi]], (3, 1000))
    truth, cosine = base_of(theta_h, theta_d, phi_d)
    seen = cosine > 0.01
    found = Base(ALPHA, (1.0, 0.0)).brdf(theta_h, theta_d, phi_d)
    assert seen.sum() > 500
    np.testing.assert_allclose(found[seen, 0], truth[seen], rtol=1e-9)
    assert not found[..., 1].any()


def table_of(alpha):
    """Table of a Beckmann coat over a base, one channel, with noise."""
    shot = recorded.made(18, oracle.Setup())
    cells = shot.cells
    coat = shot.rule.directions(oracle.EPD(0.002, 1.0)) * 0.04
    base, cosine = base_of(
        recorded.GRID.theta_h[cells.i_theta_h], cells.theta_d[:, None], recorded.GRID.phi_d[cells.i_phi_d], alpha
    )
    base = np.where(cells.valid & (cosine > 0), REFLECTANCE * base, 0.0)
    return shot.table(shot.rule.noisy(coat + base[..., None], np.random.default_rng(5)))


@pytest.fixture(scope="module")
def table():
    return table_of(ALPHA)


def fitted(table, **more):
    return FitSetup((table,), recorded.rig(), "epd", fresnel="free", diffuse=True, slice_step=18, **more).solve()


@pytest.fixture(scope="module")
def coated(table):
    return fitted(table, base=True)


def test_a_fit_finds_coat_and_base(coated):
    found = coated
    print({name: (round(value, 5), round(found.std[name], 5)) for name, value in found.params.items()}, found.noise)
    truth = {"beta": 0.002, "power": 1.0, "base_alpha": ALPHA, "base[G]": REFLECTANCE}
    for name, value in truth.items():
        assert abs(found.params[name] - value) < 4 * found.std[name], name
    assert found.std["base_alpha"] < 0.02 * ALPHA
    assert found.noise.relative == pytest.approx(0.01, rel=0.3)
    assert found.base is not None
    assert found.base.roughness == pytest.approx(found.params["base_alpha"])


def test_without_a_base_the_fit_leaves_more_than_noise(table):
    found = fitted(table)
    assert found.noise.floor > 10e-4
    assert found.base is None


def test_a_base_at_the_smallest_roughness_has_a_remark(coated):
    found = fitted(table_of(0.02), base=True)
    assert found.params["base_alpha"] == pytest.approx(8 / 256, rel=0.05)
    assert "base-too-narrow" in {remark.code for remark in found.remarks}
    assert "base-too-narrow" not in {remark.code for remark in coated.remarks}


def test_the_body_of_a_fit_is_base_and_lambertian_part(coated):
    """Its standard deviation is the propagated one: by differences of its parameters."""
    found = coated
    angles = np.array([0.05, 0.3]), np.array([0.4, 0.9]), np.array([1.5, 1.0])
    value, std = found.body(*angles)
    names = ["base_alpha", "diffuse[G]", "base[G]"]
    at = [list(found.params).index(name) for name in names]

    def body(alpha, diffuse, reflectance):
        return diffuse / np.pi + Base(alpha, (reflectance,)).brdf(*angles)[:, 0]

    fitted_values = np.array([found.params[name] for name in names])
    np.testing.assert_allclose(value[:, 0], body(*fitted_values), rtol=1e-9)
    steps = np.diag(1e-4 * np.maximum(fitted_values, 1e-3))
    slopes = [(body(*(fitted_values + s)) - body(*(fitted_values - s))) / (2 * s.sum()) for s in steps]
    covariance = found.covariance[np.ix_(at, at)]
    np.testing.assert_allclose(std[:, 0], np.sqrt(np.einsum("ka,kl,la->a", slopes, covariance, slopes)), rtol=1e-4)


def transmitted(cosine):
    return 1 - conductor(np.arccos(np.clip(cosine, 0, 1)), INDEX, 0.0)


def test_a_coat_takes_what_the_oracle_takes():
    theta_h, theta_d, phi_d = np.random.default_rng(4).uniform(0, [[1.4], [1.4], [np.pi]], (3, 2000))
    mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    cosines = mean - half, mean + half
    seen = np.minimum(*cosines) > 0.01
    truth = transmitted(cosines[0]) * transmitted(cosines[1]) / transmitted(1.0) ** 2 / np.pi
    found = DiffusePart((1.0, 0.0), 1.0).brdf(theta_h, theta_d, phi_d)
    assert seen.sum() > 500
    np.testing.assert_allclose(found[seen, 0], truth[seen], rtol=1e-9)
    assert not found[..., 1].any()
    np.testing.assert_allclose(DiffusePart((0.4,)).brdf(theta_h, theta_d, phi_d), 0.4 / np.pi)


@pytest.mark.parametrize(("albedo", "coated"), [(0.3, True), (0.3, False), (0.0, False)])
def test_data_determine_how_much_of_a_body_is_coated(albedo, coated):
    """A polished plastic, a Lambertian body below a lobe, and a metal, which tells nothing of a body that it lacks."""
    shot = recorded.pictures(18)
    f = conductor(shot.cells.theta_d, *((INDEX, 0.0) if albedo else recorded.CHROMIUM))
    body = shot.rule.body(transmitted) if coated else shot.rule.body()
    light = f[:, None, None] * shot.rule.directions(oracle.GGX(0.01)) + albedo * body
    table = shot.table(shot.rule.noisy(light, np.random.default_rng(6)))
    setup = FitSetup((table,), recorded.rig(), "ggx", fresnel="free", diffuse=True, coated=True, slice_step=18)
    found = setup.solve()
    share, std = found.params["coated_share"], found.std["coated_share"]
    if albedo:
        assert std < 0.05
        assert abs(share - coated) < max(4 * std, 0.05)
        assert found.diffuse_part.coated == share
    else:
        assert share == pytest.approx(0.5, abs=0.1)
        assert std == pytest.approx(0.3, rel=0.05)
    angles = np.array([0.3, 0.7]), np.array([0.6, 0.2]), np.array([1.0, 2.0])
    value, of_body = found.body(*angles)
    np.testing.assert_allclose(value, found.diffuse_part.brdf(*angles), rtol=1e-9, atol=1e-12)
    assert np.all(of_body > 0)


def test_a_body_keeps_the_detail_of_the_measurement_under_a_blurred_highlight(coated):
    """The light of the highlight beside it is as bright as the body, the camera records 0.8 of the base, and the entries of
    some rings are 10 % above the fit. The corrected values there are 10 % above the body, within the standard deviation."""
    shape = (90, 90, 180)
    blurred, log = np.zeros((*shape, 1)), np.zeros((*shape, 1))
    angles = recorded.GRID.theta_h[:, None, None], recorded.GRID.theta_d[:, None], recorded.GRID.phi_d
    body, _ = coated.body(*angles)
    base = np.full(blurred.shape, 0.8)
    recorded_body = body - 0.2 * coated.base.brdf(*angles)
    blurred[:20] = body[:20]
    blurred[0] *= 1e4
    log[0], log[1:] = np.log(2.0), -30.0  # the true lobe is narrower than a ring
    values = blurred + recorded_body
    values[10:20] *= 1.1
    ratio = LobeRatio(log, 0 * log, np.ones(log.shape, bool), blurred, base, 0 * log)
    table = xr.DataArray(values, dims=("theta_h", "theta_d", "phi_d", "channel"), attrs={"sampling": "centre"})
    none = FarthestGlare(np.zeros((90, 1)), np.zeros(shape))
    done, _, _ = corrected_table(table, coated, PixelNoise(0.001, 1e-9, 0.0), np.ones(shape), ratio, none, 0.0)
    within = slice(12, 18), slice(0, 60)
    found, std, true = (array[within] for array in (done["brdf"].values, done["brdf_std"].values, 1.1 * body))
    np.testing.assert_allclose(found, true, rtol=1e-3)
    assert (std > 0.03 * true).all()
    np.testing.assert_allclose(done["brdf"].values[2:8, :60], body[2:8, :60], rtol=1e-3)
    np.testing.assert_allclose(recorded_table(done).values[within], values[within], rtol=1e-9)
