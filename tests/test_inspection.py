import numpy as np
import pytest

from matcam import BoxPixel, Camera, GaussianOptics, Uncertainty
from matcam.errors import FileFormatError
from matcam.inspection import identify, inspect_camera, inspect_table
from matcam.table import brdf_table
from tests.oracle import merl_lobe


@pytest.fixture(scope="module")
def blurred():
    return brdf_table(merl_lobe.record(0.002, np.ones((90, 3))), "centre")


def test_lobe_widens_in_the_plane_as_the_camera_makes_it(blurred):
    report = inspect_table(blurred)
    rows = {row["theta_d_deg"]: row for row in report["lobe"]}
    kernel, lobe = np.sqrt(0.25 + 1 / 12) / 256, 0.002  # rad at normal view, to the accuracy of a Gaussian for the box
    for angle, row in rows.items():
        expected = np.degrees(np.sqrt(2 * np.log(2)) * np.hypot(lobe, kernel / np.cos(np.radians(angle + 0.5))))
        if angle <= 75:
            assert row["in_plane_hwhm_deg"] == pytest.approx(expected, rel=0.1)
    assert rows[75]["across_hwhm_deg"] == pytest.approx(rows[0]["across_hwhm_deg"], rel=0.25)


def test_report_of_a_table(blurred):
    report = inspect_table(blurred)
    assert report["grid"] == {"theta_h": 90, "theta_d": 90, "phi_d": 180}
    assert report["missing_share"] == pytest.approx(0.248, abs=5e-4)
    assert report["missing_above_horizon_share"] == 0
    assert report["valid_below_horizon_share"] == 0
    assert report["reciprocity_rms"] < 1e-12


def test_broken_reciprocity_is_measured(blurred):
    rng = np.random.default_rng(5)
    noisy = blurred * (1 + 0.03 * rng.standard_normal(blurred.shape))
    noisy.attrs = blurred.attrs
    # difference of two cells over their mean: sqrt(2) of one cell's noise
    assert inspect_table(noisy.clip(min=0))["reciprocity_rms"] == pytest.approx(0.03 * np.sqrt(2), rel=0.02)


def test_a_table_without_lobe_has_no_width():
    report = inspect_table(brdf_table(np.ones((90, 90, 180, 3)), "edge"))
    assert all(row["in_plane_hwhm_deg"] is None for row in report["lobe"])
    assert report["reciprocity_rms"] == 0


def test_files_are_known_by_their_content(tmp_path, stand_in):
    assert identify(stand_in("chrome")) == "merl"
    Camera(GaussianOptics(0.5)).save(tmp_path / "a.dat")
    assert identify(tmp_path / "a.dat") == "camera profile"
    (tmp_path / "b.txt").write_text("hello")
    for path, words in (
        (tmp_path / "b.txt", "neither"),
        (tmp_path / "c", "no such file"),
        (tmp_path, "cannot be read"),
    ):
        with pytest.raises(FileFormatError, match=words):
            identify(path)


def test_report_of_a_camera(tmp_path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5), uncertainty=Uncertainty.of({"optics.sigma_px": 0.015})).save(
        tmp_path / "c.json"
    )
    report = inspect_camera(tmp_path / "c.json")
    assert report["parameters"] == {"optics.sigma_px": 0.5, "pixel.half_width_px": 0.5}
    assert report["std"] == {"optics.sigma_px": pytest.approx(0.015)}
    f = report["mtf50_cycles_per_px"]
    assert np.exp(-2 * (np.pi * 0.5 * f) ** 2) * np.sinc(f) == pytest.approx(0.5, abs=1e-3)
