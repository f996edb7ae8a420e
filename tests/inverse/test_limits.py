"""Bounds of roughness at any size of the sample, and the cost of large samples."""

import numpy as np
import pytest

from matcam.core.errors import ArgumentError
from matcam.inverse.recoverability import limits
from matcam.rigs import Rig
from matcam.sample.curved import Sphere
from tests.inverse import recorded


def _rig(radius: float) -> Rig:
    rig = recorded.rig()
    return Rig(rig.camera, Sphere(radius))


def test_a_narrower_lobe_on_a_small_sphere_is_known_less_well():
    """The effect of a width far below a pixel is proportional to its square, and so is the information."""
    roughness = np.array([3e-4, 1e-3, 3e-3])
    small = limits(_rig(15.0), roughness=roughness, slice_step=30)["width_std"].values
    assert np.all(small[:-1] > 2.5 * small[1:])
    larger = limits(_rig(60.0), roughness=roughness, slice_step=30)["width_std"].values
    assert np.all(small > 3 * larger)


def test_the_blurs_are_small_in_the_image_of_a_large_sphere():
    found = limits(_rig(1e4), roughness=[0.01], slice_step=30)
    lamp, jitter, defocus = found["size"].values
    assert np.radians(lamp) * 1e4 == pytest.approx(0.2)
    assert (jitter, defocus * 1e4) == pytest.approx((0.15, 0.2))


def test_lobes_between_the_nodes_are_refused():
    with pytest.raises(
        ArgumentError, match=r"roughness must lie in \[0\.00025, 1\] \(the quadrature nodes resolve lobes"
    ):
        limits(_rig(100.0), roughness=[1e-4])
