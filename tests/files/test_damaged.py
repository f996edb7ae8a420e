"""Damaged files of the other formats: an error of the family or a result, never a crash, a hang or a memory bomb.

RGL, CSV and Zarr have theirs beside their other tests. NetCDF is read by the HDF5 library, which now and then spends seconds
on a damaged file before it gives up: see docs/exchange.md.
"""

import imagecodecs
import numpy as np
import pytest

from matcam import BoxPixel, Camera, GaussianOptics, read_merl, rigs
from matcam.files.photographs import open_photograph, read_photograph
from matcam.files.picture_header import DEFLATE_LIMIT
from matcam.io import read_exr, read_float_tiff, read_sidecar, read_utia, write_exr, write_float_tiff, write_sidecar
from tests.files.mutations import mutated, refusal, survives
from tests.files.test_open_photograph import COUNTS, write_dng


def _picture(path):
    picture = np.random.default_rng(1).random((64, 48, 3)).astype(np.float32)
    {".exr": write_exr, ".tif": write_float_tiff}[path.suffix](path, picture)


def _codes(path):
    codes = np.random.default_rng(1).integers(0, 65536, (64, 48, 3), dtype=np.uint16)
    encode = imagecodecs.png_encode if path.suffix == ".png" else imagecodecs.jpeg8_encode
    path.write_bytes(encode(codes if path.suffix == ".png" else (codes >> 8).astype(np.uint8)))


def _raw(path):
    write_dng(path, COUNTS)


def _profile(path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5)).save(path)


def _sidecar(path):
    about = rigs.merl().description()
    described = {"file": "a.exr", "shape": [8, 9], "quantity": "radiance", "axis_column_px": 4.0, "axis_row_px": 3.5}
    parts = {"camera": about["camera"], "sample": about["sample"], "blur": about["blur"]}
    lamp = {"angles_rad": [0.5], "radius_rad": 0.0}
    write_sidecar(path, picture=described, lamp=lamp, exposure=None, material={}, **parts)


def _utia(path):
    np.random.default_rng(1).random(3 * 288 * 288).tofile(path)


READERS = {
    "exr": (_picture, ".exr", read_exr, 400),
    "tiff": (_picture, ".tif", read_float_tiff, 300),
    "photograph": (_picture, ".tif", read_photograph, 300),
    "png": (_codes, ".png", open_photograph, 60),
    "jpeg": (_codes, ".jpg", open_photograph, 700),
    "raw": (_raw, ".dng", open_photograph, 400),
    "utia": (_utia, ".bin", read_utia, 400),
    "camera profile": (_profile, ".json", Camera.load, 200),
    "picture sidecar": (_sidecar, ".json", read_sidecar, 300),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("count", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_small_files(tmp_path, name, count):
    write, suffix, read, header = READERS[name]
    write(tmp_path / f"a{suffix}")
    content = (tmp_path / f"a{suffix}").read_bytes()
    # a compressed picture may be as much larger than its file as deflate can make it, and is decoded into a second copy
    times = 4 if suffix == ".json" else 4 * DEFLATE_LIMIT
    refused, _ = survives(
        read, tmp_path / f"b{suffix}", mutated(content, count, 5, header), times_the_file=times, spare=2 << 20
    )
    assert refused > count / 20


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_merl(stand_in, tmp_path, count):
    """35 MB each: mapped, damaged in place and mended. A hundred payloads are read whole, the rest are headers and lengths."""
    content = stand_in("chrome").read_bytes()
    path = tmp_path / "a.binary"
    path.write_bytes(content)
    random = np.random.default_rng(6)
    refused = 0
    for k in range(count):
        length = len(content)
        low, high = (0, 12) if k % 3 or k >= 30 * (count // 300) else (12, length)
        if k % 3 == 1:
            length = int(random.integers(0, 2 * len(content)))
        with path.open("r+b") as file:
            file.truncate(length)
        if length > high - 1 and k % 3 != 1:
            held = np.memmap(path, np.uint8, "r+")
            positions = random.integers(low, high, 64 if low else 2)
            held[positions] = random.integers(0, 256, positions.size)
            del held
        message = refusal(read_merl, path)
        refused += message is not None
        assert "\n" not in (message or "")
        _mend(path, content, None if k % 3 == 1 else positions)
    assert refused > count / 2


def _mend(path, content, positions):
    with path.open("r+b") as file:
        size = file.seek(0, 2)
        if size < len(content):
            file.write(content[size:])
        file.truncate(len(content))
        for position in () if positions is None else positions.tolist():
            file.seek(position)
            file.write(content[position : position + 1])
