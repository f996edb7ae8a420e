"""Numbers that would be taken for others are refused: values behind a mask, and tables that are no BRDF."""

import numpy as np
import pytest

from matcam import GaussianOptics, MeasuredOptics, edge_mtf, rigs
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import GRID_SHAPE, brdf_table
from matcam.files.float_pictures import as_float32
from matcam.inverse.fit.fit_data import fit_data
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import FAR_AWAY

MASKED = np.ma.masked_greater(np.linspace(0, 1, 64 * 64).reshape(64, 64), 0.99)


@pytest.mark.parametrize(
    "call",
    [
        lambda: GaussianOptics(0.5).mtf(MASKED),
        lambda: GaussianOptics(0.5).psf(MASKED, 0.0),
        lambda: MeasuredOptics(MASKED[-1], MASKED[0]),
        lambda: rigs.merl().camera.mtf(MASKED, 0.0),
        lambda: LinearImage(MASKED, "Y"),
        lambda: edge_mtf(MASKED),
        lambda: as_float32(MASKED),
    ],
)
def test_a_mask_is_not_passed_over(call):
    with pytest.raises(ArgumentError, match="must not be masked"):
        call()


def test_an_array_that_masks_nothing_is_an_array():
    np.testing.assert_array_equal(as_float32(np.ma.array([[1.0, 2.0]])), [[1, 2]])


def test_a_masked_table_has_missing_values():
    values = np.ma.array(np.ones((*GRID_SHAPE, 3)), mask=False)
    values[0, 0, 0, 0] = np.ma.masked
    assert np.isnan(brdf_table(values, "centre").values[0, 0, 0, 0])


@pytest.mark.parametrize("scale", [1e200, 1e20, 1e-20, 1e-200])
def test_a_table_beyond_the_range_is_not_fitted(scale):
    """A conductor cannot reflect it: a fit would make up for the scale with another lobe."""
    table = brdf_table(np.full((*GRID_SHAPE, 3), scale), "centre")
    with pytest.raises(
        FitError, match=r"channel R: the brightest value, 1e.20+, is impossible for a BRDF: give the table in 1/sr"
    ):
        fit_data((table,), chosen_cells(FAR_AWAY, "centre", 30))
