"""Pictures of every format, with what their files say: camera raw is written here, tag by tag."""

import struct

import imagecodecs
import numpy as np
import pytest
import tifffile

from matcam.core.errors import FileFormatError
from matcam.files import picture_header as picture_size
from matcam.files.float_pictures import write_exr
from matcam.files.photographs import open_photograph
from matcam.files.picture_header import Exif, read_exif

RNG = np.random.default_rng(0)
COUNTS = RNG.integers(600, 15000, (64, 96), dtype=np.uint16)


def write_dng(path, counts, cfa="RGGB", black=(512,) * 4, white=15871, model="Model 7", **more):
    """A digital negative as small as one can be (DNG 1.4)."""
    numbers = bytes("RGB".index(c) for c in cfa)
    tags = [
        (33421, 3, 2, (2, 2), True),
        (33422, 1, 4, numbers, True),
        (50706, 1, 4, bytes((1, 4, 0, 0)), True),
        (50707, 1, 4, bytes((1, 1, 0, 0)), True),
        (50708, 2, 0, f"Maker {model}", True),
        (50710, 1, 3, bytes((0, 1, 2)), True),
        (50713, 3, 2, (2, 2), True),
        (50714, 3, 4, black, True),
        (50717, 4, 1, white, True),
        (50721, 10, 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (271, 2, 0, "Maker", True),
        (272, 2, 0, model, True),
    ]
    tifffile.imwrite(path, counts, photometric=32803, extratags=tags, **more)
    return path


@pytest.mark.parametrize("cfa", ["RGGB", "GRBG", "BGGR", "GBRG"])
def test_raw_keeps_the_mosaic_apart_and_loses_its_black_level(tmp_path, cfa):
    black = (500, 510, 520, 530)
    found = open_photograph(write_dng(tmp_path / "a.dng", COUNTS, cfa, black))
    tile = np.tile(np.array(black).reshape(2, 2), (32, 48))
    assert found.cfa == cfa
    assert found.linear
    np.testing.assert_array_equal(found.values, COUNTS.astype(float) - tile)
    assert found.saturation == 15871 - 530
    assert found.exif.camera == "Maker Model 7"


def test_a_negative_by_another_name_is_still_one(tmp_path):
    assert open_photograph(write_dng(tmp_path / "a.tif", COUNTS)).cfa == "RGGB"


@pytest.mark.parametrize("canon", [False, True])
def test_a_preview_in_camera_raw_is_no_picture(tmp_path, canon):
    """As NEF and ARW have it under another name: a small preview first, the mosaic in a page of that page."""
    preview, path = np.full((16, 24, 3), 90, np.uint8), tmp_path / "shot.tif"
    with tifffile.TiffWriter(path) as file:
        file.write(preview, photometric="rgb", subfiletype=not canon, subifds=1)
        file.write(COUNTS, photometric=32803, subfiletype=0)
    if canon:  # its mark stands where the first directory was; that goes to the end
        data = path.read_bytes()
        directory = data[8 : 8 + 2 + 12 * int.from_bytes(data[8:10], "little") + 4]
        path.write_bytes(data[:4] + len(data).to_bytes(4, "little") + b"CR\2\0" + data[12:] + directory)
    with pytest.raises(FileFormatError, match="a preview of 24 x 16 px, as camera raw does"):
        open_photograph(path)


def test_other_formats(tmp_path):
    colour = RNG.integers(0, 65536, (20, 30, 3), dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(colour))
    found = open_photograph(tmp_path / "a.png")
    np.testing.assert_array_equal(found.values, colour)
    assert (found.cfa, found.saturation, found.linear, found.exif.camera) == (None, 65535.0, False, "")
    write_exr(tmp_path / "a.exr", colour / 7.0)
    found = open_photograph(tmp_path / "a.exr")
    np.testing.assert_array_equal(found.values, (colour / 7.0).astype(np.float32))
    assert (found.saturation, found.linear) == (np.inf, True)
    (tmp_path / "a.jpg").write_bytes(imagecodecs.jpeg8_encode((colour >> 8).astype(np.uint8)))
    assert open_photograph(tmp_path / "a.jpg").saturation == 255


def exif_block(model=b"Cam One\0", f_number=(56, 10), order="<"):
    head = b"II*\0" if order == "<" else b"MM\0*"
    entries = [(0x010F, 2, 6, 8 + 2 + 36 + 4), (0x0110, 2, len(model), 62), (0x8769, 4, 1, 80)]
    block = head + struct.pack(order + "I", 8) + struct.pack(order + "H", 3)
    block += b"".join(struct.pack(order + "HHII", *e) for e in entries) + struct.pack(order + "I", 0)
    block += b"Maker\0".ljust(12, b"\0") + model.ljust(18, b"\0")
    assert len(block) == 80
    block += struct.pack(order + "H", 1) + struct.pack(order + "HHII", 0x829D, 5, 1, 100) + struct.pack(order + "I", 0)
    return block.ljust(100, b"\0") + struct.pack(order + "II", *f_number)


@pytest.mark.parametrize("order", "<>")
def test_exif_of_jpeg_and_png(tmp_path, order):
    block = exif_block(order=order)
    jpeg = imagecodecs.jpeg8_encode(np.full((16, 16), 9, np.uint8))
    segment = b"Exif\0\0" + block
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:])
    png = imagecodecs.png_encode(np.full((16, 16), 9, np.uint8))
    chunk = struct.pack(">I", len(block)) + b"eXIf" + block + b"\0\0\0\0"
    (tmp_path / "a.png").write_bytes(png[:33] + chunk + png[33:])
    for name in ("a.jpg", "a.png"):
        found = read_exif(tmp_path / name)
        assert found.camera == "Maker Cam One"
        assert found.f_number == pytest.approx(5.6)
    assert read_exif(tmp_path / "none").camera == ""


def test_damaged_exif_says_nothing(tmp_path):
    block = exif_block()
    for cut in range(4, len(block), 7):
        (tmp_path / "a.tif").write_bytes(block[:cut])
        read_exif(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(b"II*\0\x08\0\0\0\xff\xff")
    assert read_exif(tmp_path / "a.tif") == Exif()


def test_what_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.cr2").write_bytes(b"II*\0" + bytes(500))
    (tmp_path / "a.nef").write_bytes(b"not a raw file at all" * 30)
    (tmp_path / "words.png").write_bytes(b"words")
    whole = write_dng(tmp_path / "whole.dng", COUNTS).read_bytes()
    (tmp_path / "cut.dng").write_bytes(whole[:3000])
    write_dng(tmp_path / "odd.dng", COUNTS, "RRGB")
    write_dng(tmp_path / "row.dng", COUNTS, "RBGG")
    for name, words in {
        "a.cr2": "camera raw", "a.nef": "unknown camera raw", "words.png": "neither TIFF, PNG, JPEG, OpenEXR nor camera raw",
        "cut.dng": "camera raw", "odd.dng": "the mosaic is RRGB", "row.dng": "the mosaic is RBGG",
        "missing.png": "no such file", ".": "is a folder",
    }.items():  # fmt: skip
        with pytest.raises(FileFormatError, match=words) as caught:
            open_photograph(tmp_path / name)
        assert "\n" not in str(caught.value)
    import sys

    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(FileFormatError, match=r"needs rawpy: .*matcam\[raw\]"):
        open_photograph(tmp_path / "whole.dng")


def test_a_picture_larger_than_memory_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    picture = RNG.integers(0, 256, (200, 300), dtype=np.uint8)
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(picture))
    (tmp_path / "a.jpg").write_bytes(imagecodecs.jpeg8_encode(picture))
    tifffile.imwrite(tmp_path / "a.tif", picture)
    monkeypatch.setattr(picture_size, "available_memory", lambda: 100_000)
    for name in ("a.png", "a.jpg", "a.tif"):
        with pytest.raises(FileFormatError, match="300 x 200 px needs"):
            open_photograph(tmp_path / name)
    monkeypatch.undo()
    assert picture_size.available_memory() > 1 << 28
    # a header may promise anything
    png = bytearray(imagecodecs.png_encode(picture))
    png[16:24] = struct.pack(">II", 1_000_000, 1_000_000)
    (tmp_path / "bomb.png").write_bytes(png)
    with pytest.raises(FileFormatError, match="1000000 x 1000000 px needs"):
        open_photograph(tmp_path / "bomb.png")
