"""`matcam reconstruct` on captures that an independent renderer drew: the truth lies beside the frames, and is not read."""

import json

import numpy as np
import pytest

from matcam import read_merl
from matcam.app.exploring.fitted_pictures import fitted_pictures
from matcam.core.grid import merl_grid
from matcam.core.results.summary import with_std
from matcam.io import read_netcdf
from matcam.reconstruction.rig.rig_document import read_rig
from tests.oracle.capture import METALS, Sensor, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

ALPHA, ANGLES = 0.02, np.radians([8, 25, 40, 55, 75])
VIEW = View(radius=80.0, column=109.6, row=110.3, shape=(220, 220))


def chromium(theta_d):
    """F of the middle channel."""
    n, k = (np.array(pair[1]) for pair in METALS["Cr"])
    return fresnel(np.cos(theta_d), n, k)


def true_lobe(theta_h, theta_d):
    """D G / (4 cos cos) at phi_d = 90 degrees, where light and view make one angle with the normal."""
    tan2 = np.tan(theta_h) ** 2
    d = 1 / (np.pi * ALPHA**2 * np.cos(theta_h) ** 4 * (1 + tan2 / ALPHA**2) ** 2)
    cos = np.cos(theta_h) * np.cos(theta_d)
    smith = (np.sqrt(1 + ALPHA**2 * (1 / cos**2 - 1)) - 1) / 2
    return d / (1 + 2 * smith) / (4 * cos**2)


def test_from_photographs_to_the_material(matcam, tmp_path):
    """Five lamps, five exposures, a noisy mosaic: roughness, F, lamps and table agree with the truth within their errors, and
    the pinhole's table lacks what the lens took."""
    drawn = draw(Surface("ggx", ALPHA, 1.0, *METALS["Cr"], (0.0,)), VIEW, ANGLES, azimuth=0.4, sensor=Sensor(), seed=5)
    drawn.write(tmp_path / "shots")
    done = matcam(
        "reconstruct", tmp_path / "shots", "--ndf", "ggx", "-o", "chrome.binary", "--budget", "chrome-budget.json"
    )
    assert {path.name for path in tmp_path.glob("chrome*")} == {
        "chrome.binary", "chrome-pinhole.binary", "chrome.nc", "chrome.json", "chrome.html", "chrome-budget.json"
    }  # fmt: skip
    found = json.loads((tmp_path / "chrome.json").read_text())
    rig = read_rig(tmp_path / "chrome.json")  # which checks the document against its schema
    assert rig.lamps == tuple(lamp["lamp"] for lamp in drawn.truth["lamps"])
    assert rig.frame == VIEW.shape[::-1]

    def pull(pair, truth):
        return abs(pair[0] - truth) / pair[1]

    alpha = found["parameters"]["alpha"]
    assert pull(alpha, ALPHA) < 4
    assert abs(alpha[0] / ALPHA - 1) < 0.02
    assert pull(found["parameters"]["sigma_px"], VIEW.sigma) < 4
    assert pull(found["geometry"]["radius_px"], VIEW.radius) < 4
    for lamp, truth in zip(found["geometry"]["lamps"], drawn.truth["lamps"], strict=True):
        off = np.degrees(np.arccos(min(float(np.dot(lamp["direction"], truth["direction"])), 1.0)))
        assert off < 4 * np.sqrt(2) * lamp["std_deg"]
    strength, std = np.array(found["fresnel"]["value"])[:, 1], np.array(found["fresnel"]["std"])[:, 1]
    relative = strength / strength[:4].mean() / (chromium(ANGLES) / chromium(ANGLES[:4]).mean())
    assert np.all(np.abs(relative - 1) < 4 * std / strength)
    assert not found["fresnel"]["absolute"]
    assert found["budget"]["total"]["ratio"] < 0.05

    table = read_netcdf(tmp_path / "chrome.nc")
    grid = merl_grid("centre")
    i, j, k = grid.index(theta_d=np.radians(55), phi_d=np.pi / 2)
    value, error, supported = (table[name].values[i, j, k, 1] for name in ("brdf", "brdf_std", "supported"))
    at = grid.theta_d[j]
    # F is relative: the scale is that of the curve at 25 degrees
    scale = strength[1] / chromium(ANGLES[1])
    truth = true_lobe(grid.theta_h, at) * chromium(at) * scale
    peak = slice(0, 20)
    assert supported[peak].all()
    assert np.abs((value - truth) / error)[peak].max() < 4
    assert np.abs(value / truth - 1)[peak].max() < 0.06
    # the highlight's pixels are in the cell of 55 degrees or below; no cell holds many
    ring = read_merl(tmp_path / "chrome-pinhole.binary").values[:8, j - 1 : j + 1, :, 1].reshape(8, -1)
    near = np.isfinite(ring).any(axis=1)
    assert near.any()
    assert np.all(np.nanmean(ring[near], axis=1) < 0.95 * truth[:8][near])
    # the pictures by which a reader can doubt it: outline and highlight where they are, residuals of the size of the noise
    shown = fitted_pictures("chrome.nc", table)
    assert [one.name for one in shown] == [lamp["name"] for lamp in found["geometry"]["lamps"]]
    for one, lamp in zip(shown, found["geometry"]["lamps"], strict=True):
        assert one.outline == (*lamp["centre_px"], found["geometry"]["radius_px"][0])
        half = np.add(lamp["direction"], (0, 0, 1))  # the mirror's normal, all but for the camera's distance
        x, y, _ = half / np.linalg.norm(half)
        mirror = one.outline[0] + VIEW.radius * x, one.outline[1] - VIEW.radius * y
        assert np.hypot(*np.subtract(one.highlight, mirror)) < 2.5
        residual = one.windows["window_residual"]
        assert 0.7 < np.nanstd(residual) < 1.3
        left = one.windows["window_recorded"] - one.windows["window_fitted"]
        np.testing.assert_array_equal(np.sign(left[np.isfinite(residual)]), np.sign(residual[np.isfinite(residual)]))
    page = (tmp_path / "chrome.html").read_text()
    assert "Error budget" in page
    budgets = json.loads((tmp_path / "chrome-budget.json").read_text())["budgets"]
    combined = {one["result"]: one["combined_standard_uncertainty"] for one in budgets}
    assert set(found["parameters"]) < set(combined)
    for name, (_, std) in found["parameters"].items():
        assert combined[name] == pytest.approx(std, rel=1e-6)
    assert combined["outline_radius_px"] == pytest.approx(found["geometry"]["radius_px"][1], rel=1e-6)
    assert page.count("<summary>") == len(budgets)
    # page, terminal and JSON agree
    for picture in found["pictures"]:
        assert f"<td>{picture['name']}</td>" in page
        assert f"<td>{picture['chi2']:.3g}</td>" in page
    assert all(0.7 < picture["chi2"] < 1.3 for picture in found["pictures"])
    for name in ("camera", "lamp"):
        value, std = found["geometry"][f"{name}_radii"]
        assert std < value / 2
        assert f"<td>{name}_distance_radii</td><td>{with_std(value, std)} (" in page
        length = found["geometry"]["sample_radius_mm"]
        assert f"<td>{name}_distance_mm</td><td>{with_std(value * length, std * length)} (" in page
        assert f"{name}_distance_radii" in done.stdout
        assert with_std(value, std) in done.stdout
    assert "http" not in page.replace("http://www.w3.org", "")


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [(8, 25, 40, 55, 75), (5, 10, 14, 18, 22)])
def test_from_photographs_without_a_profile(matcam, tmp_path, degrees):
    """The lens is determined to a percent by the highlights' shape, also where no lamp position is beyond 30 degrees."""
    surface = Surface("ggx", ALPHA, 1.0, *METALS["Cr"], (0.0,))
    drawn = draw(surface, VIEW, np.radians(degrees), azimuth=0.4, sensor=Sensor(), seed=5)
    del drawn.settings["camera"]["profile"]
    drawn.write(tmp_path / "shots")
    matcam("reconstruct", tmp_path / "shots", "--ndf", "ggx", "-o", "chrome.binary")
    value, std = json.loads((tmp_path / "chrome.json").read_text())["parameters"]["sigma_px"]
    assert std < 0.01 * value
    assert abs(value - VIEW.sigma) < 4 * std


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "nowhere: no such folder"),
        ((".",), "capture.toml"),
        ((".", "-o", "a.nc"), "whose name must end in .binary"),
    ],
)
def test_wrong_captures_are_one_line(matcam, arguments, message):
    done = matcam("reconstruct", *arguments, code=2)
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
