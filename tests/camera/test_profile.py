"""The profile file: what is written is read back, and nothing else is accepted."""

import json

import numpy as np
import pytest

from matcam import (
    BoxPixel,
    Camera,
    ColourOptics,
    DefocusOptics,
    DiffractionOptics,
    GaussianOptics,
    HaloOptics,
    MeasuredOptics,
    SeidelOptics,
    Sensor,
    WindowedGaussianPixel,
    ZernikeOptics,
)
from matcam.camera import Provenance, Uncertainty
from matcam.camera import profile as profile_schema
from matcam.camera.lens_field import Coefficient, LensField
from matcam.core.errors import FileFormatError, OutputError
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
    Camera(
        DefocusOptics(8, 550e-9, 4.73e-6, 1.5),
        BoxPixel(0.5),
        Sensor(
            4.73e-6,
            2e4,
            2.5,
            0.7,
            14,
            "RGGB",
            prnu=0.01,
            dark_current=3.0,
            dark_nonuniformity=0.1,
            dsnu=1.5,
            pattern_seed=7,
        ),
    ),
    Camera(
        GaussianOptics(0.6),
        field=LensField(
            (999.5, 749.5), 1249.0, Coefficient(-0.01, 1e-3), Coefficient(2e-3, 1e-4), Coefficient(0.2, 0.03), 800.0
        ),
    ),
    Camera(
        HaloOptics(HaloOptics(MeasuredOptics([0, 0.2, 0.4, 0.8], [1, 0.7, 0.3, 0]), 0.01, 4.0), 0.002, 150.0),
        uncertainty=Uncertainty.of({"optics.radius_px": 30.0, "optics.core.core.mtf[1]": 0.01}),
    ),
    Camera(
        ZernikeOptics(8, 550e-9, 4.73e-6, 0.05, (0.1, -0.02), (0.03, 0.04), (0.01, 0.0), 0.02),
        uncertainty=Uncertainty.of({"optics.coma_waves[1]": 0.01}),
    ),
    Camera(SeidelOptics(8, 550e-9, 4.73e-6, 900.0, 0.01, 0.1, 0.2, -0.05, 0.03)),
    Camera(
        ColourOptics(
            GaussianOptics(0.5),
            HaloOptics(ZernikeOptics(8, 550e-9, 4.73e-6, coma=(0.1, 0.0)), 0.01, 9.0),
            DiffractionOptics(8, 450e-9, 4.73e-6),
            red_shift=(0.1, 0.0),
            blue_shift=(-0.2, 0.05),
        ),
        uncertainty=Uncertainty.of({"optics.green.core.defocus_waves": 0.01, "optics.red.sigma_px": 0.02}),
    ),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: type(c.optics).__name__)
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


@pytest.mark.parametrize("version", profile_schema.VERSIONS)
def test_published_schemas_are_those_in_the_code(version):
    published = json.loads((REPOSITORY / "docs" / f"camera-profile-v{version}.schema.json").read_text())
    assert published == profile_schema.json_schema(version)


def test_version_1_is_still_read(tmp_path):
    """A file as matcam 0.1.0 wrote it; what version 1 did not know is refused in it."""
    path = tmp_path / "old.json"
    path.write_text(json.dumps(changed(version=1)))
    assert repr(Camera.load(path)) == repr(CAMERAS[0])
    halo = {"model": "halo", "core": {"model": "gaussian", "sigma_px": 0.5}, "fraction": 0.1, "radius_px": 9.0}
    path.write_text(json.dumps(changed(version=1, optics=halo)))
    with pytest.raises(FileFormatError, match="field optics"):
        Camera.load(path)


def test_version_2_is_still_read_and_knows_no_field(tmp_path):
    path = tmp_path / "old.json"
    path.write_text(json.dumps(valid()))
    assert Camera.load(path).field is None
    path.write_text(json.dumps(changed(field=None)))
    with pytest.raises(FileFormatError, match="field field: unknown"):
        Camera.load(path)


def test_version_3_is_still_read_and_knows_no_aberrations(tmp_path):
    path = tmp_path / "old.json"
    path.write_text(json.dumps(changed(version=3)))
    assert repr(Camera.load(path)) == repr(CAMERAS[0])
    lens = CAMERAS[6].profile()["optics"]
    for optics in (lens, halo(lens)):
        path.write_text(json.dumps(changed(version=4, optics=optics)))
        assert not Camera.load(path).optics.isotropic
        path.write_text(json.dumps(changed(version=3, optics=optics)))
        with pytest.raises(FileFormatError, match="field optics"):
            Camera.load(path)


def test_version_4_is_still_read_and_knows_no_dsnu(tmp_path):
    path = tmp_path / "old.json"
    path.write_text(json.dumps(changed(version=4, sensor=sensor())))
    assert float(Camera.load(path).sensor.dsnu) == 0
    path.write_text(json.dumps(changed(version=4, sensor=sensor(dsnu_electrons=1.0))))
    with pytest.raises(FileFormatError, match="dsnu_electrons"):
        Camera.load(path)
    path.write_text(json.dumps(changed(version=5, sensor=sensor(dsnu_electrons=1.0))))
    assert float(Camera.load(path).sensor.dsnu) == 1


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
        "version": 2,
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


def sensor(**changes):
    fields = {
        "pitch_m": 5e-6, "full_well_electrons": 2e4, "read_noise_electrons": 2.0, "gain_dn_per_electron": 1.0,
        "bits": None, "cfa": None, "prnu": 0.0, "dark_current_electrons_per_s": 0.0, "dark_nonuniformity": 0.0,
        "black_level_dn": 0.0, "pattern_seed": 0,
    }  # fmt: skip
    return fields | changes


def field(**changes):
    fields = {
        "centre_px": [99.5, 99.5], "unit_px": 141.0, "k1": [0.01, 0.001], "k2": [0.0, 0.0], "growth": [0.0, 0.0],
        "holds_at_px": 0.0,
    }  # fmt: skip
    return fields | changes


def halo(core, fraction=0.1):
    return {"model": "halo", "core": core, "fraction": fraction, "radius_px": 9.0}


def zernike(**changes):
    fields = {
        "model": "zernike", "f_number": 8.0, "wavelength_m": 5.5e-7, "pixel_pitch_m": 5e-6, "defocus_waves": 0.0,
        "astigmatism_waves": [0.0, 0.0], "coma_waves": [0.0, 0.0], "trefoil_waves": [0.0, 0.0], "spherical_waves": 0.0,
    }  # fmt: skip
    return fields | changes


def nested(depth):
    lens = {"model": "gaussian", "sigma_px": 0.5}
    for _ in range(depth):
        lens = halo(lens)
    return lens


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (changed(version=6), "version 6 is unknown"),
        (changed(version=3, field=field(unit_px=0.0)), "unit_px must lie in (0, inf) px"),
        (changed(version=3, field=field(k1=[0.1])), "field field.k1"),
        (changed(version=3, field=field(k1=[-0.4, 0.1])), "the distortion is not monotonic"),
        (changed(version=3, field=field(growth=[9.0, 0.1])), "growth must lie in"),
        (changed(version=True), "version True is unknown"),
        (changed(version="1"), "version '1' is unknown"),
        (changed(format="camera"), "not a camera profile"),
        ([1, 2], "not a camera profile"),
        ({k: v for k, v in valid().items() if k != "pixel"}, "field pixel: this field is required"),
        (changed(optics={"model": "gaussian"}), "field optics.sigma_px: this field is required"),
        (changed(optics={"model": "gaussian", "sigma_px": -0.5}), "sigma must lie in (0, inf) px, got -0.5"),
        (changed(optics={"model": "gaussian", "sigma_px": "0.5"}), "field optics.sigma_px"),
        (changed(optics={"model": "gaussian", "sigma": 0.5, "sigma_px": 0.5}), "field optics.sigma: unknown"),
        (changed(optics={"model": "lens"}), "field optics"),
        (changed(version=4, optics=zernike(coma_waves=[0.1])), "field optics.coma_waves"),
        (changed(version=4, optics=zernike(coma_waves=[1e-8, 0.0])), "must be waves rms, not metres"),
        (changed(version=4, optics=zernike(spherical_waves=9.0)), "spherical must lie in [-5, 5] waves rms"),
        (changed(version=4, optics=zernike(defocus_waves=[0.1])), "field optics.defocus_waves"),
        (changed(optics=halo({"model": "gaussian"})), "field optics.core.sigma_px: this field is required"),
        (changed(optics=halo({"model": "gaussian", "sigma_px": -1.0})), "sigma must lie in (0, inf) px, got -1"),
        (changed(optics=halo({"model": "box", "half_width_px": 0.5})), "field optics.core"),
        (changed(optics=halo({"model": "gaussian", "sigma_px": 1.0}, fraction=1.0)), "fraction must lie in [0, 1)"),
        (changed(optics=nested(300)), "field optics.core"),
        (changed(pixel={"model": "box", "half_width_px": 0.7}), "a pixel is no wider than the pitch"),
        (changed(uncertainty={"parameters": ["optics.sigma_px"], "covariance": [[-1.0]]}), "variances"),
        (changed(uncertainty={"parameters": ["optics.blur"], "covariance": [[1.0]]}), "optics.blur"),
        (changed(uncertainty={"parameters": ["optics.sigma_px"], "covariance": [[1.0], [1.0, 2.0]]}), ""),
        (changed(surprise=1), "field surprise"),
        (changed(sensor={"pitch_m": 5e-6}), "field sensor.full_well_electrons: this field is required"),
        (changed(sensor=sensor(bits=99)), "bits must be a whole number in [1, 32]"),
        (changed(sensor=sensor(cfa="XYZ")), "cfa must be one of"),
        (changed(sensor=sensor(read_noise_electrons=-1.0)), "read_noise must lie in"),
        (changed(version=1, sensor=None), "field sensor: unknown"),
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


def test_unreadable_positions(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        Camera.load(tmp_path / "none.json")
    with pytest.raises(FileFormatError, match="is a folder, not a camera profile"):
        Camera.load(tmp_path)
    huge = tmp_path / "huge.json"
    with huge.open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(FileFormatError, match="bytes exceed the limit"):
        Camera.load(huge)


def test_numbers_survive_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(3)
    for i, sigma in enumerate(10 ** rng.uniform(-3, 2, 20)):
        Camera(GaussianOptics(sigma)).save(tmp_path / f"{i}.json")
        assert float(Camera.load(tmp_path / f"{i}.json").optics.sigma) == sigma
