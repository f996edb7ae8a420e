"""Remarks on refits: what the data alone say of a width, and what else may be wrong."""

from types import SimpleNamespace

import numpy as np
import pytest

from matcam.inverse.correction.rig_refits import RigRefit, rig_refits
from matcam.inverse.rig.rig_axes import LENS, prior_axis
from tests.inverse import recorded


def refit_of(coordinate, std, relative):
    """Refit of a lens of 0.5 px whose width has a prior; coordinate and std: ln of the fitted width, and its error."""
    rig = recorded.rig(std=0.5 * relative)
    axis = prior_axis(LENS, rig, relative)
    at = SimpleNamespace(
        axes=[axis],
        lobe=np.zeros(0),
        rig=[axis.coordinate(0.5 * np.exp(coordinate))],
        covariance=np.array([[axis.std(std) ** 2]]),
    )
    found = SimpleNamespace(coordinates=at, resolved=True)
    (refit,) = rig_refits(None, rig, found, (LENS,))
    return refit


def test_the_data_alone_are_given():
    """A tight prior holds the fit at the specified width: the remark would give the same number twice."""
    held = refit_of(0.0004, 0.0019999, 0.002)
    assert held.contradicts
    assert "gives at least 0.510 px instead of 0.500 px" in held.remark.text
    refit = refit_of(0.0036, 0.0005, 0.002)
    assert refit.value == pytest.approx(0.5 * np.exp(0.0036 / (1 - 0.0005**2 / 0.002**2)), rel=1e-6)
    strong = refit_of(0.0098, 0.0001, 0.002)
    assert strong.contradicts
    assert "0.5049" in strong.remark.text
    assert "instead of 0.5000" in strong.remark.text
    assert "radius of the sample" in strong.remark.text


def test_the_end_of_the_range_is_no_estimate():
    refit = refit_of(0.15, 0.01, 0.03)
    assert refit.contradicts
    assert "gives at least 0.581 px instead of 0.500 px" in refit.remark.text


def test_data_that_tell_nothing_have_a_large_error_and_no_overflow():
    """The error of the fit is that of the prior: the data alone leave the width free, but their error is a number."""
    for coordinate in (0.0, 1e-8):  # rounding is no contradiction
        refit = refit_of(coordinate, 0.02, 0.02)
        assert refit.value == pytest.approx(0.5, rel=0.02)
        assert not refit.contradicts
        assert 5 < refit.std < 1e6


def test_close_values_differ_in_their_digits():
    axis = prior_axis(LENS, recorded.rig(), 0.01)
    text = RigRefit(axis, 1e-4, 0.50005, 1e-6, True, None, 0.0).remark.text
    assert "gives 0.5000500 ± 1e-06 px instead of 0.5000000 px" in text
