"""Charts as people photograph them: aslant, bent, badly printed, badly lit, covered in part."""

import json

import numpy as np
import pytest

from matcam.calibration.camera.calibration import calibrate
from matcam.calibration.chart.chart import Dots, Star
from matcam.calibration.chart.chart_file import read_chart, write_chart
from matcam.calibration.chart.chart_layout import design_chart
from matcam.calibration.chart.printed_levels import printed_levels
from matcam.calibration.chart.registration import register_chart
from matcam.core.errors import FitError
from tests.oracle.chart_frames import random_frame

SMALLEST = 400  # px: of the page


def drawn(folder, pixels, seed, **forced):
    """The chart that `matcam chart` draws by default for a page of so many px, and a random frame of it."""
    path = folder / "chart.json"
    write_chart(path, design_chart(pixels_across=pixels), force=True)
    chart = read_chart(path)
    return chart, random_frame(json.loads(path.read_text()), chart.page, pixels, seed, **forced)


def off(found, camera, chart):
    """Largest error of a registration, px."""
    points = np.random.default_rng(0).uniform(0.05, 0.95, (300, 2)) * chart.page
    return np.hypot(*(found(points) - np.stack(camera.sensor_of(*points.T), -1)).T).max()


def covered(frame, chart, kept):
    """The frame's counts, with grey over all fiducials but some."""
    counts = frame.counts.copy()
    y, x = np.indices(counts.shape)
    for i, mark in enumerate(chart.fiducials):
        if i not in kept:
            at_x, at_y = frame.camera.sensor_of(*np.array(mark.centre, float))
            side = np.hypot(
                *np.subtract(frame.camera.sensor_of(mark.centre[0] + mark.radius, mark.centre[1]), (at_x, at_y))
            )
            counts[np.hypot(x - at_x, y - at_y) < 7 * side] = 0.6 * np.median(counts)
    return counts


@pytest.mark.parametrize("kept", [(1, 2, 3, 4, 5, 6, 7), (3, 4, 6, 7), (1, 3, 5, 7)])
def test_any_four_fiducials_position_the_chart(tmp_path, kept):
    chart, frame = drawn(tmp_path, 620, 0, hand=False)
    found = register_chart(covered(frame, chart, kept), chart)
    assert found.found == len(kept)
    assert off(found, frame.camera, chart) < 0.6


def test_three_fiducials_do_not(tmp_path):
    chart, frame = drawn(tmp_path, 620, 0, hand=False)
    with pytest.raises(FitError, match="the image shows 3 of the 8 fiducials, but at least 4 are needed"):
        register_chart(covered(frame, chart, (1, 3, 5)), chart)


def test_the_print_is_read_off_its_patches(tmp_path):
    chart, frame = drawn(tmp_path, 620, 1, hand=False)
    gamma = frame.camera.gamma
    assert gamma > 1.5
    found = printed_levels(frame.counts, chart, register_chart(frame.counts, chart))
    assert np.abs(found.printed - found.described**gamma).max() < 0.004
    star = next(e for e in chart.elements if isinstance(e, Star))
    wave = np.cos(2 * np.pi * np.arange(4096) / 4096)
    level = ((star.bright + star.dark) / 2 + (star.bright - star.dark) / 2 * wave) ** gamma
    assert found.of(star).contrast == pytest.approx(
        2 * (level * wave).mean() / level.mean(), rel=2 * found.contrast_std
    )
    assert "0.3 is printed as" in found.remark().text
    assert "--tone" in found.remark(assumed=True).text


def test_small_patches_are_read_away_from_their_blurred_borders(tmp_path):
    chart, frame = drawn(tmp_path, 418, 114)
    assert frame.camera.sigma > 1
    found = printed_levels(frame.counts, chart, register_chart(frame.counts, chart))
    assert np.abs(found.printed - found.described).max() < 0.006


def outcome(chart, frame):
    """'good', 'wrong', 'unexplained' or 'refused', and by how much the blur is off, in words."""
    try:
        fit = next(iter(calibrate([frame.counts], chart=chart, tone="linear").channels.values()))
    except FitError as error:
        return "refused", str(error)
    sigma, std, truth = float(fit.values[0]), float(fit.std[0]), frame.camera.sigma
    text = f"{sigma / truth - 1:+.2%} ({std / truth:.2%})"
    if abs(sigma - truth) > max(0.01 * truth, 2 * std):
        return "wrong", text
    return ("good" if fit.consistent else "unexplained"), text


@pytest.mark.parametrize("seed", [4, 12, pytest.param(5, marks=pytest.mark.slow)])
def test_frames(tmp_path, seed):
    """One of a gamma of 1.5, barrel, a shadow and a thumb; a small page, blurred; one tilted by 33 degrees."""
    pixels = {4: 545, 12: 400, 5: 700}[seed]
    chart, frame = drawn(tmp_path, pixels, seed)
    kind, text = outcome(chart, frame)
    assert kind == "good", text


def test_spoilt_targets_are_left_out_by_name(tmp_path):
    """A star that is covered in half, dots whose black is not."""
    chart, frame = drawn(tmp_path, 545, 4)
    counts, camera = frame.counts.copy(), frame.camera
    y, x = np.indices(counts.shape)
    star = next(e for e in chart.elements if isinstance(e, Star))
    at_x, at_y = camera.sensor_of(*np.array(star.centre))
    reach = np.hypot(*np.subtract(camera.sensor_of(star.centre[0] + star.outer, star.centre[1]), (at_x, at_y)))
    counts[(np.hypot(x - at_x, y - at_y) < 1.5 * reach) & (x < at_x)] = 0.4 * np.median(counts)
    dots = np.array(next(e for e in chart.elements if isinstance(e, Dots)).centres)
    dot_x, dot_y = camera.sensor_of(*dots.T)
    for u, v in zip(dot_x.round().astype(int), dot_y.round().astype(int), strict=True):
        stamp = counts[v - 4 : v + 5, u - 4 : u + 5]
        stamp[:] = np.maximum(stamp, 0.9 * np.median(stamp))
    found = calibrate([counts], chart=chart, tone="linear")
    fit = found.channels["grey"]
    assert float(fit.values[0]) == pytest.approx(camera.sigma, abs=max(0.01 * camera.sigma, 2 * float(fit.std[0])))
    said = " ".join(r.text for r in found.remarks if r.code in ("target-not-measured", "target-disagrees"))
    assert "star" in said
    assert "dots" in said


def test_a_chart_too_small_to_be_measured_is_found_all_the_same(tmp_path):
    path = tmp_path / "chart.json"
    write_chart(path, design_chart())  # for 3000 px
    chart, document = read_chart(path), json.loads(path.read_text())
    document["elements"] = [e for e in document["elements"] if e["kind"] != "dots"]  # thousands
    frame = random_frame(document, chart.page, 400, 10, hand=False)
    with pytest.raises(
        FitError, match=r"the chart was found, but .* px width; .*photograph the chart at a larger scale"
    ):
        calibrate([frame.counts], chart=chart, tone="linear")


def test_an_overexposed_chart_is_said_to_be_overexposed(tmp_path):
    chart, frame = drawn(tmp_path, 620, 1, hand=False)
    clipped = np.minimum(frame.counts, np.quantile(frame.counts, 0.2))
    with pytest.raises(FitError, match=r"the chart was found, but none of the edges .*: the region is saturated"):
        calibrate([clipped], chart=chart, tone="linear")


@pytest.mark.slow
def test_frames_at_length(tmp_path):
    """200 frames, a page of 400 to 2000 px across."""
    count = {"good": 0, "wrong": 0, "unexplained": 0, "refused": 0}
    for seed in range(1000, 1200):
        pixels = int(np.exp(np.random.default_rng(seed).uniform(np.log(SMALLEST), np.log(2000))))
        kind, text = outcome(*drawn(tmp_path, pixels, seed))
        count[kind] += 1
        if kind != "good":
            print(seed, pixels, kind, text)
    print(count)
    assert count["good"] >= 198
    assert count["wrong"] + count["unexplained"] < 2
