"""Merged exposures: without bias, and as uncertain as they say."""

import numpy as np
import pytest

from matcam import Sensor
from matcam.camera import expose_bracket, merge_bracket
from matcam.core.errors import ArgumentError

EXPOSURES, TIMES = (50.0, 1000.0, 20_000.0), (0.01, 0.2, 4.0)


def camera(**changes):
    return Sensor(**({"pitch": 5e-6, "full_well": 15_000, "read_noise": 4.0, "gain": 0.25, "bits": 12} | changes))


@pytest.fixture(scope="module", name="merged")
def _merged():
    """A step wedge: a row for each radiance, 1e-3 to 200; the longest exposure saturates at 0.7, the shortest at 280."""
    truth = np.geomspace(1e-3, 200, 24)
    sensor = camera(prnu=0.01, dark_current=10.0, dark_nonuniformity=0.2, dsnu=1.0)
    scene = np.broadcast_to(truth[:, None], (truth.size, 3000))
    pictures = expose_bracket(sensor, scene, EXPOSURES, 11, TIMES)
    return truth, sensor, pictures, merge_bracket(sensor, pictures, EXPOSURES, TIMES)


def test_unbiased_over_five_decades(merged):
    truth, _, _, found = merged
    radiance, std = np.asarray(found.radiance), np.asarray(found.std)
    assert not np.any(found.saturated)
    bias = (radiance.mean(axis=1) - truth) / (std.mean(axis=1) / np.sqrt(radiance.shape[1]))
    assert np.abs(bias).max() < 5
    assert np.sum(bias**2) < 2 * 24 + 10


def test_the_stated_standard_deviation_is_the_real_one(merged):
    truth, _, _, found = merged
    pulls = (np.asarray(found.radiance) - truth[:, None]) / np.asarray(found.std)
    # 3000 pulls to a row: their variance is known to sqrt(2 / 3000) = 2.6 %
    assert np.all(np.abs(pulls.var(axis=1) - 1) < 5 * 0.026)
    assert pulls.var() == pytest.approx(1, abs=5 * 0.026 / np.sqrt(24))


def test_merging_beats_every_single_picture(merged):
    truth, sensor, pictures, found = merged
    # in the dark the longest exposure leads; in the light only the shortest is left
    dim = np.asarray(sensor.electrons(pictures[2]))[0] / EXPOSURES[2]
    assert np.asarray(found.radiance)[0].std() <= dim.std() * 1.01
    bright = np.asarray(found.std)[-1]
    expected = np.sqrt(truth[-1] * 50 + 4.0**2 + 0.1 + 4.0**2 / 12) / 50
    np.testing.assert_allclose(bright, np.hypot(expected, 0.01 * truth[-1]), rtol=0.1)


def test_saturated_in_all_is_flagged_and_missing_stays_missing():
    scene = np.full((8, 8), 10.0)
    scene[0, 0], scene[1, 1] = 1e6, np.nan
    found = merge_bracket(camera(), expose_bracket(camera(), scene, EXPOSURES, 1), EXPOSURES)
    saturated = np.zeros((8, 8), bool)
    saturated[0, 0] = True
    np.testing.assert_array_equal(found.saturated, saturated)
    for values in (found.radiance, found.std):
        np.testing.assert_array_equal(np.isnan(np.asarray(values)), saturated | np.isnan(scene))


@pytest.mark.slow
def test_colours_and_mosaics():
    scene = np.broadcast_to([1.0, 2.0, 4.0], (8, 8, 3))
    planes = merge_bracket(camera(), expose_bracket(camera(), scene, EXPOSURES, 1), EXPOSURES)
    np.testing.assert_allclose(planes.radiance, scene, rtol=0.3)
    bayer = camera(cfa="GRBG")
    mosaic = merge_bracket(bayer, expose_bracket(bayer, scene, EXPOSURES, 1), EXPOSURES)
    np.testing.assert_allclose(mosaic.radiance, np.take([1.0, 2.0, 4.0], bayer.channel_map(8, 8)), rtol=0.3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.ones((2, 4, 4)), EXPOSURES), "pictures must have shape (3, H, W) or (3, H, W, channels)"),
        ((np.ones((3, 4)), EXPOSURES), "one per exposure, got (3, 4)"),
        ((np.ones((2, 4, 4)), (1.0, 0.0)), "exposures must lie in (0, inf) e- per unit of radiance, got 0"),
        ((np.ones((0, 4, 4)), ()), "exposures must be a list of at least one number"),
        ((np.ones((2, 4, 4)), (1.0, 2.0), (1.0,)), "times must have one value for each of the 2 exposures, got 1"),
        ((np.ones((2, 4, 4)), (1.0, 2.0), (1.0, -1.0)), "times must lie in [0, inf) s, got -1"),
    ],
)
def test_nonsense_is_refused(arguments, words):
    with pytest.raises(ArgumentError) as caught:
        merge_bracket(camera(), *arguments)
    assert words in str(caught.value)
