"""Lobes of no family: mixtures of two - a coat over a base, facets of two finishes - and Student's t. Truth is the oracle's."""

import numpy as np
import pytest

from matcam import Microfacet
from matcam.core.errors import ArgumentError
from matcam.core.grid import brdf_table
from matcam.inverse import Correction, FitSetup
from matcam.inverse.fit.fit_parameters import TWO_LOBES
from tests.inverse import recorded
from tests.inverse.test_correction import SLICES, Shot
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor


def beckmann(alpha):
    return oracle.EPD(alpha, 1.0)


MIXTURES = {
    "GGX 0.003 (70 %), GGX 0.018": oracle.Lobes(((0.7, oracle.GGX(0.003)), (0.3, oracle.GGX(0.018)))),
    "GGX 0.005 (70 %), Beckmann 0.02": oracle.Lobes(((0.7, oracle.GGX(0.005)), (0.3, beckmann(0.02)))),
    "Beckmann 0.01 (70 %), GGX 0.05": oracle.Lobes(((0.7, beckmann(0.01)), (0.3, oracle.GGX(0.05)))),
    "GGX 0.01 (70 %), GGX 0.06": oracle.Lobes(((0.7, oracle.GGX(0.01)), (0.3, oracle.GGX(0.06)))),
    "coat: Beckmann 0.002 (30 %), GGX 0.1": oracle.Lobes(((0.3, beckmann(0.002)), (0.7, oracle.GGX(0.1)))),
    "coat: GGX 0.004 (50 %), Beckmann 0.2": oracle.Lobes(((0.5, oracle.GGX(0.004)), (0.5, beckmann(0.2)))),
}
TAILS = {
    "Student's t 0.005, g 2.7": oracle.Tails(0.005, 2.7),
    "Student's t 0.01, g 1.7": oracle.Tails(0.01, 1.7),
}


def test_two_lobes_are_found_and_read_by_their_half_width():
    """Where GGX and EPD leave 20 % of noise, two lobes leave the 1 % that there is."""
    lobe = MIXTURES["GGX 0.005 (70 %), Beckmann 0.02"]
    shot = recorded.made(18, oracle.Setup())
    directions = shot.rule.directions(lobe) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    table = shot.table(shot.rule.noisy(directions, np.random.default_rng(8)))
    found = FitSetup((table,), recorded.rig(), TWO_LOBES, fresnel="free", diffuse=True, slice_step=18).solve()
    width = recorded.half_width(lobe)
    print(f"half width {found.hwhm:.6f} +- {found.hwhm_std:.6f}, true {width:.6f}; noise {found.noise.relative:.4f}")
    assert abs(found.hwhm - width) < 4 * found.hwhm_std < 0.05 * width
    assert found.noise.relative == pytest.approx(0.01, rel=0.3)
    assert found.determined
    assert list(found.params)[:3] == ["hwhm_rad", "tail_exponent", "haze_share"]
    assert isinstance(found.material, Microfacet)


def test_nobody_chooses_two_lobes_by_name():
    with pytest.raises(ArgumentError, match="ndf must be"):
        Correction.of(brdf_table(np.full((90, 90, 180, 3), 0.1), "centre"), recorded.rig(), TWO_LOBES)


@pytest.fixture(scope="module")
def shot():
    return Shot()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*MIXTURES, *TAILS])
def test_a_lobe_of_no_family_is_given_back(shot, name):
    """The lens is known to 3 %. Bars are no more than five times the errors, and no less than these."""
    table, truth = shot.table((MIXTURES | TAILS)[name], 3)
    done = Correction.of(table, recorded.rig(std=0.015))
    value, std, supported = shot.read(done)
    raw = table.values[shot.i, np.array(SLICES)[:, None], shot.k, 0]
    peak = (shot.i <= 2) & (truth > 1e-9) & np.isfinite(std)
    error, bar = value[peak] / truth[peak] - 1, std[peak] / value[peak]
    rms = np.sqrt(np.mean(error**2))
    print(
        f"{name}: {done.fit.lobe_name}, before {np.median(raw[peak] / truth[peak] - 1):+.2f}, rms error {rms:.4f}, "
        f"worst {np.abs(error).max():.3f}, std {np.median(bar):.4f}, supported {supported[peak].mean():.2f}, "
        f"noise {done.shape.noise.relative:.4f}"
    )
    assert supported[peak].mean() > 0.9
    assert rms < 0.02
    assert np.median(bar) < 5 * rms
    assert np.mean(np.abs(error) > 3 * bar) < 0.01
    known = (truth > 1e-3 * truth.max()) & np.isfinite(std)
    assert 0.3 < np.sqrt(np.mean(((value - truth)[known] / std[known]) ** 2)) < 1.2
