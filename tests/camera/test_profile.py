"""The profile file: what is written is read back, and nothing else is accepted."""

import json

import numpy as np
import pytest

from matcam import (
    BoxPixel,
    Camera,
    DiffractionOptics,
    GaussianOptics,
    MeasuredOptics,
    Provenance,
    Uncertainty,
    WindowedGaussianPixel,
)
from matcam.camera import profile
from matcam.errors import FileFormatError, OutputError
from tests.conftest import REPOSITORY

CAMERAS = [
    Camera(GaussianOptics(0.5), BoxPixel(0.5)),
    Camera(
        DiffractionOptics(8, 550e-9, 4.73e-6),
        WindowedGaussianPixel(0.2, 0.45),
        uncertainty=Uncertainty(["optics.f_number", "pixel.sigma_px"], [[0.04, 1e-3], [1e-3, 1e-4]]),
        provenance=Provenance(source="lens data sheet", created="2026-01-31", software="x 1", notes="ü"),
    ),
    Camera(MeasuredOptics([0, 0.2, 0.4, 0.8], [1, 0.7, 0.3, 0]), uncertainty=Uncertainty.of({"optics.mtf[2]": 0.02})),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=["gaussian", "diffraction", "measured"])
def test_round_trip(camera, tmp_path):
    camera.save(tmp_path / "camera.json")
    read = Camera.load(tmp_path / "camera.json")
    assert repr(read) == repr(camera)
    if camera.provenance.software:
        assert read.provenance == camera.provenance
    else:
        assert read.provenance.software.startswith("matcam ")
        assert read.provenance.created
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "camera.json").read_bytes()


def test_published_schema_is_the_one_in_the_code():
    published = json.loads((REPOSITORY / "docs" / "camera-profile-v1.schema.json").read_text())
    assert published == profile.json_schema()


def test_existing_profile_is_not_replaced_unasked(tmp_path):
    path = tmp_path / "camera.json"
    CAMERAS[0].save(path)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="exists"):
        CAMERAS[1].save(path)
    assert path.read_bytes() == before
    CAMERAS[1].save(path, force=True)
    assert path.read_bytes() != before
    assert [p.name for p in tmp_path.iterdir()] == ["camera.json"]


def valid():
    return {
        "format": "matcam camera profile",
        "version": 1,
        "optics": {"model": "gaussian", "sigma_px": 0.5},
        "pixel": {"model": "box", "half_width_px": 0.5},
        "uncertainty": None,
        "provenance": {"source": ""},
    }


def changed(**changes):
    document = valid()
    for key, value in changes.items():
        document[key] = value
    return document


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (changed(version=2), "version 2 is unknown"),
        (changed(version="1"), "version '1' is unknown"),
        (changed(format="camera"), "not a camera profile"),
        ([1, 2], "not a camera profile"),
        ({k: v for k, v in valid().items() if k != "pixel"}, "field pixel: field required"),
        (changed(optics={"model": "gaussian"}), "field optics.sigma_px: field required"),
        (changed(optics={"model": "gaussian", "sigma_px": -0.5}), "sigma must lie in (0, inf) px, got -0.5"),
        (changed(optics={"model": "gaussian", "sigma_px": "0.5"}), "field optics.sigma_px"),
        (changed(optics={"model": "gaussian", "sigma": 0.5, "sigma_px": 0.5}), "field optics.sigma: extra"),
        (changed(optics={"model": "lens"}), "field optics"),
        (changed(pixel={"model": "box", "half_width_px": 0.7}), "a pixel is no wider than the pitch"),
        (changed(uncertainty={"parameters": ["optics.sigma_px"], "covariance": [[-1.0]]}), "variances"),
        (changed(uncertainty={"parameters": ["optics.blur"], "covariance": [[1.0]]}), "optics.blur"),
        (changed(uncertainty={"parameters": ["optics.sigma_px"], "covariance": [[1.0], [1.0, 2.0]]}), ""),
        (changed(surprise=1), "field surprise"),
    ],
)
def test_bad_profiles_are_refused_in_one_line_that_names_file_and_field(document, words, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError) as caught:
        Camera.load(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize("text", ["", "{", "\x00\x01\x02", '{"format": NaN}', "[" * 100_000])
def test_foreign_files_are_refused(text, tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="not a camera profile"):
        Camera.load(path)


def test_unreadable_places(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        Camera.load(tmp_path / "none.json")
    with pytest.raises(FileFormatError, match="cannot be read"):
        Camera.load(tmp_path)
    huge = tmp_path / "huge.json"
    with huge.open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(FileFormatError, match="too large"):
        Camera.load(huge)


def test_numbers_survive_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(3)
    for i, sigma in enumerate(10 ** rng.uniform(-3, 2, 20)):
        Camera(GaussianOptics(sigma)).save(tmp_path / f"{i}.json")
        assert float(Camera.load(tmp_path / f"{i}.json").optics.sigma) == sigma
