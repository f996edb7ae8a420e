"""Other maskings of a lobe, and the departure of a lobe from its family. The oracle gives the truth."""

import numpy as np
import pytest

from matcam.inverse import FitSetup
from matcam.inverse.correction.evidence import independent_share
from matcam.inverse.correction.other_maskings import MOST_LINEAR as KAPPA
from matcam.inverse.correction.other_maskings import other_maskings
from matcam.inverse.correction.spline_lobe import in_all_slices, learned_spline
from matcam.material.masking import MASKINGS
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor


def fitted(lobe, slice_step=18, **more):
    shot = recorded.made(slice_step, oracle.Setup())
    directions = shot.rule.directions(lobe) * conductor(shot.cells.theta_d, *recorded.CHROMIUM)[:, None, None]
    table = shot.table(shot.rule.noisy(directions, np.random.default_rng(8)))
    setup = FitSetup((table,), recorded.rig(), "ggx", fresnel="free", diffuse=True, slice_step=slice_step)
    return setup, setup.with_(**more).solve()


def test_a_narrow_lobe_does_not_show_its_masking():
    """Its facets hide none: every masking is as probable as the others, and none changes the lobe."""
    _, found = fitted(oracle.GGX(0.003))
    others = other_maskings(found, KAPPA)
    assert len(others) == len(MASKINGS) - 1
    for other in others:
        assert other.weight**2 == pytest.approx(1 / len(MASKINGS), abs=0.01)
        assert abs(other.coordinates.lobe[0] - found.coordinates.lobe[0]) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.05, 0.2])
def test_other_maskings_are_what_fits_with_them_find(alpha):
    """The linear problem against a search of its own: the lobe, and by how much the data become less probable."""
    setup, found = fitted(oracle.GGX(alpha))
    shares = [1.0]
    for other in other_maskings(found, KAPPA):
        masking = other.coordinates.kind.masking
        searched = setup.with_(masking=masking, noise=found.noise).solve(start=found, weights="start")
        given = setup.with_(noise=found.noise).solve(start=found, weights="start")
        moved, asked = (one.lobe[0] - found.coordinates.lobe[0] for one in (other.coordinates, searched.coordinates))
        less = KAPPA * (searched.misfit * searched.freedom - given.misfit * given.freedom) / 2
        print(
            f"{masking}, alpha {alpha}: ln alpha moves by {moved:.5f}, a search's by {asked:.5f}; {less:.3f} less probable"
        )
        if less < 5:  # what is excluded counts for nothing, wherever a linear step leads
            # 0.1 % of the roughness is 0.2 % of a peak: a 25th of what a supported entry leaves open
            assert moved == pytest.approx(asked, rel=0.15, abs=1e-3)
        shares.append(np.exp(-less))
    expected = np.array(shares) / sum(shares)
    np.testing.assert_allclose(
        [other.weight**2 for other in other_maskings(found, KAPPA)], expected[1:], rtol=0.3, atol=0.03
    )


@pytest.mark.slow
def test_a_spline_is_as_smooth_as_the_lobe():
    """Tails bend GGX by some tenths between knots. A bend that may be anything learns that from few slices, and is known
    better in all of them: its errors stay within what it says."""
    lobe = oracle.Tails(0.006, 3.0)
    setup, _ = fitted(lobe, slice_step=6)
    few_setup = setup.with_(slice_step=18, spline=1.0)
    few = few_setup.solve(start=setup.with_(slice_step=18).solve())
    learned = learned_spline(few, 1.0)
    whole, whole_setup = in_all_slices(few, few_setup, 6)
    assert whole_setup.learned_spline == learned
    width = recorded.half_width(lobe)
    print(
        f"learned spline {learned:.3f}; half width off by {few.hwhm / width - 1:+.4f} +- {few.hwhm_std / width:.4f} in few"
    )
    print(f"slices, {whole.hwhm / width - 1:+.4f} +- {whole.hwhm_std / width:.4f} in all")
    assert 0.03 <= learned < 0.7
    assert whole.hwhm_std < few.hwhm_std / 1.2
    assert abs(whole.hwhm - width) < 3 * whole.hwhm_std


def test_residuals_of_a_wrong_family_are_not_independent():
    """Noise alone leaves independent residuals; the misfit of a family with other tails is shared by neighbouring cells."""
    shares = [independent_share(fitted(lobe)[1]) for lobe in (oracle.GGX(0.05), oracle.Tails(0.05, 1.6))]
    assert shares[0] > 0.75
    assert shares[1] < 0.3
