"""Gratings photographed by the oracle's camera: contrast of their harmonics against the camera's own MTF."""

import numpy as np
import pytest

from docs_claims import limit
from matcam.calibration.chart.chart import Grating
from matcam.calibration.targets.gratings import coltman, grating_mtf
from matcam.core.errors import ArgumentError, FitError
from tests.calibration.photographed import ASLANT, page_of
from tests.oracle.chart_camera import ChartCamera

PAGE = (60.0, 50.0)
PIXEL = PAGE[0] / 200  # mm on the page
CONTRAST = 0.7 / 1.2


def camera(sigma=0.5, fill=0.9):
    return ChartCamera(200, 166, PAGE, sigma=sigma, fill=fill, filled=1.0, vignetting=0.1, **ASLANT)


def grating(profile, frequency, duty=0.5, angle=0.12):
    size = (round(90 * frequency) / frequency * PIXEL, 80 * PIXEL)
    return Grating(profile, (31.0, 24.0), size, angle, PIXEL / frequency, 0.7, 0.25, 0.95, duty)


def errors(result, truth):
    return result.samples.mtf - truth.mtf(result.samples.frequency, result.samples.direction)


CASES = [
    ("bars", 0.06, 0.5), ("bars", 0.2, 0.5), ("bars", 0.4, 0.5), ("sine", 0.1, 0.5), ("sine", 0.45, 0.5), ("lines", 0.06, 0.25),
    ("lines", 0.2, 0.25),
]  # fmt: skip


@pytest.mark.parametrize(("profile", "frequency", "duty"), CASES)
def test_found_without_hints(profile, frequency, duty):
    """Asked for: 0.005, for bars."""
    shot = camera()
    picture = 1e4 * shot.expected(page_of(grating(profile, frequency, duty))) * shot.light()
    result = grating_mtf(picture, profile=profile, contrast=CONTRAST, duty=duty)
    assert result.samples.frequency[0] == pytest.approx(frequency, rel=0.05)
    assert result.samples.frequency.size >= (1 if profile == "sine" else min(int(1 / frequency) // 2, 6))
    assert np.abs(errors(result, shot)).max() < limit("bars")


@pytest.mark.parametrize(
    ("profile", "frequency", "duty"), [("bars", 0.12, 0.5), ("bars", 0.62, 0.5), ("lines", 0.2, 0.25)]
)
def test_known_position_and_beyond_nyquist(profile, frequency, duty):
    shot, printed = camera(0.35), grating(profile, frequency, duty)
    picture = 1e4 * shot.expected(page_of(printed)) * shot.light()
    # the registration is off by half a pixel; the phase is found all the same
    result = grating_mtf(picture, grating=printed, projection=lambda p: np.stack(shot.sensor_of(*p.T), axis=-1) + 0.25)
    assert result.samples.frequency[0] == pytest.approx(frequency, rel=0.05)
    assert np.abs(errors(result, shot)).max() < 6e-4
    if frequency > 0.5:
        f, a = result.samples.frequency[0], result.samples.direction[0]
        hinted = grating_mtf(picture, contrast=CONTRAST, near=(1.03 * f * np.cos(a), 1.03 * f * np.sin(a)))
        assert hinted.samples.frequency[0] == pytest.approx(f, rel=1e-3)
        assert np.abs(errors(hinted, shot)).max() < 6e-4


def test_stated_errors_and_mosaic():
    shot = camera()
    expected = shot.expected(page_of(grating("bars", 0.15)))
    pulls = []
    for seed in range(5):
        for options in ({}, {"cfa": "GRBG", "channel": "G"}):
            picture = shot.photograph(expected, 60, seed, options.get("cfa"))
            result = grating_mtf(picture, contrast=CONTRAST, **options)
            error = errors(result, shot)
            pulls.append(error @ np.linalg.solve(result.samples.covariance, error) / error.size)
            assert np.abs(error[result.samples.frequency < 0.5]).max() < 0.02
    degrees = len(pulls) * error.size
    assert np.mean(pulls) == pytest.approx(1, abs=4 * np.sqrt(2 / degrees))


def test_harmonics_that_look_alike_are_not_trusted():
    """At exactly 1/6 cycles/px along the rows the fifth harmonic looks like the first, and the third is at Nyquist."""
    x = np.arange(120.0)
    wave = sum(
        4 / np.pi / k * (-1) ** (k // 2) * np.exp(-k / 6) * np.cos(k * (2 * np.pi * x / 6 + 0.3)) for k in (1, 3, 5)
    )
    picture = 1000 * (1 + 0.5 * np.tile(wave, (100, 1)))
    picture += np.random.default_rng(0).normal(0, 5, picture.shape)
    slanted = 1000 * (1 + 0.25 * np.cos(2 * np.pi * (np.arange(120) / 6 + 0.03 * np.arange(100)[:, None])))
    try:
        result = grating_mtf(picture, contrast=0.5)
    except FitError:
        pass
    else:
        # nothing of the first harmonic is said better than the fifth could be
        first = np.flatnonzero(np.abs(result.samples.frequency - 1 / 6) < 1e-3)
        assert (result.samples.mtf_std[first] > 0.02).all()
    sine = grating_mtf(slanted + np.random.default_rng(0).normal(0, 5, picture.shape), profile="sine", contrast=0.5)
    assert sine.samples.mtf[0] == pytest.approx(0.5, abs=4 * sine.samples.mtf_std[0])
    assert sine.contrast == pytest.approx(0.25, abs=0.003)


def test_coltman_undoes_square_waves():
    f = np.arange(0.01, 1.2, 0.01)

    def mtf(g):
        return np.exp(-2 * (np.pi * 0.4 * g) ** 2) * np.sinc(g)

    k = np.arange(1, 400, 2)
    square = 4 / np.pi * (np.where(k % 4 == 1, 1, -1) / k * mtf(f[:, None] * k)).sum(-1)
    assert np.abs(square - mtf(f)).max() > 0.1
    assert np.abs(coltman(f, square) - mtf(f)).max() < 2e-3


def test_a_photographed_series_by_coltman():
    """Contrasts read off the middles of bars, freed of their harmonics: the same MTF as by the fit."""
    shot = camera()
    shot.tilt = (0.0, 0.0)
    results = []
    for frequency in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9):
        printed = grating("bars", frequency)
        picture = 1e4 * shot.expected(page_of(printed)) * shot.light()
        results.append(
            grating_mtf(picture, grating=printed, projection=lambda p: np.stack(shot.sensor_of(*p.T), axis=-1))
        )
    f = np.array([r.samples.frequency[0] for r in results])
    found = coltman(f, np.array([r.contrast for r in results]) / CONTRAST)
    truth = shot.mtf(f, results[0].samples.direction[0])
    assert np.abs(found - truth).max() < 0.01  # what the gaps between eight frequencies leave


def test_refusals():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:150, :150]
    noise = rng.normal(0, 5, (150, 150))
    pictures = (
        1000 + noise,
        1000 + 300 * np.cos(0.4 * x) * np.cos(0.5 * y) + noise,
        np.where(x + 0.1 * y > 80, 300.0, 1000.0) + noise,
        1000 + 300 * np.cos(48 * np.arctan2(y - 75, x - 75)) + noise,
    )
    for picture in pictures:
        with pytest.raises(FitError) as error:
            grating_mtf(picture, contrast=0.5)
        assert "\n" not in str(error.value)
    for arguments in (
        {}, {"contrast": 1.2}, {"contrast": 0.5, "profile": "saw"}, {"contrast": 0.5, "duty": 1.0}, {"grating": CASES[0]},
    ):  # fmt: skip
        with pytest.raises(ArgumentError):
            grating_mtf(pictures[0], **arguments)
    with pytest.raises(ArgumentError):
        coltman([0.2, 0.1], [1, 1])
    with pytest.raises(FitError):
        grating_mtf(pictures[0], grating=grating("bars", 0.2), projection=lambda p: p + 400)
