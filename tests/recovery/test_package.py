"""The rigs by which the package enters: what a case states, and the true lens."""

import numpy as np
import pytest
import xarray as xr
from benchmarks.recovery import cases, package

import matcam


@pytest.fixture
def rig_of(monkeypatch):
    """Rig that a method gives to `matcam.correct` in a case."""
    given = []
    names = ("brdf", "brdf_std", "supported")
    monkeypatch.setattr(
        matcam, "correct", lambda brdf, rig: given.append(rig) or xr.Dataset(dict.fromkeys(names, xr.DataArray(0.0)))
    )

    def call(method, case):
        package.PACKAGE[method](np.zeros((90, 90, 180, 3)), case, cases.stated(case))
        return given[-1]

    return call


@pytest.mark.parametrize("case", cases.PUBLIC, ids=lambda case: case.name)
def test_the_stated_rig(rig_of, case):
    rig = rig_of("matcam", case)
    assert float(rig.sample.radius) == 256
    if case.mtf:
        assert float(rig.camera.optics.mtf(0.3)) == pytest.approx(case.mtf[1][2])
    elif case.table.stated:
        sigma, known = case.table.stated
        assert float(rig.camera.optics.sigma) == sigma
        assert rig.camera.uncertainty.std() == pytest.approx({"optics.sigma_px": sigma * known})
        assert rig.cell_value == (case.rule if case.rule_stated else "unknown")
    else:
        assert repr(rig) == repr(matcam.rigs.merl())


@pytest.mark.parametrize("case", cases.PUBLIC, ids=lambda case: case.name)
def test_the_true_rig(rig_of, case):
    rig = rig_of("matcam, true lens", case)
    for f in (0.1, 0.5, 1.03):
        assert float(rig.camera.optics.mtf(f)) == pytest.approx(
            float(cases.mean_mtf(case.table.setup, [f])[0]), abs=1e-6
        )
    assert rig.cell_value == case.rule
    assert rig.pixel_phase == (None if case.rule == "centre" else case.phase)
