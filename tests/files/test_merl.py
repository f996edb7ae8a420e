"""MERL files: what is read is what is in them, what is written is what was read, and nothing else is accepted."""

import struct

import numpy as np
import pytest

from matcam import read_merl, write_merl
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.grid import brdf_table
from matcam.files.merl import FILE_BYTES, SCALE

CELLS = 90 * 90 * 180


def write_raw(path, stored, dims=(90, 90, 180)):
    path.write_bytes(struct.pack("<3i", *dims) + np.asarray(stored, dtype="<f8").tobytes())


@pytest.fixture(scope="module")
def random_values():
    """Positive doubles over the whole range of exponents that the scaled value can hold, a quarter of them missing."""
    rng = np.random.default_rng(1)
    stored = rng.uniform(1, 2, 3 * CELLS) * 2.0 ** rng.integers(-1010, 1023, 3 * CELLS)
    stored[rng.random(3 * CELLS) < 0.25] = -rng.uniform(0, 5)
    stored[:5] = [0.0, -0.0, np.finfo(float).max, 2.0**-1010, -1e-300]
    return stored


def test_reading_is_what_the_format_says(tmp_path, random_values):
    write_raw(tmp_path / "a.binary", random_values)
    table = read_merl(tmp_path / "a.binary")
    planes = random_values.reshape(3, 90, 90, 180)
    for channel, scale in enumerate((1 / 1500, 1.15 / 1500, 1.66 / 1500)):
        expected = np.where(planes[channel] < 0, np.nan, planes[channel] * scale)
        np.testing.assert_allclose(table.values[..., channel], expected, rtol=3e-16)
    assert table.attrs["sampling"] == "centre"
    assert table.attrs["source"] == "a.binary"
    assert float(table["theta_h"][1]) == pytest.approx((1.5 / 90) ** 2 * np.pi / 2)
    edge = read_merl(tmp_path / "a.binary", sampling="edge")
    assert float(edge["theta_h"][1]) == pytest.approx((1 / 90) ** 2 * np.pi / 2)
    assert edge.attrs["sampling"] == "edge"


def test_read_and_write_keep_header_values_and_gaps(tmp_path, random_values):
    write_raw(tmp_path / "a.binary", random_values)
    write_merl(tmp_path / "b.binary", read_merl(tmp_path / "a.binary"))
    first, second = ((tmp_path / name).read_bytes() for name in ("a.binary", "b.binary"))
    assert first[:12] == second[:12]
    assert len(second) == FILE_BYTES
    again = np.frombuffer(second, "<f8", offset=12)
    valid = random_values >= 0
    assert np.all(again[~valid] < 0)
    units = np.abs(again[valid] - random_values[valid]) / np.spacing(np.minimum(random_values[valid], 1e308))
    assert units.max() <= 1


def test_a_second_round_trip_changes_nothing(tmp_path, random_values):
    write_raw(tmp_path / "a.binary", random_values)
    table = read_merl(tmp_path / "a.binary")
    write_merl(tmp_path / "b.binary", table)
    np.testing.assert_allclose(read_merl(tmp_path / "b.binary").values, table.values, rtol=3e-16)


def test_stand_in_materials_are_read_as_their_maker_made_them(stand_in):
    table = read_merl(stand_in("chrome"))
    assert np.isnan(table.values).mean() == pytest.approx(0.248, abs=5e-4)
    assert 10 < table.values[0, 30, 90, 1] < 1e5


def changed(**positions):
    stored = np.ones(3 * CELLS)
    for position, value in positions.items():
        stored[int(position[1:])] = value
    return stored


def bad_files():
    good = struct.pack("<3i", 90, 90, 180) + np.ones(3 * CELLS).tobytes()
    return {
        "empty": (b"", "0 bytes"),
        "header only in part": (good[:7], "7 bytes"),
        "header only": (good[:12], "truncated: 12 bytes, but a MERL file has 34992012"),
        "truncated": (good[:-8], "truncated"),
        "oversized": (good + b"\0", "oversized: 34992013 bytes"),
        "foreign": (b"\x89PNG\r\n\x1a\n" + bytes(1000), "bytes 0 to 11 are"),
        "text": (b"theta_h,theta_d,phi_d,R,G,B\n" * 100, "not a MERL file"),
        "other grid": (struct.pack("<3i", 90, 90, 360) + good[12:], "are (90, 90, 360), but must be (90, 90, 180)"),
        "huge grid": (struct.pack("<3i", 2**31 - 1, 2**31 - 1, 2**31 - 1) + good[12:], "2147483647"),
        "negative grid": (struct.pack("<3i", -90, 90, 180) + good[12:], "-90"),
        "all missing": (struct.pack("<3i", 90, 90, 180) + (-np.ones(3 * CELLS)).tobytes(), "every value is negative"),
        "NaN inside": (struct.pack("<3i", 90, 90, 180) + changed(p1000=np.nan).tobytes(), "byte 8012 is nan"),
        "infinity inside": (
            struct.pack("<3i", 90, 90, 180) + changed(p2=np.inf, p5=np.inf).tobytes(),
            "byte 28 is inf, not a finite number (2 such",
        ),
        "minus infinity": (struct.pack("<3i", 90, 90, 180) + changed(p0=-np.inf).tobytes(), "byte 12 is -inf"),
    }


@pytest.mark.parametrize("kind", bad_files())
def test_anything_else_is_refused_in_one_line(kind, tmp_path):
    content, words = bad_files()[kind]
    path = tmp_path / "bad.binary"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_merl(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert words in message
    assert "\n" not in message


def test_an_unchecked_header_allocates_nothing(tmp_path):
    import tracemalloc

    path = tmp_path / "bad.binary"
    path.write_bytes(struct.pack("<3i", 30000, 30000, 30000))
    tracemalloc.start()
    with pytest.raises(FileFormatError):
        read_merl(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_positions_that_are_no_files(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        read_merl(tmp_path / "none.binary")
    with pytest.raises(FileFormatError, match="folder"):
        read_merl(tmp_path)
    with pytest.raises(ArgumentError, match="sampling must be"):
        read_merl(tmp_path / "none.binary", sampling="middle")


def table_of(value=1.0, channels=3):
    return brdf_table(np.full((90, 90, 180, channels), value), "centre")


def test_writing_refuses_what_the_format_cannot_hold(tmp_path):
    path = tmp_path / "a.binary"
    negative = table_of()
    negative[3, 4, 5, 1] = -1e-9
    huge = table_of(np.finfo(float).max)
    infinite = table_of()
    infinite[0, 0, 0, 0] = np.inf
    cases = [
        (negative, "negative values"),
        (table_of(np.nan), "all values of this table are missing"),
        (huge, "overflow"),
        (infinite, "infinities"),
        (table_of().isel(channel=[0]), "this table has 1"),
        (table_of().isel(phi_d=slice(0, 90)), "shape"),
        (table_of().transpose("channel", ...), "dims"),
        (table_of().assign_attrs(sampling="?"), "attrs['sampling']"),
        (table_of().assign_coords(theta_h=np.arange(90.0)), "coordinate theta_h"),
        (np.ones((90, 90, 180, 3)), "must be an xarray.DataArray"),
    ]
    for table, words in cases:
        with pytest.raises(ArgumentError) as caught:
            write_merl(path, table)
        assert words in str(caught.value)
        assert not path.exists()


def test_writing_replaces_nothing_unasked_and_leaves_nothing_behind(tmp_path):
    path = tmp_path / "a.binary"
    path.write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        write_merl(path, table_of())
    assert path.read_text() == "precious"
    write_merl(path, table_of(), force=True)
    assert path.stat().st_size == FILE_BYTES
    with pytest.raises(OutputError, match="is a folder"):
        write_merl(tmp_path, table_of(), force=True)
    with pytest.raises(OutputError, match="is a file, not a folder"):
        write_merl(path / "b.binary", table_of())
    assert [p.name for p in tmp_path.iterdir()] == ["a.binary"]
    assert SCALE[0] == 1 / 1500
