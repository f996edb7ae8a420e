"""sRGB's transfer function, against values published elsewhere."""

import numpy as np
import pytest

from matcam.files import tone_curve as srgb


# codes of 8 bits and their light as the standard's own formula gives them, to the digits that tables print
@pytest.mark.parametrize(
    ("code", "light"), [(0, 0.0), (10, 0.003035), (11, 0.003347), (128, 0.215861), (188, 0.502886), (255, 1.0)]
)
def test_values_of_published_tables(code, light):
    np.testing.assert_allclose(srgb.decoded(code / 255), light, atol=5e-7)


def test_encoding_is_the_inverse():
    # the standard's two thresholds are rounded: where the branches meet they differ by 3e-8 of full scale
    light = np.concatenate([[-0.1], np.linspace(0, 1.2, 10_001)])
    np.testing.assert_allclose(srgb.decoded(srgb.encoded(light)), light, atol=1e-7)
