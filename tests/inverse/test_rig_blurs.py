"""Blurs for which rules are computed: changes of a Gaussian lens are points of its width."""

import numpy as np
import pytest

from matcam import GGX, Camera, DiffractionOptics, Rig, rigs
from matcam.forward.integral.blur import blur_of
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.rig.lens_changes import VARIANCES
from matcam.inverse.rig.rig_axes import LENS, free_axis, prior_axis, rig_with, shape_axes
from matcam.inverse.rig.rig_blurs import RigBlurs


@pytest.mark.parametrize(("relative", "count"), [(1.0, 9), (0.1, 9), (0.02, 7)])
def test_changes_of_a_gaussian_lens_are_points_of_its_width(relative, count):
    """Only the two stretched Gaussians need rules of their own."""
    rig = rig_with(rigs.merl(), {"jitter": 0.1})
    own = blur_of(rig, in_discs=True, whole=True)
    blurs = RigBlurs.of(rig, own, (prior_axis(LENS, rig, relative), *shape_axes(rig)[0]))
    assert (len(blurs.along), len(blurs.changes)) == (count, 2)
    for variance in VARIANCES:
        there = blurs.along[blurs.columns[variance, variance]].blur
        assert float(there.std_of_half) == pytest.approx(np.sqrt(variance * 0.26), rel=1e-9)


def test_changes_of_another_lens_are_gaussians_of_their_own():
    rig = Rig(Camera(DiffractionOptics(8.0, 550e-9, 5e-6), rigs.merl().camera.pixel), rigs.merl().sample)
    blurs = RigBlurs.of(rig, blur_of(rig, in_discs=True, whole=True), shape_axes(rig)[0])
    assert (len(blurs.along), len(blurs.changes)) == (1, 7)


def test_a_lens_without_width_has_no_shape():
    """A guessed lens may have no width. Its shape then changes no record."""
    axes = (free_axis(LENS, rigs.merl()), *shape_axes(rigs.merl())[0])
    _, operator = lobe_operator(rigs.merl(), "centre", 30, axes)
    for width, least, largest in ((axes[0].low, 0.0, 1e-5), (0.0, 0.1, 10.0)):
        plain, shaped = (
            operator.record(GGX(0.005), "smith", [width, *shape]) for shape in (np.zeros(4), [3.0, -2.0, 1.0, -1.5])
        )
        assert least <= np.abs(shaped - plain).max() / plain.max() < largest
