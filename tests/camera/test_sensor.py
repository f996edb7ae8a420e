"""The sensor: its statistics against Poisson's and Gauss's laws, in bounds of five standard errors, with fixed seeds."""

import numpy as np
import pytest

from matcam import Camera, DiffractionOptics, GaussianOptics, HaloOptics, Sensor
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax

PITCH = 4.73e-6
SAMPLES = 60_000


def plain(**changes):
    return Sensor(**({"pitch": PITCH, "full_well": 20_000, "read_noise": 2.5, "gain": 1.0} | changes))


@pytest.fixture(scope="module", name="record")
def _record():
    """Electrons of a sensor without patterns: a row of equal pixels for each level, 0.1 e- to near its full well."""
    levels = np.array([0.1, 1.0, 8.0, 12.0, 300.0, 19_000.0])
    sensor = plain(bits=16)
    scene = np.broadcast_to(levels[:, None], (levels.size, SAMPLES)) / 50
    return levels, np.asarray(sensor.electrons(sensor.expose(scene, 50.0, seed=3)))


def test_mean_from_a_tenth_of_an_electron_to_the_full_well(record):
    levels, electrons = record
    error = np.sqrt((levels + 2.5**2 + 1 / 12) / SAMPLES)
    assert np.all(np.abs(electrons.mean(axis=1) - levels) < 5 * error)
    assert np.sum(((electrons.mean(axis=1) - levels) / error) ** 2) < 22  # chi-square of 6, 99.9 %


def test_variance_from_a_tenth_of_an_electron_to_the_full_well(record):
    levels, electrons = record
    variance = levels + 2.5**2 + 1 / 12
    # fourth central moment: Gauss's, and Poisson's fourth cumulant
    error = np.sqrt((2 * variance**2 + levels) / SAMPLES)
    found = electrons.var(axis=1)
    assert np.all(np.abs(found - variance) < 5 * error)
    assert np.sum(((found - variance) / error) ** 2) < 22
    np.testing.assert_allclose(plain(bits=16).variance(levels), variance, rtol=1e-14)


def test_shot_noise_is_poissonian_at_low_counts():
    """Without read noise, one DN per electron: the counts themselves, against Poisson's law."""
    sensor = plain(read_noise=0.0, bits=14)
    counts = np.asarray(sensor.expose(np.full((100, 100), 0.7), 1.0, seed=8)).ravel()
    from scipy.stats import chisquare, poisson

    expected = counts.size * np.append(poisson.pmf(np.arange(5), 0.7), poisson.sf(4, 0.7))
    observed = [np.sum(counts == n) for n in range(5)] + [np.sum(counts > 4)]
    assert chisquare(observed, expected).pvalue > 1e-3


def test_photon_transfer_curve():
    """Variance against mean in DN: a line whose slope is the gain, whose start is the read noise (EMVA 1288)."""
    sensor = plain(gain=0.25, read_noise=8.0, bits=14, prnu=0.02)
    exposures = np.array([100.0, 500.0, 2000.0, 5000.0, 12_000.0])
    means, variances = [], []
    for i, exposure in enumerate(exposures):
        one, two = (np.asarray(sensor.expose(np.ones((100, 100)), exposure, seed=2 * i + k)) for k in (0, 1))
        means.append(float((one + two).mean() / 2 - sensor.black_level))
        variances.append(np.var(one - two) / 2)  # the pattern cancels
    weight = 1 / np.array(variances)
    slope, start = np.polyfit(means, variances, 1, w=weight)
    # a variance is known to sqrt(2 / pixels) = 1.4 %, the slope by five of them to 0.8 %
    assert slope == pytest.approx(0.25, rel=0.03)
    assert start == pytest.approx((8.0 * 0.25) ** 2 + 1 / 12, rel=0.2)


def test_pattern_is_part_of_the_sensor():
    scene = np.full((100, 100), 1.0)
    noiseless = [np.asarray(plain(prnu=0.05, pattern_seed=s).expected_electrons(scene, 1e3)) for s in (1, 1, 2)]
    np.testing.assert_array_equal(noiseless[0], noiseless[1])
    assert abs(np.corrcoef(noiseless[0].ravel(), noiseless[2].ravel())[0, 1]) < 5 / 100
    # variance over the pixels is (prnu signal)^2 at every exposure: its root is proportional to the signal
    for exposure in (10.0, 1e4):
        electrons = np.asarray(plain(prnu=0.05, pattern_seed=1).expected_electrons(scene, exposure))
        assert electrons.std() / exposure == pytest.approx(0.05, rel=5 / np.sqrt(2 * 100**2))
        assert electrons.mean() / exposure == pytest.approx(1, abs=5 * 0.05 / 100)


def test_fixed_pattern_gain_comes_before_shot_noise():
    """A pixel of sensitivity g counts g times the photons, with the variance of that count: g, not g^2."""
    sensor = plain(prnu=0.4, read_noise=0.0)
    expected = np.asarray(sensor.expected_electrons(np.ones((100, 100)), 400.0))
    frames = np.stack([np.asarray(sensor.expose(np.ones((100, 100)), 400.0, seed=s)) for s in range(60)])
    ratio = frames.var(axis=0, ddof=1) / expected
    slope = np.polyfit(np.log(expected.ravel()), ratio.ravel(), 1)[0]
    # each ratio is known to sqrt(2 / 59); gain after the photons were counted would make it rise like g: slope 1
    error = np.sqrt(2 / 59) / np.log(expected).std() / 100
    assert abs(slope) < 5 * error
    assert error < 0.02
    assert ratio.mean() == pytest.approx(1, abs=5 * np.sqrt(2 / 59) / 100)


def test_dark_electrons_and_their_pattern():
    sensor = plain(dark_current=200.0, dark_nonuniformity=0.5, read_noise=0.0)
    night = np.zeros((100, 100))
    expected = np.asarray(sensor.expected_electrons(night, 1.0, time=3.0))
    assert expected.mean() == pytest.approx(600, abs=5 * 300 / 100)
    assert expected.std() == pytest.approx(300, rel=0.1)
    assert expected.min() > 0
    electrons = np.asarray(sensor.electrons(sensor.expose(night, 1.0, seed=1, time=3.0)))
    assert (electrons - expected).var() == pytest.approx(600, rel=0.1)  # they are counted, too
    assert np.all(np.asarray(sensor.expected_electrons(night, 1.0)) == 0)


def test_offsets_of_the_pixels_stay_with_time_and_frames():
    sensor = plain(dsnu=4.0, read_noise=1.0)
    night = np.zeros((100, 100))
    frames = [np.asarray(sensor.electrons(sensor.expose(night, 1.0, seed=s, time=t))) for s, t in ((1, 0.0), (2, 5.0))]
    assert np.cov(*map(np.ravel, frames))[0, 1] == pytest.approx(16, rel=0.1)
    assert (frames[0] - frames[1]).var() == pytest.approx(2, rel=0.1)
    assert np.all(np.asarray(sensor.expected_electrons(night, 1.0)) == 0)
    colour = np.asarray(sensor.electrons(sensor.expose(np.zeros((100, 100, 3)), 1.0, seed=1)))
    np.testing.assert_allclose(colour.mean(axis=-1), frames[0], atol=6)


def test_rounding_and_range():
    coarse = plain(gain=0.02, read_noise=0.0, bits=8)  # 50 electrons to a DN
    scene = np.linspace(0, 15_000, 10_000).reshape(100, 100)
    digital = np.asarray(coarse.expose(scene, 1.0, seed=0))
    assert np.all(digital == np.round(digital))
    assert digital.min() >= 0
    assert digital.max() == 255
    shot_free = np.asarray(plain(read_noise=0.0).expose(scene, 1.0, seed=0))  # the same electrons, not rounded
    inside = digital < 255
    error = (np.asarray(coarse.electrons(digital)) - shot_free)[inside]
    assert np.abs(error).max() <= 25.000001
    assert error.var() == pytest.approx(50**2 / 12, rel=0.05)
    assert float(coarse.saturation) == 255 / 0.02


def test_the_well_fills_before_it_is_read():
    sensor = plain(full_well=1000.0, read_noise=10.0, black_level=100.0)
    electrons = np.asarray(sensor.electrons(sensor.expose(np.full((100, 100), 1e9), 1.0, seed=5)))
    assert electrons.mean() == pytest.approx(1000, abs=5 * 10 / 100)
    assert electrons.std() == pytest.approx(10, rel=0.05)
    assert float(plain(full_well=1000.0, bits=10, gain=2.0, black_level=23.0).saturation) == 500.0


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_bayer_layout(cfa):
    sensor = plain(cfa=cfa, read_noise=0.0)
    colour = np.broadcast_to([10.0, 200.0, 4000.0], (5, 6, 3))
    mosaic = np.asarray(sensor.expected_electrons(colour, 1.0))
    assert mosaic.shape == (5, 6)
    value = dict(zip("RGB", (10.0, 200.0, 4000.0), strict=True))
    for row in range(5):
        for column in range(6):
            letter = cfa[2 * (row % 2) + column % 2]
            assert mosaic[row, column] == value[letter]
            assert "RGB"[sensor.channel_map(5, 6)[row, column]] == letter
    with pytest.raises(ArgumentError, match=r"radiance for a .... sensor must have shape \(H, W, 3\), got \(5, 6\)"):
        sensor.expose(np.ones((5, 6)), 1.0, seed=0)


def test_seeds():
    scene = np.full((6, 7, 3), 100.0)
    sensor = plain(bits=12)
    same = [np.asarray(sensor.expose(scene, 1.0, seed)) for seed in (4, 4, jax.random.key(4), 5)]
    np.testing.assert_array_equal(same[0], same[1])
    np.testing.assert_array_equal(same[0], same[2])
    assert np.any(same[0] != same[3])
    assert np.any(same[0][..., 0] != same[0][..., 1])  # channels have their own noise
    patterned = np.asarray(plain(prnu=0.1).expected_electrons(scene, 1.0))
    np.testing.assert_array_equal(patterned[..., 0], patterned[..., 1])  # and one pattern


def test_missing_radiance_stays_missing():
    scene = np.full((100, 100), 100.0)
    scene[1, 2] = np.nan
    for bits in (None, 12):
        picture = np.asarray(plain(bits=bits, prnu=0.1).expose(scene, 1.0, seed=1))
        np.testing.assert_array_equal(np.isnan(picture), np.isnan(scene))


def test_expected_electrons_are_differentiable():
    def total(prnu, exposure):
        return plain(prnu=prnu).expected_electrons(np.ones((3, 3)), exposure).sum()

    slope = jax.grad(total, argnums=(0, 1))
    assert np.all(np.isfinite(slope(0.0, 10.0)))
    h = 1e-6
    finite = float(total(0.1 + h, 10.0) - total(0.1 - h, 10.0)) / (2 * h)
    assert float(slope(0.1, 10.0)[0]) == pytest.approx(finite, rel=1e-5)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: plain(full_well=0), "full_well must lie in [1, 1e+08] e-, got 0"),
        (lambda: plain(read_noise=-1), "read_noise must lie in [0, 1e+06] e-, got -1"),
        (lambda: plain(gain=0), "gain must lie in (0, 1e+06] DN per e-, got 0"),
        (lambda: plain(pitch=5), "5 um is 5e-6"),
        (lambda: plain(bits=12.0), "bits must be a whole number in [1, 32] or None, got 12.0"),
        (lambda: plain(bits=64), "bits"),
        (lambda: plain(cfa="RGB"), "cfa must be one of 'RGGB', 'BGGR', 'GRBG', 'GBRG', got 'RGB'"),
        (lambda: plain(prnu=[0.1, 0.2]), "prnu must be a single number"),
        (lambda: plain(bits=4, black_level=20), "black_level must lie below 15 DN"),
        (lambda: plain(pattern_seed=-1), "pattern_seed"),
        (lambda: plain().expose(np.ones(5), 1.0, 0), "radiance must have shape (H, W) or (H, W, channels), got (5,)"),
        (lambda: plain().expose(-np.ones((2, 2)), 1.0, 0), "radiance must lie in [0, inf), got -1"),
        (lambda: plain().expose(np.full((2, 2), np.inf), 1.0, 0), "radiance must lie in [0, inf), got inf"),
        (
            lambda: plain().expose(np.ones((2, 2)), 0.0, 0),
            "exposure must lie in (0, inf) e- per unit of radiance, got 0",
        ),
        (lambda: plain().expose(np.ones((2, 2)), 1.0, 0, time=-1), "time must lie in [0, inf) s, got -1"),
        (lambda: plain().expose(np.ones((2, 2)), 1.0, -3), "seed must be a whole number in [0, 2^63)"),
        (lambda: plain().channel_map(2, 2), "this sensor has no mosaic"),
        (lambda: Camera(GaussianOptics(0.5), None, BoxLike()), "sensor must be a Sensor, got BoxLike"),
        (
            lambda: Camera(HaloOptics(DiffractionOptics(8, 550e-9, 6e-6), 0.1, 9.0), sensor=plain()),
            "sensor has a pitch of 4.73e-06 m, but optics.core.pixel_pitch_m is 6e-06",
        ),
    ],
)
def test_nonsense_is_refused(build, words):
    with pytest.raises(ArgumentError) as caught:
        build()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


class BoxLike:
    pass
