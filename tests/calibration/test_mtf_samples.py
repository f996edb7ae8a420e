"""What a joint fit of the camera is handed: checked when it is made."""

import numpy as np
import pytest

from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.core.errors import ArgumentError

GOOD = {
    "kind": "star",
    "position": (10.0, 20.0),
    "frequency": [0.1, 0.2],
    "direction": [0, 1],
    "mtf": [0.9, -0.1],
    "covariance": [[4e-4, 1e-4], [1e-4, 9e-4]],
}


def test_lists_become_arrays_and_the_diagonal_is_the_variance():
    samples = MTFSamples(**GOOD)
    assert samples.direction.dtype == np.float64
    np.testing.assert_allclose(samples.mtf_std, [0.02, 0.03])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"kind": "sky"}, "kind must be one of 'edge'"),
        ({"mtf": [0.9]}, "mtf must have 2 finite values"),
        ({"mtf": [0.9, np.nan]}, "mtf must have 2 finite values"),
        ({"frequency": [0.0, 0.2]}, "frequency must be positive"),
        ({"frequency": [], "direction": [], "mtf": [], "covariance": np.zeros((0, 0))}, "at least 1"),
        ({"covariance": [0.1, 0.2]}, "covariance must be finite and of shape (2, 2)"),
        ({"covariance": [[1, 0], [0, 0]]}, "positive variances"),
        ({"covariance": [[1, 0.5], [0, 1]]}, "symmetric"),
    ],
)
def test_what_cannot_be_is_refused(changed, words):
    with pytest.raises(ArgumentError) as error:
        MTFSamples(**{**GOOD, **changed})
    assert words in str(error.value)
