"""`matcam reconstruct` on captures of a cylinder that an independent renderer drew."""

import json

import numpy as np
import pytest

from matcam.io import read_netcdf
from tests.oracle.capture import METALS
from tests.oracle.cylinder_picture import Bent, Stand, draw
from tests.oracle.sphere_picture import fresnel

ALPHAS = (0.04, 0.15)
ANGLES = np.radians([10, 30, 50, 65, 76])
STAND = Stand(
    radius=70.0,
    camera=40.0,
    lamp=25.0,
    column=82.4,
    row=24.0,
    shape=(48, 166),
    strips=((0, 23, 0.0), (24, 47, np.pi / 2)),
)
CHROMIUM = tuple((values[1],) for values in METALS["Cr"])


def true_brdf(theta_h, phi_h, theta_d):
    """Of the stretched lobe at F = 1 and phi_d = 90 degrees, where light and view make one angle with the normal."""
    ax, ay = ALPHAS
    x, y, z = np.sin(theta_h) * np.cos(phi_h), np.sin(theta_h) * np.sin(phi_h), np.cos(theta_h)
    d = 1 / (np.pi * ax * ay * ((x / ax) ** 2 + (y / ay) ** 2 + z**2) ** 2)
    half = np.array([x, y, z])
    up = np.array([-np.sin(phi_h), np.cos(phi_h), 0.0])  # perpendicular to half vector and normal's plane
    light, view = (np.cos(theta_d) * half + side * np.sin(theta_d) * up for side in (1, -1))
    hidden = sum((np.sqrt(1 + ((ax * w[0]) ** 2 + (ay * w[1]) ** 2) / w[2] ** 2) - 1) / 2 for w in (light, view))
    return d / (1 + hidden) / (4 * light[2] * view[2])


@pytest.mark.slow
def test_two_roughnesses_from_strips_at_right_angles(matcam, tmp_path):
    """Five lamps out of plane, grey frames with noise: both roughnesses, F and the table agree with the truth within their
    errors."""
    drawn = draw(
        Bent(ALPHAS, *CHROMIUM, (0.03,)),
        STAND,
        2 * ANGLES,
        np.radians([6.0, -8.0, 5.0, 9.0, -4.0]),
        lamp_std=np.radians(0.2),
        seed=3,
    )
    drawn.write(tmp_path / "strips")
    matcam("reconstruct", tmp_path / "strips", "-o", "brushed.binary")
    assert {path.name for path in tmp_path.glob("brushed*")} == {"brushed.nc", "brushed.json", "brushed.html"}
    found = json.loads((tmp_path / "brushed.json").read_text())
    assert found["sample"] == "cylinder"
    assert found["lobe"]["anisotropic"]
    for name, truth in zip(("alpha_x", "alpha_y"), ALPHAS, strict=True):
        value, std = found["parameters"][name]
        assert abs(value - truth) < 4 * std
        assert std < 0.02 * truth
    radius, std = found["geometry"]["radius_px"]
    assert abs(radius - STAND.radius) < 4 * std
    theta_d = np.radians(found["fresnel"]["theta_d_deg"])
    strength, std = np.array(found["fresnel"]["value"])[:, 0], np.array(found["fresnel"]["std"])[:, 0]
    truth = fresnel(np.cos(theta_d), CHROMIUM[0][0], CHROMIUM[1][0])
    relative = strength / strength[:3].mean() / (truth / truth[:3].mean())
    assert np.all(np.abs(relative - 1) < 4 * std / strength)
    table = read_netcdf(tmp_path / "brushed.nc").sel(channel="grey")
    at = table.sel(theta_d=np.radians(50), phi_d=np.pi / 2, method="nearest").isel(theta_h=slice(0, 12))
    d, q = float(at.theta_d), float(at.phi_d)
    assert q == pytest.approx(np.pi / 2, abs=np.pi / 20)
    scale = np.interp(d, theta_d, strength / truth) * fresnel(np.cos(d), CHROMIUM[0][0], CHROMIUM[1][0])
    for phi_h in (5, 12):
        angle = float(at.phi_h[phi_h])
        truths = [true_brdf(float(h), angle, d) * scale for h in at.theta_h]
        values = at.brdf.values[:, phi_h]
        assert np.abs(values / truths - 1).max() < 0.05
        assert at.supported.values[:, phi_h].all()
    page = (tmp_path / "brushed.html").read_text()
    assert "Profiles of the strips" in page


def test_a_cylinder_needs_an_outline(matcam, tmp_path):
    drawn = draw(Bent(ALPHAS), STAND, 2 * ANGLES[:3], np.zeros(3), exposures=1, outline=False)
    del drawn.settings["sample"]["axis_column_px"]
    drawn.write(tmp_path / "strips")
    done = matcam("reconstruct", tmp_path / "strips", code=2)
    assert "set sample.outline_radius_px and sample.axis_column_px" in done.stderr
    assert done.stderr.count("\n") == 1
