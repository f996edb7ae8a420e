"""The record of a lobe around its peak, at every cell of a table, against the oracle and against the material itself."""

import numpy as np
import pytest

from matcam import GGX, Conductor, GaussianNDF, Microfacet, Rig, Sphere, rigs
from matcam.core.grid import below_horizon, brdf_table, merl_grid
from matcam.forward.peaks.tangent_plane import lobe_record
from tests.oracle import merl_lobe


def table_of(material, rig, sampling="centre"):
    """BRDF in which the material's D is replaced by its record in the tangent plane, for a material without masking."""
    grid, ndf, radius = merl_grid(sampling), material.ndf, float(rig.sample.radius)
    theta_h, phi_d = (a.ravel() for a in np.meshgrid(grid.theta_h, grid.phi_d, indexing="ij"))
    # a Gaussian is one in the angle, GGX in the slope, of which it loses cos^-4
    r, flattening = (theta_h, 1.0) if isinstance(ndf, GaussianNDF) else (np.tan(theta_h), np.cos(theta_h) ** -4)
    x = -radius * np.cos(grid.theta_d)[:, None] * r * np.cos(phi_d)
    y = np.tile(radius * r * np.sin(phi_d), (90, 1))
    lobe = np.asarray(ndf.d(0.0)) * flattening * np.asarray(lobe_record(rig, ndf, grid.theta_d, x, y))
    angles = theta_h, grid.theta_d[:, None], phi_d
    broad = GGX(0.3)
    beside = np.asarray(Microfacet(broad, material.fresnel, masking=None).brdf(*angles)) / np.asarray(
        broad.d(theta_h)[:, None]
    )
    values = beside * lobe[..., None] + np.asarray(material.diffuse) / np.pi
    values = values.reshape(90, 90, 180, -1).transpose(1, 0, 2, 3)
    return brdf_table(np.where(below_horizon(sampling)[..., None], np.nan, values), sampling)


def test_every_cell_is_the_oracles_record():
    n, k = np.array([3.3, 2.9, 2.3]), np.array([4.3, 4.2, 3.9])
    ours = table_of(Microfacet(GaussianNDF(0.002), Conductor(n, k), masking=None), rigs.merl())
    truth = merl_lobe.record(0.002, merl_lobe.conductor(merl_lobe.THETA_D[:, None], n, k))
    np.testing.assert_allclose(ours.values, truth, rtol=1e-9, atol=1e-12 * np.nanmax(truth))
    np.testing.assert_array_equal(np.isnan(truth[..., 0]), below_horizon("centre"))
    assert ours.dims == ("theta_h", "theta_d", "phi_d", "channel")
    assert ours.attrs["sampling"] == "centre"


@pytest.mark.slow
def test_far_from_the_camera_the_table_is_the_material():
    """A lobe much wider than the kernel is recorded as it is, diffuse part included."""
    material = Microfacet(GGX(0.3), [0.5, 0.6, 0.7], diffuse=[0.1, 0.0, 0.3], masking=None)
    table = table_of(material, Rig(rigs.merl().camera, Sphere(20000.0)), sampling="edge")
    grid = merl_grid("edge")
    true = material.brdf(grid.theta_h[::9, None, None], grid.theta_d[None, ::9, None], grid.phi_d[None, None, ::30])
    np.testing.assert_allclose(table.values[::9, ::9, ::30], true, rtol=1e-4)
