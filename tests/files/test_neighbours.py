"""Files of other programs: BiRD's JSON, Zemax's and UTIA's BRDFs, light positions. Read as they are, refused by name."""

import contextlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.exchange.contents import read, write
from matcam.exchange.conversion import convert
from matcam.files import table_decoders, zemax_decoder
from matcam.files.formats import FORMATS, format_for, identify
from matcam.files.light_positions import LightPosition, read_light_positions, write_light_positions
from matcam.io import read_bird, read_samples, read_utia, read_zemax, write_bird
from tests.files.text_readers import ZEMAX
from tests.oracle.directions import half_and_difference


@pytest.fixture
def samples(tmp_path):
    random = np.random.default_rng(2)
    angles = np.degrees(random.uniform([0, 0, 0, 0], [1.5, 6.2, 1.5, 6.2], (40, 4)))
    lines = ["theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,R_per_sr,G_per_sr"]
    lines += [",".join(f"{v:.12g}" for v in (*row, *random.random(2))) for row in angles]
    (tmp_path / "s.csv").write_text("\n".join(lines) + "\n")
    return read_samples(tmp_path / "s.csv")


def same_pairs(one, other):
    """Half angles alike, and azimuths up to the mirror image that an isotropic BRDF has."""
    np.testing.assert_allclose(one["theta_h"], other["theta_h"], atol=1e-7)
    np.testing.assert_allclose(one["theta_d"], other["theta_d"], atol=1e-7)
    np.testing.assert_allclose(np.cos(one["phi_d"]), np.cos(other["phi_d"]), atol=1e-6)


def test_bird_keeps_values_directions_and_channels(tmp_path, samples):
    write(tmp_path / "a.brdf", samples)
    assert identify(tmp_path / "a.brdf") == "bird"
    again = read(tmp_path / "a.brdf")
    np.testing.assert_array_equal(again.values, samples.values)
    assert list(again["channel"].values) == ["R", "G"]
    same_pairs(again, samples)
    spectral = samples.assign_coords(channel=["550 nm", "650 nm"])
    write_bird(tmp_path / "b.brdf", spectral)
    document = json.loads((tmp_path / "b.brdf").read_text())
    assert set(document["data"]["wavelength_i"]["values"]) == {550.0, 650.0}
    assert list(read_bird(tmp_path / "b.brdf")["channel"].values) == ["550 nm", "650 nm"]
    convert(tmp_path / "b.brdf", tmp_path / "b.csv")
    np.testing.assert_array_equal(read_samples(tmp_path / "b.csv").values, samples.values)


def test_bird_documents_are_valid_by_the_schemas_of_the_project(tmp_path, samples):
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    folder = os.environ.get("MATCAM_BIRD_SCHEMAS")
    if not folder:
        pytest.skip("the schemas of the BiRD project are not in MATCAM_BIRD_SCHEMAS")
    referencing = pytest.importorskip("referencing")
    schemas = []
    for path in Path(folder).glob("*.json"):
        with contextlib.suppress(json.JSONDecodeError):  # one of them, of light sources, is no JSON
            schemas.append(json.loads(path.read_text()))
    registry = referencing.Registry().with_resources(
        (one["$id"], referencing.Resource.from_contents(one)) for one in schemas if "$id" in one
    )
    whole = next(one for one in schemas if "universal brdf data format" in one.get("title", "").lower())
    write_bird(tmp_path / "a.brdf", samples)
    document = json.loads((tmp_path / "a.brdf").read_text())
    problems = jsonschema.Draft202012Validator(whole, registry=registry).iter_errors(document)
    assert [f"{'/'.join(map(str, one.path))}: {one.message}"[:200] for one in problems] == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("data"), 'has no object "data"'),
        (lambda d: d["data"].pop("BRDF"), "data.BRDF is missing"),
        (lambda d: d["data"]["theta_i"].update(unit="grad"), "data.theta_i.unit must be one of rad, deg"),
        (lambda d: d["data"]["theta_r"]["values"].pop(), "data.theta_r has 79 values, but data.BRDF has 80"),
        (lambda d: d["data"]["theta_r"]["values"].__setitem__(0, 100), r"data.theta_r must lie in \[0, 90\] degrees"),
        (lambda d: d["data"]["BRDF"]["values"].__setitem__(0, "x"), "values must be a list of one or more finite"),
        (lambda d: d["data"]["BRDF"]["values"].__setitem__(0, 10**400), "values must be a list of one or more finite"),
        (lambda d: d["data"]["BRDF"].update(values=["1"] * 80), "values must be a list of one or more finite"),
        (lambda d: d["data"]["BRDF"].update(values=[[1], [1, 2]]), "values must be a list of one or more finite"),
        (lambda d: d["data"]["BRDF"].update(unit=[1]), "data.BRDF.unit must be one of 1/sr"),
        (
            lambda d: d["data"]["adhoc_variables"]["channel"]["values"].__setitem__(0, "x" * 61),
            "the name of a channel must have at most 60 characters",
        ),
        (lambda d: d["data"].pop("adhoc_variables"), "several readings have the same pair of directions"),
    ],
)
def test_damaged_bird_documents_are_refused(tmp_path, samples, change, message):
    write_bird(tmp_path / "a.brdf", samples)
    document = json.loads((tmp_path / "a.brdf").read_text())
    change(document)
    (tmp_path / "a.brdf").write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=message):
        read_bird(tmp_path / "a.brdf")


def test_zemax_directions_are_about_the_mirror_direction(tmp_path):
    (tmp_path / "a.bsdf").write_text(ZEMAX)
    assert identify(tmp_path / "a.bsdf") == "zemax"
    found = read(tmp_path / "a.bsdf")
    # at 60 degrees, 40 degrees beyond the mirror direction lie below the surface
    assert sorted(found.values[:, 0]) == [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]
    by_value = {float(v): i for i, v in enumerate(found.values[:, 0])}
    for value, view in ((1, 30), (2, 10), (6, 50), (9, 40)):
        light = 30 if value < 8 else 60
        expected = half_and_difference(np.radians(light), 0.0, np.radians(view), np.pi)
        at = by_value[value]
        np.testing.assert_allclose([found["theta_h"][at], found["theta_d"][at]], expected[:2], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("BRDF\n", "BTDF\n", "ScatterType must be BRDF, got BTDF"),
        ("PlaneSymmetrical", "ASymmetrical4D", "Symmetry must be PlaneSymmetrical, got ASymmetrical4D"),
        ("8 13 14\n", "8 13\n", "block 2 must have 3 rows of 3 non-negative values"),
        ("ScatterRadial 3", "ScatterRadial x", "ScatterRadial must have a count, followed by as many angles"),
        ("TIS 0.2\n8 9 10\n8 11 12\n8 13 14\n", "", "has 1 blocks of values, but each channel must occur once"),
        ("DataBegin", "", "is not a complete BSDF of Zemax"),
    ],
)
def test_other_zemax_files_are_refused_by_name(tmp_path, old, new, message):
    (tmp_path / "a.bsdf").write_text(ZEMAX.replace(old, new))
    with pytest.raises(FileFormatError, match=message):
        read_zemax(tmp_path / "a.bsdf")


def test_utia_is_read_as_its_own_loader_reads_it(tmp_path):
    values = np.random.default_rng(0).random(3 * 288 * 288)
    values.tofile(tmp_path / "m.bin")
    assert identify(tmp_path / "m.bin") == "utia"
    found = read(tmp_path / "m.bin")["brdf"]
    for plane, it, ip, jt, jp in ((0, 1, 7, 2, 9), (2, 5, 47, 3, 0)):
        index = plane * 288 * 288 + 288 * (48 * it + ip) + 48 * jt + jp  # the database's read_brdf
        assert float(found[it, ip, jt, jp, plane]) == values[index]
    assert np.degrees(found["theta_o"].values[-1]) == pytest.approx(75)
    assert np.degrees(found["phi_o"].values[1]) == pytest.approx(7.5)
    convert(tmp_path / "m.bin", tmp_path / "m.nc")
    np.testing.assert_array_equal(read(tmp_path / "m.nc")["brdf"].values, found.values)
    (tmp_path / "m.bin").write_bytes(values[:-1].tobytes())
    with pytest.raises(FileFormatError, match="has 1990648 bytes, but a BRDF of UTIA has 1990656"):
        read_utia(tmp_path / "m.bin")
    with pytest.raises(FileFormatError, match="1 values that are not finite"):
        np.append(values[:-1], np.nan).tofile(tmp_path / "m.bin")
        read_utia(tmp_path / "m.bin")


def test_large_files_are_decoded_in_another_process(tmp_path, monkeypatch):
    """What decodes them there is not what this process has."""
    (tmp_path / "a.bsdf").write_text(ZEMAX + "# nothing more\n" * 5000)
    np.full(3 * 288 * 288, 0.2).tofile(tmp_path / "m.bin")
    monkeypatch.delattr(zemax_decoder, "decode_zemax")
    monkeypatch.delattr(table_decoders, "decode_utia")
    assert read_zemax(tmp_path / "a.bsdf").shape == (13, 1)
    assert read_utia(tmp_path / "m.bin")["brdf"].shape == (6, 48, 6, 48, 3)


def test_light_positions_come_back(tmp_path):
    positions = [LightPosition(f"a {k}.jpg", np.random.default_rng(k).standard_normal(3)) for k in range(3)]
    write_light_positions(tmp_path / "a.lp", positions)
    again = read_light_positions(tmp_path / "a.lp")
    assert [one.file for one in again] == [one.file for one in positions]
    np.testing.assert_array_equal([one.position for one in again], [one.position for one in positions])


def test_wrong_light_positions_are_not_written(tmp_path):
    for name, position, message in (
        ("a.jpg", [0, 0, 0], "three finite numbers"),
        ("a.jpg", [0, np.nan, 1], "three finite numbers"),
        ("a.jpg", [0, 1], "three finite numbers"),
        ("a\nb.jpg", [0, 0, 1], "must be one line"),
    ):
        with pytest.raises(ArgumentError, match=message):
            write_light_positions(tmp_path / "a.lp", [LightPosition(name, np.array(position, float))])
    with pytest.raises(ArgumentError, match="at least one LightPosition"):
        write_light_positions(tmp_path / "a.lp", [])
    assert not (tmp_path / "a.lp").exists()


def test_what_is_only_read_is_not_offered_for_writing(tmp_path):
    assert {form.name for form in FORMATS if form.reader and not form.written} == {"zemax", "utia", "picture sidecar"}
    with pytest.raises(ArgumentError, match="the name must end in one of"):
        format_for("a.bin")
    assert format_for("a.bsdf").name == "rgl"
