"""Photographs keep their bits."""

import imagecodecs
import numpy as np
import pytest
import tifffile

from matcam.core.errors import FileFormatError
from matcam.files.photographs import read_photograph

RNG = np.random.default_rng(0)
GREY16 = RNG.integers(0, 65536, (20, 30), dtype=np.uint16)
COLOUR16 = RNG.integers(0, 65536, (20, 30, 3), dtype=np.uint16)


@pytest.mark.parametrize("picture", [GREY16, COLOUR16, (GREY16 >> 8).astype(np.uint8), GREY16 / 65535])
def test_tiff(tmp_path, picture):
    tifffile.imwrite(tmp_path / "a.tif", picture, photometric="rgb" if picture.ndim == 3 else "minisblack")
    found = read_photograph(tmp_path / "a.tif")
    assert found.dtype == picture.dtype
    np.testing.assert_array_equal(found, picture)


def test_planar_tiff(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(COLOUR16, -1, 0), photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.tif"), COLOUR16)


@pytest.mark.parametrize("picture", [GREY16, COLOUR16, (COLOUR16 >> 8).astype(np.uint8)])
def test_png_keeps_16_bits(tmp_path, picture):
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(picture))
    found = read_photograph(tmp_path / "a.png")
    assert found.dtype == picture.dtype
    np.testing.assert_array_equal(found, picture)


def test_alpha_is_left_out(tmp_path):
    with_alpha = np.dstack([COLOUR16, GREY16])
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(with_alpha))
    np.testing.assert_array_equal(read_photograph(tmp_path / "a.png"), COLOUR16)


def test_jpeg(tmp_path):
    smooth = np.add.outer(np.arange(64), np.arange(80)).astype(np.uint8)
    (tmp_path / "a.jpg").write_bytes(imagecodecs.jpeg8_encode(smooth, level=98))
    assert np.max(np.abs(read_photograph(tmp_path / "a.jpg").astype(int) - smooth)) <= 3


def test_real_photographs(real_data):
    assert read_photograph(real_data / "edges" / "v_edge.tif").shape == (300, 125, 3)
    assert read_photograph(real_data / "edges" / "ISO_DSC_300a.jpg").shape == (1164, 1218, 3)
    assert read_photograph(real_data / "edges" / "chart_squares.png").shape == (400, 400)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "neither TIFF, PNG, JPEG"),
        (b"GIF89a----", "neither TIFF"),
        (b"II*\0" + bytes(20), "damaged"),
        (b"\x89PNG\r\n\x1a\n" + bytes(20), "damaged"),
        (b"\xff\xd8\xff\xe0" + bytes(20), "damaged"),
    ],
)
def test_damaged_files_are_one_line(tmp_path, content, words):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_photograph(tmp_path / "a")
    assert "\n" not in str(caught.value)
    with pytest.raises(FileFormatError, match="no such file"):
        read_photograph(tmp_path / "b")
    with pytest.raises(FileFormatError, match="is a folder"):
        read_photograph(tmp_path)
