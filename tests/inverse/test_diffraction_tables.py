"""Tables through a lens that is limited by diffraction: the fits' operator against Airy's pattern itself (tests/oracle).

The lens is a sum of Gaussians there, of many widths, and a rule has nodes for its core, for what surrounds it and for its
tails."""

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, DiffractionOptics, Rig, Sphere
from matcam.core.workspace import Workspace
from matcam.inverse.operator.lobe_operator import lobe_operator
from tests.oracle.airy_record import recorded_way

SLICE = 1
"""Of three: theta_d is 45.5 degrees."""


def errors(f_number, alphas, places):
    """Errors over the peak of the cells closest to some distances from the highlight, px: (alphas, places)."""
    lens = DiffractionOptics(f_number, 550e-9, 6.7e-6)
    cells, operator = lobe_operator(Rig(Camera(lens, BoxPixel()), Sphere(256.0)), "centre", 30, (), Workspace())
    away = np.where(cells.valid[SLICE], 256.0 * cells.theta_h[SLICE], np.inf)
    chosen = [int(np.argmin(np.abs(away - place))) for place in places]
    found = []
    for alpha in alphas:
        recorded = np.asarray(operator.record(GGX(alpha), "smith", np.zeros(0)))[SLICE, chosen]
        truth = [
            np.mean(
                [
                    recorded_way(
                        cells.theta_h[SLICE, j], cells.theta_d[SLICE], cells.phi_d[SLICE, j] + turn, alpha,
                        float(lens.cutoff),
                    )
                    for turn in (0, np.pi)
                ]
            )
            for j in chosen
        ]  # fmt: skip
        found.append((recorded - truth) / truth[0])
        print(f_number, alpha, np.round(away[chosen], 1), "px:", found[-1])
    return np.abs(found)


def test_a_lens_of_many_widths():
    assert errors(8.0, [0.003], [0.0, 2.5]).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("f_number", "narrow"), [(2.8, 2e-4), (8.0, 4e-4), (16.0, 6e-4)])
def test_lenses_from_open_to_closed(f_number, narrow):
    """1e-4 of the peak for a lobe of 5 px, twice that for 0.8 px; for a quarter of a pixel what sums of Gaussians err by."""
    found = errors(f_number, [0.001, 0.003, 0.02], [0.0, 1.0, 2.5, 6.0, 12.0])
    np.testing.assert_array_less(found.max(axis=1), [narrow, 2e-4, 1e-4])
