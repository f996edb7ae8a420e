"""Pictures in files: every bit comes back, and damaged or foreign files are one line."""

import logging
import struct

import numpy as np
import OpenEXR
import pytest
import tifffile

from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.io import read_exr, read_float_tiff, write_exr, write_float_tiff

FORMATS = {"exr": (write_exr, read_exr), "tif": (write_float_tiff, read_float_tiff)}


@pytest.fixture(params=FORMATS, name="kind")
def _kind(request):
    return request.param


def picture(shape, seed=1):
    """Every kind of float: normal, huge, tiny, denormal, signed zeros, infinities, and NaNs with their payloads."""
    bits = np.random.default_rng(seed).integers(0, 2**32, shape, dtype=np.uint32)
    values = bits.view(np.float32)
    values.flat[:4] = [-0.0, np.nan, np.inf, 1e-42]
    return values


@pytest.mark.parametrize(
    "shape", [(2, 2), (37, 53), (40, 3), (33, 20, 3), (5, 70, 1), (9, 8, 2), (17, 4, 4), (6, 5, 31)]
)
def test_round_trip_to_the_bit(kind, shape, tmp_path):
    write, read = FORMATS[kind]
    values = picture(shape)
    write(tmp_path / f"a.{kind}", values)
    back = read(tmp_path / f"a.{kind}")
    assert back.dtype == np.float32
    assert back.shape == shape
    np.testing.assert_array_equal(back.view(np.uint32), values.view(np.uint32))


def test_other_programs_see_the_same_picture(tmp_path):
    values = np.random.default_rng(2).random((11, 7, 3)).astype(np.float32)
    write_exr(tmp_path / "a.exr", values)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, values)
    write_float_tiff(tmp_path / "a.tif", values)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), values)


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_exr_of_other_programs(compression, tmp_path):
    values = picture((41, 19))
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": values}).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr").view(np.uint32), values.view(np.uint32))


def test_nothing_is_replaced_unasked_and_nothing_is_left_half(kind, tmp_path):
    write, _ = FORMATS[kind]
    path = tmp_path / f"a.{kind}"
    write(path, np.zeros((3, 3)))
    before = path.read_bytes()
    with pytest.raises(OutputError, match="exists"):
        write(path, np.ones((3, 3)))
    assert path.read_bytes() == before
    write(path, np.ones((3, 3)), force=True)
    assert path.read_bytes() != before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros(5), "shape (H, W) or (H, W, channels)"),
        (np.zeros((0, 5)), "got (0, 5)"),
        (np.zeros((2, 2, 2, 2)), "got (2, 2, 2, 2)"),
        (np.zeros((2, 2), complex), "real numbers, got complex128"),
        ([["a", "b"]], "real numbers"),
        (np.full((2, 2), 1e39), "the range of float32, got 1e+39"),
    ],
)
def test_what_is_no_picture_is_not_written(kind, values, words, tmp_path):
    with pytest.raises(ArgumentError) as caught:
        FORMATS[kind][0](tmp_path / f"a.{kind}", values)
    assert words in str(caught.value)
    assert not list(tmp_path.iterdir())


def refused(read, path, capfd):
    with pytest.raises(FileFormatError) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""
    return str(caught.value)


def test_truncated_anywhere(kind, tmp_path, capfd):
    write, read = FORMATS[kind]
    write(tmp_path / "whole", picture((40, 30, 3)))
    whole = (tmp_path / "whole").read_bytes()
    path = tmp_path / f"cut.{kind}"
    for length in [*range(0, 600, 23), *range(600, len(whole), 1499), len(whole) - 1]:
        path.write_bytes(whole[:length])
        refused(read, path, capfd)


def test_damaged_anywhere(kind, tmp_path):
    """A flipped byte gives a picture or one line, never anything else."""
    write, read = FORMATS[kind]
    write(tmp_path / "whole", picture((20, 10)))
    whole = (tmp_path / "whole").read_bytes()
    rng, path = np.random.default_rng(7), tmp_path / f"hit.{kind}"
    positions = [*range(0, 420, 3), *rng.integers(420, len(whole), 20)]
    for position in positions:
        damaged = bytearray(whole)
        damaged[position] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            values = read(path)
        except FileFormatError:
            continue
        assert values.dtype == np.float32


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"P6 3 3 255 ", bytes(range(256)) * 8])
def test_foreign_files(kind, content, tmp_path, capfd):
    path = tmp_path / f"a.{kind}"
    path.write_bytes(content)
    refused(FORMATS[kind][1], path, capfd)


def test_files_that_are_not_there(kind, tmp_path, capfd):
    assert "no such file" in refused(FORMATS[kind][1], tmp_path / "none", capfd)
    assert "is a folder" in refused(FORMATS[kind][1], tmp_path, capfd)


def exr(path, channels, **header):
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header, channels).write(
        str(path)
    )


def test_exr_that_holds_something_else(tmp_path, capfd):
    path, ones = tmp_path / "a.exr", np.ones((8, 8), np.float32)
    exr(path, {"Y": ones.astype(np.float16)})
    assert "channel 'Y' contains 16-bit floats" in refused(read_exr, path, capfd)
    exr(path, {"Y": ones.astype(np.uint32)})
    assert "contains whole numbers" in refused(read_exr, path, capfd)
    exr(path, {"R": ones, "depth": ones})
    assert "channels are R, depth" in refused(read_exr, path, capfd)
    exr(path, {"Y": ones}, compression=OpenEXR.PXR24_COMPRESSION)
    assert "compression 5 of OpenEXR is not supported" in refused(read_exr, path, capfd)
    OpenEXR.File([OpenEXR.Part({"name": n}, {"Y": ones}) for n in ("a", "b")]).write(str(path))
    assert "several parts" in refused(read_exr, path, capfd)


def test_exr_with_an_absurd_header(tmp_path, capfd):
    path = tmp_path / "a.exr"
    write_exr(path, np.ones((8, 8)))
    whole = path.read_bytes()
    at = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    for corner in (2**31 - 2, -5, 40_000):
        path.write_bytes(whole[: at + 8] + struct.pack("<2i", corner, corner) + whole[at + 16 :])
        words = refused(read_exr, path, capfd)
        assert "header specifies" in words or "truncated" in words or "damaged" in words


def test_tiff_that_holds_something_else(tmp_path, capfd):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((8, 8), np.uint16))
    assert "contains uint16, but only 32-bit floats are supported" in refused(read_float_tiff, path, capfd)
    tifffile.imwrite(path, np.ones((8, 8), np.float64))
    assert "contains float64" in refused(read_float_tiff, path, capfd)
    tifffile.imwrite(path, np.ones((4, 8, 8), np.float32), photometric="minisblack")
    assert "4 pages" in refused(read_float_tiff, path, capfd)
    tifffile.imwrite(path, np.ones((3, 8, 8), np.float32), photometric="rgb", planarconfig="separate")
    assert "shape (3, 8, 8)" in refused(read_float_tiff, path, capfd)
    assert logging.getLogger("tifffile").level == logging.NOTSET


def test_tiff_with_an_absurd_header(tmp_path, capfd):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((8, 8), np.float32), metadata=None)
    with tifffile.TiffFile(path) as file:
        positions = [file.pages[0].tags[name].valueoffset for name in ("ImageWidth", "ImageLength")]
    whole = bytearray(path.read_bytes())
    for position in positions:
        whole[position : position + 2] = b"\xff\xff"
    path.write_bytes(whole)
    assert "header specifies 65535 x 65535 pixels" in refused(read_float_tiff, path, capfd)
