"""Edges in light and behind software that no polynomial describes. Truth: `tests/oracle/hard_edges.py`."""

import tracemalloc

import numpy as np
import pytest

from matcam import edge_mtf
from matcam.calibration.photograph.linear_filters import LAGS, Correlations, correlations, filter_uncertainty
from matcam.core.errors import FitError
from matcam.numerics.crossing import first_fall
from tests.oracle import hard_edges as oracle
from tests.oracle import local_regression as rival
from tests.oracle import processed_pictures as software
from tests.oracle import real_edges
from tests.oracle.slanted_edge import bound_of_half

PROCESSED = {*oracle.SOFTWARE}


def measured(kind, many, seed):
    """Errors of MTF50 and stated errors, relative; the rival's errors; how many are right or refused; silent failures."""
    rng = np.random.default_rng([seed, oracle.KINDS.index(kind)])
    errors, stated, theirs, right, silent = [], [], [], 0, 0
    for _ in range(many):
        drawn = oracle.drawn(rng, kind)
        try:
            edge = edge_mtf(drawn.picture)
        except FitError:
            right += 1
            continue
        error, std = edge.mtf50 / drawn.mtf50 - 1, edge.mtf50_std / drawn.mtf50
        right += abs(error) <= max(0.01, 2 * std)
        silent += abs(error) > max(0.05, 3 * std) and not edge.remarks
        errors.append(error)
        stated.append(std)
        theirs.append(rival.mtf50(drawn.picture) / drawn.mtf50 - 1)
    return np.array(errors), np.array(stated), np.array(theirs), right / many, silent


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("kind", ["even", "glint", "banding", "smoothed by 0.4 px", "rotated", "no noise"])
def test_few_of_each(kind):
    errors, stated, _, right, silent = measured(kind, 8, 81)
    assert right >= 7 / 8
    assert silent == 0
    if kind not in PROCESSED:
        assert rms(errors) < 0.025
        assert np.median(stated) < 3 * max(rms(errors), 0.003)


@pytest.mark.slow
@pytest.mark.parametrize("kind", oracle.KINDS)
def test_many_of_each(kind):
    errors, stated, theirs, right, silent = measured(kind, 80, 82)
    print(
        f"{kind:20s} right {right:.0%}, silent {silent}, refused {1 - errors.size / 80:.0%}; rms {rms(errors):.2%}, "
        f"stated {np.median(stated):.2%}; local regression {rms(theirs):.2%}"
    )
    assert right >= 0.9
    assert silent <= 0.02 * 80
    if kind in oracle.LIGHT:
        assert rms(errors) <= rms(theirs)


def even_edge(light, seed=1, sigma=0.5, snr=100):
    scene = real_edges.lit(real_edges.response(sigma, 6.0, oracle.SIZE), light)
    return real_edges.exposed(scene, snr, np.random.default_rng(seed))


@pytest.mark.parametrize(("share", "position"), [(0.1, 22.0), (0.06, -20.0), (0.15, 13.0), (0.12, -11.0), (0.08, 29.0)])
def test_a_distant_ghost_is_neither_uneven_light_nor_sharpening(share, position):
    """Up to 24 px it is part of the edge, and beyond that a hypothesis of the light.

    Removed with the light, it made MTF50 5 to 13 % too high at stated errors of 4 to 6 %. Left in the light, it became an
    overshoot of the edge, and the picture was refused as sharpened.
    """
    errors = []
    for seed in range(3):
        rng, ghost = np.random.default_rng(seed), real_edges.response(0.5, 6.0, oracle.SIZE, offset=position)
        scene = (1 - share) * real_edges.response(0.5, 6.0, oracle.SIZE) + share * ghost
        edge = edge_mtf(real_edges.exposed(real_edges.levels(scene), 100, rng))
        errors.append(edge.mtf50 / real_edges.ghosted_half(0.5, 6.0, share, position) - 1)
        assert abs(errors[-1]) < 2 * edge.mtf50_std / edge.mtf50
        assert any("a ghost with" in str(remark) for remark in edge.remarks)
        samples = edge.samples
        residual = (samples.value - edge.esf(samples.distance).value) / samples.std
        assert rms(residual[np.abs(samples.distance) < 1.2]) < 1.6  # the figure shows both
    assert rms(errors) < 0.03


def test_tilted_light_is_no_ghost():
    light = even_edge(lambda x, y: (1 - 0.1 * real_edges.soft_step((x + y) / 2**0.5 - 15, 0.6), 0.0))
    assert not any("ghost" in str(remark) for remark in edge_mtf(light).remarks)


def test_a_glint_is_no_glare():
    counts = even_edge(lambda x, y: (1.0, 0.25 * np.exp(-((x + 12) ** 2 + (y - 10) ** 2) / (2 * 18.0**2))))
    edge = edge_mtf(counts)
    assert edge.mtf50 == pytest.approx(real_edges.half(0.5, 6.0), rel=0.012)
    assert "uneven-light" in [remark.code for remark in edge.remarks]


def test_a_photograph_of_many_squares_is_refused_in_bounded_memory():
    """The light of a region is evaluated in parts, because a whole photograph would need 20 GB."""
    y, x = np.mgrid[:1000, :1000]
    squares = np.where((x % 250 < 120) & (y % 250 < 120), 0.9, 0.1)
    picture = 40000 * squares + np.random.default_rng(1).normal(0, 200, squares.shape)
    tracemalloc.start()
    with pytest.raises(FitError, match="choose another region"):
        edge_mtf(picture)
    assert tracemalloc.get_traced_memory()[1] < 1e9
    tracemalloc.stop()


def test_glare_beside_even_light_stays_glare():
    scene = 0.94 * real_edges.response(0.5, 6.0, oracle.SIZE) + 0.06 * real_edges.response(12.0, 6.0, oracle.SIZE)
    edge = edge_mtf(real_edges.exposed(real_edges.levels(scene), 100, np.random.default_rng(2)))
    assert edge.glare_found
    assert edge.glare_fraction == pytest.approx(0.06, abs=0.015)
    assert "uneven-light" not in [remark.code for remark in edge.remarks]
    assert edge.mtf50 < edge.core_mtf50


FREQUENCY = np.arange(81) / 64
MTF = np.exp(-2 * (np.pi * 0.5 * FREQUENCY) ** 2) * np.sinc(FREQUENCY)


def flat_sides(snr, seed):
    rng = np.random.default_rng(seed)
    dark = np.zeros((100, 80), bool)
    dark[:, :32] = True
    bright = np.zeros_like(dark)
    bright[:, 48:] = True
    return rng.poisson(np.where(np.arange(80) < 40, 0.25, 1.0) * snr**2, (100, 80)).astype(float), (dark, bright)


def test_a_filter_is_known_by_the_noise_behind_it():
    for seed in range(5):
        counts, sides = flat_sides(100, seed)
        assert filter_uncertainty(correlations(counts, sides), FREQUENCY, MTF).share < 0.015
    half = first_fall(FREQUENCY, MTF)
    for name, filtered, width in (
        ("smooth", oracle.smoothed(counts, 0.4), 0.4),
        ("sharp", software.unsharp(counts, 0.5), None),
    ):
        # what the filter itself does to the MTF, by its own taps
        impulse = np.zeros((65, 65))
        impulse[32, 32] = 1.0
        taps = (oracle.smoothed(impulse, width) if width else software.unsharp(impulse, 0.5)).sum(0)
        transfer = np.cos(2 * np.pi * FREQUENCY[:, None] * (np.arange(65) - 32)) @ taps
        behind = MTF * transfer
        effect = first_fall(FREQUENCY, behind) / half - 1
        found = filter_uncertainty(correlations(filtered, sides), FREQUENCY, behind)
        assert found.probability > 0.99, name
        assert found.smooths == (name == "smooth")
        assert found.share == pytest.approx(abs(effect), rel=0.6), name


def test_white_noise_adds_little_to_the_error():
    """Less than a tenth of what the noise of an edge at SNR 100 does to MTF50."""
    count = len(LAGS)
    white = Correlations(np.zeros(count), np.full(count, 1e4))
    assert filter_uncertainty(white, FREQUENCY, MTF).share < 0.1 * bound_of_half(0.5, 100)


def test_light_that_is_left_is_no_filter():
    for seed in range(5):
        counts, sides = flat_sides(40, seed)
        x, y = real_edges.grid(100, 80)
        counts *= 1 + 0.01 * np.sin(2 * np.pi * (x + y) / 35)
        assert filter_uncertainty(correlations(counts, sides), FREQUENCY, MTF).probability < 0.5


def test_a_shoulder_is_remarked_on():
    rng = np.random.default_rng(7)
    counts = real_edges.exposed(real_edges.levels(real_edges.response(0.7, 6.0)), 100, rng)
    counts = 1e4 * np.tanh(1.2 * counts / 1e4) / np.tanh(1.2)
    edge = edge_mtf(counts)
    assert {remark.code for remark in edge.remarks} & {"asymmetric", "tone-curve"}
    truth = real_edges.half(0.7, 6.0)
    assert 0.02 < abs(edge.mtf50 / truth - 1) < 2 * edge.mtf50_std / truth


@pytest.mark.parametrize(("levels", "largest"), [(16, 0.06), (64, 0.02), (1000, 0.003)])
def test_pictures_without_noise_state_their_rounding(levels, largest):
    picture = np.rint(real_edges.levels(real_edges.response(0.7, 6.0)) * levels / 0.75)
    edge = edge_mtf(picture)
    truth = real_edges.half(0.7, 6.0)
    assert abs(edge.mtf50 - truth) < 2 * edge.mtf50_std
    assert edge.mtf50_std < largest * truth
    assert ("quantised" in [remark.code for remark in edge.remarks]) == (levels < 200)


def test_white_below_the_end_of_the_range_is_no_saturation():
    rng = np.random.default_rng(8)
    light = real_edges.levels(real_edges.response(0.7, 6.0))
    # a tone curve has left less noise than a level in the white, and more in the dark
    noise = rng.normal(size=light.shape) * np.where(light < 0.6, 0.9, 0.1)
    codes = np.rint(220 * light + noise).astype(np.uint8)
    assert np.mean(codes == codes.max()) > 0.3
    assert edge_mtf(codes, tone="linear").mtf50 == pytest.approx(real_edges.half(0.7, 6.0), rel=0.01)
    clipped = np.minimum(real_edges.exposed(light, 100, rng), 9500)
    with pytest.raises(FitError, match="saturated"):
        edge_mtf(clipped)
