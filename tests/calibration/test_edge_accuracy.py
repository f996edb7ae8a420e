"""The edge estimators without noise: what is left is theirs. Truth: `tests/oracle/slanted_edge.py`."""

import numpy as np
import pytest

from matcam import edge_mtf, edge_mtf_stack
from tests.oracle import slanted_edge as oracle

SIGMAS = (0.3, 0.5, 0.8, 1.2)
ELECTRONS = 1e4


def relative(found, truth):
    return np.asarray(found) / truth - 1


@pytest.fixture(scope="module")
def straight():
    """One result for each sigma, 5 degrees, no noise."""
    return edge_mtf_stack(np.stack([oracle.picture(oracle.gaussian(s)) for s in SIGMAS]) * ELECTRONS)


@pytest.mark.parametrize("number", range(4))
def test_bias_without_noise(straight, number):
    sigma, result = SIGMAS[number], straight[number]
    truth = oracle.gaussian_half(sigma)
    assert abs(relative(result.parametric.mtf50, truth)) <= 2e-4
    assert abs(relative(result.mtf50, truth)) <= 2e-4
    below = result.frequency <= 0.5
    assert np.max(np.abs(result.mtf - oracle.gaussian_mtf(result.frequency, sigma))[below]) <= 2e-4
    assert result.frequency[-1] >= 1
    assert result.parametric.values[0] == pytest.approx(sigma, rel=1e-4)
    assert np.degrees(result.angle) == pytest.approx(5, abs=1e-3)
    assert result.parametric.consistent
    assert result.glare_fraction == 0


def test_esf_and_lsf(straight):
    result, x = straight[1], np.linspace(-6, 6, 97)
    esf, lsf = result.esf(x), result.lsf(x)
    truth = oracle.edge(x, np.radians(5), 0.5)
    assert np.max(np.abs(esf.value - truth)) < 1e-4
    slope = (oracle.edge(x + 1e-4, np.radians(5), 0.5) - oracle.edge(x - 1e-4, np.radians(5), 0.5)) / 2e-4
    assert np.max(np.abs(lsf.value - slope)) < 2e-4
    assert np.all(esf.std > 0)
    samples = result.samples
    assert np.max(np.abs(samples.value - oracle.edge(samples.distance, np.radians(5), 0.5))) < 2e-3
    with pytest.raises(TypeError, match="EdgeMTF"):
        len(result)


@pytest.mark.parametrize(
    "f_number",
    [
        pytest.param(2.8, marks=pytest.mark.slow),
        pytest.param(5.6, marks=pytest.mark.slow),
        pytest.param(8, marks=pytest.mark.slow),
        pytest.param(16, marks=pytest.mark.slow),
    ],
)
def test_diffraction_pattern_that_no_model_was_told_of(f_number):
    cutoff = 4.73 / (0.55 * f_number)
    mtf = lambda f: oracle.airy_mtf(f, cutoff)  # noqa: E731
    image = oracle.picture(oracle.edge_of(mtf, cutoff)) * ELECTRONS
    truth = oracle.half_frequency(mtf)
    # as it would be seen at SNR 100, and as clean as it is
    for noise in ({"gain": 1.0, "read_noise": 0.0}, {}):
        result = edge_mtf(image, **noise)
        assert abs(relative(result.mtf50, truth)) <= 3e-3
        fit = result.parametric
        assert not fit.consistent
        # MTF50 of a Gaussian lens and its width have the same error: that of the combined blur of lens and pixel
        share = fit.covariance[0, 0] ** 0.5 / (fit.values[0] + 1 / 12 / fit.values[0])
        assert share == pytest.approx(fit.mtf50_std / fit.mtf50, rel=0.1)


ANGLES = [*range(2, 44), 14.04, 18.43, 26.57]


def test_every_angle():
    for sigma in (0.3, 0.5):
        images = np.stack([oracle.picture(oracle.gaussian(sigma, a)) for a in ANGLES]) * ELECTRONS
        result = edge_mtf_stack(images)
        assert not any(result.problems)
        truth = np.array([oracle.gaussian_half(sigma, a) for a in ANGLES])
        assert np.max(np.abs(relative(result.mtf50, truth))) <= 1e-3
        assert np.max(np.abs(relative(result.parametric.mtf50, truth))) <= 1e-3


@pytest.mark.parametrize(
    "turn",
    [*(pytest.param(t, marks=pytest.mark.slow) for t in ("as it is", "mirrored", "both", "upside down")), "transposed"],
)
def test_orientation(turn):
    image = oracle.picture(oracle.gaussian(0.5, 7)) * ELECTRONS
    turned, degrees = {
        "as it is": (image, 7),
        "mirrored": (image[:, ::-1], 173),
        "transposed": (image.T, 83),
        "upside down": (image[::-1], -7),
        "both": (image.T[::-1], -83),
    }[turn]
    result = edge_mtf(turned)
    assert np.degrees(result.angle) == pytest.approx(degrees, abs=1e-3)
    assert abs(relative(result.mtf50, oracle.gaussian_half(0.5, 7))) <= 2e-4
    height, width = turned.shape
    assert result.position == pytest.approx(((width - 1) / 2, (height - 1) / 2), abs=1e-2)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.2])
def test_bowed_edge(sigma):
    images = np.stack([oracle.picture(oracle.curved_gaussian(sigma, bow)) for bow in (0.0, 2.0, -2.0)]) * ELECTRONS
    result = edge_mtf_stack(images)
    straight, *bowed = result.mtf50
    assert np.max(np.abs(relative(bowed, straight))) <= 5e-4
    assert abs(relative(result.parametric.mtf50[1], result.parametric.mtf50[0])) <= 5e-4
    # the ends of the edge's middle line are 2 px away from it at the rows' ends, half a pixel outside the last rows
    assert result.bow[1:] == pytest.approx([-2 * np.cos(np.radians(5)), 2 * np.cos(np.radians(5))], abs=0.05)


@pytest.mark.parametrize("light", [(0.1, 0), (0, 0.1), (-0.07, 0.07)])
def test_uneven_light(light):
    result = edge_mtf(oracle.picture(oracle.gaussian(0.5), light) * ELECTRONS)
    truth = oracle.gaussian_half(0.5)
    assert abs(relative(result.mtf50, truth)) <= 2e-3
    assert abs(relative(result.parametric.mtf50, truth)) <= 2e-3
    assert result.light == pytest.approx((light[0] / oracle.WIDTH, light[1] / oracle.HEIGHT), abs=2e-5)


@pytest.mark.parametrize("radius", [5, 7, 10, 20, 40, 80])
def test_glare_is_told_from_the_core(radius):
    for sigma in (0.5, 1.2):
        response = 0.95 * oracle.gaussian(sigma) + 0.05 * oracle.gaussian(radius)
        result = edge_mtf(oracle.picture(response) * ELECTRONS)
        assert result.glare_found
        assert abs(result.glare_fraction - 0.05) <= 5e-3
        assert abs(relative(result.core_mtf50, oracle.gaussian_half(sigma))) <= 3e-3


def test_missing_pixels_are_left_out():
    image = oracle.picture(oracle.gaussian(0.5)) * ELECTRONS
    holes = np.random.default_rng(3).random(image.shape) < 0.03
    image[holes] = np.nan
    assert abs(relative(edge_mtf(image).mtf50, oracle.gaussian_half(0.5))) <= 5e-4


def test_a_pixel_that_is_not_all_sensitive():
    image = oracle.picture(oracle.gaussian(0.5, half_width=0.35)) * ELECTRONS
    truth = oracle.gaussian_half(0.5, half_width=0.35)
    result = edge_mtf(image, half_width=0.35)
    assert abs(relative(result.parametric.mtf50, truth)) <= 2e-4
    # the free curve does not need to know
    assert abs(relative(edge_mtf(image).mtf50, truth)) <= 5e-4
