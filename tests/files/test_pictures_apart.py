"""Pictures are decoded in a process of its own: what a decoder does there cannot harm the one that asks for the picture."""

import os
import resource
import struct
import time
import zlib

import imagecodecs
import numpy as np
import pytest
import tifffile

from matcam.cli import _run
from matcam.core.errors import FileFormatError
from matcam.core.readers import apart
from matcam.core.readers.apart import Limits, reading_limits, start_reader
from matcam.files import formats, picture_decoders, picture_header
from matcam.files.photographs import open_photograph, read_photograph
from matcam.io import read_exr, read_float_tiff, write_exr, write_float_tiff
from tests.files.test_open_photograph import COUNTS, write_dng

PICTURE = np.random.default_rng(2).random((20, 30, 3)).astype(np.float32)


def png(path):
    path.write_bytes(imagecodecs.png_encode((255 * PICTURE).astype(np.uint8)))


def jpeg(path):
    path.write_bytes(imagecodecs.jpeg8_encode((255 * PICTURE).astype(np.uint8)))


KINDS = {
    "float.tif": (lambda path: write_float_tiff(path, PICTURE), read_float_tiff),
    "codes.tif": (lambda path: tifffile.imwrite(path, (255 * PICTURE).astype(np.uint8), photometric="rgb"), read_photograph),
    "a.png": (png, read_photograph),
    "a.jpg": (jpeg, read_photograph),
    "a.exr": (lambda path: write_exr(path, PICTURE), read_exr),
    "a.dng": (lambda path: write_dng(path, COUNTS), lambda path: open_photograph(path).values),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_what_is_decoded_apart_is_what_is_decoded_here(tmp_path, name, monkeypatch):
    write, read = KINDS[name]
    write(tmp_path / name)
    asked = []
    send = apart._nursery.send

    def counted(request, *sockets):
        asked.append(request)
        return send(request, *sockets)

    monkeypatch.setattr(apart._nursery, "send", counted)
    there = read(tmp_path / name)
    assert [request["path"] for request in asked] == [str(tmp_path / name)]
    with reading_limits(None):
        here = read(tmp_path / name)
    assert len(asked) == 1
    assert there.dtype == here.dtype
    np.testing.assert_array_equal(there, here)


@pytest.mark.parametrize("name", KINDS)
def test_a_picture_has_limits(tmp_path, name):
    """Less memory than any decoder needs: refused, whatever the decoder makes of it."""
    write, read = KINDS[name]
    write(tmp_path / name)
    with reading_limits(Limits(memory=1000)), pytest.raises(FileFormatError) as caught:
        read(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def bomb(path, side=20_000):
    """389 kB of black, a byte a pixel."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = bytes(100 * (side + 1))
    data = b"".join(packer.compress(rows) for _ in range(side // 100)) + packer.flush()
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def test_a_small_file_of_a_large_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(picture_header, "available_memory", lambda: 1 << 40)  # it would fit
    bomb(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size < 400_000
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    with pytest.raises(FileFormatError, match=r"compressed too strongly and needs 9\.3 GiB"):
        open_photograph(tmp_path / "a.png")
    assert time.monotonic() - start < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB
    bomb(tmp_path / "b.png", 2000)  # small ones are read, as well as they may be compressed
    assert open_photograph(tmp_path / "b.png").values.shape == (2000, 2000)


def test_trust_decodes_here(tmp_path, monkeypatch, capsys):
    write_float_tiff(tmp_path / "a.tif", PICTURE)
    here = []
    decode = picture_decoders.decode_float_tiff
    monkeypatch.setattr(
        picture_decoders, "decode_float_tiff", lambda *a, **b: (here.append(os.getpid()), decode(*a, **b))[1]
    )
    assert _run(["inspect", str(tmp_path / "a.tif"), "--json"]) == 0
    assert here == []
    assert _run(["--trust", "inspect", str(tmp_path / "a.tif"), "--json"]) == 0
    assert here == [os.getpid()]
    first, second = capsys.readouterr().out.split("}\n{")
    assert first.strip("{} \n") == second.strip("{} \n")


def test_the_reader_starts_before_it_is_needed(tmp_path):
    apart._nursery.stop()
    write_float_tiff(tmp_path / "a.tif", PICTURE)
    modules = formats.decoded_by([tmp_path / "a.tif", tmp_path / "none.exr"])
    assert modules == ["imagecodecs._zlib", "matcam.files.picture_decoders", "tifffile"]
    assert formats.decoded_by([tmp_path]) == modules
    with reading_limits(None):
        start_reader(modules)
    assert apart._nursery.process is None
    begin = time.monotonic()
    start_reader(modules)
    assert time.monotonic() - begin < 1
    process = apart._nursery.process
    assert process.poll() is None
    np.testing.assert_array_equal(read_float_tiff(tmp_path / "a.tif"), PICTURE)
    assert apart._nursery.process is process
