"""One colour plane of a photograph: what it holds, where it comes from, and what is refused."""

import numpy as np
import pytest

from matcam import LinearImage
from matcam.calibration.photograph.linear_image import planes_of, usable_region
from matcam.core.errors import ArgumentError, FitError
from matcam.files.photographs import Photograph
from matcam.files.picture_header import Exif

MOSAIC = np.arange(40.0 * 30).reshape(40, 30)


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("channel", ["R", "G", "B"])
def test_sites_of_a_mosaic_stay_where_they_are(cfa, channel):
    there = np.array(list(cfa)).reshape(2, 2)[np.ix_(np.arange(40) % 2, np.arange(30) % 2)] == channel
    plane = LinearImage.of(MOSAIC, channel, cfa)
    np.testing.assert_array_equal(plane.values, np.where(there, MOSAIC, np.nan))
    for x, y in ((0, 0), (1, 0), (0, 1), (3, 5)):
        # cut before or after, the same pixels in the same place
        early, late = LinearImage.of(MOSAIC, channel, cfa, roi=(x, y, 17, 20)), plane.cut((x, y, 17, 20))
        for part in (early, late):
            np.testing.assert_array_equal(part.values, plane.values[y : y + 20, x : x + 17])
            assert part.corner == (x, y)
            assert part.cfa == early.cfa
    assert plane.cut((3, 5, 20, 20)).cut((2, 1, 9, 9)).corner == (5, 6)


def test_colours_and_luminance():
    colour = np.random.default_rng(1).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    np.testing.assert_array_equal(LinearImage.of(colour, "B").values, colour[..., 2])
    luminance = LinearImage.of(colour)
    assert luminance.channel == "Y"
    np.testing.assert_allclose(luminance.values, colour @ np.array([0.2126, 0.7152, 0.0722]))
    np.testing.assert_array_equal(luminance.saturated, (colour == 255).any(-1))
    np.testing.assert_array_equal(LinearImage.of(colour, "G").saturated, colour[..., 1] == 255)
    table = np.arange(256.0)[:, None] * [1, 2, 3]
    np.testing.assert_array_equal(LinearImage.of(colour, "G", tone=table).values, 2.0 * colour[..., 1])


def test_large_pictures_go_through_a_table_to_the_same_values():
    codes = np.random.default_rng(2).integers(0, 65536, (400, 300)).astype(np.uint16)
    for tone in ("srgb", 2.2):
        whole, part = LinearImage.of(codes, tone=tone), LinearImage.of(codes, tone=tone, roi=(50, 60, 20, 30))
        np.testing.assert_allclose(whole.cut((50, 60, 20, 30)).values, part.values, rtol=1e-14)


def test_what_a_photograph_says_of_itself():
    codes = np.full((20, 30), 188, np.uint8)
    photograph = Photograph(codes, None, 255.0, False, Exif("Maker One", 5.6))
    plane = LinearImage.of(photograph, tone="auto", source="a.png")
    assert (plane.f_number, plane.source, plane.saturation) == (5.6, "a.png", 255.0)
    assert plane.values[0, 0] == pytest.approx(0.503, abs=1e-3)
    assert [(r.code, r.text) for r in plane.remarks] == [
        ("tone-assumed", "no tone curve is specified: sRGB is assumed for 8 bits; give the tone curve (--tone)")
    ]
    assert LinearImage.of(photograph).remarks == ()
    # tone curves come after demosaicing
    assert LinearImage.of(photograph, "G", "RGGB", "auto").tone == "linear"
    # an array says nothing of itself: it is linear
    assert LinearImage.of(codes, tone="auto").values[0, 0] == 188
    assert [plane.channel for plane in planes_of(photograph)] == ["grey"]
    raw = Photograph(MOSAIC, "RGGB", 1000.0, True, Exif())
    assert [plane.channel for plane in planes_of(raw)] == ["R", "G", "B"]
    assert LinearImage.of(raw, "G").cfa == "RGGB"


def test_a_plane_goes_through_unchanged():
    plane = LinearImage(MOSAIC, source="a")
    assert LinearImage.of(plane) is plane
    assert usable_region(plane.cut((2, 4, 20, 30))).corner == (2, 4)
    for options in ({"channel": "G"}, {"cfa": "RGGB"}, {"tone": "srgb"}):
        with pytest.raises(ArgumentError, match="already specified by the LinearImage"):
            LinearImage.of(plane, **options)


def test_what_is_refused():
    for arguments, words in (
        ({"values": np.zeros(3)}, "values must be numbers of shape"),
        ({"values": MOSAIC, "channel": "X"}, "channel must be one of"),
        ({"values": MOSAIC, "channel": "Y", "cfa": "RGGB"}, "channel must be one of 'R', 'G', 'B' with a mosaic"),
        ({"values": MOSAIC, "channel": "R", "cfa": "RGBG"}, "cfa must be one of"),
        ({"values": MOSAIC, "saturated": np.zeros((2, 2), bool)}, "saturated must have the shape of values"),
    ):
        with pytest.raises(ArgumentError, match=words):
            LinearImage(**arguments)
    for options, words in (
        ({"tone": None}, "tone must be 'auto', 'linear', 'srgb', a gamma or a table"),
        ({"roi": (0, 0, 31, 20)}, "roi must lie inside the image of 30 x 40 px"),
        ({"roi": (0, 0, "a", 20)}, "four whole numbers"),
        ({"channel": "G"}, "give cfa if the image is a mosaic"),
    ):
        with pytest.raises(ArgumentError, match=words):
            LinearImage.of(MOSAIC, **options)
    with pytest.raises(ArgumentError, match="at least 16 x 16 px, got 8 x 20"):
        usable_region(LinearImage.of(MOSAIC, roi=(0, 0, 8, 20)))
    white = np.where(np.arange(30) > 20, 255, 40).astype(np.uint8) * np.ones((40, 1), np.uint8)
    with pytest.raises(FitError, match="region is saturated: 30% of its samples are at 255, the end of their range"):
        usable_region(LinearImage.of(white))
    assert usable_region(LinearImage.of(white, roi=(0, 0, 20, 20))).shape == (20, 20)
    with pytest.raises(ArgumentError, match="camera raw is linear"):
        LinearImage.of(Photograph(MOSAIC, "RGGB", 1000.0, True, Exif()), "R", tone="srgb")
