"""Two mirror balls: made-up lamps at a finite distance, and the published directions of a real pair."""

import numpy as np
import pytest

from matcam.acquisition.lamps.two_probes import compare_probes
from matcam.acquisition.mirror_ball import unit
from matcam.core.errors import ArgumentError


def lamps():
    rng = np.random.default_rng(0)
    return 60.0 * unit(rng.normal(size=(12, 3)) * [0.3, 0.3, 0] + np.array([0, 0, 1.0]))


def test_lamps_at_a_finite_distance_explain_two_probes():
    moved = np.array([2.0, -1.0, 0.5])
    found = compare_probes(lamps(), lamps() - moved)
    assert found.rms > np.radians(1)
    assert found.left < np.radians(0.05)
    assert found.displacement == pytest.approx(moved / 60, rel=0.1)
    assert [remark.code for remark in found.remarks] == ["probes-near-lamps"]
    assert compare_probes(lamps(), lamps()).remarks == ()


def test_scatter_is_not_explained():
    rng = np.random.default_rng(1)
    found = compare_probes(lamps(), unit(unit(lamps()) + rng.normal(0, 0.02, (12, 3))))
    assert [remark.code for remark in found.remarks] == ["probes-disagree"]
    with pytest.raises(ArgumentError, match="the same lamps"):
        compare_probes(lamps(), lamps()[:5])


def test_psbox_probes_are_explained_in_part(real_data):
    """0.41 to 1.75 degrees apart. One distance takes most of it away, and leaves half a degree: not explained."""
    folder = real_data / "captures" / "psbox"
    first, second = (np.loadtxt(folder / f"LightProbe-{k}" / "light_directions.txt").T for k in (1, 2))
    found = compare_probes(first, second)
    assert np.degrees([found.apart.min(), found.apart.max()]) == pytest.approx([0.41, 1.75], abs=0.01)
    assert np.degrees([found.rms, found.left, found.left_by_turn]) == pytest.approx([1.04, 0.48, 0.58], abs=0.01)
    assert [remark.code for remark in found.remarks] == ["probes-disagree"]
