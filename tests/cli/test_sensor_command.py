"""`matcam sensor`: what it prints and writes, and that the other commands use its sensor."""

import json
import re

import numpy as np
import pytest
import tifffile

from matcam import Camera, DiffractionOptics, GaussianOptics
from tests.oracle import exposures


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("series") / "exposures"
    exposures.write_folder(path, stack=4, times=exposures.TIMES[::3])
    return path


def test_sensor_writes_a_figure_a_table_a_page_maps_and_a_profile(matcam, folder, tmp_path):
    Camera(GaussianOptics(0.6)).save(tmp_path / "lens.json")
    words = (
        "--camera",
        "lens.json",
        "--profile",
        "camera.json",
        "--pitch",
        3.45,
        "--page",
        "page.html",
        "--maps",
        "--json",
    )
    found = json.loads(matcam("sensor", folder, *words).stdout)
    assert found["gain_dn_per_electron"][0] == pytest.approx(exposures.GAIN, rel=0.03)
    assert found["schema"] == "matcam-sensor-1"
    assert all((tmp_path / name).exists() for name in found["files"])
    assert (tmp_path / "exposures-sensor.csv").read_text().startswith("plane,exposure_s,light_s,signal_dn,")
    response = tifffile.imread(tmp_path / "exposures-sensor-prnu.tif")
    assert response.shape == (90, 120)
    assert response.mean() == pytest.approx(1, abs=1e-5)
    sensor = Camera.load(tmp_path / "camera.json").sensor
    assert float(sensor.pitch) == pytest.approx(3.45e-6)
    said = matcam("inspect", "camera.json").stdout
    assert re.search(r"gain_dn_per_electron +0\.2[45]", said)
    assert re.search(r"pitch_m +3\.45e-06", said)
    # the profile's sensor takes a raw picture
    matcam("simulate", "--camera", "camera.json", "--exposure", 2000, "--radius", 30, "--size", 64, 64, "-o", "raw.tif")
    assert np.ptp(tifffile.imread(tmp_path / "raw.tif")) > 100


def test_sensor_prints_values_with_standard_deviations(matcam, folder, tmp_path):
    text = matcam("sensor", folder).stdout
    assert "gain, DN per e-" in text
    assert "exposures that are beyond saturation or clipped were not used" in text
    assert "exposures-sensor.png" in text
    assert "next:" not in text
    Camera(GaussianOptics(0.6)).save(tmp_path / "lens.json")
    words = ("--camera", "lens.json", "--profile", "camera.json", "--pitch", 3.45, "--force")
    assert matcam("sensor", folder, *words).stdout.splitlines()[-1] == "next: matcam inspect camera.json"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--pitch", "3.45e-6"), "--pitch must lie in [0.01, 10000] um, got 3.45e-06"),
        (("--profile", "new.json"), "--profile writes the profile of --camera with this sensor: give both"),
        (("--camera", "gaussian.json", "--profile", "new.json"), "gaussian.json has no pixel pitch: give --pitch"),
        (
            ("--camera", "f8.json", "--profile", "new.json", "--pitch", "3"),
            "sensor has a pitch of 3e-06 m, but optics.pixel_pitch_m is 5e-06 m: specify the same pitch",
        ),
    ],
)
def test_wrong_requests_are_refused(matcam, folder, tmp_path, words, message):
    Camera(GaussianOptics(0.6)).save(tmp_path / "gaussian.json")
    Camera(DiffractionOptics(8, 550e-9, 5e-6)).save(tmp_path / "f8.json")
    failed = matcam("sensor", folder, *words, code=2)
    assert message in failed.stderr
    assert not (tmp_path / "new.json").exists()
    assert not list(tmp_path.glob("*.png"))
