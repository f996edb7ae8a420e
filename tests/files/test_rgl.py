"""RGL's tensor files: real ones back to the bit, anything else refused."""

import struct

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.io import read_rgl, write_rgl
from tests.files.mutations import mutated, survives

MATERIALS = ("cc_ibiza_sunset", "paper_white", "satin_rosaline", "vch_golden_yellow")


def _file(real_data, material="paper_white"):
    return real_data / "rgl" / f"{material}_rgb.bsdf"


@pytest.mark.parametrize("material", MATERIALS)
def test_reading_and_writing_give_the_same_bytes(real_data, tmp_path, material):
    fields = read_rgl(_file(real_data, material))
    write_rgl(tmp_path / "a.bsdf", fields)
    assert (tmp_path / "a.bsdf").read_bytes() == _file(real_data, material).read_bytes()
    again = read_rgl(tmp_path / "a.bsdf")
    for name, field in fields.variables.items():
        assert again[name].dtype == field.dtype
        assert again[name].values.tobytes() == field.values.tobytes()


def test_fields_are_where_the_format_says(real_data):
    content, fields = _file(real_data).read_bytes(), read_rgl(_file(real_data))
    at = content.index(b"luminance") + len("luminance")
    dimensions, kind, offset = struct.unpack_from("<HBQ", content, at)
    shape = struct.unpack_from(f"<{dimensions}Q", content, at + 11)
    assert kind == 10
    assert fields["luminance"].shape == shape
    np.testing.assert_array_equal(
        fields["luminance"].values.ravel(), np.frombuffer(content, "<f4", int(np.prod(shape)), offset)
    )
    assert bytes(fields["description"].values) == b"White A4 paper (160 gsm)"
    assert fields.attrs["source"] == "paper_white_rgb.bsdf"


def _with(content, name, *, dtype=None, offset=None, shape=None):
    data = bytearray(content)
    at = data.index(bytes([len(name)]) + b"\0" + name.encode()) + 2 + len(name)
    dimensions, old_type, old_offset = struct.unpack_from("<HBQ", data, at)
    struct.pack_into("<HBQ", data, at, dimensions, dtype or old_type, old_offset if offset is None else offset)
    if shape is not None:
        struct.pack_into(f"<{dimensions}Q", data, at + 11, *shape)
    return bytes(data)


def test_what_is_wrong_is_said_in_one_line(real_data, tmp_path):
    good = _file(real_data).read_bytes()
    start = read_rgl(_file(real_data))["rgb"].values.tobytes()
    at = good.index(start)
    cases = [
        (b"", "not an RGL file"),
        (b"tensor_file\0\2\0" + good[14:], "not an RGL file"),
        (good[:14] + struct.pack("<I", 2**32 - 1) + good[18:], "4294967295 fields"),
        (good[:19], "the list of fields is damaged"),
        (good[:-1], "truncated or damaged: field valid"),
        (_with(good, "rgb", dtype=11), "truncated or damaged"),
        (_with(good, "rgb", dtype=99), "type 99"),
        (_with(good, "rgb", dtype=6), "field rgb must be float32"),
        (_with(good, "rgb", offset=2**63), "truncated or damaged"),
        (_with(good, "vndf", shape=(1, 8, 2**40, 2**40)), "truncated or damaged"),
        (_with(good, "vndf", shape=(1, 8, 128, 0)), "field vndf must be float32"),
        (_with(good, "theta_i", shape=(7,)), "shapes of the fields must agree"),
        (good.replace(b"sigma", b"s1gma"), "field sigma is missing"),
        (good.replace(b"\x05\0sigma", b"\x05\0vndf2", 1).replace(b"vndf2", b"s gma"), "is invalid or repeated"),
        (good[:at] + struct.pack("<f", np.nan) + good[at + 4 :], "field rgb must contain finite numbers, got nan"),
    ]
    path = tmp_path / "bad.bsdf"
    for content, words in cases:
        path.write_bytes(content)
        with pytest.raises(FileFormatError) as caught:
            read_rgl(path)
        assert str(caught.value).startswith(str(path)), words
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(FileFormatError, match="no such file"):
        read_rgl(tmp_path / "none.bsdf")
    with pytest.raises(FileFormatError, match="folder"):
        read_rgl(tmp_path)


def test_fields_that_make_no_brdf_are_not_written(real_data, tmp_path):
    fields = read_rgl(_file(real_data))
    less = fields.copy(deep=True)
    less["vndf"][0, 3, 5, 5] = -1e-9
    nothing = fields.copy(deep=True)
    nothing["luminance"][0, 2] = 0
    for wrong, words in (
        (fields.drop_vars("ndf"), "field ndf is missing"),
        (fields.astype(np.float64), "must be float32"),
        (fields.assign_coords(theta_i=fields["theta_i"][::-1]), "theta_i must increase strictly"),
        (less, "vndf must not be negative"),
        (nothing, "a positive value for every direction"),
        (fields.isel(column=slice(8)), "must be square"),
        (fields.assign(sigma=fields["sigma"].where(fields["sigma"] < 0.5, 0)), "sigma must be positive"),
        (fields.isel(channel=[0]), "3 channels"),
        (fields["rgb"], "a Dataset"),
    ):
        with pytest.raises(ArgumentError, match=words):
            write_rgl(tmp_path / "a.bsdf", wrong)
        assert not list(tmp_path.iterdir())
    (tmp_path / "a.bsdf").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        write_rgl(tmp_path / "a.bsdf", fields)


@pytest.mark.parametrize("count", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_files(real_data, tmp_path, count):
    content = _file(real_data, "satin_rosaline").read_bytes()
    refused, accepted = survives(read_rgl, tmp_path / "a.bsdf", mutated(content, count, 1, 412))
    assert refused > count / 3
    assert accepted > 0
