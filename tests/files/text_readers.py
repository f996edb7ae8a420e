"""Every reader of a text that others may have made, with a small sound file of its kind: what mutation runs and fuzzing share.

Each reads in this process: it costs microseconds, and may not cost more. What is decoded in a process of its own is in
test_damaged.py and test_containers.py.
"""

import dataclasses
import json

from matcam import BoxPixel, Camera, DiffractionOptics, GaussianOptics, HaloOptics, Sensor
from matcam.app.exploring.opened import entries_of
from matcam.batch.job import Job
from matcam.camera import Uncertainty
from matcam.cli.rig_file import _KEYS, read_rig_file
from matcam.files.capture import COLUMNS, read_capture
from matcam.files.exposure_series import read_exposure_series
from matcam.files.light_positions import read_light_positions
from matcam.files.tone_curve import read_tone_curve
from matcam.io import read_bird, read_samples, read_sidecar, read_zemax, write_bird, write_sidecar
from matcam.targets import design_chart, read_chart, write_chart
from tests.files.test_sidecar import sections

RIG = """schema = "matcam-rig-1"
camera = "camera.json"
[sample]
shape = "sphere"
radius_px = 400
radius_mm = 25
[lens]
distance = 30
glare = 0.001
glare_radius_px = 30
[lamp]
radius_deg = 0.25
distance = 700
"""
CAPTURE = """format = "matcam capture"
version = 1
[camera]
profile = "camera.json"
cfa = "RGGB"
black_level_dn = 256.0
accept_processed = false
[sample]
kind = "sphere"
radius_mm = [25.0, 0.005]
region_px = [800, 600, 900, 900]
[distances]
camera_mm = [1200, 5]
lamp_mm = 700
[lamp]
radius_mm = [3.5, 0.05]
motion = "arc"
intensity = "reference"
gain_std = 0.005
direction_std_deg = 1.0
[reference]
kind = "diffuse"
reflectance = [0.98, 0.003]
region_px = [10, 10, 60, 60]
[outline]
field_beyond_deg = 3.0
"""
ROWS = (
    "frames/a.tif,L1,20,90,E1,0.01",
    "frames/b.tif,L1,20,90,E2,0.04",
    "frames/c.tif,L2,60.5,-90,E1,",
    "dark/d.tif,,,,E1,0.01",
)


def _capture(folder):
    (folder / "capture.toml").write_text(CAPTURE)
    (folder / "camera.json").write_text("{}")
    (folder / "frames.csv").write_text("\n".join([",".join(COLUMNS), *ROWS]) + "\n")
    for row in ROWS:
        frame = folder / row.split(",")[0]
        frame.parent.mkdir(exist_ok=True)
        frame.write_bytes(b"II*\0")


def _small_chart():
    """One element of each kind; dots would be thousands of places."""
    chart = design_chart(["squares", "star", "sines"])
    kinds = {type(element): element for element in chart.elements}
    return dataclasses.replace(chart, elements=tuple(kinds.values()))


def _profile(path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5)).save(path)


def _large_profile(path):
    lens = HaloOptics(DiffractionOptics(8, 550e-9, 4.73e-6), 0.003, 120.0)
    sensor = Sensor(4.73e-6, 2e4, 2.5, 0.5, 12, "RGGB", prnu=0.01)
    Camera(lens, BoxPixel(0.45), sensor, uncertainty=Uncertainty.of({"optics.fraction": 1e-3})).save(path)


def _samples(path):
    path.write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n" + "1.5,30,90,0.25\n2.5,30,90,\n3,40,-10,1e3\n" * 9)


ZEMAX = """# a comment
Source Measured
Symmetry PlaneSymmetrical
SpectralContent Monochrome
ScatterType BRDF
SampleRotation 1
0
AngleOfIncidence 2
30 60
ScatterAzimuth 3
0 90 180
ScatterRadial 3
0 20 40

Monochrome
DataBegin
TIS 0.1
1 2 3
1 4 5
1 6 7
TIS 0.2
8 9 10
8 11 12
8 13 14
DataEnd
"""


def _bird(path):
    _samples(path.with_suffix(".csv"))
    samples = read_samples(path.with_suffix(".csv")).isel(sample=[0, 2])
    write_bird(path, samples)


def _record(path):
    run = {"settings": "0" * 64, "files": {"a.binary": 4, "a.nc": 4}}
    fit = {"params": {"alpha": 0.1}, "std": {"alpha": 0.01}}
    about = {"input": {"bytes": 4, "mtime_ns": 1, "sha256": "0" * 64}, "fit": fit, "supported_share": 0.5, "run": run}
    path.write_text(json.dumps(about, indent=1))
    for suffix in (".nc", ".binary"):
        path.with_suffix(suffix).write_bytes(b"test")


def _finished(path):
    """What a run and the app make of a material's record."""
    Job(path.with_suffix(".binary"), path.with_suffix(".binary"), None, key="0" * 64).is_finished()
    return [entry.label for entry in entries_of(path.parent)]


TEXTS = {
    "capture.toml": (lambda path: _capture(path.parent), "capture.toml", lambda path: read_capture(path.parent)),
    "frames.csv": (lambda path: _capture(path.parent), "frames.csv", lambda path: read_capture(path.parent)),
    "rig.toml": (
        lambda path: path.write_text(RIG),
        "rig.toml",
        lambda path: read_rig_file(path, {*_KEYS.values()}, "predict"),
    ),
    "chart": (
        lambda path: write_chart(path, _small_chart()),
        "chart.json",
        read_chart,
    ),
    "small profile": (_profile, "camera.json", Camera.load),
    "whole profile": (_large_profile, "camera.json", Camera.load),
    "sidecar": (lambda path: write_sidecar(path, **sections()), "a.exr.json", read_sidecar),
    "samples": (_samples, "a.csv", read_samples),
    "zemax": (lambda path: path.write_text(ZEMAX), "a.bsdf", read_zemax),
    "bird": (_bird, "a.brdf", read_bird),
    "light positions": (
        lambda path: path.write_text('3\n"a 1.jpg" 0.1 0.2 0.97\nb.jpg 1 2 3\nc.jpg -1e-3 0 1\n'),
        "a.lp",
        read_light_positions,
    ),
    "exposures": (
        lambda path: path.write_text(
            "# EMVA 1288\nn 12 640 480\nb 40000.0 120.0\ni images\\b_0.png\ni b 1.png\nd 4e4\ni d.png\n"
        ),
        "data.txt",
        read_exposure_series,
    ),
    "tone curve": (lambda path: path.write_text("0 0\n1 0.5 # half\n200 100\n255,200\n"), "tone.txt", read_tone_curve),
    "record": (_record, "a.json", _finished),
}
"""Name -> (writes a sound file, its name, reads it)."""


def sound(name, folder):
    """Write a sound file of this reader into an empty folder: its path."""
    write, file, _ = TEXTS[name]
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / file)
    return folder / file
