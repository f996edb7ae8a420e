"""Noise of the pixels that a reconstruction reads."""

import numpy as np

from matcam.reconstruction.observed_pixels import ObservedPixels


def test_noise_follows_the_step_between_two_exposures():
    """Above a level of 0.1 only the shorter of two exposures is not clipped: its shot noise is 16 times larger."""
    random = np.random.default_rng(5)
    level = np.geomspace(0.01, 1.0, 240)
    gain = np.where(level < 0.1, 1e-4, 16e-4)
    values = level + np.sqrt(gain * level) * random.standard_normal(level.size)
    std = np.sqrt(gain * np.maximum(values, 1e-6))  # as a camera states it: from the recorded value
    yes = np.ones(level.size, bool)
    pixels = ObservedPixels(None, level, level, values, std, ~yes, 0 * yes, yes, np.zeros((2, level.size)))
    shuffled = random.permutation(level.size)  # pixels are in no order of level
    mixed = pixels._replace(std=std[shuffled], used=yes, clipped=~yes)
    found = mixed.noise_at(level[shuffled])
    np.testing.assert_allclose(found, np.sqrt(gain * level)[shuffled], rtol=0.2)
    assert abs(np.mean(found / np.sqrt(gain * level)[shuffled]) - 1) < 0.02
