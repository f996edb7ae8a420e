"""`matcam capture`, and `matcam simulate --capture`."""

import json

import numpy as np
import pytest

from matcam import Sphere, limits, rigs
from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.core.grid import CHANNEL_WAVELENGTHS
from matcam.files.capture import read_capture, read_settings
from matcam.forward import synthetic_samples
from matcam.inverse.capture_plan import plan_capture
from matcam.lamp.lamps import NearLamp
from matcam.material.optical_constants import metal
from tests.acquisition.drawn import small
from tests.oracle.capture import MOSAICS
from tests.oracle.flat_picture import FlatStand
from tests.oracle.sphere_picture import Surface, View, fresnel, picture


def test_a_template_is_a_capture_without_frames(matcam, tmp_path):
    folder = tmp_path / "new"
    assert "lists no images" in matcam("capture", "init", folder).stdout
    # what is active in it is what holds without it
    bare = tmp_path / "bare.toml"
    bare.write_text('format = "matcam capture"\nversion = 1\n')
    assert read_settings(folder / "capture.toml") == read_settings(bare)
    assert "--force" in matcam("capture", "init", folder, code=2).stderr
    empty = matcam("capture", "check", folder, code=2)
    assert "no frame of the sample" in empty.stderr
    # every commented field is one that is read
    text = (folder / "capture.toml").read_text().replace("# [reference]", "[reference]")
    lines = [
        line.removeprefix("# ") if " = " in line else line for line in text.splitlines() if not line.startswith("# A ")
    ]
    others = ("Units are part", "of a cylinder", "of a flat", "of each strip")  # fields of other samples than a sphere
    (folder / "capture.toml").write_text(
        "\n".join(line for line in lines if not any(words in line for words in others))
    )
    assert read_settings(folder / "capture.toml")["sample"]["region_px"] == [800, 600, 900, 900]


def test_a_capture_is_filled_from_a_folder_of_photographs(matcam, tmp_path):
    """From empty folder to check without a typed line; photographs already in the capture are only listed."""
    drawn = small()
    drawn.write(tmp_path / "photographs")
    matcam("capture", "init", "new", "--from", "photographs/frames")
    capture = read_capture(tmp_path / "new")
    assert (len(capture.lamps), len(capture.exposures), len(capture.frames)) == (4, 5, 20)
    found = json.loads(matcam("capture", "init", "photographs", "--from", "photographs", "--force", "--json").stdout)
    assert found["frames"] == len(drawn.rows)
    assert read_capture(tmp_path / "photographs").problems == ()
    assert "give both" in matcam("capture", "init", "other", "--lamps", "a.lp", code=2).stderr


def test_check_says_what_it_found(matcam, tmp_path):
    folder = small().write(tmp_path)
    found = json.loads(matcam("capture", "check", folder, "--json", code=1).stdout)
    assert found["lamps"] == 4
    assert {one["code"] for one in found["findings"]} >= {"times-wrong", "angles-missed"}
    assert found["radiometry"]["clip_level_dn"][0] == pytest.approx(15256, rel=5e-3)
    last = matcam("capture", "check", folder, code=1).stdout.splitlines()[-1]
    assert last == f"next: correct these faults, then repeat matcam capture check {folder}"


def test_what_an_ended_run_left_is_no_obstacle(matcam, tmp_path, monkeypatch):
    """Its empty folders and unnamed files; a full disk left them, and the rerun was refused."""

    def drawn(*_):
        raise FitError("as far as the pictures")

    monkeypatch.setattr(synthetic_samples._CurvedSample, "drawn", drawn)
    folder = tmp_path / "shots"
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / ".L01_E1-x1.tif").write_bytes(b"half")
    again = ("simulate", "--capture", folder, "--radius", "30", "--lamp-positions", "1")
    assert "as far as the pictures" in matcam(*again, code=2).stderr
    (folder / "frames" / "L01_E1.tif").write_bytes(b"somebody's")
    assert "is not empty: use --force" in matcam(*again, code=2).stderr


def test_a_steady_lamp_with_few_readings_of_its_reference_does_not_drift(matcam):
    """Of four lamp positions two are behind the patch, and one is read with an error of 1.5 %, three times the scatter."""
    options = ("--radius", "60", "--roughness", "0.05", "--lamp-positions", "6")
    matcam("simulate", "--capture", "shots", *options)
    found = json.loads(matcam("capture", "check", "shots", "--json", code=1).stdout)
    assert {one["code"] for one in found["findings"]} == {"times-wrong", "angles-missed"}


def test_a_simulated_flat_sample_is_checked_as_one(matcam, tmp_path):
    """Its pictures against their truth by another route: the mean of the texture follows cosine and lobe."""
    options = (
        "--sample",
        "flat",
        "--roughness",
        "0.3",
        "--diffuse",
        "0.4",
        "--lamp-positions",
        "4",
        "--size",
        "96",
        "96",
    )
    matcam("simulate", "--capture", "cloth", *options)
    found = json.loads(matcam("capture", "check", "cloth", "--json", code=1).stdout)
    assert {one["code"] for one in found["findings"]} <= {"times-wrong"}
    capture, truth = read_capture(tmp_path / "cloth"), json.loads((tmp_path / "cloth" / "truth.json").read_text())
    stand, n, k = FlatStand(alpha=0.3), *(np.mean(one) for one in metal("Cr", CHANNEL_WAVELENGTHS)[:2])
    light = []
    for lamp, frame in zip(truth["lamps"], capture.of("frames", exposure="E2"), strict=True):
        white, lobe = stand.weights(np.radians(lamp["tilt_deg"]), np.array(lamp["direction"]))
        reflectance = fresnel(np.cos(np.radians(10)), n, k)
        expected = lamp["gain"] * (0.4 * white + reflectance * lobe)
        light.append((capture.read(frame).values.astype(float).mean() - 256) / expected)
    assert np.std(light) < 0.06 * np.mean(light)  # 96 px of a texture that varies over their length


@pytest.mark.slow
def test_a_simulated_cylinder_is_reconstructed(matcam, tmp_path):
    options = ("--radius", "80", "--distance", "40", "--lamp-distance", "25", "--roughness", "0.08", "--azimuth", "5")
    matcam("simulate", "--capture", "strip", "--sample", "cylinder", *options, "--lamp-positions", "5")
    found = json.loads(matcam("capture", "check", "strip", "--json", code=1).stdout)
    assert {one["code"] for one in found["findings"]} <= {"times-wrong", "angles-missed"}
    matcam("reconstruct", "strip", "-o", "strip.binary", "--ndf", "ggx")
    document = json.loads((tmp_path / "strip.json").read_text())
    value, std = document["parameters"]["alpha"]
    assert abs(value - 0.08) < 4 * std < 0.002


@pytest.mark.slow
def test_a_simulated_capture_is_what_it_states(matcam, tmp_path):
    """Its frames against the oracle's pictures at the truth that it states."""
    folder = tmp_path / "simulated"
    options = (
        "--radius",
        "40",
        "--distance",
        "40",
        "--lamp-distance",
        "25",
        "--roughness",
        "0.05",
        "--lamp-positions",
        "2",
    )
    matcam("simulate", "--capture", folder, *options, "--seed", "3", "--azimuth", "30", "--json")
    capture, truth = read_capture(folder), json.loads((folder / "truth.json").read_text())
    assert capture.problems == ()
    n, k, _ = metal("Cr", CHANNEL_WAVELENGTHS)
    for lamp in truth["lamps"]:
        frame = next(f for f in capture.of("frames", lamp=lamp["lamp"]) if f.exposure == "E3")
        codes = capture.read(frame).values.astype(float)
        view = View(40.0, 40.0, 25.0, 0.5, 0.5, *truth["centre_px"], codes.shape)
        clean = picture(
            Surface("ggx", 0.05, n=tuple(n), k=tuple(k), diffuse=(0.0,)),
            view,
            np.array(lamp["direction"]),
            lamp["shift_px"],
        )
        channel = np.tile(np.array(MOSAICS["RGGB"]), (codes.shape[0] // 2, codes.shape[1] // 2))
        clean = np.take_along_axis(clean, channel[..., None], axis=2)[..., 0]
        electrons = truth["electrons_per_radiance"] * 16 * lamp["gain"] * clean
        pull = ((codes - 256) / 0.5 - electrons) / np.sqrt(electrons + 9.4)
        used = (electrons < 29_000) & (np.indices(codes.shape).max(0) > 46)
        assert abs(pull[used].mean()) < 0.05
        assert 0.9 < pull[used].std() < 1.1
        # the patch, by the law itself: reflectance / pi, cosine over distance squared, from the lamp to its middle
        middle = np.array([23.5 - truth["centre_px"][0], truth["centre_px"][1] - 23.5, 0]) * np.sqrt(40**2 - 1) ** -1
        way = 25 * np.array(lamp["direction"]) - middle
        radiance = truth["patch"]["reflectance"] / np.pi * way[2] * 25**2 / np.linalg.norm(way) ** 3
        light = (codes[4:44, 4:44].mean() - 256) / 0.5
        if radiance > 0:
            assert light == pytest.approx(truth["electrons_per_radiance"] * 16 * lamp["gain"] * radiance, rel=5e-3)
    stated = np.array([lamp["stated_deg"][0] - lamp["angle_deg"] for lamp in truth["lamps"]])
    assert 0 < np.abs(stated).max() < 1.5
    assert all(np.abs(lamp["shift_px"]).max() > 0 for lamp in truth["lamps"])


@pytest.mark.slow
def test_a_plan_names_what_the_model_does(matcam):
    """docs/model.md 10: 1 % on a dielectric at 75 degrees wants theta_d to 0.12 degrees, the outline to 0.15 px of 400."""
    found = json.loads(matcam("capture", "plan", "0.02", "--accuracy", "0.02", "--radius", "400", "--json").stdout)
    assert found["fresnel_slope_per_deg"] == pytest.approx(0.082, abs=0.003)
    assert found["lamp_std_deg"] == pytest.approx(0.25, abs=0.02)
    assert found["outline_std_px"] * 400 / min(found["radius_px"] or 1600, 1600) == pytest.approx(0.15, abs=0.02)
    assert found["lamp_angle_deg"][-1] == pytest.approx(160)
    # half of the given radius is tried first, so a plan for a smaller radius may find less
    assert found["radius_px"] == 200
    text = matcam("capture", "plan", "0.02", "--accuracy", "0.02", "--radius", "400").stdout
    assert "200 px suffices, the smallest tried" in text
    assert "or more" not in text


@pytest.mark.slow
def test_a_plan_is_for_the_rigs_own_distances():
    """A lamp at 3 radii: the bound is that of `limits` for this rig, and not that of a distant one."""
    camera = rigs.merl().camera
    near = rigs.Rig(camera, Sphere(400.0, 20.0), NearLamp(3.0))
    needs = plan_capture(near, 0.02, 0.3, np.radians(60))
    assert [size for size, _ in needs.fresnel_std] == [200.0]  # half of the rig's is enough
    noise = PixelNoise(picture_gain=0.01)
    bounds = []
    for one in (rigs.Rig(camera, Sphere(200.0, 20.0), NearLamp(3.0)), rigs.Rig(camera, Sphere(200.0))):
        found = limits(one, roughness=[0.02], noise=noise)
        bounds.append(float(np.interp(np.radians(60), found["theta_d"].values, found["fresnel_std"].values[0])))
    assert needs.fresnel_std[0][1] == pytest.approx(bounds[0], rel=1e-9)
    assert abs(bounds[0] / bounds[1] - 1) > 0.02


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "give either --output"),
        (("-o", "a.exr", "--capture", "b"), "give either --output"),
        (("--capture", "b", "--exposure", "3"), "omit TABLE"),
        (("--capture", "b", "--size", "30", "40"), "follows from the radius"),
        (("--capture", "b", "--sample", "flat", "--lamp-distance", "40"), "distant lamp"),
    ],
)
def test_what_simulate_needs(matcam, options, message):
    assert message in matcam("simulate", *options, code=2).stderr
