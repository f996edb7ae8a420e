"""Tone curves are undone, read, measured, and refused where they cannot be ones."""

import numpy as np
import pytest

from matcam.calibration.photograph.tone import linear_values, tone_from_patches
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.files.tone_curve import read_tone_curve

LIGHT = np.linspace(0, 1, 40)


def encoded(light, full):
    """IEC 61966-2-1, rounded to whole codes."""
    return np.rint(full * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def test_named_curves():
    codes = encoded(LIGHT, 65535).astype(np.uint16)
    assert linear_values(codes, "srgb") == pytest.approx(LIGHT, abs=1e-4)
    assert linear_values(LIGHT ** (1 / 2.2), 2.2) == pytest.approx(LIGHT, abs=1e-12)
    assert linear_values(codes, "linear").dtype == np.float64
    np.testing.assert_array_equal(linear_values(codes, "linear"), codes)


def test_tables(tmp_path, real_data):
    table = np.arange(256.0) ** 2
    codes = np.array([[0, 3, 255]], dtype=np.uint8)
    np.testing.assert_array_equal(linear_values(codes, table), [[0, 9, 65025]])
    three = np.stack([table, 2 * table, 3 * table], 1)
    np.testing.assert_array_equal(linear_values(codes, three, 2), [[0, 27, 195075]])
    np.testing.assert_array_equal(linear_values(codes.reshape(1, 1, 3), three), [[[0, 18, 195075]]])
    np.testing.assert_array_equal(
        linear_values(np.tile(codes.reshape(1, 1, 1, 3), (2, 1, 1, 1)), three)[1], [[[0, 18, 195075]]]
    )
    np.savetxt(tmp_path / "one.dat", table, header="squares")
    np.testing.assert_allclose(read_tone_curve(tmp_path / "one.dat"), table)
    (tmp_path / "two.csv").write_text("0, 0\n100; 50\n\n200, 200\n")
    found = read_tone_curve(tmp_path / "two.csv")
    assert found[[0, 100, 200]] == pytest.approx([0, 50, 200])
    assert (np.diff(found) > 0).all()
    for name, shape in (("lut1.dat", (256,)), ("lut3.dat", (256, 3))):
        published = read_tone_curve(real_data / "edges" / name)
        assert published.shape == shape
        assert published[200] == pytest.approx(200)


def test_measured_from_patches():
    rng = np.random.default_rng(1)
    light = np.array([0.02, 0.05, 0.1, 0.18, 0.3, 0.45, 0.6, 0.75, 0.9])
    picture = np.zeros((40, 40 * light.size))
    for i, value in enumerate(light):
        picture[:, 40 * i : 40 * i + 40] = encoded(value, 255)
    picture = np.clip(np.rint(picture + rng.normal(0, 2, picture.shape)), 0, 255).astype(np.uint8)
    patches = [(40 * i + 5, 5, 30, 30) for i in range(light.size)]
    table = tone_from_patches(picture, patches, light)
    truth = linear_values(np.arange(256, dtype=np.uint8), "srgb")
    inside = slice(40, 243)
    assert np.max(np.abs(table - truth)[inside]) < 0.01
    colour = np.stack([picture, picture[:, ::-1], picture], -1)
    np.testing.assert_allclose(tone_from_patches(colour, patches, light, channel=0), table)
    for changed, words in (
        ({"light": light[::-1]}, "must not decrease"),
        ({"light": light[:4]}, "one linear value of light for each"),
        ({"patches": patches[:2], "light": light[:2]}, "at least 3 patches"),
        ({"patches": [*patches[:-1], (340, 0, 30, 30)]}, "inside the image of 360 x 40"),
        ({"patches": [*patches[:-1], patches[0]]}, "same code"),
        ({"light": -light}, "not negative"),
        ({"image": picture / 2}, "whole numbers"),
    ):
        with pytest.raises(ArgumentError, match=words):
            tone_from_patches(**({"image": picture, "patches": patches, "light": light} | changed))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("0\n1\n2\n1\n", "must not decrease, but it decreases from code 2 to 3"),
        ("0 0\n10 4\n20 3\n", "must not decrease, but it decreases from code 10 to 20"),
        ("0 0\n10 4\n10 5\n", "codes of the tone curve must increase strictly"),
        ("0\none\n", "line 2: 'one' must consist of numbers"),
        ("0 1\n2\n", "line 2 has 1 numbers"),
        ("1 2 3 4\n", "line 1 has 4 numbers"),
        ("", "at least 2 codes"),
        ("5\n5\n5\n", "all codes of a channel have the same linear value"),
        ("0\nnan\n", "finite"),
    ],
)
def test_what_is_no_tone_curve(tmp_path, content, words):
    (tmp_path / "t.dat").write_text(content)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_tone_curve(tmp_path / "t.dat")
    assert "t.dat" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_does_not_fit():
    codes = np.array([[0, 30]], dtype=np.uint8)
    for tone, words in (
        ("film", "tone must be"), (9.0, "gamma must lie in"), (np.arange(20.0), "tone has 20 entries"),
        (np.arange(60.0)[::-1], "must not decrease"), (np.ones((5, 2)), "one or three linear values each"),
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=words):
            linear_values(codes, tone)
    with pytest.raises(ArgumentError, match="whole numbers"):
        linear_values(codes / 2, np.arange(60.0))
    with pytest.raises(FileFormatError, match="no such file"):
        read_tone_curve("none")
