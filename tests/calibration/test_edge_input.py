"""What the edge estimator is given: mosaics, colours, tone curves, real photographs, other lenses, and what it must refuse."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from matcam import LinearImage, edge_mtf, edge_mtf_stack
from matcam.core.errors import ArgumentError, FitError
from matcam.files.photographs import read_photograph
from tests.oracle import slanted_edge as oracle

ELECTRONS = 1e4


@pytest.fixture(scope="module")
def clean():
    return oracle.picture(oracle.gaussian(0.5)) * ELECTRONS


@pytest.fixture(scope="module")
def noisy():
    return oracle.photographs(oracle.gaussian(0.5), 100, 1, 31)[0]


MOSAICS = [
    pytest.param("R", marks=pytest.mark.slow),
    pytest.param("B", marks=pytest.mark.slow),
    pytest.param("G", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("channel", MOSAICS)
def test_mosaic_without_demosaicing(channel):
    # each colour sees another lens; a site of another colour must not be touched
    sigmas = {"R": 0.5, "G": 0.4, "B": 0.3}
    colours = np.array([["G", "R"], ["B", "G"]])[np.ix_(np.arange(oracle.HEIGHT) % 2, np.arange(oracle.WIDTH) % 2)]
    for swap in (sigmas, {"R": 0.3, "G": 0.5, "B": 0.5}):
        mosaic = sum(oracle.picture(oracle.gaussian(s)) * (colours == c) for c, s in swap.items()) * ELECTRONS
        result = edge_mtf(mosaic, cfa="GRBG", channel=channel)
        truth = oracle.gaussian_half(swap[channel])
        assert result.mtf50 == pytest.approx(truth, rel=1e-3)
        assert result.parametric.mtf50 == pytest.approx(truth, rel=1e-3)
        assert np.degrees(result.angle) == pytest.approx(5, abs=2e-3)


def test_region_of_a_larger_picture(clean):
    frame = np.random.default_rng(1).uniform(0, ELECTRONS, (200, 150))
    frame[25:185, 40:120] = clean
    alone, inside = edge_mtf(clean), edge_mtf(frame, (40, 25, 80, 160))
    assert inside.mtf50 == alone.mtf50
    assert inside.position == pytest.approx((alone.position[0] + 40, alone.position[1] + 25))
    plane = LinearImage.of(frame)
    for same in (edge_mtf(plane, (40, 25, 80, 160)), edge_mtf(plane.cut((40, 25, 80, 160)))):
        assert (same.mtf50, same.position) == (inside.mtf50, inside.position)


def test_tone_curves_are_undone(clean):
    linear = clean / clean.max() * 0.9
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    truth = oracle.gaussian_half(0.5)
    assert edge_mtf(encoded, tone="srgb").mtf50 == pytest.approx(truth, rel=1e-4)
    assert edge_mtf(encoded).mtf50 < 0.99 * truth
    codes = np.rint(65535 * encoded).astype(np.uint16)
    assert edge_mtf(codes, tone="srgb").mtf50 == pytest.approx(truth, rel=1e-3)
    code = np.arange(65536) / 65535
    table = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    assert edge_mtf(codes, tone=table).mtf50 == pytest.approx(truth, rel=1e-3)


def test_colours_and_luminance(clean):
    colour = np.stack([clean, oracle.picture(oracle.gaussian(0.8)) * ELECTRONS, clean], axis=-1)
    assert edge_mtf(colour, channel="G").mtf50 == pytest.approx(oracle.gaussian_half(0.8), rel=2e-4)
    assert edge_mtf(colour, channel="B").mtf50 == pytest.approx(oracle.gaussian_half(0.5), rel=2e-4)
    weights = (0.2126, 0.7152, 0.0722)
    mixed = lambda f: sum(w * oracle.gaussian_mtf(f, s) for w, s in zip(weights, (0.5, 0.8, 0.5), strict=True))  # noqa: E731
    assert edge_mtf(colour).mtf50 == pytest.approx(oracle.half_frequency(mixed), rel=1e-3)


# ---------------------------------------------------------------- other lenses

PITCH = {"wavelength": 550e-9, "pixel_pitch": 4.73e-6}


def test_diffraction_lens():
    cutoff = 4.73 / (0.55 * 8)
    mtf = lambda f: oracle.airy_mtf(f, cutoff)  # noqa: E731
    result = edge_mtf(
        oracle.picture(oracle.edge_of(mtf, cutoff)) * ELECTRONS, model="diffraction", gain=1, read_noise=0, **PITCH
    )
    fit = result.parametric
    assert fit.mtf50 == pytest.approx(oracle.half_frequency(mtf), rel=2e-4)
    assert fit.values[0] == pytest.approx(8, rel=1e-3)
    assert fit.consistent
    assert fit.camera.parameters()["optics.f_number"] == pytest.approx(8, rel=1e-3)
    assert fit.camera.uncertainty.std()["optics.f_number"] > 0


def test_halo_lens():
    response = 0.95 * oracle.gaussian(0.5) + 0.05 * oracle.gaussian(15)
    fit = edge_mtf(oracle.picture(response) * ELECTRONS, model="halo", gain=1, read_noise=0).parametric
    assert fit.values == pytest.approx([0.5, 0.05, 15], rel=5e-3)
    assert fit.consistent
    assert fit.camera.parameters()["optics.core.sigma_px"] == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
def test_defocused_lens():
    cutoff = 4.73 / (0.55 * 4)
    mtf = lambda f: oracle.defocused_mtf(f, cutoff, 3.0)  # noqa: E731
    image = oracle.picture(oracle.edge_of(mtf, cutoff)) * ELECTRONS
    result = edge_mtf(image, model="defocus", gain=1, read_noise=0, **PITCH)
    assert result.parametric.mtf50 == pytest.approx(oracle.half_frequency(mtf), rel=1e-3)
    assert result.parametric.values == pytest.approx([4, 3], rel=0.02)
    assert result.parametric.consistent
    assert not edge_mtf(image, gain=1, read_noise=0).parametric.consistent
    assert result.mtf50 == pytest.approx(oracle.half_frequency(mtf), rel=3e-3)


# ---------------------------------------------------------------- real photographs


def test_real_edge_as_published(real_data):
    picture = read_photograph(real_data / "edges" / "v_edge.tif")
    published = np.loadtxt(real_data / "edges" / "v_edge_sfrmat5_published.csv", delimiter=",", skiprows=1)
    result = edge_mtf(picture)
    below = published[:, 0] < 0.5
    ours = np.interp(published[below, 0], result.frequency, result.mtf)
    assert np.max(np.abs(ours - published[below, 1])) <= 0.02
    assert np.degrees(result.angle) == pytest.approx(5.4, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(8))
def test_real_chart_as_published(real_data, number):
    picture = read_photograph(real_data / "edges" / "chart_squares.png")
    roi = json.loads((real_data / "edges" / "chart_squares.json").read_text())["rois"][number]
    # named centres, but upper left corners: as centres, most regions would hold no edge, or a corner of the square
    result = edge_mtf(picture, (roi["centre_x"], roi["centre_y"], roi["width"], roi["height"]))
    assert result.mtf50 == pytest.approx(roi["mtf50"], rel=0.1)


# ---------------------------------------------------------------- what is refused


def refused(clean, noisy):
    rng = np.random.default_rng(5)
    codes = np.clip(noisy / 8000 * 255, 0, 255).astype(np.uint8)
    sharpened = noisy + 1.0 * (noisy - gaussian_filter(noisy, 1.0))
    along, diagonal = (oracle.picture(oracle.gaussian(0.5, a)) * ELECTRONS for a in (1e-9, 45))
    return {
        "noise alone": (rng.poisson(5000, (160, 80)).astype(float), {}, FitError, "edge"),
        "flat": (np.full((160, 80), 7.0), {}, FitError, "only one value, 7"),
        "nothing": (np.full((160, 80), np.nan), {}, FitError, "0 usable samples"),
        "along the grid": (
            along,
            {},
            FitError,
            "the edge is at 0.0 degrees to the pixel grid",
        ),
        "diagonal": (
            diagonal,
            {},
            FitError,
            "the edge is at 45.0 degrees to the pixel grid",
        ),
        "noisy and along": (rng.poisson(along).astype(float), {}, FitError, "sample too few distances"),
        "noisy and diagonal": (rng.poisson(diagonal).astype(float), {}, FitError, "sample too few distances"),
        "clipped codes": (codes, {}, FitError, "saturated"),
        "clipped numbers": (np.minimum(noisy, 9500), {}, FitError, "saturated"),
        "sharpened": (sharpened, {}, FitError, "image is sharpened: the edge overshoots"),
        "outside": (clean, {"roi": (10, 10, 80, 100)}, ArgumentError, "roi must lie inside the image of 80 x 160 px"),
        "negative": (clean, {"roi": (-1, 0, 40, 40)}, ArgumentError, "inside the image"),
        "small": (clean, {"roi": (30, 30, 15, 40)}, ArgumentError, "at least 16 x 16 px, got 15 x 40"),
        "three numbers": (clean, {"roi": (1, 2, 3)}, ArgumentError, "four whole numbers"),
        "fractions": (clean, {"roi": (0.5, 0, 40, 40)}, ArgumentError, "four whole numbers"),
        "a line": (clean[0], {}, ArgumentError, "image must be"),
        "words": (np.array([["a"]]), {}, ArgumentError, "image must be"),
        "model": (clean, {"model": "lens"}, ArgumentError, "model must be one of"),
        "wavelength": (clean, {"model": "diffraction"}, ArgumentError, "wavelength must be given"),
        "pitch": (
            clean,
            {"model": "defocus", "wavelength": 5e-7, "pixel_pitch": 5.0},
            ArgumentError,
            "pixel_pitch must lie in",
        ),
        "half width": (clean, {"half_width": 0.6}, ArgumentError, "half_width must lie in (0, 0.5] px"),
        "gain alone": (clean, {"gain": 1.0}, ArgumentError, "together"),
        "no noise": (clean, {"gain": 0.0, "read_noise": 0.0}, ArgumentError, "must not both be 0"),
        "cfa": (clean, {"cfa": "RGBG", "channel": "R"}, ArgumentError, "cfa must be one of"),
        "cfa without channel": (clean, {"cfa": "RGGB"}, ArgumentError, "channel must be one of"),
        "mosaic as grey": (clean * np.tile([[1.0, 0.6], [0.5, 1.0]], (80, 40)), {}, FitError, "a colour mosaic"),
        "channel of grey": (clean, {"channel": "R"}, ArgumentError, "give cfa"),
        "tone": (clean, {"tone": "gamma"}, ArgumentError, "tone must be"),
        "table for fractions": (clean, {"tone": np.arange(256.0)}, ArgumentError, "whole numbers"),
        "short table": (codes.astype(np.uint16) + 10, {"tone": np.arange(20.0)}, ArgumentError, "tone has 20 entries"),
        "off the edge": (clean[:, :1] + 0.01 * np.arange(80.0), {}, FitError, "edge"),
    }


def test_bad_input_is_one_line_that_says_what(clean, noisy):
    for name, (image, options, error, words) in refused(clean, noisy).items():
        with pytest.raises(error) as caught:
            edge_mtf(image, **options)
        assert words in str(caught.value), name
        assert "\n" not in str(caught.value)


def test_a_sharpened_picture_can_be_measured_if_asked(noisy):
    sharpened = noisy + 0.3 * (noisy - gaussian_filter(noisy, 1.0, mode="nearest"))
    with pytest.raises(FitError, match="sharpened"):
        edge_mtf(sharpened)
    result = edge_mtf(sharpened, accept_sharpened=True)
    both = lambda f: oracle.gaussian_mtf(f, 0.5) * (1.3 - 0.3 * np.exp(-2 * (np.pi * f) ** 2))  # noqa: E731
    assert result.mtf50 == pytest.approx(oracle.half_frequency(both), rel=0.02)
    assert result.overshoot > 0.02


def test_a_stack_says_which_edges_cannot_be_measured(clean):
    result = edge_mtf_stack(np.stack([clean, np.full_like(clean, 3.0), clean[:, ::-1]]))
    assert [bool(p) for p in result.problems] == [False, True, False]
    assert np.isnan(result.mtf50).tolist() == [False, True, False]
    assert np.isnan(result.mtf[1]).all()
    assert len(result) == 3
    assert [problem and problem.code for problem in result.problems] == [None, "flat", None]
    assert result.good.tolist() == [0, 2]
    assert [edge.mtf50 for edge in result] == pytest.approx(result.mtf50, nan_ok=True)
    assert (
        result.to_dict()["problems"][1]["text"]
        == "the region has only one value, 3: choose a region that contains the target"
    )
    planes = [LinearImage(clean, corner=(7, 9)), LinearImage(clean[:, ::-1])]
    placed = edge_mtf_stack(planes)
    assert placed.mtf50 == pytest.approx(result.mtf50[[0, 2]], rel=1e-9)
    assert placed.position[0][0] == pytest.approx(result.position[0][0] + 7)
    with pytest.raises(ArgumentError, match="regions of one shape"):
        edge_mtf_stack([planes[0], planes[1].cut((0, 0, 60, 80))])
    for bad in (clean, np.ones((2, 10, 40)), np.ones((0, 80, 80)), np.array([[["a"]]])):
        with pytest.raises(ArgumentError, match="images must be"):
            edge_mtf_stack(bad)


def test_a_lens_model_fits_a_wide_region_as_a_narrow_one():
    light = {"model": "diffraction", "wavelength": 550e-9, "pixel_pitch": 5e-6}
    narrow, wide = (
        edge_mtf(100 + 900 * oracle.gaussian(0.5, height=120, width=width), **light).parametric.mtf50
        for width in (500, 1400)
    )
    assert wide == pytest.approx(narrow, rel=0.02)
