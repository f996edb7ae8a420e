"""A rough base under a coat, as in car paint and lacquer: its BRDF, and fits of tables that show it. Truth is the oracle's."""

import numpy as np
import pytest

from matcam.inverse import FitSetup
from matcam.inverse.fit.base_lobe import Base
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle import whole_tables

INDEX, ALPHA, REFLECTANCE = 1.5, 0.15, 0.3


def base_of(theta_h, theta_d, phi_d):
    """BRDF of the oracle's base, 1/sr, and the smaller cosine."""
    mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    cos_i, cos_o = mean - half, mean + half
    light = whole_tables.Base(oracle.GGX(ALPHA), (1.0,), INDEX).light(np.tan(theta_h) ** 2, cos_i, cos_o)
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


@pytest.fixture(scope="module")
def table():
    """Table of a Beckmann coat over the base, one channel, with noise."""
    shot = recorded.made(18, oracle.Setup())
    cells = shot.cells
    coat = shot.rule.directions(oracle.EPD(0.002, 1.0)) * 0.04
    base, cosine = base_of(
        recorded.GRID.theta_h[cells.i_theta_h], cells.theta_d[:, None], recorded.GRID.phi_d[cells.i_phi_d]
    )
    base = np.where(cells.valid & (cosine > 0), REFLECTANCE * base, 0.0)
    return shot.table(shot.rule.noisy(coat + base[..., None], np.random.default_rng(5)))


def fitted(table, **more):
    return FitSetup((table,), recorded.rig(), "epd", fresnel="free", diffuse=True, slice_step=18, **more).solve()


def test_a_fit_finds_coat_and_base(table):
    found = fitted(table, base=True)
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


def test_the_body_of_a_fit_is_base_and_lambertian_part(table):
    """Its standard deviation is the propagated one: by differences of its parameters."""
    found = fitted(table, base=True)
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
