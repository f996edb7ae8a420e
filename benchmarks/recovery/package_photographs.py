"""The package under test as an entrant on photographs: `matcam.reconstruct` with the stated lens, and with the true one."""

import csv
import tempfile
from pathlib import Path

import numpy as np
from benchmarks.recovery.entries import Answer
from benchmarks.recovery.package import stated_camera, true_camera

import matcam
from matcam.acquisition.check.unmeasured_lens import GUESSED_LENS
from matcam.camera import Uncertainty
from matcam.files.float_pictures import write_exr

RADIUS_MM = 25.0
"""Radius of the sphere, mm. No result depends on it."""
FAR = 1e5
"""Distance of camera and lamps, radii of the sphere, for those that the benchmark calls distant."""
OUTLINE_STD = 0.01
"""Standard deviation of the outline, px: the benchmark specifies it exactly, and the format of captures requires a value."""
DIRECTION_STD = 0.01
"""Standard deviation of a lamp direction, degrees: the benchmark specifies it exactly."""
PITCH_M, WELL = 5e-6, 1e7
"""Pixel pitch, m, and full well, electrons, of the sensor in the profile. No result depends on them: no pixel is clipped."""
COLOURS = "RGGB"
"""Mosaic in which `matcam.reconstruct` reads pictures in full colour: it keeps one of the three values of each pixel."""


def defaults(pictures, case, facts):
    """Answer of `matcam.reconstruct` with the lens as stated; where none is stated, with its default prior."""
    return answer(pictures, facts, unknown_camera(facts) if facts["lens"] is None else stated_camera(facts))


def true_lens(pictures, case, facts):
    """Answer of `matcam.reconstruct` with the true lens."""
    return answer(pictures, facts, true_camera(case))


def unknown_camera(facts):
    """Camera whose lens has the prior of a capture without a camera profile. Such a capture does not specify the gain."""
    sigma, std = GUESSED_LENS
    pixel = matcam.BoxPixel(facts["pixel_half_width_px"])
    return matcam.Camera(matcam.GaussianOptics(sigma), pixel, uncertainty=Uncertainty.of({"optics.sigma_px": std}))


def answer(pictures, facts, camera):
    """Answer of `matcam.reconstruct` for photographs, 1/sr."""
    with tempfile.TemporaryDirectory() as folder:
        write_capture(Path(folder), pictures, facts, camera)
        found = matcam.reconstruct(folder)
    # F is relative without a reference in the frames; the unit of the fit is known here, because that of the pictures is
    unit = np.array([one.value for one in found.units]) / facts["electrons_per_value"]
    table = found.table
    return Answer(table["brdf"].values * unit, table["brdf_std"].values * unit, table["supported"].values > 0)


def write_capture(folder, pictures, facts, camera):
    """Write photographs and the stated facts as a capture in a folder."""
    for name in ("frames", "dark"):
        (folder / name).mkdir()
    rows = [("file", "lamp", "angle_deg", "azimuth_deg", "exposure", "time_s")]
    for n, (picture, angle) in enumerate(zip(pictures, facts["lamp_angle_deg"], strict=True)):
        rows.append((f"frames/L{n}.exr", f"L{n}", angle, 0, "E0", 1))
        write_exr(folder / rows[-1][0], picture * facts["electrons_per_value"])
    random = np.random.default_rng(0)
    for n in range(2):  # frames without light have the stated read noise
        rows.append((f"dark/D{n}.exr", "", "", "", "E0", 1))
        write_exr(folder / rows[-1][0], facts["read_noise_electrons"] * random.standard_normal(pictures.shape[1:]))
    with (folder / "frames.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    sensor = matcam.Sensor(PITCH_M, float(WELL), facts["read_noise_electrons"], cfa=COLOURS)
    matcam.Camera(camera.optics, camera.pixel, sensor, uncertainty=camera.uncertainty).save(folder / "camera.json")
    (folder / "capture.toml").write_text(_settings(facts), encoding="utf-8")


def _settings(facts):
    sphere, distance = facts["sphere"], f"[{FAR * RADIUS_MM}, {0.1 * FAR * RADIUS_MM}]"
    return f"""format = "matcam capture"
version = 1

[camera]
profile = "camera.json"
cfa = "{COLOURS}"
accept_processed = true

[sample]
kind = "sphere"
radius_mm = {RADIUS_MM}

[distances]
camera_mm = {distance}
lamp_mm = {distance}

[lamp]
motion = "arc"
intensity = "constant"
gain_std = {max(facts["gain_relative_standard_deviation"], 1e-4)}
direction_std_deg = {DIRECTION_STD}

[outline]
centre_px = {sphere["centre_px"]}
radius_px = [{sphere["radius_px"]}, {OUTLINE_STD}]
"""


PACKAGE = {"matcam": defaults, "matcam, true lens": true_lens}
