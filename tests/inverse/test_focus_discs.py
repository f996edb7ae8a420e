"""A lens out of focus in `measure` and in the fits' operator: discs, against every point of the pupil."""

from dataclasses import replace

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Rig, Sphere
from matcam.core.workspace import Workspace
from matcam.inverse.operator.lobe_operator import lobe_operator
from matcam.inverse.rig.rig_axes import free_axis, rig_with
from tests.inverse.recorded import measured
from tests.oracle.focus_disc import kernel

RADIUS, SIGMA, FOCUS = 60.0, 0.5, 0.4
RIG = Rig(Camera(GaussianOptics(SIGMA), BoxPixel(0.5)), Sphere(RADIUS), aperture=0.04, focus=FOCUS)


def light(x, y, lamp, alpha):
    """Radiance of F = 1 at places of the picture, px, its normal's z, and where it is lit and seen."""
    n_x, n_y = x / RADIUS, y / RADIUS
    n_z = np.sqrt(np.maximum(1 - n_x**2 - n_y**2, 1e-12))
    cos_i, cos_h = (n_x * np.sin(angle) + n_z * np.cos(angle) for angle in (lamp, lamp / 2))
    with np.errstate(all="ignore"):
        d = (alpha / (cos_h**2 * (alpha**2 - 1) + 1)) ** 2 / np.pi
        lambdas = [(np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i, n_z)]
        return d / (1 + sum(lambdas)) / (4 * n_z), n_z, (cos_i > 0) & (np.hypot(n_x, n_y) < 1)


@pytest.mark.parametrize("azimuth", [None, pytest.param(0.5, marks=pytest.mark.slow)])
@pytest.mark.parametrize("alpha", [pytest.param(0.03, marks=pytest.mark.slow), 0.1])
def test_records_of_a_lens_out_of_focus_are_means_over_its_pupil(azimuth, alpha):
    rig = replace(RIG, lamp_azimuth=azimuth)
    cells, operator = lobe_operator(rig, "centre", 30, (), Workspace())
    found = np.asarray(operator.record(GGX(alpha), "smith", np.zeros(0)))
    reach, per_px = 6.5, 8
    fine = (np.arange(int(2 * reach * per_px)) + 0.5) / per_px - reach
    own_x, own_y = np.meshgrid(fine, fine)
    turn = azimuth or 0.0
    off_x, off_y = own_x * np.cos(turn) + own_y * np.sin(turn), own_y * np.cos(turn) - own_x * np.sin(turn)
    slices, numbers = np.nonzero(cells.valid)
    rng, truth, largest = np.random.default_rng(1), {}, 0.0
    for k in rng.permutation(slices.size):
        i, j = slices[k], numbers[k]
        directions = []
        for way in range(cells.x.shape[-1]):
            shown = light(cells.x[i, j, way] + off_x, cells.y[i, j, way] + off_y, 2 * cells.theta_d[i], alpha)
            if not np.all(shown[2]):
                break  # the sum over points is exact only where light ends nowhere in it
            disc = np.abs(RADIUS * 0.04 * (shown[1] - np.cos(FOCUS)) / 2)
            largest = max(largest, disc.max())
            directions.append(
                np.sum(kernel(own_x, own_y, SIGMA, 0.5, disc) * shown[0]) / per_px**2 / cells.cos_i[i, j, way]
            )
        else:
            truth[i, j] = np.mean(directions)
            if len(truth) == 8:
                break
    assert len(truth) == 8
    assert largest > 0.4
    compared = np.zeros(cells.valid.shape, bool)
    compared[tuple(np.transpose(list(truth)))] = True
    table = measured(GGX(alpha), rig, cells._replace(valid=compared))
    for (i, j), value in truth.items():
        assert found[i, j] == pytest.approx(value, rel=5e-5, abs=1e-7 * np.nanmax(found[i]))
        assert table[i, j] == pytest.approx(value, rel=5e-5, abs=1e-7 * np.nanmax(found[i]))


@pytest.mark.slow
def test_a_free_aperture_follows_the_discs():
    """Between the points of its axis a record is that of a rig with this aperture."""
    axis, workspace = free_axis("aperture", RIG), Workspace()
    cells, operator = lobe_operator(RIG, "centre", 30, (axis,), workspace)
    coordinate = 0.6 * axis.high
    _, there = lobe_operator(rig_with(RIG, {"aperture": axis.value(coordinate)}), "centre", 30, (), workspace)
    found = np.asarray(operator.record(GGX(0.03), "smith", np.array([coordinate])))
    truth, before = (np.asarray(one.record(GGX(0.03), "smith", np.zeros(len(one.axes)))) for one in (there, operator))
    change, error = (np.abs(a - truth)[cells.valid].max() for a in (before, found))
    assert error < 0.02 * change
