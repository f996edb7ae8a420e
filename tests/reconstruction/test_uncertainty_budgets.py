"""Uncertainty budgets of a reconstruction: they state its uncertainty, and a stated value moves the result as they say."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from matcam.core.errors import ArgumentError
from matcam.reconstruction.from_capture import reconstruct
from tests.oracle.capture import METALS, Sensor, draw
from tests.oracle.sphere_picture import Surface, View

VIEW = View(radius=80.0, column=109.6, row=110.3, shape=(220, 220))
ANGLES = np.radians([8, 25, 40, 55, 78])
N, K = METALS["Cr"][0][1], METALS["Cr"][1][1]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def capture():
    """Capture whose lens is known to 0.1 %, as well as the photographs determine it."""
    surface = Surface("ggx", 0.02, n=(N,), k=(K,))
    drawn = draw(surface, VIEW, ANGLES, azimuth=0.4, sensor=Sensor(cfa=None), reference="diffuse", seed=5)
    known = {"parameters": ["optics.sigma_px"], "covariance": [[0.0005**2]]}
    return replace(drawn, profile={**drawn.profile, "uncertainty": known})


@pytest.fixture(scope="module")
def found(capture, tmp_path_factory):
    return reconstruct(capture.write(tmp_path_factory.mktemp("capture")), "ggx")


def test_a_budget_is_the_stated_uncertainty(found):
    budgets = {one.name: one for one in found.uncertainty_budgets()}
    stated = {**found.parameters, **found.lengths}
    (channel,) = found.fit.channels
    ratio = found.ratio(np.radians(75))
    stated[f"F(75 deg) / F(10 to 45 deg), {channel}"] = (ratio.value, ratio.std)
    assert set(found.parameters) < set(budgets)
    judged = set(budgets) & set(stated)
    assert {"alpha", "sigma_px", "outline_radius_px", "camera_distance_radii"} < judged
    for name in judged:
        assert budgets[name].value == pytest.approx(stated[name][0], rel=1e-12)
        assert budgets[name].combined == pytest.approx(stated[name][1], rel=1e-6)
    level = budgets[f"F(10 to 45 deg), {channel}"]
    assert level.combined / level.value == pytest.approx(found.budget["total"]["level"], rel=1e-6)
    assert found.uncertainty_budget("alpha").to_dict() == budgets["alpha"].to_dict()
    with pytest.raises(ArgumentError, match="no result 'beta'"):
        found.uncertainty_budget("beta")


def test_a_stated_lens_moves_the_result_by_its_sensitivity(capture, found, tmp_path):
    """The same pictures with another lens in the profile."""
    step, values = 0.001, []
    for sign in (1, -1):
        stated = copy.deepcopy(capture.profile)
        stated["optics"]["sigma_px"] += sign * step
        folder = replace(capture, profile=stated).write(tmp_path / str(sign))
        values.append(reconstruct(folder, "ggx").parameters)
    for name in ("alpha", "sigma_px"):
        (lens,) = [one for one in found.uncertainty_budget(name).sources if one.name.startswith("lens")]
        assert lens.value == pytest.approx(capture.profile["optics"]["sigma_px"])
        moved = (values[0][name][0] - values[1][name][0]) / (2 * step)
        negligible = 0.01 * found.uncertainty_budget(name).combined / lens.uncertainty
        assert lens.sensitivity == pytest.approx(moved, rel=0.02, abs=negligible)
    assert lens.contribution > 0.5 * found.uncertainty_budget("sigma_px").combined
