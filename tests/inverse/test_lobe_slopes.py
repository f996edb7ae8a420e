"""Slopes of a lobe's record."""

import numpy as np
import pytest

from matcam import rigs
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import lobe_record, record_and_slopes
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.rig.rig_axes import free_axis, shape_axes
from matcam.material.ndf.free_lobe import KNOTS


@pytest.mark.parametrize(
    ("kind", "lobe"),
    [
        pytest.param(LobeKind("epd", "van-ginneken"), np.log([0.01, 0.7]), marks=pytest.mark.slow),
        (LobeKind("ggx", "smith", spline_size=KNOTS), [np.log(0.01), *np.linspace(-0.5, 0.7, KNOTS) ** 2]),
    ],
)
def test_slopes_are_differences_of_the_record(kind, lobe):
    """Of the record that the operator makes of the lobe itself, by the lobe's coordinates and the rig's.

    Lambda's table moves with the roughness, and is right to 1e-6.
    """
    axes = (free_axis("optics.sigma_px", rigs.merl()), *shape_axes(rigs.merl())[0])
    _, operator = lobe_operator(rigs.merl(), "centre", 30, axes)
    q = np.array([*lobe, 0.1, -0.2, 0.3, 0.4, -0.1])

    def record(q):
        return lobe_record(operator, kind, q)

    value, slopes = record_and_slopes(operator, kind, q)
    np.testing.assert_allclose(value, record(q), rtol=1e-12, atol=1e-15 * np.abs(value).max())
    step = 1e-3
    for position, slope in enumerate(slopes):
        near, far = (
            (record(q + n * step * np.eye(q.size)[position]) - record(q - n * step * np.eye(q.size)[position]))
            / (2 * n * step)
            for n in (1, 2)
        )
        np.testing.assert_allclose(slope, (4 * near - far) / 3, rtol=1e-5, atol=1e-6 * np.abs(value).max())
