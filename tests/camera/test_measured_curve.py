"""The MTF of a measured lens: the spline that SciPy makes, in memory that is linear in the samples."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from matcam import MeasuredOptics
from matcam.core.jax import jax


def curve(count, seed=0):
    random = np.random.default_rng(seed)
    frequency = np.concatenate([[0], np.cumsum(random.uniform(0.01, 1, count - 1))])
    return frequency, np.concatenate([[1], random.uniform(-0.2, 1, count - 2), [0]])


@pytest.mark.parametrize("count", [4, 5, 6, 40, 3000])
def test_it_is_the_spline(count):
    frequency, values = curve(count)
    at = np.sort(np.random.default_rng(1).uniform(0, frequency[-1], 300))
    lens = MeasuredOptics(frequency, values)
    np.testing.assert_allclose(lens.mtf(at), CubicSpline(frequency, values)(at), rtol=0, atol=1e-13)
    np.testing.assert_allclose(lens.mtf(frequency), values, rtol=0, atol=1e-13)


def test_uncertainty_passes_through_it():
    frequency, values = curve(12)
    at = np.linspace(0, frequency[-1], 50)
    slopes = jax.jacobian(lambda v: MeasuredOptics(frequency, v).mtf(at))(values)
    np.testing.assert_allclose(slopes, CubicSpline(frequency, np.eye(12))(at), rtol=0, atol=1e-12)


_SCRIPT = """
import resource
import numpy as np
from matcam import MeasuredOptics
def used(count):
    x = np.linspace(0, 1, count)
    MeasuredOptics(x, np.cos(np.pi / 2 * x) ** 2).mtf(0.3)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
before = used(20)
print(used(4000) - before)
"""


def test_a_small_file_takes_little_memory():
    """As many samples as 160 kB of JSON hold; a matrix of them takes 500 MB."""
    done = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 60_000  # kB: what is compiled
