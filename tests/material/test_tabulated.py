"""A MERL table as a material: SciPy's interpolation, the samples themselves, and what is missing."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from matcam import GGX, Conductor, Microfacet
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, below_horizon, brdf_table, cosines, merl_grid, theta_h_edges
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading
from matcam.material import Tabulated
from matcam.material.material import shading_at

SMOOTH = Microfacet(GGX(0.4), Conductor([0.2, 1.0, 2.0], 3.0), diffuse=0.1)


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(1).uniform(0.5, 1.5, (*GRID_SHAPE, 3))


def _angles(count, seed):
    random = np.random.default_rng(seed)
    angles = (
        np.pi / 2 * random.uniform(0, 1, count) ** 2,
        random.uniform(0, np.pi / 2, count),
        random.uniform(-7, 7, count),
    )
    above = np.minimum(*cosines(*angles)) > 1e-3
    return tuple(a[above] for a in angles)


@pytest.mark.parametrize("sampling", ["centre", "edge"])
def test_interpolation_is_scipys(noise, sampling):
    """On noise, so that every neighbour counts; the grid padded as the docstring says."""
    grid = merl_grid(sampling)
    padded = np.pad(
        np.concatenate([noise[:, :, -1:], noise, noise[:, :, :1]], axis=2), ((1, 1), (1, 1), (0, 0), (0, 0)), "edge"
    )
    axes = (
        np.concatenate([[-1], np.sqrt(grid.theta_h), [2]]),
        np.concatenate([[-1], grid.theta_d, [2]]),
        np.concatenate([[grid.phi_d[0] - np.pi / 180], grid.phi_d, [grid.phi_d[-1] + np.pi / 180]]),
    )
    theta_h, theta_d, phi_d = _angles(3000, 2)
    expected = RegularGridInterpolator(axes, padded)((np.sqrt(theta_h), theta_d, np.mod(phi_d, np.pi)))
    ours = Tabulated(brdf_table(noise, sampling)).brdf(theta_h, theta_d, phi_d)
    np.testing.assert_allclose(ours, expected, rtol=1e-9)


@pytest.mark.parametrize("sampling", ["centre", "edge"])
def test_the_samples_come_back_and_what_is_missing_stays(noise, sampling):
    missing = below_horizon(sampling)
    values = np.where(missing[..., None], np.nan, noise)
    grid = np.meshgrid(*merl_grid(sampling), indexing="ij")
    back = np.asarray(Tabulated(brdf_table(values, sampling)).brdf(*grid))
    # at grazing angles a sampling point may be above the horizon by no more than rounding
    clear = np.abs(np.minimum(*cosines(*grid))) > 1e-12
    np.testing.assert_allclose(back[clear], values[clear], rtol=1e-6)


def test_a_missing_cell_does_not_poison_its_neighbours(noise):
    i_h, i_d, i_p = 20, 30, 40
    values = noise.copy()
    values[i_h, i_d, i_p, 1] = np.nan
    material = Tabulated(brdf_table(values, "centre"))
    whole = Tabulated(brdf_table(noise, "centre"))

    def at(dh, dd, dp):
        angles = (
            ((i_h + 0.5 + dh) / 90) ** 2 * np.pi / 2,
            (i_d + 0.5 + dd) / 180 * np.pi,
            (i_p + 0.5 + dp) / 180 * np.pi,
        )
        return np.asarray(material.brdf(*angles)), np.asarray(whole.brdf(*angles))

    holed, full = at(0.4, -0.4, 0.3)
    assert np.isnan(holed[1])
    np.testing.assert_array_equal(holed[[0, 2]], full[[0, 2]])
    holed, full = at(0.6, 0.0, 0.0)  # 40 % of the missing cell: the rest is the one neighbour
    assert holed[1] == pytest.approx(noise[i_h + 1, i_d, i_p, 1], rel=1e-9)
    holed, full = at(0.7, 0.2, -0.2)
    around = noise[i_h : i_h + 2, i_d : i_d + 2, i_p - 1 : i_p + 1, 1]
    assert np.isfinite(holed).all()
    assert around.min() < holed[1] < around.max()
    holed, full = at(1.0, 0.3, 0.3)
    np.testing.assert_allclose(holed, full, rtol=1e-9)


def test_a_table_of_a_smooth_material_is_that_material():
    """Linear interpolation on cells of one degree: h^2 / 8 times second derivatives, which grow as 2 / cos^2."""
    grid = np.meshgrid(*merl_grid("centre"), indexing="ij")
    material = Tabulated(brdf_table(np.asarray(SMOOTH.brdf(*grid)), "centre"))
    theta_h, theta_d, phi_d = _angles(4000, 3)
    inner = (np.minimum(*cosines(theta_h, theta_d, phi_d)) > 0.3) & (theta_h > 1e-4)
    ours, true = (np.asarray(m.brdf(theta_h, theta_d, phi_d))[inner] for m in (material, SMOOTH))
    np.testing.assert_allclose(ours, true, rtol=2e-3)


def test_peak_and_grazing_cells_hold_their_value(noise):
    material = Tabulated(brdf_table(noise, "centre"))
    for theta_h in (0.0, 1e-9, 4e-5):
        np.testing.assert_allclose(
            material.brdf(theta_h, 0.5 / 180 * np.pi, 0.5 / 180 * np.pi), noise[0, 0, 0], rtol=1e-9
        )
    np.testing.assert_allclose(material.brdf(0.0, np.radians(89.9), 0.5 / 180 * np.pi), noise[0, 89, 0], rtol=1e-9)
    assert float(material.finest) == theta_h_edges()[1]


def test_reciprocity(noise):
    material = Tabulated(brdf_table(noise, "centre"))
    theta_h, theta_d, phi_d = _angles(300, 4)
    one, other = (material.brdf(theta_h, theta_d, phi) for phi in (phi_d, phi_d + np.pi))
    np.testing.assert_allclose(one, other, rtol=1e-9)


def test_reflected_is_0_below_the_horizon_and_differentiable(noise):
    values = np.where(below_horizon("centre")[..., None], np.nan, noise)
    material = Tabulated(brdf_table(values, "centre"))
    seen = Shading(
        cos_i=jnp.asarray([0.5, -0.3, 0.0, 0.9]),
        cos_o=jnp.asarray([0.5, 0.5, 0.5, 0.9]),
        slope_along=jnp.asarray([0.0, jnp.inf, 0.3, 0.01]),
        slope_across=jnp.asarray([0.0, 1.0, 0.3, 0.0]),
        theta_d=jnp.asarray([1.0, 0.8, 0.8, 0.4]),
        phi_d=jnp.asarray([0.3, 0.3, 0.3, 0.3]),
    )
    reflected = np.asarray(material.reflected(seen))
    assert reflected.shape == (4, 3)
    np.testing.assert_array_equal(reflected[1:3], 0)
    assert np.all(reflected[[0, 3]] > 0)
    slopes = jax.grad(lambda seen: jnp.sum(material.reflected(seen)))(seen)
    assert all(np.all(np.isfinite(s)) for s in slopes)
    one_theta_d = shading_at(np.linspace(0, 1, 7), 0.4, 0.2)
    assert material.reflected(one_theta_d).shape == (7, 3)


def test_refusals(noise):
    with pytest.raises(ArgumentError, match=r"must be an xarray.DataArray \(see read_merl\), got ndarray"):
        Tabulated(noise)
    table = brdf_table(noise, "centre")
    del table.attrs["sampling"]
    with pytest.raises(ArgumentError, match="sampling"):
        Tabulated(table)
