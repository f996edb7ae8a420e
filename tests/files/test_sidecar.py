"""The sidecar: what goes in comes out, the camera with it, and nothing else is accepted."""

import copy
import json

import numpy as np
import pytest

from matcam import BoxPixel, Camera, DiffractionOptics, HaloOptics, Sensor
from matcam.camera import Uncertainty
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.files import sidecar
from matcam.io import read_sidecar, sidecar_path, write_sidecar
from tests.conftest import REPOSITORY

CAMERA = Camera(
    HaloOptics(DiffractionOptics(8, 550e-9, 4.73e-6), 0.003, 120.0),
    BoxPixel(0.45),
    Sensor(4.73e-6, 2e4, 2.5, 0.5, 12, "RGGB", prnu=0.01),
    uncertainty=Uncertainty.of({"optics.fraction": 1e-3}),
)


def sections(**changes):
    given = {
        "picture": {
            "file": "copper.exr", "shape": [512, 512, 3], "quantity": "radiance",
            "channel_wavelengths_m": [6.1e-7, 5.5e-7, 4.6e-7], "axis_column_px": 255.5, "axis_row_px": 255.5,
        },
        "camera": CAMERA.profile(),
        "sample": {"kind": "sphere", "radius_px": 1 / 3, "distance_radii": None},
        "lamp": {"angles_rad": [0.5, 1.0], "azimuths_rad": [0.0, 3.0], "radius_rad": 0.004, "distance_radii": 28.0},
        "blur": {"jitter_px": 0.1, "aperture": 0.02, "focus_rad": 0.3},
        "exposure": {"electrons_per_radiance": [1e3, 1e4], "times_s": [0.01, 0.1], "seed": 1},
        "material": {"ndf": {"kind": "ggx", "alpha": 0.1}, "fresnel": [0.9, 0.6, 0.4]},
    }  # fmt: skip
    return copy.deepcopy(given) | changes


def test_round_trip(tmp_path):
    path = sidecar_path(tmp_path / "copper.exr")
    assert path.name == "copper.exr.json"
    write_sidecar(path, **sections(), notes="ü")
    back = read_sidecar(path)
    for name, section in sections().items():
        assert back[name] == section
    assert back["software"].startswith("matcam ")
    assert back["notes"] == "ü"
    assert repr(Camera.from_profile(back["camera"])) == repr(CAMERA)


@pytest.mark.parametrize(
    "changes",
    [
        {"exposure": None},
        {"lamp": {"angles_rad": [0.5], "azimuths_rad": None, "radius_rad": 0.0, "distance_radii": None}},
        {"sample": {"kind": "cylinder", "radius_px": 100.0, "distance_radii": 8.0}},
        {"sample": {"kind": "flat", "theta_o_rad": 0.7, "texture_pitch_px": 2.0}},
    ],
)
def test_all_kinds(changes, tmp_path):
    write_sidecar(tmp_path / "a.json", **sections(**changes))
    name, section = next(iter(changes.items()))
    assert read_sidecar(tmp_path / "a.json")[name] == section


def test_published_schema_is_the_one_in_the_code():
    published = json.loads((REPOSITORY / "docs" / "picture-sidecar-v1.schema.json").read_text())
    assert published == sidecar.json_schema()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sample": {"kind": "cube"}}, "field sample"),
        (
            {"sample": {"kind": "sphere", "radius_px": -1.0, "distance_radii": None}},
            "radius_px: must be greater than 0",
        ),
        ({"sample": {"kind": "sphere", "radius_px": 9.0, "distance_radii": 1.0}}, "distance_radii"),
        ({"sample": {"kind": "sphere", "radius_px": 9.0}}, "distance_radii: this field is required"),
        ({"lamp": {"angles_rad": [], "radius_rad": 0.0}}, "field lamp.angles_rad"),
        ({"lamp": {"angles_rad": [0.1], "azimuths_rad": [45.0], "radius_rad": 0.0}}, "field lamp.azimuths_rad.0"),
        ({"lamp": {"angles_rad": [0.1], "azimuths_rad": [], "radius_rad": 0.0}}, "as many entries as angles_rad"),
        ({"lamp": {"angles_rad": [0.1], "radius_rad": 0.0, "distance_radii": 0.5}}, "field lamp.distance_radii"),
        ({"lamp": {"angles_rad": [np.nan], "radius_rad": 0.0}}, "field lamp.angles_rad.0"),
        ({"lamp": {"angles_rad": [0.1], "radius_rad": 0.0, "colour": 1}}, "field lamp.colour: unknown"),
        ({"exposure": {"electrons_per_radiance": [0.0], "times_s": [], "seed": 1}}, "electrons_per_radiance.0"),
        ({"picture": sections()["picture"] | {"quantity": "grey"}}, "field picture.quantity"),
        ({"picture": sections()["picture"] | {"shape": [3]}}, "field picture.shape"),
        ({"picture": sections()["picture"] | {"file": "../../x.exr"}}, "field picture.file"),
    ],
)
def test_bad_sections_are_refused_in_one_line(changes, words, tmp_path):
    path = tmp_path / "a.json"
    with pytest.raises(ArgumentError) as caught:
        write_sidecar(path, **sections(**changes))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not path.exists()
    write_sidecar(path, **sections())
    document = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError) as caught:
        read_sidecar(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_what_json_cannot_hold_is_not_written(tmp_path):
    for material in ({"alpha": np.nan}, {"alpha": np.float32(1)}, {"alpha": object()}):
        with pytest.raises(ArgumentError, match="cannot be written as JSON"):
            write_sidecar(tmp_path / "a.json", **sections(material=material))
    assert not list(tmp_path.iterdir())


def test_existing_sidecars_are_kept(tmp_path):
    write_sidecar(tmp_path / "a.json", **sections())
    with pytest.raises(OutputError, match="exists"):
        write_sidecar(tmp_path / "a.json", **sections())
    write_sidecar(tmp_path / "a.json", **sections(), force=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, "sidecar version 2 is unknown"),
        ({"version": True}, "version True is unknown"),
        ({"format": "other"}, "not a picture sidecar"),
        ({"surprise": 1}, "field surprise: unknown"),
    ],
)
def test_other_versions_and_formats(change, words, tmp_path):
    path = tmp_path / "a.json"
    write_sidecar(path, **sections())
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FileFormatError) as caught:
        read_sidecar(path)
    assert words in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "\x00", '{"format": NaN}', "[" * 100_000])
def test_foreign_files(text, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="not a picture sidecar"):
        read_sidecar(path)


def test_a_bad_camera_inside_is_named():
    with pytest.raises(FileFormatError, match=r"copper\.exr\.json: field pixel: this field is required"):
        document = CAMERA.profile()
        del document["pixel"]
        Camera.from_profile(document, "copper.exr.json")
